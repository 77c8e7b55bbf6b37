//! The real graph on a simulated recording: complete, in order, the same every time, readable by others, swappable,
//! and clear about bad input.

use lacuna_interfaces::RobotFile;
use lacuna_recording::ros::cdr::Cursor;
use lacuna_simulate::demo::DEMO_ROBOT;
use lacuna_tests::{Bench, MODEL, Messages, error_line, messages, report, shared_data, wait_for, workspace};
use rustix::process::{Pid, Signal, kill_process};
use std::path::Path;
use std::process::{Command, Output};
use std::time::Duration;

fn replay_with(bench: &Bench, graph: &Path, sets: &[&str]) -> Output {
    let graph = graph.display().to_string();
    let mut args = vec!["up", &graph, "--json"];
    let defaults = ["recording=run.csv", "robot=robot.toml", "model=model.toml", "out=run.mcap"];
    for set in defaults.iter().chain(sets) {
        args.extend(["--set", set]);
    }
    bench.lacuna(&args)
}

fn replay(bench: &Bench, sets: &[&str]) -> Output {
    replay_with(bench, &workspace().join("launch/replay.toml"), sets)
}

fn efforts(messages: &Messages, topic: &str) -> Vec<Vec<f64>> {
    let one = |data: &[u8]| -> Option<Vec<f64>> {
        let mut cursor = Cursor::new(data)?;
        cursor.header()?;
        cursor.strings()?;
        let mut list = || {
            let numbers = cursor.numbers()?;
            (0..numbers.len()).map(|i| numbers.get(i)).collect::<Option<Vec<f64>>>()
        };
        list()?;
        list()?;
        list()
    };
    messages[topic].iter().map(|(_, data)| one(data).expect("a JointState")).collect()
}

#[test]
fn every_sample_is_recorded_once_in_order_and_twice_the_same() {
    let bench = Bench::with_motion(3.0);
    let rows = std::fs::read_to_string(bench.path().join("run.csv")).expect("csv").lines().count() as u64 - 1;
    let mut runs = Vec::new();
    for (out, buffer) in [("a.mcap", ""), ("b.mcap", "buffer = 3\n")] {
        // The second run has tiny buffers: another interleaving, the same result.
        let text = std::fs::read_to_string(workspace().join("launch/replay.toml")).expect("graph");
        let graph =
            bench.write("g.toml", &text.replace("mode = \"replay\"\n", &format!("mode = \"replay\"\n{buffer}")));
        let done = replay_with(&bench, &graph, &[&format!("out={out}")]);
        let report = report(&done);
        assert_eq!(done.status.code(), Some(0));
        assert_eq!((report["samples"].as_u64(), report["lost"].as_u64()), (Some(rows), Some(0)));
        for topic in ["measured", "smoothed", "torque", "friction", "payload", "monitor"] {
            assert_eq!(report["nodes"]["recorder"]["received"][topic], rows, "{topic}");
        }
        runs.push(messages(&bench.path().join(out)));
    }
    let [mut first, mut second] = <[Messages; 2]>::try_from(runs).expect("two runs");
    for (topic, list) in &first {
        assert_eq!(list.len() as u64, rows, "{topic}");
        assert!(list.windows(2).all(|w| w[0].0 < w[1].0), "{topic} is out of order");
    }
    // The status holds clock readings.
    assert!(first.remove("/status").is_some() && second.remove("/status").is_some());
    assert_eq!(first.keys().collect::<Vec<_>>(), second.keys().collect::<Vec<_>>());
    for (topic, list) in &first {
        assert!(list == &second[topic], "{topic} differs between two replays");
    }
}

