//! Graphs that are killed, starved, starved of disk, watched by strangers. The campaigns are those of `lacuna bench`,
//! scaled down.

use lacuna_benches::balance;
use lacuna_interfaces::graph::GraphFile;
use lacuna_tests::{Bench, Chain, Running, bin, error_line, report, wait_for, workspace};
use rustix::process::{Pid, Signal, geteuid, kill_process};
use serde_json::Value;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

fn relay(_: usize) -> String {
    "lacuna-test-relay".to_owned()
}

/// `lacuna bench ARGS --json`; the benchmark itself fails (exit code 1) if anything was not as it should be.
fn campaign(args: &[&str]) -> Value {
    let out = Command::new(bin("lacuna"))
        .arg("bench")
        .args(args)
        .arg("--json")
        .current_dir(workspace())
        .stdin(Stdio::null())
        .output()
        .expect("lacuna starts");
    let text = String::from_utf8_lossy(&out.stdout).into_owned();
    assert_eq!(out.status.code(), Some(0), "{text}{}", String::from_utf8_lossy(&out.stderr));
    serde_json::from_str::<Value>(&text).expect("JSON")["result"].take()
}

fn check_kills(result: &Value, kills: u64, replays: u64) {
    let live = &result["live"];
    assert_eq!(live["kills"], kills);
    assert_eq!(live["problems"], serde_json::json!([]));
    assert_eq!((live["raw_unexplained"].as_u64(), &live["flagged"]), (Some(0), &live["holes"]));
    let parts =
        ["raw_recorded", "raw_unpublished", "raw_recorder_down", "raw_overrun"].map(|k| live[k].as_u64().expect(k));
    assert_eq!(parts.iter().sum::<u64>(), live["raw_due"].as_u64().expect("raw_due"));
    let replay = &result["replay"];
    assert_eq!(replay["kills"].as_u64().zip(replay["too_late"].as_u64()).map(|(a, b)| a + b), Some(replays));
    assert_eq!(replay["one_line"], replay["kills"]);
}

#[test]
fn killed_processes_come_back_and_every_raw_sample_is_accounted_for() {
    check_kills(&campaign(&["faults", "--kills", "12", "--replays", "3", "--round", "6"]), 12, 3);
}

#[test]
#[ignore = "long: 300 kills in live graphs, 36 in replays; about six minutes"]
fn three_hundred_kills() {
    check_kills(&campaign(&["faults"]), 300, 36);
}

#[test]
fn a_replay_under_stress_loses_nothing() {
    let rows = campaign(&["stress", "--samples", "3000", "--repeats", "6"]);
    for row in rows.as_array().expect("rows") {
        assert_eq!((&row["runs"], &row["lost"], &row["failed"]), (&1.into(), &0.into(), &serde_json::json!([])));
        assert_eq!(row["samples"], 3_000);
    }
}

#[test]
#[ignore = "long: a million samples six times, half an hour of soak"]
fn a_million_samples_under_stress_and_a_long_soak() {
    let rows = campaign(&["stress", "--repeats", "6"]);
    assert!(rows.as_array().expect("rows").iter().all(|r| r["samples"] == 1_000_000), "{rows}");
    campaign(&["soak"]);
}

#[test]
fn a_short_soak_balances_its_counts() {
    let out = Command::new(bin("lacuna"))
        .args(["bench", "soak", "--minutes", "0.05", "--json"])
        .current_dir(workspace())
        .output()
        .expect("lacuna starts");
    // Memory has not settled after three seconds; the long soak looks at it.
    let document: Value = serde_json::from_slice(&out.stdout).expect("JSON");
    let soak = &document["result"];
    assert_eq!((soak["samples"].as_u64(), soak["restarts"].as_u64()), (Some(12_000), Some(0)));
    for edge in soak["edges"].as_array().expect("edges") {
        assert_eq!(edge["dropped"], edge["gaps"], "{edge}");
    }
    // Seven stages, the monitor among them, and the supervisor.
    assert_eq!(soak["processes"].as_array().map(Vec::len), Some(8));
}

