//! Recordings for the tests, written in each format.

#![allow(dead_code, reason = "each test file uses a part of this")]

use lacuna_interfaces::{JointMeasured, RobotFile, flag};
use lacuna_recording::container::{Compression, Writer, WriterOptions};
use lacuna_recording::topics::{Has, Topic};
use std::fmt::Write as _;
use std::path::Path;

/// Two revolute joints with temperatures, a link-side encoder on the first, and a drive switch.
pub fn robot() -> RobotFile {
    RobotFile::parse(
        "kind = \"serial\"\nname = \"arm\"\njoints = [\"shoulder\", \"elbow\"]\n[[dh]]\na = 0.3\n[[dh]]\na = 0.2\n\
         [columns]\ntemperature = [\"x_ta\", \"x_tb\"]\nlink_position = [\"x_enc\"]\nenabled = \"x_on\"\n",
    )
    .unwrap()
}

/// `n` samples of a smooth motion at 1 kHz.
pub fn motion(n: usize) -> Vec<JointMeasured> {
    (0..n).map(|k| sample(k as i64 * 1_000_000, (k as f64 * 0.01).sin(), (k as f64 * 0.013).cos())).collect()
}

pub fn sample(stamp_ns: i64, q1: f64, q2: f64) -> JointMeasured {
    let mut m = JointMeasured {
        temperature_degc: [f64::NAN; 8],
        link_q_rad: [f64::NAN; 8],
        link_tau_nm: [f64::NAN; 8],
        ..JointMeasured::default()
    };
    m.header.stamp_ns = stamp_ns;
    m.header.joints = 2;
    m.q_rad[..2].copy_from_slice(&[q1, q2]);
    m.tau_nm[..2].copy_from_slice(&[q1 * 3.0 + 0.1, q2 - 0.7]);
    m.temperature_degc[..2].copy_from_slice(&[25.0 + q1, 26.0]);
    m.link_q_rad[0] = q1 - 1e-3;
    if stamp_ns % 7_000_000 == 0 {
        m.header.flags = flag::DRIVE_OFF;
    }
    m
}

/// Writes samples as they are, in the format of this name.
pub fn write(format: &str, path: &Path, samples: &[JointMeasured]) {
    match format {
        "csv" => std::fs::write(path, csv(samples)).unwrap(),
        "mcap" => write_mcap(path, samples, &WriterOptions::default()),
        other => panic!("format {other} has no writer in the conformance suite; add one"),
    }
}

pub fn csv(samples: &[JointMeasured]) -> String {
    let mut text = "t,q1,q2,tau1,tau2,x_ta,x_tb,x_enc,x_on\n".to_owned();
    for m in samples {
        let (t, on) = (m.header.stamp_ns, u8::from(!m.header.has(flag::DRIVE_OFF)));
        let sign = if t < 0 { "-" } else { "" };
        let t = t.unsigned_abs();
        write!(text, "{sign}{}.{:09}", t / 1_000_000_000, t % 1_000_000_000).unwrap();
        let values = [m.q_rad[0], m.q_rad[1], m.tau_nm[0], m.tau_nm[1], m.temperature_degc[0], m.temperature_degc[1]];
        for v in values.into_iter().chain([m.link_q_rad[0]]) {
            write!(text, ",{v}").unwrap();
        }
        writeln!(text, ",{on}").unwrap();
    }
    text
}

pub fn write_mcap(path: &Path, samples: &[JointMeasured], options: &WriterOptions) {
    let joints = robot().joints;
    let mut writer = Writer::create(path, "ros2", options).unwrap();
    let detail = Topic::measured_detail(&mut writer, "/measured/detail", &joints).unwrap();
    let has = Has { position: true, velocity: false, effort: true };
    let measured = Topic::joint_state(&mut writer, "/measured", &joints, has).unwrap();
    for m in samples {
        let mut batch = writer.batch();
        detail.write(&mut batch, &m.header, |s| {
            s.numbers(&m.temperature_degc[..2])
                .numbers(&m.link_q_rad[..2])
                .numbers(&m.link_tau_nm[..2])
                .bytes(&[u8::from(!m.header.has(flag::DRIVE_OFF))])
                .done();
        });
        measured.write(&mut batch, &m.header, |s| s.numbers(&m.q_rad[..2]).numbers(&m.tau_nm[..2]).done());
        assert!(batch.end());
    }
    writer.finish().unwrap();
}

pub const COMPRESSIONS: [Compression; 3] = [Compression::None, Compression::Lz4, Compression::Zstd];
