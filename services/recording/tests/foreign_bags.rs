//! Bags that other software wrote: `rosbags`, in Python (named by `LACUNA_TEST_PYTHON`).

use lacuna_interfaces::RobotFile;
use lacuna_recording::{ReadOptions, TimeSource, inspect, open, open_with, read_all_with};
use std::path::Path;
use std::process::Command;

fn robot(joints: &str) -> RobotFile {
    RobotFile::parse(&format!("kind = \"serial\"\nname = \"arm\"\njoints = [{joints}]\n[[dh]]\n[[dh]]\n")).unwrap()
}

fn bags() -> Option<tempfile::TempDir> {
    let Ok(python) = std::env::var("LACUNA_TEST_PYTHON") else {
        eprintln!("SKIPPED: LACUNA_TEST_PYTHON names no Python with rosbags");
        return None;
    };
    let dir = tempfile::tempdir().unwrap();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/oracles/write_bag.py");
    let output = Command::new(python).arg(script).arg(dir.path()).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    Some(dir)
}

#[test]
fn joints_are_matched_by_name_in_bags_of_others() {
    let Some(dir) = bags() else { return };
    let arm = robot("\"shoulder\", \"elbow\"");
    let start = 1_700_000_000_000_000_000_i64;
    for (time, late) in [(TimeSource::Auto, 0), (TimeSource::Header, 0), (TimeSource::Log, 1_000_000)] {
        let options = ReadOptions { time, ..ReadOptions::default() };
        let mut reader = open_with(dir.path().join("arm"), &arm, &options).unwrap();
        assert_eq!(reader.about().topic.as_deref(), Some("/joint_states"));
        assert_eq!(reader.about().ignored, ["/diagnostics"]);
        let mut k = 0;
        while let Some(sample) = reader.next_sample().unwrap() {
            let m = &sample.measured;
            let angle = 0.1 * k as f64;
            assert_eq!(m.header.stamp_ns, start + k * 2_000_000 + late);
            assert!((m.q_rad[0] - angle.sin()).abs() < 1e-15 && (m.q_rad[1] - angle.cos()).abs() < 1e-15);
            assert!((m.tau_nm[0] - 3.0 * angle.sin()).abs() < 1e-15);
            assert_eq!(m.tau_nm[1], k as f64);
            k += 1;
        }
        assert_eq!(k, 200, "the gripper's messages are passed over");
        assert!(reader.repairs().is_empty());
    }
    let whole = read_all_with(dir.path().join("arm"), &arm, &ReadOptions::default()).unwrap();
    assert_eq!((whole.t_s[0], whole.t_s[199]), (0.0, 0.398));
}

#[test]
fn stamps_of_zero_fall_back_to_the_log_time() {
    let Some(dir) = bags() else { return };
    let mut reader = open(dir.path().join("unstamped"), &robot("\"shoulder\", \"elbow\"")).unwrap();
    let mut last = 0;
    while let Some(sample) = reader.next_sample().unwrap() {
        last = sample.measured.header.stamp_ns;
    }
    assert_eq!(last, 1_700_000_000_000_000_000 + 199 * 2_000_000);
}

#[test]
fn doubt_is_an_error_in_words() {
    let Some(dir) = bags() else { return };
    let arm = dir.path().join("arm");
    for (path, joints, topic, expect) in [
        (&arm, "\"j1\", \"j2\"", None, "found joints wheel, elbow, shoulder, finger on /joint_states; expected j1, j2"),
        (&arm, "\"shoulder\", \"wrist\"", None, "message 1 of /joint_states: found joints wheel, elbow, shoulder"),
        (&arm, "\"finger\", \"thumb\"", None, "message 2 of /joint_states: found joints finger; expected also thumb"),
        (&arm, "\"shoulder\", \"elbow\"", Some("/diagnostics"), "no JointState topic /diagnostics"),
        (&dir.path().join("two"), "\"shoulder\", \"elbow\"", None, "topics /left, /right; expected the choice of one"),
        (&dir.path().to_path_buf(), "\"shoulder\", \"elbow\"", None, "found a folder with 0 .mcap files"),
    ] {
        let options = ReadOptions { topic: topic.map(str::to_owned), ..ReadOptions::default() };
        let e = open_with(path, &robot(joints), &options).unwrap_err().to_string();
        assert!(e.contains(expect), "{e}");
    }
    let options = ReadOptions { topic: Some("/right".to_owned()), ..ReadOptions::default() };
    assert!(open_with(dir.path().join("two"), &robot("\"elbow\", \"shoulder\""), &options).is_ok());
}

#[test]
fn inspection_lists_what_is_there() {
    let Some(dir) = bags() else { return };
    let file = std::fs::read_dir(dir.path().join("arm")).unwrap().map(|e| e.unwrap().path());
    let file = file.into_iter().find(|p| p.extension().is_some_and(|e| e == "mcap")).unwrap();
    let info = inspect(file).unwrap();
    assert_eq!(info.profile, "ros2");
    assert_eq!(info.topics["/joint_states"].messages, 400);
    assert_eq!(info.topics["/joint_states"].schema, "sensor_msgs/msg/JointState");
    assert_eq!(info.topics["/diagnostics"].messages, 200);
    assert!(!info.was_cut && !info.is_complete(), "not a recording of ours");
}