#[test]
fn live_overload_drops_what_it_counts() {
    // A reader that sleeps most of the time, behind buffers of four.
    let chain = Chain {
        mode: "live",
        buffer: 4,
        samples: 8_000,
        paced_hz: Some(8_000.0),
        sink: "pause_every = 10, pause_us = 5000",
        ..Chain::default()
    };
    let bench = Bench::new();
    let text = chain.toml(relay);
    bench.write("g.toml", &text);
    let out = bench.up("g.toml", &[]).output();
    assert_eq!(out.status.code(), Some(3), "{}", String::from_utf8_lossy(&out.stderr));
    let report = report(&out);
    let edges = balance::edges(&GraphFile::parse(&text).expect("graph"), &report);
    assert_eq!(balance::disagreements(&edges), Vec::<String>::new());
    let last = edges.iter().find(|e| e.topic == "t3").expect("the sink's topic");
    assert!(last.dropped > 1000, "the sink was not overloaded: {last:?}");
    // Each hole is seen where it is, by the process that has it.
    let missing = report["nodes"]["sink"]["missing"].as_u64().expect("count");
    let received = report["nodes"]["sink"]["received"]["t3"].as_u64().expect("count");
    assert!(missing + received <= 8_000 && missing + received > 7_900, "{missing} + {received}");
}

#[test]
fn what_a_recorder_cannot_write_in_time_is_lost_and_said() {
    let bench = Bench::new();
    csv(&bench, 40_000, 1000.0);
    // Compression as slow as it can be, and room for one chunk beside the one under way.
    let graph = "name = \"slow\"\nmode = \"live\"\nrobot = \"robot.toml\"\nbuffer = 16384\n[[node]]\nname = \"source\"\n\
        exec = \"lacuna-source\"\noutput = \"measured\"\nconfig = { recording = \"run.csv\", rate = 20.0 }\n[[node]]\n\
        name = \"recorder\"\nexec = \"lacuna-recorder\"\ninputs = [\"measured\"]\n\
        config = { path = \"run.mcap\", level = 22, chunk_kib = 1024, queue_chunks = 1 }\n";
    bench.write("g.toml", graph);
    let out = bench.up("g.toml", &[]).output();
    assert_eq!(out.status.code(), Some(3), "{}", String::from_utf8_lossy(&out.stderr));
    let report = report(&out);
    let recorder = &report["nodes"]["recorder"];
    let count = |value: &Value| value.as_u64().expect("count");
    let (dropped, lost) = (count(&recorder["dropped"]), count(&report["lost"]));
    assert!(dropped > 0 && dropped <= lost && lost <= count(&report["samples"]), "{report}");
    let kept = lacuna_tests::messages(&bench.path().join("run.mcap"))["/measured"].len() as u64;
    assert!(kept >= count(&recorder["received"]["measured"]) - dropped, "{kept}: {report}");
}

#[test]
fn a_stopped_reader_holds_a_replay_back_and_nothing_is_lost() {
    let chain = Chain { samples: 200_000, buffer: 8, ..Chain::default() };
    let bench = Bench::new();
    bench.write("g.toml", &chain.toml(relay));
    let run = bench.up("g.toml", &[]);
    run.wait_running();
    let pid = Pid::from_raw(run.pid("relay1")).expect("pid");
    kill_process(pid, Signal::STOP).expect("stop");
    std::thread::sleep(Duration::from_millis(700));
    kill_process(pid, Signal::CONT).expect("continue");
    let out = run.output();
    assert_eq!(out.status.code(), Some(0), "{}", String::from_utf8_lossy(&out.stderr));
    assert_eq!(report(&out)["nodes"]["sink"]["received"]["t3"], 200_000);
}

/// A live graph of stand-ins that runs and whose source is started again when it dies; its folder, itself and its name.
fn live_graph() -> (Bench, Running, String) {
    let bench = Bench::new();
    let text = Chain { mode: "live", samples: 1_000_000, relays: 1, ..Chain::default() }.toml(relay);
    let text = text
        .replace("paced = false", "live = true")
        .replace("output = \"t0\"", "output = \"t0\"\nrestart = \"on-failure\"");
    bench.write("g.toml", &text);
    let run = bench.up("g.toml", &[]);
    let name = run.wait_running()["run"].as_str().expect("run").to_owned();
    (bench, run, name)
}