#[test]
fn independent_readers_see_what_was_recorded() {
    let Some(python) = std::env::var_os("LACUNA_TEST_PYTHON") else {
        eprintln!("SKIPPED: independent_readers_see_what_was_recorded: no Python with mcap (LACUNA_TEST_PYTHON)");
        return;
    };
    let bench = Bench::with_motion(2.0);
    report(&replay(&bench, &[]));
    let ours = messages(&bench.path().join("run.mcap"));
    let out = Command::new(python)
        .arg(workspace().join("tests/oracles/read_mcap.py"))
        .args(["mcap", "run.mcap"])
        .current_dir(bench.path())
        .output()
        .expect("python");
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    let theirs: serde_json::Value = serde_json::from_slice(&out.stdout).expect("JSON");
    let topics = theirs["topics"].as_object().expect("topics");
    assert_eq!(topics.len(), ours.len());
    for (topic, list) in &ours {
        let times: Vec<u64> =
            topics[topic]["log_time"].as_array().expect("times").iter().filter_map(|t| t.as_u64()).collect();
        assert_eq!(times, list.iter().map(|m| m.0).collect::<Vec<_>>(), "{topic}");
    }
    // Values, through their decoder: measured torque against the CSV the recording came from.
    let csv = std::fs::read_to_string(bench.path().join("run.csv")).expect("csv");
    let measured = topics["/measured"]["fields"]["effort"].as_array().expect("effort");
    for (row, effort) in csv.lines().skip(1).zip(measured) {
        let expected: Vec<f64> = row.split(',').skip(4).take(3).map(|v| v.parse().expect("number")).collect();
        let found: Vec<f64> = effort
            .as_array()
            .expect("list")
            .iter()
            .map(|v| v.as_str().expect("text").parse().expect("number"))
            .collect();
        assert_eq!(expected, found);
    }
    let names: Vec<&str> = theirs["attachments"].as_object().expect("attachments").keys().map(String::as_str).collect();
    assert_eq!(names, ["graph.toml", "model.toml", "robot.toml"]);
}

#[test]
fn stages_are_swapped_by_the_launch_file_alone() {
    let bench = Bench::with_motion(3.0);
    let text = std::fs::read_to_string(workspace().join("launch/replay.toml")).expect("graph");
    let other = text
        .replace("friction = \"lacuna-friction\"", "friction = \"lacuna-test-friction\"")
        .replace("exec = \"lacuna-torque\"", "exec = \"lacuna-test-torque\"");
    let graph = bench.write("other.toml", &other);
    let done = replay_with(&bench, &graph, &[]);
    assert_eq!(report(&done)["lost"], 0);
    let recorded = messages(&bench.path().join("run.mcap"));
    assert!(efforts(&recorded, "/friction").iter().flatten().all(|f| *f == 1.5));
    let (rigid, residual) = (efforts(&recorded, "/torque/rigid"), efforts(&recorded, "/residual"));
    let measured = efforts(&recorded, "/measured");
    for k in 0..measured.len() {
        for j in 0..3 {
            // Whatever stages made them, the payload stage's residual is the measured torque less the model.
            assert!((measured[k][j] - rigid[k][j] - 1.5 - residual[k][j]).abs() < 1e-9);
        }
    }
    assert!(rigid.iter().flatten().any(|t| t.abs() > 1.0), "the swapped torque stage did not run");
}

#[test]
fn bad_input_exits_2_with_one_line_and_leaves_no_complete_recording() {
    type Edit = fn(&str) -> String;
    fn line(text: &str, n: usize, edit: impl Fn(&str) -> String) -> String {
        text.lines().enumerate().map(|(i, l)| if i + 1 == n { edit(l) } else { l.to_owned() } + "\n").collect()
    }
    fn field(row: &str, i: usize, value: &str) -> String {
        row.split(',').enumerate().map(|(k, v)| if k == i { value } else { v }).collect::<Vec<_>>().join(",")
    }
    let cases: [(&str, Edit, &[&str]); 5] = [
        ("missing column", |t| t.replacen("tau2", "x_tau2", 1), &["run.csv", "tau2"]),
        ("text in a number", |t| line(t, 500, |l| field(l, 2, "abc")), &["run.csv:500", "abc"]),
        ("NaN", |t| line(t, 501, |l| field(l, 4, "nan")), &["run.csv:501", "nan"]),
        ("time runs backwards", |t| line(t, 502, |l| field(l, 0, "0.1")), &["run.csv:502", "0.1"]),
        ("short row", |t| line(t, 503, |_| "0.502,0.1".to_owned()), &["run.csv:503"]),
    ];
    // Forearms that cannot meet in the recorded poses.
    let bench = Bench::with_motion(1.0);
    bench.write("robot.toml", &DEMO_ROBOT.replace("l2 = 0.88", "l2 = 0.36"));
    let done = replay(&bench, &[]);
    let words = error_line(&done);
    assert_eq!(done.status.code(), Some(2), "{words}");
    assert!(words.contains("run.csv") && words.contains("workspace"), "{words}");
    assert!(!complete(&bench.path().join("run.mcap")));
    for (what, edit, expected) in cases {
        let bench = Bench::with_motion(1.0);
        let csv = std::fs::read_to_string(bench.path().join("run.csv")).expect("csv");
        bench.write("run.csv", &edit(&csv));
        let done = replay(&bench, &[]);
        let line = error_line(&done);
        assert_eq!(done.status.code(), Some(2), "{what}: {line}");
        expected.iter().for_each(|part| assert!(line.contains(part), "{what}: expected '{part}' in: {line}"));
        assert!(done.stdout.is_empty(), "{what}: a failed run printed a report");
        assert!(!complete(&bench.path().join("run.mcap")), "{what}: half a recording is marked complete");
    }
}

