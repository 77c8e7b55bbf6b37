//! Real recordings, irregular and spoilt as they are (../shared/data beside the project, or LACUNA_SHARED_DATA).

use lacuna_interfaces::{JointMeasured, JointSmoothed, Recording, RobotFile, Stage, StageContext, flag};
use lacuna_smoother::{Config, Smoother, smooth_recording};
use std::path::{Path, PathBuf};

fn data() -> Option<PathBuf> {
    let root = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../..");
    let data = std::env::var_os("LACUNA_SHARED_DATA").map_or_else(|| root.join("../shared/data"), PathBuf::from);
    if data.join("dfki_double_pendulum").is_dir() {
        return Some(data);
    }
    eprintln!("SKIPPED: no recordings at {}", data.display());
    None
}

fn robot(folder: &Path) -> RobotFile {
    RobotFile::parse(&std::fs::read_to_string(folder.join("robot.toml")).unwrap()).unwrap()
}

/// Columns `t`, `q1`… and the named extra ones; rows that do not parse, repeat their time or jump are left out,
/// as a reader would do or refuse (the reader has tests of its own).
fn read(file: &Path, joints: usize, extra: &[&str]) -> (Recording, Vec<Vec<f64>>) {
    let text = std::fs::read_to_string(file).unwrap();
    let mut lines = text.lines();
    let header: Vec<&str> = lines.next().unwrap().split(',').map(str::trim).collect();
    let place = |name: &str| header.iter().position(|h| *h == name).unwrap();
    let names: Vec<String> = (1..=joints).map(|j| format!("q{j}")).collect();
    let columns: Vec<usize> = names.iter().map(|n| place(n)).chain(extra.iter().map(|n| place(n))).collect();
    let mut recording = Recording { q_rad: vec![Vec::new(); joints], joints: names, ..Recording::default() };
    let mut others = vec![Vec::new(); extra.len()];
    for line in lines {
        let Ok(v) = line.split(',').map(|v| v.trim().parse::<f64>()).collect::<Result<Vec<f64>, _>>() else { continue };
        let later = recording.t_s.last().is_none_or(|t| v[0] > *t && v[0] < t + 10.0);
        if v.len() != header.len() || !later || columns.iter().any(|c| v[*c].abs() > 1e4) {
            continue;
        }
        recording.t_s.push(v[0]);
        for (list, c) in recording.q_rad.iter_mut().chain(&mut others).zip(&columns) {
            list.push(v[*c]);
        }
    }
    (recording, others)
}

fn stream(robot: &RobotFile, recording: &Recording) -> Vec<JointSmoothed> {
    let mut stage = Smoother::new(Config::default(), &StageContext { robot, urdf: None, model: None }).unwrap();
    let mut out = Vec::new();
    for (k, t) in recording.t_s.iter().enumerate() {
        let mut m = JointMeasured::default();
        m.header.seq = k as u64 + 1;
        m.header.stamp_ns = (t * 1e9).round() as i64;
        recording.q_rad.iter().enumerate().for_each(|(j, q)| m.q_rad[j] = q[k]);
        stage.step(&m, &mut |o| out.push(*o));
    }
    stage.finish(&mut |o| out.push(*o));
    out
}

#[test]
fn every_recording_passes_stream_and_offline_alike() {
    let Some(data) = data() else { return };
    for (folder, file) in [
        ("dfki_double_pendulum", "design_A.0_20220812_20220812-061157-PM_measured.csv"),
        ("bam_xl330", "xl330_kp200_lift_and_drop_10h28m49.csv"),
        ("odrive_cogging", "slow2_nocomp_0.csv"),
        ("staubli_tx40", "tx40_traj.csv"),
        ("kuka_kr300", "traj_B.csv"),
        ("kinova_gen3", "opti_traj_testing1.csv"),
    ] {
        let robot = robot(&data.join(folder));
        let n = robot.joint_count();
        let (recording, _) = read(&data.join(folder).join(file), n, &[]);
        assert!(recording.len() > 1000, "{file}");
        let out = stream(&robot, &recording);
        assert_eq!(out.len(), recording.len(), "{file}");
        let whole = smooth_recording(&recording, &Config::default(), &robot, None).unwrap();
        // A lag of four time constants leaves a few hundredths of the filter's error.
        let (mut off, mut size) = (vec![0.0; n], vec![0.0; n]);
        for (k, o) in out.iter().enumerate() {
            assert_eq!(o.header.seq, k as u64 + 1, "{file}");
            for j in 0..n {
                assert!(o.qdd_rad_s2[j].is_finite() && o.sd_qdd_rad_s2[j] > 0.0, "{file} sample {k}");
                if o.header.flags & flag::SHORT_LAG == 0 {
                    off[j] += (o.qd_rad_s[j] - whole.qd_rad_s[j][k]).powi(2);
                    size[j] += whole.qd_rad_s[j][k].powi(2);
                }
            }
        }
        for j in 0..n {
            let ratio = (off[j] / size[j]).sqrt();
            assert!(ratio < 0.02, "{file} joint {}: {ratio:.4}", j + 1);
        }
    }
}

#[test]
fn velocity_agrees_with_what_the_servo_reports() {
    let Some(data) = data() else { return };
    let folder = data.join("bam_xl330");
    let robot = robot(&folder);
    for file in ["xl330_kp100_sin_sin_10h28m10.csv", "xl330_kp400_up_and_down_10h29m29.csv"] {
        let (recording, servo) = read(&folder.join(file), 1, &["x_qd"]);
        let config: Config = toml::from_str("process_noise = { bandwidth_hz = 12 }").unwrap();
        let smoothed = smooth_recording(&recording, &config, &robot, None).unwrap();
        // The servo's own velocity is a moving average and comes late: correlate at its best delay.
        let best = (0..12)
            .map(|late| {
                let n = recording.len() - late;
                let (a, b) = (&smoothed.qd_rad_s[0][..n], &servo[0][late..]);
                let dot = |x: &[f64], y: &[f64]| x.iter().zip(y).map(|(x, y)| x * y).sum::<f64>();
                dot(a, b) / (dot(a, a) * dot(b, b)).sqrt()
            })
            .fold(0.0, f64::max);
        assert!(best > 0.97, "{file}: correlation {best:.3}");
    }
}
