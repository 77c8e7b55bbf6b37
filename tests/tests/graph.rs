//! A graph of processes: lossless, orderly, loud when something is wrong, gone when it is over.

use lacuna_tests::{Bench, Chain, assert_shm_clean, error_line, report, runs, wait_for};
use rustix::process::{Pid, Signal, kill_process};
use std::time::Duration;

fn relay(_: usize) -> String {
    "lacuna-test-relay".to_owned()
}

fn kill(pid: i32, signal: Signal) {
    kill_process(Pid::from_raw(pid).expect("a process id"), signal).expect("signal is sent");
}

fn start(chain: &Chain) -> (Bench, lacuna_tests::Running) {
    let bench = Bench::new();
    bench.write("g.toml", &chain.toml(relay));
    let run = bench.up("g.toml", &[]);
    (bench, run)
}

#[test]
fn replay_is_lossless_and_leaves_nothing() {
    // Small buffers and a slow reader make every edge block.
    for (buffer, sink) in [(512, ""), (1, ""), (2, "pause_every = 500, pause_us = 2000")] {
        let chain = Chain { buffer, sink, samples: 20_000, ..Chain::default() };
        let (_bench, run) = start(&chain);
        let out = run.output();
        let report = report(&out);
        assert_eq!(out.status.code(), Some(0));
        assert_eq!((report["samples"].as_u64(), report["lost"].as_u64()), (Some(20_000), Some(0)));
        for node in ["relay0", "relay1", "relay2"] {
            assert_eq!(report["nodes"][node]["published"], 20_000, "{node}");
        }
        assert_eq!(report["nodes"]["sink"]["details"]["seen"]["t3"], serde_json::json!([20_000, 20_000]));
        assert_eq!(report["nodes"]["sink"]["details"]["complete"], true);
        assert_shm_clean(report["run"].as_str().expect("run name"));
    }
}

#[test]
fn two_graphs_at_once_do_not_touch() {
    let chain = Chain { samples: 30_000, ..Chain::default() };
    let (_a, first) = start(&chain);
    let (_b, second) = start(&Chain { samples: 31_000, ..chain });
    let (first, second) = (report(&first.output()), report(&second.output()));
    assert_eq!((first["samples"].as_u64(), second["samples"].as_u64()), (Some(30_000), Some(31_000)));
    assert_eq!((first["lost"].as_u64(), second["lost"].as_u64()), (Some(0), Some(0)));
}

#[test]
fn a_stage_of_another_layout_is_refused_with_both_names() {
    let bench = Bench::new();
    let exec = |i| if i == 1 { "lacuna-test-other-layout".to_owned() } else { relay(i) };
    bench.write("g.toml", &Chain::default().toml(exec));
    let out = bench.lacuna(&["up", "g.toml", "--quiet"]);
    let line = error_line(&out);
    assert_eq!(out.status.code(), Some(2), "{line}");
    assert!(line.contains("lacuna.JointMeasured.0000000000000bad"), "{line}");
    assert_eq!(line.matches("lacuna.JointMeasured.").count(), 2, "both names belong in it: {line}");
}

#[test]
fn a_stage_killed_in_a_replay_fails_the_run() {
    let chain = Chain { samples: 10_000_000, ..Chain::default() };
    let (_bench, run) = start(&chain);
    let status = run.wait_running();
    kill(run.pid("relay1"), Signal::KILL);
    let out = run.output();
    let line = error_line(&out);
    assert_eq!(out.status.code(), Some(1), "{line}");
    assert!(line.contains("relay1") && line.contains("SIGKILL"), "{line}");
    assert!(out.stdout.is_empty(), "a failed run must not print a report");
    let name = status["run"].as_str().expect("run name");
    assert_shm_clean(name);
    let after = runs().into_iter().find(|s| s["run"] == name).expect("the run is remembered");
    assert_eq!(after["state"], "failed");
}

#[test]
fn stop_request_drains_in_order() {
    let chain = Chain { samples: 10_000_000, paced_hz: Some(2000.0), ..Chain::default() };
    let (bench, run) = start(&chain);
    let status = run.wait_running();
    let name = status["run"].as_str().expect("run name").to_owned();
    std::thread::sleep(Duration::from_millis(300));
    let down = bench.lacuna(&["down", &name]);
    assert_eq!(down.status.code(), Some(0), "{}", String::from_utf8_lossy(&down.stderr));
    let out = run.output();
    let report = report(&out);
    assert_eq!(out.status.code(), Some(0));
    assert_eq!((report["stopped"].as_bool(), report["lost"].as_u64()), (Some(true), Some(0)));
    assert!(report["samples"].as_u64() > Some(100));
    assert_eq!(report["nodes"]["sink"]["details"]["complete"], true);
    assert_shm_clean(&name);
}

