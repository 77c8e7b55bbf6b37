//! Two models side by side on one recording: real processes, the model of a real diagnosis.

use lacuna_recording::ros::cdr::Cursor;
use lacuna_simulate::case::{CaseOptions, draw_case};
use lacuna_simulate::{simulate, write_csv};
use lacuna_tests::{Bench, error_line, report, workspace};
use std::collections::BTreeMap;
use std::path::Path;

/// Speed above which a sample counts [rad/s]: below it friction may be anything within its level.
const MOVING: f64 = 0.05;

/// A folder with a Delta whose friction has a Stribeck part that its robot file does not know: five recordings
/// `train_*.csv` and a sixth, `new.csv`. Returns the joint.
fn folder() -> (Bench, usize) {
    let options = CaseOptions {
        effects: 1,
        ids: vec!["stribeck".to_owned()],
        severity: [1.0, 1.0],
        mass_error: 0.01,
        trajectories: 6,
        duration_s: 3.0,
        ..CaseOptions::default()
    };
    let case = draw_case(12, &options).expect("case");
    let simulation = simulate(&case.robot, None, &case.config).expect("simulation");
    let bench = Bench::new();
    bench.write("robot.toml", &toml::to_string(&case.robot).expect("robot file"));
    for (i, recording) in simulation.recordings.iter().enumerate() {
        let mut csv = Vec::new();
        write_csv(recording, &mut csv).expect("csv");
        let name = if i < 5 { format!("train_{i}.csv") } else { "new.csv".to_owned() };
        bench.write(&name, &String::from_utf8(csv).expect("text"));
    }
    let joint = &simulation.truth.effects[0].joints[0];
    let index = case.robot.joints.iter().position(|j| j == joint).expect("a joint of the robot");
    (bench, index)
}

fn ok(bench: &Bench, args: &[&str]) {
    let done = bench.lacuna(args);
    assert!(done.status.success(), "{args:?}: {}", String::from_utf8_lossy(&done.stderr));
}

/// A message of a JointState topic, read with the `mcap` crate.
struct State {
    sequence: u32,
    velocity: Vec<f64>,
    effort: Vec<f64>,
}

fn states(path: &Path) -> BTreeMap<String, Vec<State>> {
    let bytes = std::fs::read(path).expect("recording");
    let mut all: BTreeMap<String, Vec<State>> = BTreeMap::new();
    for message in mcap::MessageStream::new(&bytes).expect("an MCAP file") {
        let message = message.expect("a message");
        if message.channel.schema.as_ref().is_none_or(|s| s.name != "sensor_msgs/msg/JointState") {
            continue;
        }
        let read = || -> Option<State> {
            let mut cursor = Cursor::new(&message.data)?;
            cursor.header()?;
            cursor.strings()?;
            cursor.numbers()?;
            let mut list = || -> Option<Vec<f64>> {
                let numbers = cursor.numbers()?;
                (0..numbers.len()).map(|i| numbers.get(i)).collect()
            };
            Some(State { sequence: message.sequence, velocity: list()?, effort: list()? })
        };
        let entry = all.entry(message.channel.topic.clone()).or_default();
        entry.push(read().expect("a JointState"));
    }
    all
}

