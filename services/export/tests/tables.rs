//! Every table format over the same recording, read back by programs that share no code with this crate: pandas,
//! pyarrow, scipy (a Python with them is named by `LACUNA_TEST_PYTHON_TABLES`), rosbags and the `csv` crate.

#[path = "../../recorder/tests/common/mod.rs"]
mod common;

use common::{config, number, record, robot, run, stamp};
use lacuna_export::formats::FORMATS;
use lacuna_export::{Exported, Request, export};
use lacuna_recorder::{Recorder, Stream};
use lacuna_recording::LoadedRobot;
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Command;

/// More than the window holds in one go, and no multiple of a block.
const SAMPLES: u64 = 70_001;
const FEW: u64 = 1201;

fn recording(path: &Path, samples: u64) {
    let robot = robot();
    let mut recorder = Recorder::new(&config(path, ""), &run(&robot, &Stream::ALL)).unwrap();
    (0..samples).for_each(|k| record(&mut recorder, k).unwrap());
    assert!(recorder.finish().unwrap().lossless());
}

fn to(from: &Path, to: &Path) -> Exported {
    export(&request(from, to), &mut |_| {}).unwrap()
}

fn request<'a>(recording: &'a Path, to: &'a Path) -> Request<'a> {
    Request { recording, robot: None, topics: &[], from_s: 0.0, to_s: f64::INFINITY, to, force: false }
}

fn script(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/oracles").join(name)
}

fn python(variable: &str) -> Option<String> {
    let python = std::env::var(variable).ok();
    if python.is_none() {
        eprintln!("SKIPPED: {variable} names no Python with the readers");
    }
    python
}

