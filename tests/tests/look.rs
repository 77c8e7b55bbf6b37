//! What people do with recordings and running graphs: export, play, echo, hz, and the notebook page.

use lacuna_tests::{Bench, assert_shm_clean, error_line, report, wait_for, workspace};
use serde_json::Value;
use std::path::Path;
use std::process::{Command, Output};
use std::time::{Duration, Instant};

const SIMULATION: &str = "seed = 4\n[friction]\nf_c = [5.2, 4.6, 4.9]\nf_v = [0.95, 0.8, 0.9]\n\
[[trajectory]]\nkind = \"fourier\"\nduration_s = 4.0\ncount = 2\n";

fn ok(output: &Output) -> String {
    let errors = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{errors}");
    String::from_utf8(output.stdout.clone()).expect("text")
}

fn refused(output: &Output, words: &[&str]) {
    let line = error_line(output);
    assert_eq!(output.status.code(), Some(2), "{line}");
    for word in words {
        assert!(line.contains(word), "\"{word}\" belongs in: {line}");
    }
}

fn lines(text: &str) -> Vec<Value> {
    text.lines().map(|l| serde_json::from_str(l).unwrap_or_else(|e| panic!("{l}: {e}"))).collect()
}

/// A folder with robot.toml, rec/traj_01.csv and run.mcap, recorded by the whole graph.
fn recorded() -> Bench {
    let bench = Bench::new();
    bench.write("sim.toml", SIMULATION);
    ok(&bench.lacuna(&["simulate", "--robot", "robot.toml", "--config", "sim.toml", "--out", "rec"]));
    replay(&bench, "rec/traj_01.csv", "run.mcap");
    bench
}

fn replay(bench: &Bench, recording: &str, out: &str) {
    let graph = workspace().join("launch/replay.toml").display().to_string();
    let set = [format!("recording={recording}"), "robot=robot.toml".to_owned(), format!("out={out}")];
    let mut args = vec!["up", &graph, "--quiet"];
    set.iter().for_each(|s| args.extend(["--set", s.as_str()]));
    ok(&bench.lacuna(&args));
}

/// Stamps [ns] and first position of the simulated recording: the CSV is read here by hand.
fn samples(bench: &Bench) -> Vec<(i64, f64)> {
    let text = std::fs::read_to_string(bench.path().join("rec/traj_01.csv")).expect("recording");
    let rows = text.lines().skip(1).map(|l| {
        let mut cells = l.split(',').map(|c| c.parse::<f64>().expect("number"));
        let t = cells.next().expect("t");
        ((t * 1e9).round() as i64, cells.next().expect("q1"))
    });
    rows.collect()
}