#[test]
fn the_diagnosed_model_beats_the_identified_one_beside_it() {
    let (bench, joint) = folder();
    let train: Vec<String> = (0..5).map(|i| format!("train_{i}.csv")).collect();
    let with = |head: &[&'static str]| -> Vec<String> {
        head.iter().map(|s| (*s).to_owned()).chain(train.iter().cloned()).collect()
    };
    for args in [
        with(&["identify", "--robot", "robot.toml", "--out", "before"]),
        with(&["diagnose", "--robot", "robot.toml", "--out", "after"]),
    ] {
        ok(&bench, &args.iter().map(String::as_str).collect::<Vec<_>>());
    }
    let graph = workspace().join("launch/compare.toml").display().to_string();
    let sets = [
        "recording=new.csv",
        "robot=robot.toml",
        "before=before/model.toml",
        "after=after/model.toml",
        "out=both.mcap",
    ];
    let mut args = vec!["up", &graph, "--json"];
    sets.iter().for_each(|s| args.extend(["--set", s]));
    let done = bench.lacuna(&args);
    let report = report(&done);
    assert_eq!(done.status.code(), Some(0));
    let rows = std::fs::read_to_string(bench.path().join("new.csv")).expect("csv").lines().count() - 1;
    assert_eq!((report["samples"].as_u64(), report["lost"].as_u64()), (Some(rows as u64), Some(0)));
    let samples = &report["nodes"]["recorder"]["details"]["samples"];
    for stream in ["measured", "smoothed", "before/torque", "before/payload", "after/friction", "after/payload"] {
        assert_eq!(samples[stream], rows, "{stream} of {samples}");
    }

    let path = bench.path().join("both.mcap");
    let found = states(&path);
    let moving: Vec<bool> = found["/smoothed"].iter().map(|s| s.velocity[joint].abs() > MOVING).collect();
    let rms = |topic: &str| {
        let list = &found[topic];
        let numbers: Vec<u32> = list.iter().map(|s| s.sequence).collect();
        assert_eq!(numbers, (1..=rows as u32).collect::<Vec<_>>(), "{topic}: every sample once, in order");
        let squares: Vec<f64> =
            list.iter().zip(&moving).filter(|(_, m)| **m).map(|(s, _)| s.effort[joint] * s.effort[joint]).collect();
        (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
    };
    let (before, after) = (rms("/before/residual"), rms("/after/residual"));
    eprintln!("residual of joint {}: before {before:.4} Nm, after {after:.4} Nm", joint + 1);
    assert!(after < 0.5 * before, "before {before} Nm, after {after} Nm");
    // Each branch's residual is the measured torque less its own model: they differ by the models alone.
    for k in (0..rows).step_by(97) {
        for side in ["before", "after"] {
            let at = |topic: &str| found[&format!("/{side}{topic}")][k].effort[joint];
            let model = at("/torque/rigid") + at("/friction");
            assert!((found["/measured"][k].effort[joint] - model - at("/residual")).abs() < 1e-9);
        }
    }
    // Both models are in the recording, word for word.
    let bytes = std::fs::read(&path).expect("recording");
    let summary = mcap::Summary::read(&bytes).expect("summary").expect("an index");
    for side in ["before", "after"] {
        let name = format!("model-{side}.toml");
        let index = summary.attachment_indexes.iter().find(|a| a.name == name).expect("attached");
        let attached = mcap::read::attachment(&bytes, index).expect("attachment");
        let file = std::fs::read(bench.path().join(side).join("model.toml")).expect("model file");
        assert_eq!(attached.data.as_ref(), file.as_slice());
    }
}

#[test]
fn two_streams_of_a_kind_in_one_namespace_are_refused_in_a_line() {
    let (bench, _) = folder();
    let text = std::fs::read_to_string(workspace().join("launch/compare.toml")).expect("graph");
    let merged = text.replace("before/", "both/").replace("after/", "both/").replace("both/", "");
    let graph = bench.write("merged.toml", &merged);
    let sets = ["recording=new.csv", "robot=robot.toml", "out=a.mcap"];
    let path = graph.display().to_string();
    let mut args = vec!["up", &path, "--quiet"];
    sets.iter().for_each(|s| args.extend(["--set", s]));
    let done = bench.lacuna(&args);
    let line = error_line(&done);
    assert_eq!(done.status.code(), Some(2), "{line}");
    assert!(line.contains("model of its own") || line.contains("has a writer already"), "{line}");
    // In one namespace, but under other names: the recorder would mix them up.
    let second = text.replace("after/", "before/second-").replace("model = \"${after}\"", "model = \"${before}\"");
    bench.write("merged.toml", &second);
    let done = bench.lacuna(&args);
    let line = error_line(&done);
    assert_eq!(done.status.code(), Some(2), "{line}");
    assert!(line.contains("a second topic of TorqueModel"), "{line}");
    assert!(!bench.path().join("a.mcap").exists());
}