#[test]
fn a_live_source_that_dies_goes_on_with_new_numbers() {
    let (bench, run, name) = live_graph();
    // At once, when nothing is known of its rate, and again when something is.
    for pause_ms in [200, 1800] {
        std::thread::sleep(Duration::from_millis(pause_ms));
        let pid = run.pid("source");
        kill_process(Pid::from_raw(pid).expect("pid"), Signal::KILL).expect("kill");
        wait_for("a new source", Duration::from_secs(10), || (run.pid("source") != pid).then_some(()));
    }
    std::thread::sleep(Duration::from_millis(800));
    assert_eq!(bench.lacuna(&["down", &name]).status.code(), Some(0));
    let report = report(&run.output());
    assert_eq!(report["restarts"], 2);
    let faults = report["faults"].as_array().expect("faults");
    assert!(faults.iter().all(|f| f["flowing_ns"].is_u64()), "{faults:?}");
    // Every number is either there or counted as missing, and most of what came after the restarts is there.
    let sink = &report["nodes"]["sink"];
    let seen = &sink["details"]["seen"]["t1"];
    let (count, last) = (seen[0].as_u64().expect("count"), seen[1].as_u64().expect("last"));
    assert_eq!(count + sink["missing"].as_u64().expect("missing"), last, "{report}");
    assert_eq!(last, report["samples"].as_u64().expect("samples"));
    assert!(count > report["nodes"]["source"]["published"].as_u64().expect("published") + 500, "{report}");
}

/// What a process leaves that is killed between making a segment and giving it a size; iceoryx2 0.10 waits for such a
/// size without an end.
#[test]
fn a_segment_that_nobody_will_finish_holds_nobody_up() {
    let (bench, run, name) = live_graph();
    let (supervisor, source) = (Pid::from_raw(run.child.id() as i32).expect("pid"), run.pid("source"));
    std::thread::sleep(Duration::from_millis(300));
    // Its connections, empty before the supervisor hears of its death and cleans up after it.
    kill_process(supervisor, Signal::STOP).expect("stop");
    kill_process(Pid::from_raw(source).expect("pid"), Signal::KILL).expect("kill");
    let connections: Vec<PathBuf> =
        shm_files(&name).into_iter().filter(|p| p.extension().is_some_and(|e| e == "connection")).collect();
    assert!(!connections.is_empty(), "the bus names its connections otherwise");
    for path in &connections {
        std::fs::remove_file(path).expect("a connection");
        std::fs::File::create(path).expect("an empty one");
    }
    kill_process(supervisor, Signal::CONT).expect("continue");
    wait_for("a new source", Duration::from_secs(20), || (run.pid("source") != source).then_some(()));
    std::thread::sleep(Duration::from_millis(500));
    assert_eq!(bench.lacuna(&["down", &name]).status.code(), Some(0));
    let report = report(&run.output());
    assert_eq!(report["restarts"], 1);
    assert!(report["nodes"]["sink"]["received"]["t1"].as_u64().is_some_and(|n| n > 0), "{report}");
    lacuna_tests::assert_shm_clean(&name);
}

/// Runs a command as the user `nobody`; `None` with a word where that cannot be done.
fn as_nobody(test: &str) -> Option<Command> {
    let setpriv = Path::new("/usr/bin/setpriv");
    if !geteuid().is_root() || !setpriv.is_file() {
        eprintln!("SKIPPED: {test}: needs root and setpriv");
        return None;
    }
    let mut command = Command::new(setpriv);
    command.args(["--reuid=65534", "--regid=65534", "--clear-groups"]);
    Some(command)
}

#[test]
fn another_user_can_neither_read_nor_write_bus_and_recording() {
    let test = "another_user_can_neither_read_nor_write_bus_and_recording";
    if as_nobody(test).is_none() {
        return;
    }
    let bench = Bench::new();
    let live = workspace().join("launch/live.toml").display().to_string();
    csv(&bench, 20_000, 2000.0);
    let sets = ["recording=run.csv", "robot=robot.toml", "model=", "out=run.mcap"];
    let args: Vec<&str> = sets.iter().flat_map(|s| ["--set", s]).collect();
    let run = bench.up(&live, &args);
    let name = run.wait_running()["run"].as_str().expect("name").to_owned();
    let recording = bench.path().join("run.mcap");
    wait_for("a recording", Duration::from_secs(10), || recording.exists().then_some(()));
    // The recording's folder is this test's; what protects it there are its own rights.
    Command::new("chmod").arg("755").arg(bench.path()).status().expect("chmod");
    let mut paths = vec![recording, run_dir(&name), run_dir(&name).join("graph.toml")];
    paths.extend(shm_files(&name));
    assert!(paths.len() > 10, "the bus has its files somewhere else: {paths:?}");
    for path in &paths {
        for access in ["-r", "-w"] {
            let mut test = as_nobody(test).expect("as before");
            let may = test.arg("test").arg(access).arg(path).status().expect("test");
            assert_eq!(may.code(), Some(1), "nobody may {access} {}", path.display());
        }
    }
    // A process of that user cannot take part either.
    let mut stranger = as_nobody(test).expect("as before");
    let out = stranger
        .arg(bin("lacuna-torque"))
        .args(["--run"])
        .arg(run_dir(&name))
        .args(["--node", "torque", "--unsupervised"])
        .stdin(Stdio::null())
        .output()
        .expect("starts");
    assert_ne!(out.status.code(), Some(0), "{}", String::from_utf8_lossy(&out.stdout));
    assert_eq!(bench.lacuna(&["down", &name]).status.code(), Some(0));
    assert_eq!(report(&run.output())["restarts"], 0);
}