#[test]
fn a_recording_is_looked_at_played_and_exported() {
    let bench = recorded();
    let expected = samples(&bench);
    let n = expected.len();

    // hz: the simulator samples at 1 kHz.
    let hz: Value = serde_json::from_str(&ok(&bench.lacuna(&["hz", "run.mcap", "--json"]))).expect("JSON");
    let of = |name: &str| hz["topics"].as_array().into_iter().flatten().find(|t| t["topic"] == name).cloned();
    for topic in ["/measured", "/residual", "/status"] {
        let t = of(topic).unwrap_or_else(|| panic!("{topic} in {hz}"));
        assert_eq!((t["messages"].as_u64(), t["not_increasing"].as_u64()), (Some(n as u64), Some(0)));
        assert!((t["rate_hz"].as_f64().expect("rate") - 1000.0).abs() < 1e-6, "{t}");
        assert!((t["period"]["max_s"].as_f64().expect("step") - 1e-3).abs() < 1e-12, "{t}");
    }
    let csv = ["hz", "rec/traj_01.csv", "--robot", "robot.toml", "--json"];
    let csv: Value = serde_json::from_str(&ok(&bench.lacuna(&csv))).expect("JSON");
    assert_eq!(csv["topics"][0]["messages"].as_u64(), Some(n as u64));

    // echo: every sample with its stamp and number.
    let all = lines(&ok(&bench.lacuna(&["echo", "run.mcap", "--topics", "/measured", "--json"])));
    assert_eq!(all.len(), n);
    for (line, (stamp, q1)) in all.iter().zip(&expected) {
        assert_eq!((line["stamp_ns"].as_i64(), line["fields"]["position"][0].as_f64()), (Some(*stamp), Some(*q1)));
    }
    assert_eq!(all[0]["fields"]["name"], serde_json::json!(["q1", "q2", "q3"]));
    let words = ok(&bench.lacuna(&["echo", "run.mcap", "--from", "1", "--limit", "3"]));
    assert_eq!(words.lines().count(), 3, "{words}");
    let part = ["echo", "rec/traj_01.csv", "--robot", "robot.toml", "--from", "1", "--until", "1.25", "--json"];
    let part = lines(&ok(&bench.lacuna(&part)));
    assert_eq!((part.len(), part[0]["stamp_ns"].as_i64()), (250, Some(expected[1000].0)));

    // play: the same lines, at their pace. Never quicker; how much slower is the machine's affair.
    let args = ["play", "run.mcap", "--topics", "/payload", "--from", "0.5", "--until", "2.5", "--rate", "4", "--json"];
    let started = Instant::now();
    let played = lines(&ok(&bench.lacuna(&args)));
    assert!(started.elapsed() >= Duration::from_millis(495), "2 s at four times the speed");
    assert_eq!(played.len(), 2000);

    // export, for the robot's own commands: identify reads back what it would have read.
    let exported = ok(&bench.lacuna(&["export", "run.mcap", "--to", "run.csv", "--json"]));
    let exported: Value = serde_json::from_str(&exported).expect("JSON");
    assert_eq!((exported["rows"].as_u64(), exported["late"].as_u64()), (Some(n as u64), Some(0)));
    let table = std::fs::read_to_string(bench.path().join("run.csv")).expect("table");
    let header: Vec<&str> = table.lines().next().expect("header").split(',').collect();
    let at = |name: &str| header.iter().position(|h| *h == name).unwrap_or_else(|| panic!("{name} in {header:?}"));
    let (stamp, q1, residual) = (at("stamp_ns"), at("measured_q_rad_q1"), at("residual_tau_nm_q2"));
    assert_eq!(table.lines().count(), n + 1);
    for (line, expected) in table.lines().skip(1).zip(&expected) {
        let cells: Vec<&str> = line.split(',').collect();
        let read = (cells[stamp].parse::<i64>().ok(), cells[q1].parse::<f64>().ok());
        assert_eq!(read, (Some(expected.0), Some(expected.1)));
        assert!(cells[residual].parse::<f64>().is_ok(), "{line}");
    }
    refused(&bench.lacuna(&["export", "run.mcap", "--to", "run.csv"]), &["run.csv", "existing", "--force"]);
    refused(&bench.lacuna(&["export", "rec/traj_01.csv", "--to", "a.mat"]), &["traj_01.csv", "--robot"]);
    refused(&bench.lacuna(&["echo", "run.mcap", "--topics", "/absent"]), &["run.mcap", "/measured", "/absent"]);
    refused(&bench.lacuna(&["play", "run.mcap", "--rate", "0"]), &["--rate", "positive"]);
    refused(&bench.lacuna(&["echo", "run.mcap", "--from", "3", "--until", "2"]), &["--until"]);
    assert!(!bench.path().join("a.mat").exists());
}

