//! Readers that share no code with this crate find every sample, in order, with its exact numbers: Python's
//! `mcap` + `mcap-ros2-support` and `rosbags` (a Python with them is named by `LACUNA_TEST_PYTHON`), JavaScript's
//! `@mcap/core` (its node_modules are in `LACUNA_TEST_NODE`), the Rerun viewer (`LACUNA_TEST_PYTHON_LONG`), and the `mcap`
//! crate.

mod common;

use common::{TOPICS, config, number, record, robot, run, stamp};
use lacuna_recorder::{Recorder, Stream};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Command;

const SAMPLES: u64 = 1200;

fn recording(path: &Path, more: &str) {
    let robot = robot();
    let mut recorder = Recorder::new(&config(path, more), &run(&robot, &Stream::ALL)).unwrap();
    for k in 0..SAMPLES {
        record(&mut recorder, k).unwrap();
    }
    let counts = recorder.finish().unwrap();
    assert!(counts.lossless());
    let mut messages = counts.messages;
    assert_eq!(messages.remove("/gaps"), Some(0));
    assert_eq!(messages.keys().collect::<Vec<_>>(), TOPICS);
    assert!(messages.values().all(|&n| n == SAMPLES));
}

fn script() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/oracles/read_mcap.py")
}

/// A Python with the packages, if one was named.
fn python() -> Option<String> {
    let Ok(python) = std::env::var("LACUNA_TEST_PYTHON") else {
        eprintln!("SKIPPED: LACUNA_TEST_PYTHON names no Python with mcap, mcap-ros2-support and rosbags");
        return None;
    };
    let probe = Command::new(&python).arg(script()).arg("probe").output().unwrap();
    // Named but unfit is a mistake in the set-up, not a reason to skip.
    assert!(probe.status.success(), "{python}: {}", String::from_utf8_lossy(&probe.stderr));
    Some(python)
}