fn read(python: &str, path: &Path) -> Value {
    let output = Command::new(python).arg(script("read_table.py")).arg(path).output().unwrap();
    assert!(output.status.success(), "{}: {}", path.display(), String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

/// A number as the readers print it.
fn float(value: &Value) -> f64 {
    match value {
        Value::Null => f64::NAN,
        Value::String(text) => text.parse().unwrap(),
        other => other.as_f64().unwrap(),
    }
}

/// Group, which number it holds (see the recorder's tests).
const LISTS: [(&str, usize, &str); 18] = [
    ("measured_q_rad", 0, "rad"),
    ("measured_tau_nm", 1, "Nm"),
    ("measured_temperature_degc", 2, "°C"),
    ("smoothed_q_rad", 3, "rad"),
    ("smoothed_qd_rad_s", 4, "rad/s"),
    ("smoothed_qdd_rad_s2", 5, "rad/s²"),
    ("smoothed_sd_q_rad", 6, "rad"),
    ("smoothed_sd_qd_rad_s", 7, "rad/s"),
    ("smoothed_sd_qdd_rad_s2", 8, "rad/s²"),
    ("torque_nominal_tau_nm", 9, "Nm"),
    ("torque_rigid_tau_nm", 10, "Nm"),
    ("friction_tau_nm", 11, "Nm"),
    ("residual_tau_nm", 12, "Nm"),
    ("residual_payload_tau_nm", 13, "Nm"),
    ("monitor_residual_nm", 16, "Nm"),
    ("monitor_sd_nm", 17, "Nm"),
    ("monitor_region_low", 19, ""),
    ("monitor_region_high", 20, ""),
];

fn check(found: &Value, what: &str) {
    let column = |name: &str| found["columns"][name].as_array().unwrap_or_else(|| panic!("{what}: {name}"));
    let joints = ["q1", "q2", "q3"];
    for (group, which, _) in LISTS {
        for (j, joint) in joints.iter().enumerate() {
            let values = column(&format!("{group}_{joint}"));
            assert_eq!(values.len() as u64, FEW, "{what} {group}");
            for (k, value) in values.iter().enumerate() {
                assert_eq!(float(value), number(which, k as u64, j), "{what} {group}_{joint} {k}");
            }
        }
    }
    for k in 0..FEW {
        let at = k as usize;
        let get = |name: &str| float(&column(name)[at]);
        let flag = |name: &str| match &column(name)[at] {
            Value::Bool(yes) => *yes,
            other => float(other) != 0.0,
        };
        assert_eq!(column("stamp_ns")[at], stamp(k), "{what}");
        assert_eq!(get("t_s"), k as f64 / 1000.0, "{what}");
        assert_eq!((get("payload_mass_kg"), get("payload_sd_mass_kg")), (number(14, k, 1), number(15, k, 1)));
        assert_eq!((flag("payload_excited"), flag("payload_step")), (k % 10 != 3, false));
        assert_eq!(
            (flag("monitor_alarm_q1"), flag("monitor_watched_q2"), flag("monitor_watched_q3")),
            (true, false, true)
        );
        assert_eq!((get("monitor_region_variable_q2"), get("monitor_since_s_q2")), (3.0, stamp(k / 2) as f64 * 1e-9));
        assert_eq!(
            (get("status_seq"), get("status_lag_ns"), get("status_hop_latency_ns_2")),
            ((k + 1) as f64, 5.0, 200.0)
        );
        assert_eq!(get("status_hop_latency_ns_1"), (100 + k) as f64);
    }
    let names: Vec<&String> = found["columns"].as_object().unwrap().keys().collect();
    assert!(!names.iter().any(|n| n.contains("link_q_rad")), "{what}: a column without a single value");
    // Three joints in 18 lists and score, watched, alarm, since, region variable; 4 of the payload; 5 and 3 of the status;
    // drive; time twice.
    assert_eq!(names.len(), 3 * (18 + 5) + 4 + 8 + 1 + 2, "{what}: {names:?}");
}

fn ascii(unit: &str) -> String {
    unit.replace('°', "deg").replace('²', "^2")
}

#[test]
fn every_format_holds_every_number() {
    let dir = tempfile::tempdir().unwrap();
    let from = dir.path().join("run.mcap");
    recording(&from, FEW);
    let python = python("LACUNA_TEST_PYTHON_TABLES");
    for format in FORMATS {
        let path = dir.path().join(format!("run.{}", format.extension));
        let exported = to(&from, &path);
        assert_eq!((exported.format, exported.rows, exported.late, exported.repeated), (format.name, FEW, 0, 0));
        assert_eq!(exported.bytes, std::fs::metadata(&path).unwrap().len());
        assert!(exported.left_out.is_empty() && !exported.was_cut);
        let Some(python) = &python else { continue };
        let found = read(python, &path);
        check(&found, format.name);
        if format.extension == "csv" {
            continue;
        }
        for (group, _, unit) in LISTS {
            let unit = if format.extension == "mat" { ascii(unit) } else { unit.to_owned() };
            assert_eq!(found["units"][group], unit, "{} {group}", format.name);
            assert_eq!(found["joints"][group], serde_json::json!(["q1", "q2", "q3"]), "{} {group}", format.name);
        }
        if format.extension == "parquet" {
            let types = ["measured_q_rad_q1", "stamp_ns", "status_seq", "payload_excited"].map(|n| &found["types"][n]);
            assert_eq!(types, ["double", "int64", "int64", "bool"]);
        }
    }
}

#[test]
fn rows_are_those_of_the_recording_beyond_window_and_block() {
    let dir = tempfile::tempdir().unwrap();
    let (from, path) = (dir.path().join("run.mcap"), dir.path().join("run.csv"));
    recording(&from, SAMPLES);
    let topics = ["/smoothed".to_owned(), "/payload".to_owned()];
    let exported = export(&Request { topics: &topics, ..request(&from, &path) }, &mut |_| {}).unwrap();
    assert_eq!((exported.rows, exported.left_out.len()), (SAMPLES, 10));
    let mut reader = csv::Reader::from_path(&path).unwrap();
    let names: Vec<String> = reader.headers().unwrap().iter().map(str::to_owned).collect();
    assert_eq!(names[..3], ["t_s", "stamp_ns", "smoothed_q_rad_q1"]);
    let at = |name: &str| names.iter().position(|n| n == name).unwrap();
    let (position, velocity, mass) = (at("smoothed_q_rad_q2"), at("smoothed_qd_rad_s_q3"), at("payload_mass_kg"));
    let mut rows = 0;
    for (k, row) in reader.records().enumerate() {
        let row = row.unwrap();
        let get = |i: usize| row[i].parse::<f64>().unwrap();
        let k = k as u64;
        assert_eq!(row[1].parse::<i64>().unwrap(), stamp(k));
        assert_eq!((get(position), get(velocity), get(mass)), (number(3, k, 1), number(4, k, 2), number(14, k, 1)));
        rows += 1;
    }
    assert_eq!(rows, SAMPLES);
    // A part of the time, over the file before: only with force.
    let part = Request { from_s: 0.5, to_s: 0.75, ..request(&from, &path) };
    let e = export(&part, &mut |_| {}).unwrap_err().to_string();
    assert!(e.contains("run.csv: found an existing file"), "{e}");
    let exported = export(&Request { force: true, ..part }, &mut |_| {}).unwrap();
    assert_eq!(exported.rows, 250);
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 2, "no temporary file is left");
}

/// A robot, and its recording as CSV with a spike that the reader repairs.
fn plain(dir: &Path) -> (LoadedRobot, PathBuf) {
    let robot = dir.join("robot.toml");
    let text = "kind = \"serial\"\nname = \"arm\"\njoints = [\"shoulder\", \"elbow\"]\ntorque_unit = \"A\"\n[[dh]]\na = 0.3\n[[dh]]\na = 0.2\n";
    std::fs::write(&robot, text).unwrap();
    let mut csv = String::from("t,q1,q2,tau1,tau2,x_phase,other\n");
    for k in 0..500 {
        let t = f64::from(k) / 1000.0;
        csv += &format!("{t},{},{},{},{},{k},1\n", 0.1 * t, -t, 2.0 + t, 3.0);
    }
    let recording = dir.join("arm.csv");
    std::fs::write(&recording, csv).unwrap();
    (lacuna_recording::load_robot(&robot).unwrap(), recording)
}

#[test]
fn a_recording_without_topics_is_exported_as_its_robot_reads_it() {
    let dir = tempfile::tempdir().unwrap();
    let (robot, from) = plain(dir.path());
    let path = dir.path().join("out/arm.csv");
    let e = export(&request(&from, &path), &mut |_| {}).unwrap_err().to_string();
    assert!(e.contains("arm.csv: ") && e.contains("--robot"), "{e}");
    let exported = export(&Request { robot: Some(&robot.file), ..request(&from, &path) }, &mut |_| {}).unwrap();
    let names: Vec<&str> = exported.table.columns.iter().map(|c| c.name.as_str()).collect();
    // Amperes are not called newton metres.
    assert_eq!(names, ["q_rad_shoulder", "q_rad_elbow", "tau_a_shoulder", "tau_a_elbow", "x_phase", "flags"]);
    assert_eq!((exported.rows, exported.left_out), (500, vec!["other".to_owned()]));
    let text = std::fs::read_to_string(&path).unwrap();
    let mut lines = text.lines();
    assert_eq!(lines.next(), Some("t_s,stamp_ns,q_rad_shoulder,q_rad_elbow,tau_a_shoulder,tau_a_elbow,x_phase,flags"));
    assert_eq!(lines.nth(250), Some("0.25,250000000,0.025,-0.25,2.25,3,250,0"));
}

#[test]
fn a_bag_folder_is_written_of_either_kind_of_recording() {
    let dir = tempfile::tempdir().unwrap();
    let from = dir.path().join("run.mcap");
    recording(&from, 300);
    let folder = dir.path().join("bag");
    let bag = lacuna_export::bag::write(&from, None, &folder, false).unwrap();
    // The topic of gaps is there, and empty.
    assert_eq!((bag.messages, bag.topics.len()), (300 * 12, 13));
    assert_eq!(std::fs::read(folder.join("bag_0.mcap")).unwrap(), std::fs::read(&from).unwrap(), "a copy to the byte");
    let e = lacuna_export::bag::write(&from, None, &folder, false).unwrap_err().to_string();
    assert!(e.contains("bag: found an existing folder"), "{e}");
    lacuna_export::bag::write(&from, None, &folder, true).unwrap();
    // --force replaces bags, and nothing else.
    let precious = dir.path().join("precious");
    std::fs::create_dir(&precious).unwrap();
    std::fs::write(precious.join("thesis.txt"), "all of it").unwrap();
    let e = lacuna_export::bag::write(&from, None, &precious, true).unwrap_err().to_string();
    assert!(e.contains("no bag folder") && precious.join("thesis.txt").exists(), "{e}");

    let (robot, csv) = plain(dir.path());
    let arm = dir.path().join("arm");
    assert!(lacuna_export::bag::write(&csv, None, &arm, false).unwrap_err().to_string().contains("--robot"));
    let bag = lacuna_export::bag::write(&csv, Some(&robot), &arm, false).unwrap();
    assert!(bag.topics.contains(&"/measured".to_owned()), "{:?}", bag.topics);
    // And back: the same samples, read out of the bag.
    let read = lacuna_recording::read_all(&arm, &robot.file).unwrap();
    let expected = lacuna_recording::read_all(&csv, &robot.file).unwrap();
    assert_eq!((read.t_s, read.q_rad, read.tau_nm), (expected.t_s, expected.q_rad, expected.tau_nm));

    let Some(python) = python("LACUNA_TEST_PYTHON") else { return };
    for (folder, topic, samples) in [(&folder, "/residual", 300), (&arm, "/measured", 500)] {
        let output = Command::new(&python).arg(script("read_mcap.py")).arg("rosbags").arg(folder).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let found: Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(found["topics"][topic]["stamp"].as_array().map(Vec::len), Some(samples), "{topic}");
    }
}

#[test]
fn what_cannot_be_exported_is_refused_and_leaves_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let from = dir.path().join("run.mcap");
    recording(&from, 50);
    let out = dir.path().join("out");
    std::fs::create_dir(&out).unwrap();
    let refused = |request: &Request<'_>, words: &[&str]| {
        let e = export(request, &mut |_| {}).unwrap_err().to_string();
        assert!(words.iter().all(|w| e.contains(w)) && !e.contains('\n'), "{e}");
    };
    let csv = out.join("a.csv");
    refused(&request(&from, &out.join("a.xlsx")), &["a.xlsx", ".xlsx", ".csv, .parquet, .mat"]);
    let topics = ["/absent".to_owned()];
    refused(&Request { topics: &topics, ..request(&from, &csv) }, &["run.mcap", "/measured", "expected topic /absent"]);
    refused(&Request { from_s: 9.0, ..request(&from, &csv) }, &["run.mcap", "no sample"]);
    refused(&Request { from_s: f64::NAN, ..request(&from, &csv) }, &["--from"]);
    refused(&Request { from_s: 2.0, to_s: 1.0, ..request(&from, &csv) }, &["--until"]);
    refused(&request(&dir.path().join("absent.mcap"), &csv), &["absent.mcap", "no such file"]);
    // Damage in the middle.
    let mut bytes = std::fs::read(&from).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 0xff;
    bytes[middle + 1] ^= 0xff;
    let broken = dir.path().join("broken.mcap");
    std::fs::write(&broken, &bytes).unwrap();
    assert!(export(&request(&broken, &csv), &mut |_| {}).is_err());
    assert_eq!(std::fs::read_dir(&out).unwrap().count(), 0);
}
