//! Real recordings, read from `../shared/data` beside the project where it is there (or `LACUNA_SHARED_DATA`).
//! The expected counts were taken from the files with Python's `csv` module.

use lacuna_interfaces::RepairKind;
use lacuna_recording::{LoadedRobot, load_robot, read_all};
use std::path::{Path, PathBuf};

fn data() -> Option<PathBuf> {
    let beside = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data");
    let folder = std::env::var_os("LACUNA_SHARED_DATA").map_or(beside, PathBuf::from);
    if folder.is_dir() {
        return Some(folder);
    }
    eprintln!("SKIPPED: no folder {}", folder.display());
    None
}

fn recordings(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path());
    let mut files: Vec<_> = entries.filter(|p| p.extension().is_some_and(|e| e == "csv")).collect();
    files.sort();
    files
}

fn robot(folder: &Path) -> LoadedRobot {
    load_robot(folder.join("robot.toml")).unwrap()
}

/// Samples and repairs of all recordings of a folder but those whose name begins with `except`.
fn totals(folder: &Path, except: &str) -> (usize, usize, u64) {
    let robot = robot(folder);
    let (mut files, mut samples, mut repairs) = (0, 0, 0);
    for path in recordings(folder) {
        if path.file_name().unwrap().to_str().unwrap().starts_with(except) {
            continue;
        }
        let r = read_all(&path, &robot.file).unwrap();
        assert!(r.t_s.windows(2).all(|w| w[0] < w[1]), "{path:?}");
        assert!(r.extra.values().all(|column| column.len() == r.len()));
        files += 1;
        samples += r.len();
        repairs += r.repairs.iter().map(|r| r.count).sum::<u64>();
    }
    (files, samples, repairs)
}

#[test]
fn every_recording_reads_with_the_samples_it_holds() {
    let Some(data) = data() else { return };
    for (folder, except, expected) in [
        ("bam_xl330", "-", (16, 19_452, 0)),
        ("dfki_double_pendulum", "-", (10, 64_393, 1)),
        ("kinova_gen3", "-", (3, 8_977, 0)),
        ("kuka_kr300", "-", (3, 7_503, 0)),
        ("odrive_cogging", "map_", (10, 82_547, 0)),
        ("staubli_tx40", "TX40_bp", (1, 45_000, 0)),
    ] {
        assert_eq!(totals(&data.join(folder), except), expected, "{folder}");
    }
}

#[test]
fn every_delta_case_reads() {
    let Some(data) = data() else { return };
    let cases: Vec<_> = std::fs::read_dir(data.join("delta_concealed/cases")).unwrap().collect();
    assert!(!cases.is_empty());
    for case in cases {
        let (files, samples, repairs) = totals(&case.unwrap().path(), "-");
        assert_eq!((files, samples, repairs), (6, 6 * 4_999, 0));
    }
}

#[test]
fn the_friction_file_begins_with_a_repeated_stamp() {
    let Some(data) = data() else { return };
    let folder = data.join("dfki_double_pendulum");
    let path = recordings(&folder).into_iter().find(|p| p.to_str().unwrap().contains("friccomp")).unwrap();
    let r = read_all(&path, &robot(&folder).file).unwrap();
    assert_eq!((r.len(), r.repairs.len()), (2495, 1));
    assert_eq!((r.repairs[0].kind, r.repairs[0].signal.as_str()), (RepairKind::DuplicateStamp, "t"));
    assert_eq!(r.tau_nm[1][0], 0.231131, "the first of the two rows is kept");
}

#[test]
fn named_columns_arrive() {
    let Some(data) = data() else { return };
    let kuka = data.join("kuka_kr300");
    let robot_file = robot(&kuka).file;
    let mut reader = lacuna_recording::open(kuka.join("traj_A.csv"), &robot_file).unwrap();
    let m = reader.next_sample().unwrap().unwrap().measured;
    assert_eq!((m.link_q_rad[0], m.link_q_rad[2]), (-0.0003634794, 0.0007282336));
    assert!(m.link_q_rad[3].is_nan() && m.temperature_degc[0].is_nan());
    let kinova = data.join("kinova_gen3");
    let loaded = robot(&kinova);
    assert!(loaded.urdf.unwrap().contains("<robot"));
    let r = read_all(kinova.join("RunTrajectory1.csv"), &loaded.file).unwrap();
    assert_eq!((r.extra["x_temp1"][0], r.extra["x_velocity7"].len()), (33.8463, 1942));
}

#[test]
fn maps_without_time_are_refused_in_words() {
    let Some(data) = data() else { return };
    let folder = data.join("odrive_cogging");
    let path = recordings(&folder).into_iter().find(|p| p.to_str().unwrap().contains("map_")).unwrap();
    let e = read_all(&path, &robot(&folder).file).unwrap_err();
    assert_eq!(e.line, Some(1));
    assert!(e.what.contains("found columns q1, tau1; expected also t"), "{e}");
}