fn run_dir(run: &str) -> PathBuf {
    PathBuf::from(format!("/tmp/lacuna-{}", geteuid().as_raw())).join(run)
}

/// Everything of a run in shared memory.
fn shm_files(run: &str) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut folders = vec![PathBuf::from("/dev/shm")];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(&folder).into_iter().flatten().flatten() {
            let path = entry.path();
            if path.to_string_lossy().contains(run) {
                if path.is_dir() {
                    folders.push(path.clone());
                }
                found.push(path);
            }
        }
    }
    found
}

/// A recording of the synthetic motion of the benchmarks.
fn csv(bench: &Bench, samples: u64, rate_hz: f64) {
    lacuna_benches::motion::write_csv(&bench.path().join("run.csv"), samples, rate_hz).expect("csv");
}

#[test]
fn the_environment_changes_nothing() {
    let bench = Bench::new();
    bench.write("g.toml", &Chain { samples: 20_000, ..Chain::default() }.toml(relay));
    // What the bus would look for: a configuration in the working directory or the user's home.
    let hostile = "[global]\nroot-path = \"/nonexistent\"\nprefix = \"other_\"\n[defaults.publish-subscribe]\nmax-subscribers = 0\n";
    for folder in ["config", ".config/iceoryx2"] {
        std::fs::create_dir_all(bench.path().join(folder)).expect("folder");
        bench.write(&format!("{folder}/iceoryx2.toml"), hostile);
    }
    let out = Command::new(bin("lacuna"))
        .args(["up", "g.toml", "--json"])
        .current_dir(bench.path())
        .env("HOME", bench.path())
        .env("XDG_CONFIG_HOME", bench.path().join(".config"))
        .env("IOX2_LOG_LEVEL", "trace")
        .env("RUST_LOG", "trace")
        .env("LACUNA_BUFFER", "1")
        .env("TMPDIR", "/nonexistent")
        .output()
        .expect("lacuna starts");
    let report = report(&out);
    assert_eq!((report["samples"].as_u64(), report["lost"].as_u64()), (Some(20_000), Some(0)));
    assert!(out.stderr.is_empty(), "{}", String::from_utf8_lossy(&out.stderr));
    let logs = bench.lacuna(&["logs", report["run"].as_str().expect("run")]);
    let text = String::from_utf8_lossy(&logs.stdout).into_owned();
    assert!(!text.contains("TRACE") && !text.contains("DEBUG"), "{text}");
}

/// `lacuna up launch/replay.toml` in `bench`, recording to `out`.
fn replay_to(bench: &Bench, out: &str, more: &[&str]) -> std::process::Output {
    let graph = workspace().join("launch/replay.toml").display().to_string();
    let out = format!("out={out}");
    let sets = ["recording=run.csv", "robot=robot.toml", "model=", &out];
    let mut args = vec!["up", &graph, "--quiet"];
    args.extend(sets.iter().chain(more).flat_map(|s| ["--set", s]));
    bench.lacuna(&args)
}

