//! The offline commands end to end, through the command line alone: simulate, identify, diagnose, info, recover.

use lacuna_interfaces::{ModelFile, RobotFile};
use lacuna_tests::{Bench, error_line, shared_data};
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::Path;
use std::process::Output;

const SIMULATION: &str = "seed = 4\n[friction]\nf_c = [5.2, 4.6, 4.9]\nf_v = [0.95, 0.8, 0.9]\n\
[[trajectory]]\nkind = \"fourier\"\nduration_s = 4.0\ncount = 2\n\
[[trajectory]]\nkind = \"point_to_point\"\nduration_s = 4.0\n";

fn ok(output: &Output) -> String {
    let errors = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{errors}");
    assert_eq!(errors, "", "a command that succeeds says nothing on standard error");
    String::from_utf8(output.stdout.clone()).expect("text")
}

/// Exit code 2 and one line that holds all of `words`.
fn refused(output: &Output, words: &[&str]) {
    let line = error_line(output);
    assert_eq!(output.status.code(), Some(2), "{line}");
    assert!(output.stdout.is_empty(), "a refusal prints no result: {line}");
    for word in words {
        assert!(line.contains(word), "\"{word}\" belongs in: {line}");
    }
}

fn json(path: &Path) -> Value {
    let text = std::fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    serde_json::from_str(&text).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

fn floats(value: &Value) -> Vec<f64> {
    value.as_array().into_iter().flatten().filter_map(Value::as_f64).collect()
}

/// A folder with robot.toml, sim.toml, rec/traj_01.csv to traj_03.csv and truth.json.
fn recorded() -> Bench {
    let bench = Bench::new();
    bench.write("sim.toml", SIMULATION);
    let args = ["simulate", "--robot", "robot.toml", "--config", "sim.toml", "--out", "rec", "--truth", "truth.json"];
    ok(&bench.lacuna(&args));
    bench
}

const RECORDINGS: [&str; 3] = ["rec/traj_01.csv", "rec/traj_02.csv", "rec/traj_03.csv"];

fn identify(bench: &Bench, out: &str, args: &[&str]) -> Output {
    bench.lacuna(&[&["identify", "--robot", "robot.toml", "--out", out], args].concat())
}

#[test]
fn the_demo_is_identified_and_three_files_are_written() {
    let bench = Bench::new();
    ok(&bench.lacuna(&["simulate", "--demo", "--out", "demo", "--truth", "truth.json"]));
    refused(&bench.lacuna(&["simulate", "--demo", "--out", "demo"]), &["demo/free", "13 recordings", "--overwrite"]);
    let recordings: Vec<String> = (1..=13).map(|k| format!("demo/free/traj_{k:02}.csv")).collect();
    let mut args = vec!["identify", "--robot", "demo/robot.toml", "--out", "out"];
    args.extend(recordings.iter().map(String::as_str));
    let words = ok(&bench.lacuna(&args));
    for part in ["of the torque (RMS) on data it had not seen", "RMS [Nm]", "out/model.toml", "out/report.html"] {
        assert!(words.contains(part), "\"{part}\" belongs in:\n{words}");
    }
    let account = json(&bench.path().join("out/identification.json"));
    check_account(&account, 13);
    // The demo's rotors are five times heavier than its robot file says.
    let departing = account["parameters"].as_array().into_iter().flatten().filter(|p| p["departs"] == true).count();
    assert!(departing >= 3 && words.contains("depart from the robot file"), "{departing} depart");
    let read = |path: &str| std::fs::read_to_string(bench.path().join(path)).expect(path);
    let robot = RobotFile::parse(&read("demo/robot.toml")).expect("robot file");
    let model = ModelFile::parse(&read("out/model.toml")).expect("a model file");
    model.check(&robot).expect("a model of this robot");
    let truth = json(&bench.path().join("truth.json"));
    let base = |key: &str| floats(&truth["free"]["base_params"][key]);
    for (what, found, truth) in [("f_c", model.friction.f_c, base("fc")), ("f_v", model.friction.f_v, base("fv"))] {
        assert_eq!((found.len(), truth.len()), (3, 3));
        for (j, (found, truth)) in found.iter().zip(&truth).enumerate() {
            assert!((found / truth - 1.0).abs() < 0.03, "{what} of joint {}: {found}, truth {truth}", j + 1);
        }
    }
    let report = read("out/report.html");
    assert!(report.starts_with("<!doctype html>") && report.contains("D3-1200-class"));
    for part in ["traj_01.csv", "Identified parameters", "Error on held-out data"] {
        assert!(report.contains(part), "\"{part}\" belongs in the report");
    }
}

/// The schema of identification.json that other programs rely on.
fn check_account(account: &Value, recordings: usize) {
    assert_eq!(account["schema"], "lacuna.identification/1");
    let held = &account["held_out"];
    let error = held["relative_error"].as_f64().expect("relative_error");
    // Friction is a tenth of this robot's torque and more: a fit that missed it could not reach this.
    assert!(error > 0.0 && error < 0.02, "relative error {error}");
    assert!(held["nominal_relative_error"].as_f64().expect("nominal") > 10.0 * error);
    for key in ["rms_nm", "mean_nm", "std_nm"] {
        assert_eq!(floats(&held[key]).len(), 3, "{key}");
    }
    assert_eq!(held["moving_only"], true);
    assert!(held["band_hz"].as_f64().expect("band") > 0.0);
    for side in ["train", "test"] {
        let ranges = held[side].as_array().expect("ranges");
        assert_eq!((ranges.len(), &ranges[1]["file"]), (recordings, &Value::from("traj_02.csv")));
        assert!(ranges.iter().all(|r| r["from_s"].as_f64() < r["to_s"].as_f64()));
    }
    let parameters = account["parameters"].as_array().expect("parameters");
    assert!(parameters.iter().any(|p| p["symbol"] == "f_c2"));
    for p in parameters {
        let [low, high] = floats(&p["ci95"])[..] else { panic!("an interval of {p}") };
        let value = p["value"].as_f64().expect("value");
        assert!(low <= value && value <= high, "{p}");
        assert!(p["unit"].is_string() && p["merged_with"].is_array(), "{p}");
    }
    for key in ["not_excited", "repairs", "warnings"] {
        assert!(account[key].is_array(), "{key}");
    }
}

#[test]
fn identify_splits_as_it_is_told() {
    let bench = recorded();
    let args = ["--train", "rec/traj_01.csv", "rec/traj_02.csv@0.5:3", "--test", "rec/traj_03.csv@1:", "--json"];
    let printed: Value = serde_json::from_str(&ok(&identify(&bench, "out", &args))).expect("JSON on standard output");
    assert_eq!(printed, json(&bench.path().join("out/identification.json")));
    let held = &printed["held_out"];
    assert_eq!(held["train"].as_array().map(Vec::len), Some(2));
    assert_eq!((held["train"][1]["from_s"].as_f64(), held["train"][1]["to_s"].as_f64()), (Some(0.5), Some(3.0)));
    assert_eq!(held["test"][0]["from_s"].as_f64(), Some(1.0));
    let report = std::fs::read_to_string(bench.path().join("out/report.html")).expect("report.html");
    assert!(report.contains("traj_03.csv (held out)") && report.contains("traj_01.csv (training)"));

    let args = ["--method", "paper", "--holdout", "kfold=3", "--moving", "0.2", "--band", "12", "--json"];
    let printed = ok(&identify(&bench, "paper", &[&args[..], &RECORDINGS].concat()));
    let printed: Value = serde_json::from_str(&printed).expect("JSON on standard output");
    let held = &printed["held_out"];
    assert_eq!((held["moving_rad_s"].as_f64(), held["band_hz"].as_f64()), (Some(0.2), Some(12.0)));
    assert_eq!((&printed["method"], held["folds"].as_array().map(Vec::len)), (&Value::from("paper"), Some(3)));
    let models: Vec<&Value> =
        printed["paper"]["table1"].as_array().expect("table 1").iter().map(|t| &t["model"]).collect();
    assert_eq!(models, ["M_KH", "M_Id", "M_Id+F", "pooled"]);
}

#[test]
fn identify_refuses_in_one_line() {
    let bench = recorded();
    bench.write("serial.toml", "kind = \"serial\"\nname = \"arm\"\njoints = [\"a\"]\n[[dh]]\na = 0.1\n");
    bench.write("typo.toml", &format!("{}colour = 1\n", lacuna_tests::ROBOT));
    bench.write("corrupt.csv", "t,q1,q2,q3,tau1,tau2,tau3\n0,0,0,0,1,1,1\n0.001,0,0,0,1,1\n0.002,0,0,0,1,1,1\n");
    bench.write("one.csv", "t,q1,tau1\n0,0,0\n0.001,0,0\n");
    let [a, b, _] = RECORDINGS;
    let cases: &[(&[&str], &[&str])] = &[
        (&[], &["found no recording"]),
        (&["absent.csv"], &["absent.csv", "no such file"]),
        (&["corrupt.csv", a], &["corrupt.csv:3:"]),
        (&["one.csv"], &["one.csv"]),
        (&["--train", a], &["1 training and 0 test"]),
        (&["--train", a, "--test", b, "--holdout", "halves"], &["one way of splitting"]),
        (&["--train", &format!("{a}@3:1"), "--test", b], &["@3:1"]),
        (&["--train", a, "--test", &format!("{b}@90:99")], &["test", "no row"]),
        (&["--holdout", "thirds", a, b], &["thirds", "kfold=N"]),
        (&["--holdout", "recordings", a], &["found 1 recording"]),
        (&["--method", "magic", a, b], &["magic", "pooled or paper"]),
        (&["--signal", "sensor", a, b], &["sensor", "motor-minus-link"]),
        (&["--signal", "motor-minus-link", a, b], &["columns.link_torque"]),
        (&["--delay", "nan", a, b], &["--delay", "nan"]),
        (&["--band", "900", a, b], &["band_hz", "900"]),
        (&["--band", "-3", a, b], &["band_hz", "-3"]),
        (&["--block", "0", a, b], &["--block"]),
    ];
    for (args, words) in cases {
        refused(&identify(&bench, "out", args), words);
    }
    for (robot, words) in [("absent.toml", &["absent.toml"][..]), ("typo.toml", &["typo.toml:", "colour"])] {
        refused(&bench.lacuna(&["identify", "--robot", robot, "--out", "out", a, b]), words);
    }
    let arm = ["identify", "--robot", "serial.toml", "--out", "out", "--method", "paper", "one.csv"];
    refused(&bench.lacuna(&arm), &["paper", "delta"]);
    refused(&identify(&bench, "robot.toml", &[a, b]), &["robot.toml", "expected a folder"]);
    assert!(!bench.path().join("out").exists(), "what is refused leaves nothing behind");
}

#[test]
fn identify_twice_gives_the_same_bytes() {
    let bench = recorded();
    for out in ["one", "two"] {
        ok(&identify(&bench, out, &RECORDINGS));
    }
    for file in ["model.toml", "identification.json", "report.html"] {
        let read = |out: &str| std::fs::read(bench.path().join(out).join(file)).expect(file);
        assert!(read("one") == read("two"), "{file} differs between two runs");
    }
}

#[test]
fn simulate_is_the_same_by_seed_and_keeps_the_truth_apart() {
    let bench = recorded();
    let simulate = |out: &str, args: &[&str]| {
        bench.lacuna(&[&["simulate", "--robot", "robot.toml", "--config", "sim.toml", "--out", out], args].concat())
    };
    ok(&simulate("again", &["--seed", "4"]));
    ok(&simulate("other", &["--seed", "5"]));
    let read = |folder: &str| std::fs::read(bench.path().join(folder).join("traj_02.csv")).expect("recording");
    assert!(read("rec") == read("again"), "the same seed gives another recording");
    assert!(read("rec") != read("other"), "another seed gives the same recording");
    let names = |folder: &str| -> Vec<String> {
        let entries = std::fs::read_dir(bench.path().join(folder)).expect("folder").flatten();
        let mut names: Vec<String> = entries.filter_map(|e| e.file_name().into_string().ok()).collect();
        names.sort();
        names
    };
    assert_eq!(names("rec"), ["manifest.json", "traj_01.csv", "traj_02.csv", "traj_03.csv"]);
    let truth = json(&bench.path().join("truth.json"));
    assert_eq!((&truth["schema"], &truth["robot"]), (&Value::from("lacuna.truth/1"), &Value::from("test-delta")));
    assert_eq!(floats(&truth["base_params"]["fc"]), [5.2, 4.6, 4.9]);
    let manifest = json(&bench.path().join("rec/manifest.json"));
    assert_eq!(manifest["files"].as_array().map(Vec::len), Some(3));
    // Recordings of two simulations in one folder would be a mixture.
    refused(&simulate("rec", &[]), &["rec:", "3 recordings", "--overwrite"]);
    ok(&simulate("rec", &["--overwrite"]));
    bench.write("sim.toml", "seed = 1\n[friction]\nf_c = [1.0]\n");
    refused(&simulate("new", &[]), &["sim.toml", "friction.f_c", "expected 3"]);
    bench.write("sim.toml", "seed = 1\nspeed = 2\n");
    refused(&simulate("new", &[]), &["sim.toml:2:", "speed"]);
    assert!(!bench.path().join("new").exists());
}

#[test]
fn simulate_draws_cases_that_the_other_commands_read() {
    let bench = Bench::new();
    let case = ["simulate", "--case", "11", "--kind", "serial", "--effect", "stribeck", "--trajectories", "2"];
    let place = ["--duration", "2", "--out", "case", "--truth", "keys/11.json", "--json"];
    let printed: Value = serde_json::from_str(&ok(&bench.lacuna(&[&case[..], &place].concat()))).expect("JSON");
    assert_eq!(printed["recordings"], serde_json::json!(["case/traj_01.csv", "case/traj_02.csv"]));
    let truth = json(&bench.path().join("keys/11.json"));
    let effects: Vec<&Value> = truth["effects"].as_array().expect("effects").iter().map(|e| &e["id"]).collect();
    assert_eq!(effects, ["stribeck"]);
    let info = ok(&bench.lacuna(&["info", "case/traj_01.csv", "--robot", "case/robot.toml", "--json"]));
    let info: Value = serde_json::from_str(&info).expect("JSON");
    let duration = info["recording"]["duration_s"].as_f64().expect("duration");
    assert!((duration - 2.0).abs() < 0.01, "{duration} s");
    let bad = ["simulate", "--case", "1", "--effect", "gremlins", "--out", "bad"];
    refused(&bench.lacuna(&bad), &["gremlins"]);
    // Options of cases mean nothing without one: use, not input, but exit code 2 all the same.
    let misused = bench.lacuna(&["simulate", "--robot", "robot.toml", "--kind", "delta", "--out", "bad"]);
    assert_eq!(misused.status.code(), Some(2));
    assert!(!bench.path().join("bad").exists());
}

/// Rows at 1 kHz, with a pause, a repeated stamp and a further column.
fn with_faults() -> String {
    let mut text = "t,q1,q2,q3,tau1,tau2,tau3,x_load\n".to_owned();
    for k in 0..1000 {
        let t = f64::from(k) * 1e-3 + if k >= 600 { 0.25 } else { 0.0 };
        let row = format!("{t:.3},0.{k:03},0.2,0.3,{}.5,2,3,7\n", k % 10);
        text += &row;
        if k == 700 {
            text += &row;
        }
    }
    text
}

#[test]
fn info_says_what_is_in_a_csv() {
    let bench = Bench::new();
    bench.write("run.csv", &with_faults());
    let printed = ok(&bench.lacuna(&["info", "run.csv", "--robot", "robot.toml", "--json"]));
    let printed: Value = serde_json::from_str(&printed).expect("JSON");
    assert_eq!(printed["schema"], "lacuna.info/1");
    let r = &printed["recording"];
    assert_eq!((r["format"].as_str(), r["samples"].as_u64()), (Some("csv"), Some(1000)));
    assert_eq!(r["duration_s"].as_f64(), Some(1.249));
    assert!((r["median_rate_hz"].as_f64().expect("rate") - 1000.0).abs() < 1e-6);
    assert_eq!(r["gaps"], serde_json::json!([{ "from_s": 0.599, "to_s": 0.85 }]));
    assert_eq!(r["extra_columns"], serde_json::json!(["x_load"]));
    let kinds: Vec<(&str, u64)> = (r["repairs"].as_array().expect("repairs").iter())
        .map(|x| (x["kind"].as_str().expect("kind"), x["count"].as_u64().expect("count")))
        .collect();
    assert!(kinds.contains(&("duplicate_stamp", 1)) && kinds.contains(&("gap", 1)), "{kinds:?}");
    let q1 = &r["joints"][0];
    assert_eq!((q1["q_min_rad"].as_f64(), q1["q_max_rad"].as_f64()), (Some(0.0), Some(0.999)));
    assert_eq!((q1["tau_min_nm"].as_f64(), q1["tau_max_nm"].as_f64()), (Some(0.5), Some(9.5)));
    // mean of (k + 1/2)², k = 0 … 9
    assert!((q1["tau_rms_nm"].as_f64().expect("RMS") - 33.25f64.sqrt()).abs() < 1e-12);

    let words = ok(&bench.lacuna(&["info", "run.csv", "--robot", "robot.toml"]));
    for part in ["1000 samples", "1000 Hz", "Gaps: 1", "x_load", "repeated stamp dropped"] {
        assert!(words.contains(part), "\"{part}\" belongs in:\n{words}");
    }
    let words = ok(&bench.lacuna(&["info", "run.csv"]));
    assert!(words.contains("rows of t, q1") && words.contains("Needs a robot file"), "{words}");
    refused(&bench.lacuna(&["info", "absent.csv"]), &["absent.csv", "no such file"]);
    bench.write("picture.png", "png");
    refused(&bench.lacuna(&["info", "picture.png"]), &["picture.png", ".png"]);
    bench.write("not.mcap", "text");
    refused(&bench.lacuna(&["info", "not.mcap"]), &["not.mcap", "mcap signature"]);
}

/// A JointState of three joints in CDR, little endian.
fn joint_state(stamp_ns: u64, q: f64, tau: f64) -> Vec<u8> {
    let mut out: Vec<u8> = Vec::new();
    fn number(out: &mut Vec<u8>, v: u32) {
        out.resize(out.len().next_multiple_of(4), 0);
        out.extend(v.to_le_bytes());
    }
    fn string(out: &mut Vec<u8>, s: &str) {
        number(out, s.len() as u32 + 1);
        out.extend(s.as_bytes());
        out.push(0);
    }
    fn list(out: &mut Vec<u8>, values: &[f64]) {
        number(out, values.len() as u32);
        if !values.is_empty() {
            out.resize(out.len().next_multiple_of(8), 0);
        }
        values.iter().for_each(|v| out.extend(v.to_le_bytes()));
    }
    number(&mut out, (stamp_ns / 1_000_000_000) as u32);
    number(&mut out, (stamp_ns % 1_000_000_000) as u32);
    string(&mut out, "");
    number(&mut out, 3);
    ["q1", "q2", "q3"].iter().for_each(|name| string(&mut out, name));
    list(&mut out, &[q; 3]);
    list(&mut out, &[]);
    list(&mut out, &[tau; 3]);
    [&[0, 1, 0, 0][..], &out].concat()
}

/// A bag of `count` JointStates at 1 kHz, written by the `mcap` crate in chunks of about 4 kB.
fn bag(path: &Path, count: u32) {
    let file = std::io::BufWriter::new(std::fs::File::create(path).expect("file"));
    let options = mcap::WriteOptions::new().profile("ros2").chunk_size(Some(4096)).compression(None);
    let mut writer = options.create(file).expect("writer");
    let text = b"std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n";
    let schema = writer.add_schema("sensor_msgs/msg/JointState", "ros2msg", text).expect("schema");
    let channel = writer.add_channel(schema, "/joint_states", "cdr", &BTreeMap::new()).expect("channel");
    for k in 0..count {
        let log_time = u64::from(k) * 1_000_000;
        let header =
            mcap::records::MessageHeader { channel_id: channel, sequence: k, log_time, publish_time: log_time };
        let message = joint_state(log_time, 1e-3 * f64::from(k), 2.0);
        writer.write_to_known_channel(&header, &message).expect("message");
    }
    writer.finish().expect("end");
}

#[test]
fn a_cut_bag_is_told_and_recovered() {
    let bench = Bench::new();
    let whole = bench.path().join("whole.mcap");
    bag(&whole, 1000);
    let printed = ok(&bench.lacuna(&["info", "whole.mcap", "--robot", "robot.toml", "--json"]));
    let printed: Value = serde_json::from_str(&printed).expect("JSON");
    let topic = &printed["container"]["topics"]["/joint_states"];
    assert_eq!((topic["messages"].as_u64(), topic["duration_s"].as_f64()), (Some(1000), Some(0.999)));
    assert_eq!(printed["container"]["was_cut"], false);
    assert_eq!(
        (printed["recording"]["samples"].as_u64(), printed["recording"]["format"].as_str()),
        (Some(1000), Some("mcap"))
    );
    assert_eq!(printed["recording"]["joints"][2]["q_max_rad"].as_f64(), Some(0.999));

    let bytes = std::fs::read(&whole).expect("bag");
    std::fs::write(bench.path().join("cut.mcap"), &bytes[..bytes.len() * 6 / 10]).expect("cut bag");
    let words = ok(&bench.lacuna(&["info", "cut.mcap"]));
    assert!(words.contains("cut off before its end") && words.contains("/joint_states"), "{words}");
    let printed = ok(&bench.lacuna(&["recover", "cut.mcap", "good.mcap", "--json"]));
    let printed: Value = serde_json::from_str(&printed).expect("JSON");
    assert_eq!(printed["was_cut"], true);
    let recovered = printed["messages"].as_u64().expect("messages");
    // 60 % of the bytes less an unfinished chunk of some thirty messages; index and end mark are few bytes here.
    assert!((480..=660).contains(&recovered), "{recovered} messages");
    // Read by the crate that knows nothing of ours, through its index.
    let good = std::fs::read(bench.path().join("good.mcap")).expect("recovered bag");
    let read = mcap::MessageStream::new(&good).expect("stream").map(|m| m.expect("message").log_time);
    assert_eq!(read.collect::<Vec<_>>(), (0..recovered).map(|k| k * 1_000_000).collect::<Vec<_>>());
    assert!(mcap::Summary::read(&good).expect("summary").is_some(), "the recovered file has an index");

    refused(&bench.lacuna(&["recover", "cut.mcap", "good.mcap"]), &["good.mcap"]);
    refused(&bench.lacuna(&["recover", "cut.mcap", "./cut.mcap", "--overwrite"]), &["same file"]);
    assert_eq!(std::fs::metadata(bench.path().join("cut.mcap")).expect("cut bag").len(), bytes.len() as u64 * 6 / 10);
    refused(&bench.lacuna(&["recover", "robot.toml", "new.mcap"]), &["robot.toml"]);
    assert!(!bench.path().join("new.mcap").exists());
}

#[test]
fn a_real_arm_is_identified_within_its_published_error() {
    let Some(data) = shared_data("a_real_arm_is_identified_within_its_published_error") else { return };
    let bench = Bench::new();
    let robot = data.join("staubli_tx40/robot.toml").display().to_string();
    let file = data.join("staubli_tx40/tx40_traj.csv").display().to_string();
    let (train, test) = (format!("{file}@0:5.4"), format!("{file}@5.5:8.9"));
    let conditions = ["--moving", "0", "--band", "50", "--json"];
    let split = ["identify", "--robot", &robot, "--out", "out", "--train", &train, "--test", &test];
    let account: Value = serde_json::from_str(&ok(&bench.lacuna(&[&split[..], &conditions].concat()))).expect("JSON");
    // The published model leaves 43 % without the coupling of the wrist: to be met within a point.
    let error = account["held_out"]["relative_error"].as_f64().expect("error");
    assert!((error - 0.43).abs() < 0.01, "relative error {error}");
}

/// Recordings of a robot whose joint q2 carries a constant torque that its file does not know.
fn with_offset() -> Bench {
    let bench = Bench::new();
    let effect = "[[effect]]\nid = \"torque_offset\"\njoints = [\"q2\"]\nparams = { tau_0 = 3.0 }\n";
    bench.write("sim.toml", &format!("{SIMULATION}{effect}"));
    ok(&bench.lacuna(&["simulate", "--robot", "robot.toml", "--config", "sim.toml", "--out", "rec"]));
    bench
}

fn diagnose(bench: &Bench, out: &str, args: &[&str]) -> Output {
    bench.lacuna(&[&["diagnose", "--robot", "robot.toml", "--out", out], args].concat())
}

/// The schema of findings.json that other programs rely on.
fn check_findings(findings: &Value) {
    assert_eq!(findings["schema"], "lacuna.findings/1");
    assert_eq!(findings["joints"], serde_json::json!(["q1", "q2", "q3"]));
    assert_eq!(findings["recordings"], serde_json::json!(["traj_01.csv", "traj_02.csv", "traj_03.csv"]));
    assert!(findings["mismatch"]["detected"].is_boolean() && findings["mismatch"]["where"].is_array());
    assert!(findings["baseline"]["relative_error"].is_f64() && findings["unknown"]["share"].is_number());
    for key in ["findings", "excluded", "repairs"] {
        assert!(findings[key].is_array(), "{key}");
    }
    for key in ["before_rms_nm", "after_rms_nm"] {
        assert_eq!(floats(&findings["held_out"][key]).len(), 3, "{key}");
    }
    for f in findings["findings"].as_array().into_iter().flatten() {
        assert!(f["effect"].is_string() && f["joints"].is_array() && f["sentence"].is_string(), "{f}");
        let probability = f["probability"].as_f64().expect("probability");
        assert!((0.0..=1.0).contains(&probability), "{f}");
        assert_eq!(floats(&f["held_out"]["ci95"]).len(), 2, "{f}");
    }
}

#[test]
fn diagnose_names_a_planted_effect_and_writes_three_files() {
    let bench = with_offset();
    let words = ok(&diagnose(&bench, "out", &RECORDINGS));
    let findings = json(&bench.path().join("out/findings.json"));
    check_findings(&findings);
    assert_eq!(findings["mismatch"]["detected"], true);
    let first = &findings["findings"][0];
    // Sliding, a constant torque and an asymmetric Coulomb level are the same.
    let named = first["effect"].as_str().expect("effect");
    assert!(["torque_offset", "coulomb_asym"].contains(&named), "{named}");
    assert_eq!(first["joints"], serde_json::json!(["q2"]));
    let verdict = findings["verdict"].as_str().expect("verdict");
    assert!(!verdict.is_empty() && words.starts_with(verdict), "the verdict comes first:\n{words}");
    assert!(words.contains("out/findings.json") && words.contains("out/report.html"), "{words}");
    let read = |path: &str| std::fs::read_to_string(bench.path().join(path)).expect(path);
    let model = ModelFile::parse(&read("out/model.toml")).expect("a model file");
    model.check(&RobotFile::parse(lacuna_tests::ROBOT).expect("robot file")).expect("a model of this robot");
    assert!(model.terms.iter().any(|t| t.effect == named), "{:?}", model.terms);
    let report = read("out/report.html");
    assert!(report.starts_with("<!doctype html>") && report.contains("What is missing"));
    for part in ["Residual over velocity and angle", "black box", "every fold predicted by a fit to the others"] {
        assert!(report.contains(part), "\"{part}\" belongs in the report");
    }
    // Against a simulator without the effect, judged on a recording that nothing was chosen or fitted on.
    bench.write("sim.toml", SIMULATION);
    ok(&bench.lacuna(&["simulate", "--robot", "robot.toml", "--config", "sim.toml", "--out", "sim"]));
    let [a, b, c] = RECORDINGS;
    let sim = ["sim/traj_01.csv", "sim/traj_02.csv", "sim/traj_03.csv"];
    let words = ok(&diagnose(&bench, "split", &[&["--train", a, b, "--test", c, "--sim"][..], &sim].concat()));
    let findings = json(&bench.path().join("split/findings.json"));
    check_findings(&findings);
    assert_eq!(findings["held_out"]["split"], "files");
    let named: Vec<&Value> = findings["findings"].as_array().into_iter().flatten().map(|f| &f["effect"]).collect();
    assert!(named == ["torque_offset"] || named == ["coulomb_asym"], "{named:?}");
    assert!(words.contains("the simulator misses") && words.contains("The simulator contains: "), "{words}");
}

#[test]
fn diagnose_twice_gives_the_same_bytes_and_no_alarm_on_a_sound_robot() {
    let bench = recorded();
    for out in ["one", "two"] {
        ok(&diagnose(&bench, out, &[&["--seed", "7"][..], &RECORDINGS].concat()));
    }
    for file in ["findings.json", "model.toml", "report.html"] {
        let read = |out: &str| std::fs::read(bench.path().join(out).join(file)).expect(file);
        assert!(read("one") == read("two"), "{file} differs between two runs");
    }
    let findings = json(&bench.path().join("one/findings.json"));
    check_findings(&findings);
    assert_eq!(
        (&findings["mismatch"]["detected"], &findings["findings"]),
        (&Value::from(false), &serde_json::json!([]))
    );
}

#[test]
fn diagnose_refuses_in_one_line() {
    let bench = recorded();
    bench.write("corrupt.csv", "t,q1,q2,q3,tau1,tau2,tau3\n0,0,0,0,1,1,1\n0.001,0,0,0,1,1\n0.002,0,0,0,1,1,1\n");
    let [a, b, _] = RECORDINGS;
    let cases: &[(&[&str], &[&str])] = &[
        (&["absent.csv"], &["absent.csv", "no such file"]),
        (&[a, "corrupt.csv"], &["corrupt.csv:3:"]),
        (&["--band", "0", a, b], &["--band", "0"]),
        (&["--moving", "-1", a, b], &["--moving", "-1"]),
        (&["--train", a], &["1 training and 0 test"]),
        (&["--train", a, "--test", a], &["traj_01.csv", "training and test alike"]),
        (&["--train", a, "--test", "rec/traj_02.csv@3:2"], &["traj_02.csv@3:2"]),
        (&["--holdout", "third", a], &["third", "halves"]),
        (&["--holdout", "recordings", a], &["1 recording", "2"]),
        (&[a, b, "--sim", "absent.csv"], &["absent.csv", "no such file"]),
    ];
    for (args, words) in cases {
        refused(&diagnose(&bench, "out", args), words);
    }
    refused(&diagnose(&bench, "robot.toml", &[a, b]), &["robot.toml", "expected a folder"]);
    assert_eq!(diagnose(&bench, "out", &[]).status.code(), Some(2), "no recording is a misuse");
    assert!(!bench.path().join("out").exists(), "what is refused leaves nothing behind");
}