#[test]
fn a_recording_plays_through_a_graph_with_the_robot_that_is_in_it() {
    let bench = recorded();
    // Nothing but the recording is needed.
    std::fs::remove_file(bench.path().join("robot.toml")).expect("robot file");
    let graph = workspace().join("launch/live.toml").display().to_string();
    let args = ["play", "run.mcap", "--graph", &graph, "--set", "out=again.mcap", "--from", "1", "--until", "2"];
    let output = bench.lacuna(&[&args[..], &["--rate", "2", "--json"]].concat());
    let report = report(&output);
    assert_eq!(output.status.code(), Some(0), "{report}");
    assert_eq!((report["samples"].as_u64(), report["lost"].as_u64()), (Some(1000), Some(0)), "{report}");
    assert!(report["seconds"].as_f64().expect("seconds") >= 0.49, "paced: {report}");
    let hz: Value = serde_json::from_str(&ok(&bench.lacuna(&["hz", "again.mcap", "--json"]))).expect("JSON");
    let messages = |name: &str| {
        let found = hz["topics"].as_array().into_iter().flatten().find(|t| t["topic"] == name);
        found.and_then(|t| t["messages"].as_u64())
    };
    assert_eq!((messages("/measured"), messages("/residual")), (Some(1000), Some(1000)));
    let set = ["play", "run.mcap", "--graph", &graph, "--set", "rate=3"];
    refused(&bench.lacuna(&set), &["--set rate", "--rate"]);
}

/// A live graph at recorded speed, slow enough to be looked at.
fn live(bench: &Bench) -> lacuna_tests::Running {
    let graph = workspace().join("launch/live.toml").display().to_string();
    let set = ["recording=rec/traj_01.csv", "robot=robot.toml", "out=live.mcap", "rate=0.4"];
    let args: Vec<&str> = set.iter().flat_map(|s| ["--set", *s]).collect();
    bench.up(&graph, &args)
}

#[test]
fn observers_of_a_live_graph_are_not_part_of_it() {
    let bench = Bench::new();
    bench.write("sim.toml", SIMULATION);
    ok(&bench.lacuna(&["simulate", "--robot", "robot.toml", "--config", "sim.toml", "--out", "rec"]));
    let running = live(&bench);
    let status = running.wait_running();
    let run = status["run"].as_str().expect("run").to_owned();

    let seen = lines(&ok(&bench.lacuna(&["echo", "--run", &run, "--topics", "smoothed", "--limit", "20", "--json"])));
    assert_eq!(seen.len(), 20);
    let seq: Vec<u64> = seen.iter().filter_map(|l| l["fields"]["seq"].as_u64()).collect();
    assert!(seq.windows(2).all(|w| w[1] > w[0]), "{seq:?}");
    assert_eq!(seen[0]["fields"]["q_rad"].as_array().map(Vec::len), Some(3));

    let args = ["hz", "--run", &run, "--topics", "measured,payload", "--seconds", "2", "--json"];
    let hz: Value = serde_json::from_str(&ok(&bench.lacuna(&args))).expect("JSON");
    assert_eq!(hz["between"], "live");
    for topic in hz["topics"].as_array().expect("topics") {
        // 400 a second are published; what an observer may miss on a busy machine it counts.
        let sum = topic["messages"].as_u64().expect("n") + topic["missing"].as_u64().expect("missing");
        let rate = sum as f64 / topic["duration_s"].as_f64().expect("duration");
        assert!((rate - 400.0).abs() < 40.0, "{topic}");
    }
    refused(&bench.lacuna(&["echo", "--run", &run, "--topics", "absent"]), &["absent", "measured"]);

    // One that hangs, and one that is killed: the graph goes on, loses nothing, and ends in time.
    let observer = || {
        Command::new(lacuna_tests::bin("lacuna"))
            .args(["echo", "--run", &run, "--json"])
            .stdout(std::fs::File::create(bench.path().join("seen.jsonl")).expect("file"))
            .spawn()
            .expect("observer")
    };
    let mut killed = observer();
    let seen = || std::fs::metadata(bench.path().join("seen.jsonl")).is_ok_and(|m| m.len() > 0).then_some(());
    wait_for("the observer to see something", Duration::from_secs(20), seen);
    killed.kill().expect("kill");
    killed.wait().expect("wait");
    let mut hangs = observer();
    wait_for("the second one as well", Duration::from_secs(20), seen);
    let pid = rustix::process::Pid::from_raw(hangs.id() as i32).expect("pid");
    rustix::process::kill_process(pid, rustix::process::Signal::STOP).expect("stop");

    let report = report(&running.output());
    assert_eq!((report["samples"].as_u64(), report["lost"].as_u64()), (Some(4000), Some(0)), "{report}");
    assert_eq!(report["restarts"].as_u64(), Some(0), "{report}");
    hangs.kill().expect("kill");
    hangs.wait().expect("wait");
    assert_shm_clean(&run);
    refused(&bench.lacuna(&["echo", "--run", &run]), &["not running"]);
    refused(&bench.lacuna(&["hz", "--run", "no-such-run"]), &["no-such-run"]);
}

