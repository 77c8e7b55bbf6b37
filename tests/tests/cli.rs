//! What every command keeps to: results on standard output, messages on standard error, the four exit codes, and help,
//! man pages and completions that know them all.

use lacuna_tests::{Bench, Chain, ROBOT, error_line, report};
use std::collections::{BTreeMap, BTreeSet};
use std::process::{Command, Stdio};

/// Names and help texts of all commands, as `lacuna help` lists them.
fn commands() -> BTreeMap<String, String> {
    let bench = Bench::new();
    let text = |args: &[&str]| String::from_utf8(bench.lacuna(args).stdout).expect("text");
    let overview = text(&["--help"]);
    let listed = overview.lines().skip_while(|l| !l.starts_with("Commands:")).skip(1).take_while(|l| !l.is_empty());
    // Descriptions that go on in another line are indented further.
    let names =
        listed.filter(|l| l.starts_with("  ") && !l.starts_with("   ")).filter_map(|l| l.split_whitespace().next());
    names.filter(|n| *n != "help").map(|n| (n.to_owned(), text(&[n, "--help"]))).collect()
}

/// A small example of every command that has `--json`, in the order in which they can run in one folder.
const JSON: [(&str, &[&str]); 16] = [
    (
        "simulate",
        &[
            "simulate",
            "--robot",
            "robot.toml",
            "--config",
            "sim.toml",
            "--out",
            "rec",
            "--truth",
            "truth.json",
            "--json",
        ],
    ),
    ("info", &["info", "rec/traj_01.csv", "--robot", "robot.toml", "--json"]),
    ("export", &["export", "rec/traj_01.csv", "--robot", "robot.toml", "--to", "table.csv", "--json"]),
    ("hz", &["hz", "rec/traj_01.csv", "--robot", "robot.toml", "--json"]),
    // These print an object a line: here one.
    ("echo", &["echo", "rec/traj_01.csv", "--robot", "robot.toml", "--limit", "1", "--json"]),
    ("play", &["play", "rec/traj_01.csv", "--robot", "robot.toml", "--until", "0.0005", "--json"]),
    (
        "identify",
        &["identify", "--robot", "robot.toml", "--out", "model", "--json", "rec/traj_01.csv", "rec/traj_02.csv"],
    ),
    ("payload", &["payload", "--robot", "robot.toml", "--model", "model/model.toml", "--json", "rec/traj_01.csv"]),
    (
        "diagnose",
        &["diagnose", "--robot", "robot.toml", "--out", "findings", "--json", "rec/traj_01.csv", "rec/traj_02.csv"],
    ),
    ("up", &["up", "g.toml", "--json"]),
    ("status", &["status", "--json"]),
    ("top", &["top", "--once", "--json"]),
    ("recover", &["recover", "cut.mcap", "whole.mcap", "--json"]),
    ("excite", &["excite", "--robot", "limited.toml", "--out", "motion.csv", "--candidates", "2", "--json"]),
    ("bench", &["bench", "stages", "--json"]),
    ("prove", &["prove", "concealed", "--cases", "1", "--json"]),
];

/// These take minutes; that they keep standard output to JSON is checked where they run.
const LONG: [&str; 2] = ["bench", "prove"];

#[test]
fn json_is_alone_on_standard_output() {
    let with: BTreeSet<String> = commands()
        .into_iter()
        .filter(|(_, help)| help.lines().any(|l| l.trim_start().starts_with("--json")))
        .map(|(name, _)| name)
        .collect();
    let known: BTreeSet<String> = JSON.iter().map(|(name, _)| (*name).to_owned()).collect();
    assert_eq!(with, known, "every command with --json needs an example here");

    let bench = Bench::new();
    bench.write("sim.toml", "[[trajectory]]\nkind = \"fourier\"\nduration_s = 3.0\ncount = 2\n");
    let limits = "[limits]\nq_min_rad = -0.4\nq_max_rad = 1.1\nqd_max_rad_s = 6.0\nqdd_max_rad_s2 = 60.0\n";
    bench.write("limited.toml", &format!("{ROBOT}{limits}"));
    bench.write("g.toml", &Chain { samples: 500, ..Chain::default() }.toml(|_| "lacuna-test-relay".to_owned()));
    for (name, args) in JSON.iter().filter(|(name, _)| !LONG.contains(name)) {
        if *name == "recover" {
            let graph = "name = \"r\"\nmode = \"replay\"\nrobot = \"robot.toml\"\n[[node]]\nname = \"source\"\nexec = \"lacuna-source\"\n\
                output = \"measured\"\nconfig = { recording = \"rec/traj_01.csv\", rate = \"max\" }\n[[node]]\nname = \"recorder\"\n\
                exec = \"lacuna-recorder\"\ninputs = [\"measured\"]\nconfig = { path = \"run.mcap\" }\n";
            bench.write("r.toml", graph);
            report(&bench.lacuna(&["up", "r.toml", "--json"]));
            let bytes = std::fs::read(bench.path().join("run.mcap")).expect("recording");
            std::fs::write(bench.path().join("cut.mcap"), &bytes[..bytes.len() * 2 / 3]).expect("cut");
        }
        let out = bench.lacuna(args);
        let errors = String::from_utf8_lossy(&out.stderr).into_owned();
        assert_eq!(out.status.code(), Some(0), "{name}: {errors}");
        let parsed: Result<serde_json::Value, _> = serde_json::from_slice(&out.stdout);
        assert!(parsed.is_ok(), "{name}: {:?}: {}", parsed.err(), String::from_utf8_lossy(&out.stdout));
        assert!(!errors.contains('{'), "{name}: JSON belongs on standard output: {errors}");
        // With nothing to say, nothing is said; an error keeps standard output empty.
        let out = bench.lacuna(&[args[0], "--no-such-option", "--json"]);
        assert_eq!((out.status.code(), out.stdout.len()), (Some(2), 0), "{name}");
    }
}