#[test]
fn a_live_stage_that_dies_is_started_again_and_the_hole_is_counted() {
    let chain =
        Chain { mode: "live", samples: 8_000, paced_hz: Some(4000.0), restart: "on-failure", ..Chain::default() };
    let (_bench, run) = start(&chain);
    run.wait_running();
    let first = run.pid("relay1");
    kill(first, Signal::KILL);
    wait_for("the relay to be started again", Duration::from_secs(10), || (run.pid("relay1") != first).then_some(()));
    let out = run.output();
    let report = report(&out);
    assert_eq!(report["restarts"], 1);
    let lost = report["lost"].as_u64().expect("lost");
    let seen = report["nodes"]["sink"]["received"]["t3"].as_u64().expect("count");
    assert_eq!(seen + lost, 8_000, "what is missing at the end must be counted: {report}");
    assert_eq!(out.status.code(), Some(if lost > 0 { 3 } else { 0 }));
    assert_shm_clean(report["run"].as_str().expect("run name"));
}

#[test]
fn supervisor_killed_takes_the_stages_with_it() {
    let chain = Chain { samples: 10_000_000, paced_hz: Some(1000.0), ..Chain::default() };
    let (_bench, mut run) = start(&chain);
    run.wait_running();
    let pids: Vec<i32> = ["source", "relay0", "relay1", "relay2", "sink"].iter().map(|n| run.pid(n)).collect();
    run.child.kill().expect("kill");
    run.child.wait().expect("wait");
    wait_for("all stages to end", Duration::from_secs(20), || {
        let alive = |pid: &i32| std::path::Path::new(&format!("/proc/{pid}/exe")).exists();
        (!pids.iter().any(alive)).then_some(())
    });
}

#[test]
fn dry_run_and_only() {
    let bench = Bench::new();
    bench.write("g.toml", &Chain::default().toml(relay));
    let out = bench.lacuna(&["up", "g.toml", "--dry-run"]);
    let text = String::from_utf8_lossy(&out.stdout).into_owned();
    assert!(out.status.success() && text.contains("relay2") && text.contains("t0 → t1"), "{text}");
    let out = bench.lacuna(&["up", "g.toml", "--only", "source,relay0", "--json"]);
    let report = report(&out);
    assert_eq!(report["nodes"].as_object().map(serde_json::Map::len), Some(2));
    assert_eq!(report["nodes"]["relay0"]["published"], 50_000);
}

#[test]
fn bad_graphs_exit_2_with_one_line() {
    let good = Chain::default().toml(relay);
    let cases: [(&str, String, &[&str], &str); 8] = [
        ("unknown key", good.replace("buffer", "bufer"), &[], "g.toml:4"),
        ("no such executable", good.replace("lacuna-test-sink", "lacuna-test-sinc"), &[], "lacuna-test-sinc"),
        ("no such topic", good.replace("inputs = [\"t1\"]", "inputs = [\"tx\"]"), &[], "tx"),
        ("no such robot", good.replace("robot.toml", "rowbot.toml"), &[], "rowbot.toml"),
        ("unknown --set", good.clone(), &["--set", "speed=3"], "speed"),
        ("unknown node", good.clone(), &["--only", "sauce"], "sauce"),
        ("bad stage config", good.replace("rate_hz = 1000.0", "rate_hz = nan"), &[], "rate_hz"),
        ("unknown config key", good.replace("paced = false", "paced = false, pace = 1"), &[], "pace"),
    ];
    for (what, text, args, expect) in cases {
        let bench = Bench::new();
        bench.write("g.toml", &text);
        let out = bench.lacuna(&[&["up", "g.toml", "--quiet"], args].concat());
        let line = error_line(&out);
        assert_eq!(out.status.code(), Some(2), "{what}: {line}");
        assert!(line.contains(expect), "{what}: expected '{expect}' in: {line}");
    }
    let out = Bench::new().lacuna(&["up", "absent.toml"]);
    assert_eq!(out.status.code(), Some(2));
    assert!(error_line(&out).contains("absent.toml"));
}