#[test]
fn bad_files_exit_2_with_one_line_before_anything_starts() {
    let serial = "kind = \"serial\"\nname = \"D3-1200-class\"\njoints = [\"a\", \"b\", \"c\", \"d\"]\n[[dh]]\n[[dh]]\n[[dh]]\n[[dh]]\n";
    let robot = |from: &str, to: &str| DEMO_ROBOT.replacen(from, to, 1);
    let cases = [
        ("unknown key in robot", "robot.toml", robot("l2 = ", "l3 = "), "robot.toml:7"),
        ("robot of other joints", "robot.toml", serial.to_owned(), "q4"),
        (
            "wrong joint names",
            "robot.toml",
            robot("[geometry]", "joints = [\"x\", \"y\", \"z\"]\nlimits = { typo = 1 }\n[geometry]"),
            "typo",
        ),
        ("unknown key in model", "model.toml", MODEL.replace("f_v", "fv"), "model.toml:7"),
        ("model of another robot", "model.toml", MODEL.replace("D3-1200", "D4"), "D4"),
        ("too few friction values", "model.toml", MODEL.replace("[1.5, 1.5, 1.5]", "[1.5]"), "f_c"),
    ];
    for (what, file, text, expected) in cases {
        let bench = Bench::with_motion(0.5);
        bench.write(file, &text);
        let done = replay(&bench, if what == "robot of other joints" { &["model="] } else { &[] });
        let line = error_line(&done);
        assert_eq!(done.status.code(), Some(2), "{what}: {line}");
        assert!(line.contains(expected), "{what}: expected '{expected}' in: {line}");
        assert!(!bench.path().join("run.mcap").exists(), "{what}: a recording was begun");
    }
    for (set, expected) in [
        ("recording=absent.csv", "absent.csv"),
        ("robot=absent.toml", "absent.toml"),
        ("model=absent.toml", "absent.toml"),
    ] {
        let bench = Bench::with_motion(0.5);
        let done = replay(&bench, &[set]);
        assert_eq!(done.status.code(), Some(2));
        assert!(error_line(&done).contains(expected), "{}", error_line(&done));
    }
    // An existing recording is not replaced unless asked.
    let bench = Bench::with_motion(0.5);
    bench.write("run.mcap", "precious");
    let done = replay(&bench, &[]);
    assert_eq!(done.status.code(), Some(2), "{}", error_line(&done));
    assert_eq!(std::fs::read_to_string(bench.path().join("run.mcap")).expect("file"), "precious");
    assert_eq!(replay(&bench, &["overwrite=true"]).status.code(), Some(0));
}

fn complete(path: &Path) -> bool {
    path.exists() && lacuna_recording::container::inspect(path).is_ok_and(|info| info.is_complete())
}