#[test]
fn an_observer_of_a_replay_is_refused() {
    let bench = Bench::new();
    bench.write("sim.toml", SIMULATION);
    ok(&bench.lacuna(&["simulate", "--robot", "robot.toml", "--config", "sim.toml", "--out", "rec"]));
    let graph = workspace().join("launch/replay.toml").display().to_string();
    let set = ["recording=rec/traj_01.csv", "robot=robot.toml", "out=run.mcap", "rate=1"];
    let running = bench.up(&graph, &set.iter().flat_map(|s| ["--set", *s]).collect::<Vec<_>>());
    let run = running.wait_running()["run"].as_str().expect("run").to_owned();
    for command in ["echo", "hz"] {
        refused(&bench.lacuna(&[command, "--run", &run]), &["replay", "hold up", "recording"]);
    }
    let report = report(&running.output());
    assert_eq!((report["samples"].as_u64(), report["lost"].as_u64()), (Some(4000), Some(0)));
}

/// The code blocks of a page in a language.
fn blocks(page: &str, language: &str) -> Vec<String> {
    let mut found = Vec::new();
    let mut rest = page;
    let begin = format!("```{language}\n");
    while let Some(at) = rest.find(&begin) {
        rest = &rest[at + begin.len()..];
        let end = rest.find("```").expect("a block ends");
        found.push(rest[..end].to_owned());
        rest = &rest[end + 3..];
    }
    found
}

#[test]
fn the_notebook_page_runs() {
    let Ok(python) = std::env::var("LACUNA_TEST_PYTHON_TABLES") else {
        eprintln!("SKIPPED: LACUNA_TEST_PYTHON_TABLES names no Python with pandas, pyarrow and matplotlib");
        return;
    };
    let bench = recorded();
    ok(&bench.lacuna(&["export", "run.mcap", "--to", "run.parquet"]));
    ok(&bench.lacuna(&[
        "diagnose",
        "--robot",
        "robot.toml",
        "--out",
        "findings",
        "rec/traj_01.csv",
        "rec/traj_02.csv",
    ]));
    let page = std::fs::read_to_string(workspace().join("docs/NOTEBOOK.md")).expect("page");
    let code = blocks(&page, "python");
    assert_eq!(code.len(), 4);
    // Beyond what the page says: table and direct reading agree, and the residual is that of the table.
    let checks = "import numpy as np\n\
        assert list(direct.columns) == ['q1', 'q2', 'q3'] and len(direct) == len(run) > 3000\n\
        assert np.array_equal(direct.to_numpy(), residual.to_numpy())\n\
        assert units['measured_tau_nm_q1'] == 'Nm' and len(rows) == max(1, len(table))\n\
        assert rows.robot[0] == findings['robot'] and rows.findings[0] == len(table)\n";
    let script = bench.write("page.py", &format!("{}\n{checks}", code.join("\n")));
    let output = Command::new(python)
        .arg(script)
        .current_dir(bench.path())
        .env("MPLBACKEND", "Agg")
        .env("MPLCONFIGDIR", bench.path())
        .output()
        .expect("python");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let picture = std::fs::read(bench.path().join("residual.png")).expect("picture");
    assert!(picture.starts_with(b"\x89PNG") && picture.len() > 10_000);
    assert!(Path::new(&bench.path().join("findings/result.json")).exists());
}