#[test]
fn every_exit_code_is_given() {
    let bench = Bench::new();
    let relay = |_: usize| "lacuna-test-relay".to_owned();
    // 0: done. 2: bad use and bad input.
    assert_eq!(bench.lacuna(&["messages", "--python"]).status.code(), Some(0));
    assert_eq!(bench.lacuna(&["messages"]).status.code(), Some(2));
    let out = bench.lacuna(&["info", "absent.mcap"]);
    assert_eq!(out.status.code(), Some(2), "{}", error_line(&out));
    // 3: a reader that is too slow for a live stream loses samples, and the run says so.
    let slow = Chain {
        mode: "live",
        buffer: 2,
        samples: 2_000,
        paced_hz: Some(4000.0),
        sink: "pause_every = 5, pause_us = 20000",
        ..Chain::default()
    };
    bench.write("slow.toml", &slow.toml(relay));
    let out = bench.lacuna(&["up", "slow.toml", "--json"]);
    assert_eq!(out.status.code(), Some(3), "{}", String::from_utf8_lossy(&out.stderr));
    assert!(report(&out)["lost"].as_u64() > Some(0));
    // 1: a process of the graph ends without a word.
    let dies = |i: usize| if i == 1 { "/bin/false".to_owned() } else { relay(i) };
    bench.write("dies.toml", &Chain::default().toml(dies));
    for how in ["--quiet", "--json"] {
        let out = bench.lacuna(&["up", "dies.toml", how]);
        assert_eq!(out.status.code(), Some(1), "{}", error_line(&out));
        assert!(out.stdout.is_empty(), "{}", String::from_utf8_lossy(&out.stdout));
    }
}

#[test]
fn a_command_line_that_cannot_be_used_is_one_line() {
    let bench = Bench::new();
    for (args, words) in [
        (&["stauts"][..], &["lacuna: unrecognized subcommand 'stauts'", "'status'", "see 'lacuna --help'"][..]),
        (&["up", "g.toml", "--jsn"], &["lacuna up: unexpected argument '--jsn'", "'--json'", "see 'lacuna up --help'"]),
        (&["identify"], &["lacuna identify: ", "--robot <FILE>, --out <DIR>"]),
        (&["bench", "stress", "--only", "hogs"], &["lacuna bench stress: ", "'hogs'", "start-order", "exists: 'hog'"]),
        (&["bench", "latency", "--rates", "0"], &["--rates: found 0"]),
        (&["bench", "graph", "--launch", "nowhere"], &["nowhere/replay.toml", "--launch"]),
    ] {
        let out = bench.lacuna(args);
        let line = error_line(&out);
        assert_eq!((out.status.code(), out.stdout.len()), (Some(2), 0), "{line}");
        assert!(line.starts_with("lacuna") && !line.contains("lacuna: lacuna"), "{line}");
        assert!(words.iter().all(|w| line.contains(w)), "{words:?} belong in: {line}");
    }
    // Every executable of the graph says it likewise.
    for name in ["source", "smoother", "torque", "friction", "payload", "monitor", "recorder", "live", "link"] {
        let name = format!("lacuna-{name}");
        let out =
            Command::new(lacuna_tests::bin(&name)).args(["--run", ".", "--nod", "x"]).output().expect("it starts");
        let line = error_line(&out);
        assert_eq!(out.status.code(), Some(2), "{line}");
        assert!(line.contains(&format!("{name}: unexpected argument '--nod'")) && line.contains("'--node'"), "{line}");
        let help = Command::new(lacuna_tests::bin(&name)).arg("--help").output().expect("it starts");
        assert!(help.status.success() && String::from_utf8_lossy(&help.stdout).contains("Usage: "), "{name}");
    }
}

#[test]
fn help_man_pages_and_completions_know_every_command() {
    let bench = Bench::new();
    let all = commands();
    assert!(all.len() > 15, "{:?}", all.keys());
    let out = bench.lacuna(&["man", "man"]);
    assert_eq!(out.status.code(), Some(0), "{}", String::from_utf8_lossy(&out.stderr));
    let shells = ["bash", "zsh", "fish"].map(|shell| {
        let out = bench.lacuna(&["completions", shell]);
        assert_eq!(out.status.code(), Some(0));
        (shell, String::from_utf8(out.stdout).expect("text"))
    });
    let page = |name: &str| std::fs::read_to_string(bench.path().join("man").join(format!("{name}.1"))).expect("page");
    assert!(page("lacuna").contains("EXIT STATUS"));
    for (name, help) in &all {
        for code in ["0  done", "1  failed", "2  bad input or use", "3  finished, but samples were lost"] {
            assert!(help.contains(code), "{name}: {help}");
        }
        let page = page(&format!("lacuna-{name}"));
        assert!(page.contains("EXIT STATUS") && page.contains("samples were lost"), "{name}");
        for (shell, text) in &shells {
            assert!(text.contains(name.as_str()), "{shell}: {name}");
        }
    }
    // The shell itself takes them, where it is there.
    for (shell, text) in &shells {
        let Ok(mut child) = Command::new(shell).arg("-n").stdin(Stdio::piped()).spawn() else {
            eprintln!("SKIPPED: syntax of the completions: no {shell}");
            continue;
        };
        std::io::Write::write_all(&mut child.stdin.take().expect("stdin"), text.as_bytes()).expect("written");
        assert!(child.wait().expect("ends").success(), "{shell}");
    }
}