fn read(python: &str, how: &str, path: &Path) -> Value {
    let output = Command::new(python).arg(script()).arg(how).arg(path).output().unwrap();
    assert!(output.status.success(), "{how}: {}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

/// A `float64` or a list of them.
fn floats(value: &Value) -> Vec<f64> {
    match value {
        Value::Array(list) => list.iter().flat_map(floats).collect(),
        other => vec![other.as_str().unwrap().parse().unwrap()],
    }
}

/// Checks all topics of a recording of the samples 0 to `n` − 1.
fn check(found: &Value, n: u64) {
    let topics = found["topics"].as_object().unwrap();
    let mut names: Vec<_> = topics.keys().map(String::as_str).collect();
    names.sort_unstable();
    assert_eq!(names, TOPICS);
    for (topic, entry) in topics {
        let stamps: Vec<i64> = (0..n).map(stamp).collect();
        assert_eq!(entry["stamp"], serde_json::json!(stamps), "{topic}");
        assert_eq!(entry["log_time"], serde_json::json!(stamps), "{topic}");
    }
    let lists = [
        ("/measured", "position", 0),
        ("/measured", "effort", 1),
        ("/measured/detail", "temperature", 2),
        ("/smoothed", "position", 3),
        ("/smoothed", "velocity", 4),
        ("/smoothed/detail", "acceleration", 5),
        ("/smoothed/detail", "position_sd", 6),
        ("/smoothed/detail", "velocity_sd", 7),
        ("/smoothed/detail", "acceleration_sd", 8),
        ("/torque/nominal", "effort", 9),
        ("/torque/rigid", "effort", 10),
        ("/friction", "effort", 11),
        ("/residual", "effort", 12),
        ("/residual_payload", "effort", 13),
        ("/monitor", "residual", 16),
        ("/monitor", "residual_sd", 17),
        ("/monitor", "score", 18),
        ("/monitor", "region_low", 19),
        ("/monitor", "region_high", 20),
    ];
    for k in 0..n {
        let at = k as usize;
        for (topic, field, which) in lists {
            let expected: Vec<f64> = (0..3).map(|j| number(which, k, j)).collect();
            let fields = &topics[topic]["fields"];
            assert_eq!(floats(&fields[field][at]), expected, "{topic} {field} {k}");
            assert_eq!(fields["name"][at], serde_json::json!(["q1", "q2", "q3"]));
        }
        let payload = &topics["/payload"]["fields"];
        assert_eq!(floats(&payload["mass"][at]), [number(14, k, 1)]);
        assert_eq!(floats(&payload["mass_sd"][at]), [number(15, k, 1)]);
        assert_eq!(payload["excited"][at], k % 10 != 3);
        assert_eq!(payload["step"][at], false);
        let watch = &topics["/monitor"]["fields"];
        assert_eq!(watch["watched"][at], serde_json::json!([true, false, true]));
        assert_eq!(watch["alarm"][at], serde_json::json!([true, false, false]));
        assert_eq!(floats(&watch["since"][at]), [stamp(k), stamp(k / 2), 0].map(|ns| ns as f64 * 1e-9));
        assert_eq!(watch["region_variable"][at], serde_json::json!([1, 3, 0]));
        let status = &topics["/status"]["fields"];
        assert_eq!(status["seq"][at], k + 1);
        assert_eq!(status["flags"][at], if k % 10 == 3 { 1 << 7 } else { 0 });
        assert_eq!(status["lag_ns"][at], 5);
        assert_eq!(status["hop_latency_ns"][at], serde_json::json!([100 + k, 200, 300]));
        let detail = &topics["/measured/detail"]["fields"];
        assert!(floats(&detail["link_position"][at]).iter().all(|v| v.is_nan()));
        assert_eq!(detail["drive_on"][at], true);
    }
}

#[test]
fn python_finds_every_sample() {
    let Some(python) = python() else { return };
    let dir = tempfile::tempdir().unwrap();
    for compression in ["zstd", "lz4", "none"] {
        let path = dir.path().join(format!("{compression}.mcap"));
        recording(&path, &format!("compression = \"{compression}\"\nchunk_kib = 64\n"));
        let found = read(&python, "mcap", &path);
        check(&found, SAMPLES);
        assert_eq!(found["profile"], "ros2");
        assert_eq!(found["schemas"]["/measured"], "sensor_msgs/msg/JointState");
        assert_eq!(found["schemas"]["/monitor"], "lacuna_msgs/msg/ResidualWatch");
        check(&read(&python, "linear", &path), SAMPLES);
        assert_eq!(found["attachments"], serde_json::json!({"robot.toml": 14, "graph.toml": 0}));
        let start = &found["metadata"]["lacuna"];
        assert_eq!(
            (&start["robot"], &start["torque_unit"], &start["source"]),
            (&Value::from("d"), &Value::from("Nm"), &Value::from("motion.csv"))
        );
        let end = &found["metadata"]["lacuna.end"];
        assert_eq!((&end["complete"], &end["lossless"]), (&Value::from("true"), &Value::from("true")));
        assert_eq!(end["samples.payload"], SAMPLES.to_string());
    }
}

#[test]
fn javascript_finds_every_sample() {
    let Ok(modules) = std::env::var("LACUNA_TEST_NODE") else {
        eprintln!("SKIPPED: LACUNA_TEST_NODE names no folder with @mcap/core");
        return;
    };
    let dir = tempfile::tempdir().unwrap();
    let script = script().with_file_name("read_mcap.mjs");
    for compression in ["zstd", "lz4", "none"] {
        let path = dir.path().join(format!("{compression}.mcap"));
        recording(&path, &format!("compression = \"{compression}\"\nchunk_kib = 64\n"));
        let output = Command::new("node").arg(&script).arg(&modules).arg(&path).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let found: Value = serde_json::from_slice(&output.stdout).unwrap();
        check(&found, SAMPLES);
        assert_eq!(found["profile"], "ros2");
        assert_eq!(found["schemas"]["/measured"], "sensor_msgs/msg/JointState");
        assert_eq!(found["schemas"]["/status"], "lacuna_msgs/msg/Status");
        assert_eq!(found["attachments"], serde_json::json!({"robot.toml": 14, "graph.toml": 0}));
        assert_eq!(found["metadata"]["lacuna.end"]["complete"], "true");
    }
}

/// A Python with the Rerun SDK, if one was named.
fn rerun(args: &[&std::ffi::OsStr]) -> Option<std::process::Output> {
    let Ok(python) = std::env::var("LACUNA_TEST_PYTHON_LONG") else {
        eprintln!("SKIPPED: LACUNA_TEST_PYTHON_LONG names no Python with rerun-sdk");
        return None;
    };
    Some(Command::new(python).arg(script().with_file_name("read_rerun.py")).args(args).output().unwrap())
}

#[test]
#[ignore = "long: the Rerun SDK is large"]
fn rerun_shows_every_joint_by_its_name() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.mcap");
    recording(&path, "");
    let Some(output) = rerun(&["read".as_ref(), path.as_os_str()]) else { return };
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let found: Value = serde_json::from_slice(&output.stdout).unwrap();
    let lists = [
        ("/measured/position", 0),
        ("/measured/effort", 1),
        ("/smoothed/velocity", 4),
        ("/torque/rigid/effort", 10),
        ("/residual/effort", 12),
    ];
    for (entity, which) in lists {
        let series = &found[entity];
        assert_eq!(series["names"], serde_json::json!([["q1", "q2", "q3"]]), "{entity}");
        assert_eq!(series["stamp"], serde_json::json!((0..SAMPLES).map(stamp).collect::<Vec<i64>>()), "{entity}");
        for k in 0..SAMPLES {
            let expected: Vec<f64> = (0..3).map(|j| number(which, k, j)).collect();
            assert_eq!(floats(&series["values"][k as usize]), expected, "{entity} {k}");
        }
    }
    // The viewer itself, where there is a graphics driver; software will do.
    let picture = dir.path().join("a.png");
    let Some(output) = rerun(&["picture".as_ref(), path.as_os_str(), picture.as_os_str()]) else { return };
    if output.status.code() == Some(3) {
        eprintln!("SKIPPED: the Rerun viewer's picture: {}", String::from_utf8_lossy(&output.stderr));
        return;
    }
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let said: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(said["views"].as_array().map(Vec::len), Some(3), "{said}");
    assert_eq!(said["reports"], serde_json::json!([]), "a view complains");
    let bytes = std::fs::read(&picture).unwrap();
    assert!(bytes.starts_with(b"\x89PNG") && bytes.len() > 50_000, "{} bytes", bytes.len());
}

#[test]
fn rosbags_reads_the_bag_folder() {
    let Some(python) = python() else { return };
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("run");
    recording(&folder, "bag = true\n");
    check(&read(&python, "rosbags", &folder), SAMPLES);
    check(&read(&python, "mcap", &folder.join("run_0.mcap")), SAMPLES);
}

#[test]
fn python_reads_a_cut_file_to_its_end() {
    let Some(python) = python() else { return };
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.mcap");
    recording(&path, "chunk_kib = 16\n");
    let bytes = std::fs::read(&path).unwrap();
    std::fs::write(&path, &bytes[..bytes.len() * 2 / 3]).unwrap();
    let found = read(&python, "linear", &path);
    let n = found["topics"]["/measured"]["stamp"].as_array().unwrap().len();
    assert!(n > SAMPLES as usize / 2, "{n}");
    assert!(found["metadata"].get("lacuna.end").is_none());
    // And whole again after recovery.
    let to = dir.path().join("b.mcap");
    let recovered = lacuna_recording::recover(&path, &to, &Default::default()).unwrap();
    assert!(recovered.was_cut && recovered.damages.is_empty());
    let whole = read(&python, "mcap", &to);
    let kept = whole["topics"]["/measured"]["stamp"].as_array().unwrap().len();
    assert!(kept >= n, "{kept} of {n}");
    assert_eq!(whole["metadata"]["lacuna.recovered"]["was_cut"], "true");
}

#[test]
fn the_mcap_crate_reads_the_file_with_its_index_and_checksums() {
    let dir = tempfile::tempdir().unwrap();
    for compression in ["zstd", "lz4", "none"] {
        let path = dir.path().join(format!("{compression}.mcap"));
        recording(&path, &format!("compression = \"{compression}\"\nchunk_kib = 64\n"));
        let bytes = std::fs::read(&path).unwrap();
        let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
        let stats = summary.stats.as_ref().unwrap();
        assert_eq!(stats.message_count, SAMPLES * TOPICS.len() as u64);
        assert_eq!(
            (stats.chunk_count as usize, stats.attachment_count, stats.metadata_count),
            (summary.chunk_indexes.len(), 2, 2)
        );
        assert_eq!((stats.message_start_time, stats.message_end_time), (0, stamp(SAMPLES - 1) as u64));
        // Through the chunk and message indexes.
        let mut indexed = 0;
        for chunk in &summary.chunk_indexes {
            for (channel, entries) in summary.read_message_indexes(&bytes, chunk).unwrap() {
                for entry in &entries {
                    let message = summary.seek_message(&bytes, chunk, entry).unwrap();
                    assert_eq!((message.channel.id, message.log_time), (channel.id, entry.log_time));
                    indexed += 1;
                    if indexed >= 300 {
                        break;
                    }
                }
            }
        }
        assert!(indexed >= 300);
        // Front to back, with the data section's checksum.
        let options = mcap::sans_io::linear_reader::LinearReaderOptions::default()
            .with_prevalidate_chunk_crcs(true)
            .with_validate_data_section_crc(true)
            .with_validate_summary_section_crc(true);
        let mut reader = mcap::sans_io::linear_reader::LinearReader::new_with_options(options);
        let mut input = bytes.as_slice();
        let mut messages = 0;
        while let Some(event) = reader.next_event() {
            match event.unwrap() {
                mcap::sans_io::linear_reader::LinearReadEvent::ReadRequest(n) => {
                    let n = std::io::Read::read(&mut input, reader.insert(n)).unwrap();
                    reader.notify_read(n);
                }
                mcap::sans_io::linear_reader::LinearReadEvent::Record { opcode, data } => {
                    mcap::parse_record(opcode, data).unwrap();
                    messages += u64::from(opcode == mcap::records::op::MESSAGE);
                }
            }
        }
        assert_eq!(messages, stats.message_count);
    }
}