#[test]
fn a_full_disk_is_one_line_and_what_was_written_reads() {
    let bench = Bench::new();
    let disk = bench.path().join("disk");
    std::fs::create_dir(&disk).expect("folder");
    let mounted = geteuid().is_root()
        && Command::new("mount")
            .args(["-t", "tmpfs", "-o", "size=1m", "tmpfs"])
            .arg(&disk)
            .stderr(Stdio::null())
            .status()
            .is_ok_and(|s| s.success());
    if !mounted {
        eprintln!("SKIPPED: a_full_disk_is_one_line_and_what_was_written_reads: cannot mount a small disk");
        return;
    }
    csv(&bench, 60_000, 1000.0);
    let done = replay_to(&bench, "disk/run.mcap", &["compression=none"]);
    let recovered = bench.lacuna(&["recover", "disk/run.mcap", "whole.mcap"]);
    bench.write("sim.toml", "[[trajectory]]\nkind = \"fourier\"\nduration_s = 3.0\ncount = 2\n");
    let others = [
        &["recover", "whole.mcap", "disk/again.mcap", "--json"][..],
        &["export", "run.csv", "--robot", "robot.toml", "--to", "disk/t.csv", "--json"],
        &["simulate", "--robot", "robot.toml", "--config", "sim.toml", "--out", "disk/rec", "--json"],
        &["messages", "--python", "--out", "disk/m.py"],
    ]
    .map(|args| (args, bench.lacuna(args)));
    // What is printed may go there, too.
    let full = std::fs::File::create(disk.join("printed")).expect("a name needs no room");
    let printed = [&["messages", "--python"][..], &["status", "--json"]].map(|args| {
        let mut lacuna = Command::new(bin("lacuna"));
        lacuna.args(args).stdout(full.try_clone().expect("handle")).output().expect("lacuna starts")
    });
    drop(full);
    let unmounted = Command::new("umount").arg(&disk).status().is_ok_and(|s| s.success());
    let line = error_line(&done);
    assert_eq!(done.status.code(), Some(1), "{line}");
    assert!(line.contains("run.mcap") && line.contains("No space left"), "{line}");
    assert!(recovered.status.success(), "{}", String::from_utf8_lossy(&recovered.stderr));
    // Whatever writes there: the input was right, so it failed and was not misused, and standard output is JSON or nothing.
    for (args, out) in others {
        let line = error_line(&out);
        assert_eq!((out.status.code(), out.stdout.len()), (Some(1), 0), "{args:?}: {line}");
        assert!(line.contains("disk/") && line.contains("No space left"), "{args:?}: {line}");
    }
    for out in printed {
        let line = error_line(&out);
        assert_eq!(out.status.code(), Some(1), "{line}");
        assert!(line.contains("standard output: cannot be written"), "{line}");
    }
    let bytes = std::fs::read(bench.path().join("whole.mcap")).expect("file");
    let messages = mcap::MessageStream::new(&bytes).expect("MCAP").collect::<Result<Vec<_>, _>>().expect("messages");
    assert!(messages.len() > 1000, "{}", messages.len());
    assert!(unmounted);
}

#[test]
fn a_folder_that_cannot_be_written_is_one_line() {
    let bench = Bench::new();
    csv(&bench, 5_000, 1000.0);
    for out in ["/proc/run.mcap", "absent/run.mcap", "run.csv/run.mcap"] {
        let done = replay_to(&bench, out, &[]);
        let line = error_line(&done);
        assert!(matches!(done.status.code(), Some(1 | 2)), "{line}");
        assert!(line.contains(out) || line.contains("run.csv"), "{line}");
    }
}

#[test]
fn a_recording_that_is_removed_or_cut_while_it_is_read() {
    for cut in [false, true] {
        let bench = Bench::new();
        csv(&bench, 8_000, 2000.0);
        let graph = workspace().join("launch/replay.toml").display().to_string();
        let sets = ["recording=run.csv", "robot=robot.toml", "model=", "out=run.mcap", "rate=1.0"];
        let args: Vec<&str> = sets.iter().flat_map(|s| ["--set", s]).collect();
        let run = bench.up(&graph, &args);
        run.wait_running();
        let path = bench.path().join("run.csv");
        if cut {
            let file = std::fs::OpenOptions::new().write(true).open(&path).expect("file");
            let length = file.metadata().expect("size").len();
            file.set_len(length * 3 / 4 + 7).expect("cut");
        } else {
            std::fs::remove_file(&path).expect("remove");
        }
        let done = run.output();
        if cut {
            // The row at the cut is a short one, or the recording just ends earlier; never samples that are not there.
            if done.status.success() {
                assert!(report(&done)["samples"].as_u64() < Some(8_000));
            } else {
                let line = error_line(&done);
                assert_eq!(done.status.code(), Some(2), "{line}");
                assert!(line.contains("run.csv:"), "{line}");
            }
        } else {
            // An open file stays readable, whatever its name does.
            assert_eq!(report(&done)["samples"], 8_000);
        }
    }
}