#[test]
fn a_killed_stage_leaves_a_readable_incomplete_recording() {
    let bench = Bench::with_motion(8.0);
    let graph = workspace().join("launch/replay.toml").display().to_string();
    let sets = ["recording=run.csv", "robot=robot.toml", "model=model.toml", "out=run.mcap", "rate=1.0"];
    let args: Vec<&str> = sets.iter().flat_map(|s| ["--set", s]).collect();
    let run = bench.up(&graph, &args);
    run.wait_running();
    std::thread::sleep(Duration::from_millis(1500));
    kill_process(Pid::from_raw(run.pid("friction")).expect("pid"), Signal::KILL).expect("kill");
    let done = run.output();
    let line = error_line(&done);
    assert_eq!(done.status.code(), Some(1), "{line}");
    assert!(line.contains("friction"), "{line}");
    let path = bench.path().join("run.mcap");
    assert!(!complete(&path));
    let robot = RobotFile::parse(DEMO_ROBOT).expect("robot");
    let read = lacuna_recording::read_all(&path, &robot).expect("readable up to the kill");
    assert!(read.len() > 800, "only {} samples of about 1500 are there", read.len());
}

#[test]
fn a_recorder_killed_in_a_live_run_goes_on_in_a_new_file() {
    let bench = Bench::with_motion(5.0);
    let graph = workspace().join("launch/live.toml").display().to_string();
    let sets = ["recording=run.csv", "robot=robot.toml", "model=model.toml", "out=run.mcap"];
    let args: Vec<&str> = sets.iter().flat_map(|s| ["--set", s]).collect();
    let run = bench.up(&graph, &args);
    run.wait_running();
    let robot = RobotFile::parse(DEMO_ROBOT).expect("robot");
    let (first, second) = (bench.path().join("run.mcap"), bench.path().join("run-restart1.mcap"));
    wait_for("the recording to hold samples", Duration::from_secs(10), || {
        lacuna_recording::read_all(&first, &robot).ok().filter(|r| r.len() > 500)
    });
    kill_process(Pid::from_raw(run.pid("recorder")).expect("pid"), Signal::KILL).expect("kill");
    let out = run.output();
    let report = report(&out);
    assert_eq!(report["restarts"], 1);
    assert!(!complete(&first) && complete(&second));
    let counts = [&first, &second].map(|path| lacuna_recording::read_all(path, &robot).expect("readable").len() as u64);
    assert!(counts.iter().all(|n| *n > 500), "{counts:?}");
    // What fell between the files is said in the second one, and in the run's report. The message ends with two numbers.
    let gaps = &messages(&second)["/gaps"];
    let raw =
        gaps.iter().find(|(_, data)| data.windows(9).any(|w| w == b"measured\0")).expect("a gap in the raw stream");
    let number = |from_end: usize| {
        let at = raw.1.len() - from_end;
        u64::from_le_bytes(raw.1[at..at + 8].try_into().expect("eight bytes"))
    };
    let (began, missing) = (number(16), number(8));
    assert_eq!((began, counts[0] + missing + counts[1]), (counts[0] + 1, report["samples"].as_u64().expect("samples")));
    let [down, lost] =
        [&report["nodes"]["recorder"]["while_down"], &report["lost"]].map(|n| n.as_u64().expect("count"));
    assert!(missing > 0 && missing <= down && down <= lost, "{missing} {down} {lost}");
    assert_eq!(out.status.code(), Some(3));
}

#[test]
fn shared_recordings_replay_to_their_end() {
    let Some(data) = shared_data("shared_recordings_replay_to_their_end") else { return };
    let recordings = [
        ("dfki_double_pendulum", "design_A.0_20220812_20220812-061157-PM_measured.csv"),
        ("staubli_tx40", "tx40_traj.csv"),
        ("kuka_kr300", "traj_A.csv"),
        ("kinova_gen3", "opti_traj_testing1.csv"),
        ("bam_xl330", "xl330_kp100_sin_sin_10h28m10.csv"),
        ("odrive_cogging", "slow2_nocomp_0.csv"),
    ];
    for (folder, file) in recordings {
        let bench = Bench::new();
        let path = |name: &str| data.join(folder).join(name).canonicalize().expect("shared file").display().to_string();
        let sets = [format!("recording={}", path(file)), format!("robot={}", path("robot.toml")), "model=".to_owned()];
        let done = replay(&bench, &sets.iter().map(String::as_str).collect::<Vec<_>>());
        let report = report(&done);
        assert_eq!(done.status.code(), Some(0), "{folder}");
        let rows = report["samples"].as_u64().expect("samples");
        assert_eq!(messages(&bench.path().join("run.mcap"))["/residual"].len() as u64, rows, "{folder}");
    }
}
