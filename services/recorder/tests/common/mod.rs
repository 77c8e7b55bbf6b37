//! A run of all streams with known numbers.

#![allow(dead_code, reason = "each test file uses a part of this")]

use lacuna_interfaces::{
    FrictionTorque, Header, JointMeasured, JointSmoothed, Joints, PayloadEstimate, ResidualWatch, RobotFile,
    TorqueModel, flag, region,
};
use lacuna_recorder::{Attachment, Config, Recorder, Run, Stream, WriteError};
use std::path::Path;

/// Topics of a recording without holes that have messages.
pub const TOPICS: [&str; 12] = [
    "/friction",
    "/measured",
    "/measured/detail",
    "/monitor",
    "/payload",
    "/residual",
    "/residual_payload",
    "/smoothed",
    "/smoothed/detail",
    "/status",
    "/torque/nominal",
    "/torque/rigid",
];

pub fn robot() -> RobotFile {
    RobotFile::parse(
        "kind = \"delta\"\nname = \"d\"\n[geometry]\nl1 = 0.35\nl2 = 0.88\nra = 0.2\nrb = 0.05\n[mass]\nplatform = 1.1\n\
         upper_arm = 1.8\nforearm_point = 0.22\n[columns]\ntemperature = [\"temp1\", \"temp2\", \"temp3\"]\n",
    )
    .unwrap()
}

pub fn config(path: &Path, more: &str) -> Config {
    toml::from_str(&format!("path = '{}'\n{more}", path.display())).unwrap()
}

pub fn run<'a>(robot: &'a RobotFile, streams: &'a [Stream]) -> Run<'a> {
    let text = |name: &str, data: &str| Attachment {
        name: name.to_owned(),
        media_type: "application/toml".to_owned(),
        data: data.as_bytes().to_vec(),
    };
    Run {
        robot,
        streams,
        branches: &[],
        resumed: false,
        live: false,
        attachments: vec![text("robot.toml", "kind = \"delta\""), text("graph.toml", "")],
        facts: [("source".to_owned(), "motion.csv".to_owned())].into(),
    }
}

/// The number that message `k` holds for joint `j` in list `which`: irregular, and exact in f64.
pub fn number(which: usize, k: u64, j: usize) -> f64 {
    ((k as f64 + 1.0) * (0.37 + which as f64)).sin() * 10.0_f64.powi(j as i32 - 1)
}

fn list(which: usize, k: u64) -> Joints {
    std::array::from_fn(|j| if j < 3 { number(which, k, j) } else { 0.0 })
}

pub fn header(k: u64) -> Header {
    let mut h = Header { seq: k + 1, stamp_ns: stamp(k), joints: 3, hops: 4, lag_ns: 5, ..Header::default() };
    h.hop_ns[..4].copy_from_slice(&[1000, 1100 + k, 1300 + k, 1600 + k]);
    h.flags = if k % 10 == 3 { flag::NOT_EXCITED } else { 0 };
    h
}

/// 1 kHz, starting at 0.
pub fn stamp(k: u64) -> i64 {
    k as i64 * 1_000_000
}

/// Sample `k` of every stream.
pub fn record(recorder: &mut Recorder, k: u64) -> Result<(), WriteError> {
    let header = header(k);
    let nan = [f64::NAN; 8];
    recorder.lane(0)?.measured(&JointMeasured {
        header,
        q_rad: list(0, k),
        tau_nm: list(1, k),
        temperature_degc: list(2, k),
        link_q_rad: nan,
        link_tau_nm: nan,
    })?;
    recorder.lane(0)?.smoothed(&JointSmoothed {
        header,
        q_rad: list(3, k),
        qd_rad_s: list(4, k),
        qdd_rad_s2: list(5, k),
        sd_q_rad: list(6, k),
        sd_qd_rad_s: list(7, k),
        sd_qdd_rad_s2: list(8, k),
        ..JointSmoothed::default()
    })?;
    recorder.lane(0)?.torque(&TorqueModel {
        header,
        tau_nominal_nm: list(9, k),
        tau_rigid_nm: list(10, k),
        ..TorqueModel::default()
    })?;
    recorder.lane(0)?.friction(&FrictionTorque {
        header,
        tau_friction_nm: list(11, k),
        ..FrictionTorque::default()
    })?;
    recorder.lane(0)?.payload(&PayloadEstimate {
        header,
        residual_nm: list(12, k),
        residual_payload_nm: list(13, k),
        mass_kg: number(14, k, 1),
        sd_mass_kg: number(15, k, 1),
        ..PayloadEstimate::default()
    })?;
    recorder.lane(0)?.watch(&ResidualWatch {
        header,
        residual_nm: list(16, k),
        sd_nm: list(17, k),
        score: list(18, k),
        since_ns: [stamp(k), stamp(k / 2), 0, 0, 0, 0, 0, 0],
        region_low: list(19, k),
        region_high: list(20, k),
        region_variable: [region::VELOCITY, region::LOAD, region::TIME, 0, 0, 0, 0, 0],
        alarm: 0b001,
        watched: 0b101,
    })
}