#[test]
fn priority_and_processors_are_what_the_graph_says_or_an_error() {
    let bench = Bench::new();
    let text = Chain { mode: "live", samples: 4_000, paced_hz: Some(2000.0), ..Chain::default() }.toml(relay);
    let with = |extra: &str| text.replace("output = \"t2\"\n", &format!("output = \"t2\"\n{extra}\n"));
    for (extra, expected) in [("priority = 100", "priority"), ("cpus = [4096]", "cpus"), ("cpus = [1000]", "cpus")] {
        bench.write("g.toml", &with(extra));
        let out = bench.lacuna(&["up", "g.toml", "--quiet"]);
        let line = error_line(&out);
        assert_eq!(out.status.code(), Some(2), "{line}");
        assert!(line.contains(expected) && line.contains("relay1"), "{line}");
    }
    bench.write("g.toml", &with("cpus = [0]\npriority = 10"));
    let run = bench.up("g.toml", &[]);
    if !geteuid().is_root() {
        let line = error_line(&run.output());
        assert!(line.contains("priority") && line.contains("CAP_SYS_NICE"), "{line}");
        eprintln!("SKIPPED: SCHED_FIFO itself: needs the right to it");
        return;
    }
    run.wait_running();
    let pid = run.pid("relay1");
    let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).expect("stat");
    // Fields 40 and 41 of proc_pid_stat(5), counted after the name in parentheses: real-time priority and policy.
    let fields: Vec<&str> = stat.rsplit_once(')').expect("name").1.split_whitespace().collect();
    assert_eq!((fields[37], fields[38]), ("10", "1"), "{stat}");
    let status = std::fs::read_to_string(format!("/proc/{pid}/status")).expect("status");
    let allowed = status.lines().find_map(|l| l.strip_prefix("Cpus_allowed_list:")).map(str::trim);
    assert_eq!(allowed, Some("0"));
    assert_eq!(report(&run.output())["samples"], 4_000);
}

#[test]
fn top_shows_a_running_graph_without_touching_it() {
    let bench = Bench::new();
    let chain = Chain { mode: "live", samples: 10_000, paced_hz: Some(2000.0), ..Chain::default() };
    bench.write("g.toml", &chain.toml(relay));
    let run = bench.up("g.toml", &[]);
    let name = run.wait_running()["run"].as_str().expect("run").to_owned();
    let look = wait_for("rates and latencies", Duration::from_secs(10), || {
        let out = bench.lacuna(&["top", &name, "--json", "--once"]);
        let look: Value = serde_json::from_slice(&out.stdout).ok()?;
        let sink = look["nodes"].as_array()?.iter().find(|n| n["name"] == "sink")?.clone();
        let hops: Vec<&str> = sink["latency"].as_array()?.iter().filter_map(|l| l["hop"].as_str()).collect();
        (hops == ["in", "age"] && sink["rate_hz"].as_f64()? > 0.0).then_some(look)
    });
    assert_eq!((&look["schema"], &look["state"]), (&"lacuna.top/1".into(), &"running".into()));
    assert_eq!(look["nodes"].as_array().map(Vec::len), Some(5));
    let text = String::from_utf8(bench.lacuna(&["top", &name, "--once"]).stdout).expect("text");
    assert!(text.contains("relay2") && text.contains("age p99"), "{text}");
    let out = bench.lacuna(&["top", &name]);
    assert_eq!(out.status.code(), Some(2), "not a terminal");
    assert!(error_line(&out).contains("terminal"));
    terminal_view(&name);
    assert_eq!(report(&run.output())["lost"], 0);
    let after: Value = serde_json::from_slice(&bench.lacuna(&["top", &name, "--json"]).stdout).expect("JSON");
    assert_eq!(after["state"], "done");
}

/// `lacuna top` on a terminal: draws, and leaves at the key `q` with the terminal as it was.
fn terminal_view(run: &str) {
    let command = format!("stty rows 24 cols 150; {} top {run}", bin("lacuna").display());
    let started = Command::new("script")
        .args(["-qec", &command, "/dev/null"])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn();
    let Ok(mut child) = started else {
        eprintln!("SKIPPED: lacuna top on a terminal: no `script` to make one");
        return;
    };
    std::thread::sleep(Duration::from_millis(700));
    let mut keys = child.stdin.take().expect("keys");
    keys.write_all(b"q").expect("key");
    let out = child.wait_with_output().expect("script ends");
    drop(keys);
    let text = String::from_utf8_lossy(&out.stdout).into_owned();
    assert!(out.status.success() && text.contains("relay2"), "{text}");
    let (enter, leave) = (text.find("\u{1b}[?1049h"), text.find("\u{1b}[?1049l"));
    assert!(enter.is_some() && enter < leave, "{text}");
}
