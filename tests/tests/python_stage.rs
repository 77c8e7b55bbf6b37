//! A stage in Python takes the box of one in Rust: the same samples, the same numbers, and no sample where its messages
//! are laid out otherwise.

use lacuna_tests::{Bench, bin, error_line, messages, python, report, workspace};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// The messages for Python, as `lacuna messages` makes them, in a folder of their own.
fn generated(bench: &Bench) -> (PathBuf, String) {
    let folder = bench.path().join("generated");
    let out = bench.lacuna(&["messages", "--python", "--out", "generated/lacuna_messages.py"]);
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    let text = std::fs::read_to_string(folder.join("lacuna_messages.py")).expect("messages");
    (folder, text)
}

/// The graph with the Python stage, with `python` as the script's interpreter.
fn up(bench: &Bench, python: &Path, messages: &Path, out: &str, graph: &str, how: &str) -> Output {
    let friction = format!("friction={}", workspace().join("launch/python/friction.py").display());
    let out = format!("out={out}");
    let sets = ["recording=run.csv", "robot=robot.toml", "model=model.toml", &out, &friction];
    let beside = python.parent().expect("a folder").display().to_string();
    let path = std::env::var("PATH").unwrap_or_default();
    Command::new(bin("lacuna"))
        .arg("up")
        .arg(workspace().join(graph))
        .arg(how)
        .args(sets.iter().flat_map(|s| ["--set", s]))
        .env("PATH", format!("{beside}:{path}"))
        .env("PYTHONPATH", messages)
        .env("PYTHONDONTWRITEBYTECODE", "1")
        .current_dir(bench.path())
        .output()
        .expect("lacuna starts")
}

const PROBE: [&str; 2] = ["-c", "import iceoryx2, tomllib"];

#[test]
fn a_python_stage_gives_the_bytes_of_the_rust_stage() {
    let Some(python) = python("a_python_stage_gives_the_bytes_of_the_rust_stage", &PROBE) else { return };
    let bench = Bench::with_motion(2.0);
    // An offset too, so that every term of the law counts.
    let model = std::fs::read_to_string(bench.path().join("model.toml")).expect("model");
    bench.write("model.toml", &model.replace("[noise]", "offset = [0.3, -0.2, 0.0]\n[noise]"));
    let (generated, _) = generated(&bench);
    let graph = workspace().join("launch/replay.toml").display().to_string();
    let sets = ["recording=run.csv", "robot=robot.toml", "model=model.toml", "out=rust.mcap"];
    let args: Vec<&str> = ["up", &graph, "--json"].into_iter().chain(sets.iter().flat_map(|s| ["--set", s])).collect();
    report(&bench.lacuna(&args));
    let done = up(&bench, &python, &generated, "python.mcap", "launch/replay.toml", "--json");
    let report = report(&done);
    assert_eq!((report["lost"].as_u64(), done.status.code()), (Some(0), Some(0)));
    assert_eq!(report["nodes"]["friction"]["published"], report["samples"]);
    let [mut rust, mut python] = ["rust.mcap", "python.mcap"].map(|name| messages(&bench.path().join(name)));
    // The status holds clock readings.
    assert!(rust.remove("/status").is_some() && python.remove("/status").is_some());
    assert_eq!(rust.keys().collect::<Vec<_>>(), python.keys().collect::<Vec<_>>());
    for (topic, list) in &rust {
        let differs = list.iter().zip(&python[topic]).position(|(a, b)| a != b);
        assert!(list.len() == python[topic].len() && differs.is_none(), "{topic} differs, first at {differs:?}");
    }
}

#[test]
fn a_python_stage_of_another_layout_is_refused_with_both_names() {
    let Some(python) = python("a_python_stage_of_another_layout_is_refused_with_both_names", &PROBE) else { return };
    let bench = Bench::with_motion(0.5);
    let (generated, text) = generated(&bench);
    let right = text.split('"').find(|s| s.starts_with("lacuna.TorqueModel.")).expect("type name").to_owned();
    // As a module would be that was made before the message changed.
    let wrong = format!("lacuna.TorqueModel.{}", "0".repeat(16));
    std::fs::write(generated.join("lacuna_messages.py"), text.replace(&right, &wrong)).expect("written");
    let out = up(&bench, &python, &generated, "never.mcap", "launch/replay.toml", "--quiet");
    let line = error_line(&out);
    assert_eq!(out.status.code(), Some(2), "{line}");
    assert!(line.contains(&right) && line.contains(&wrong) && line.contains("\"torque\""), "{line}");
    assert!(!bench.path().join("never.mcap").exists());
    // A structure that Python lays out otherwise does not even import.
    let moved = text.replacen("(\"tau_nm\", ", "(\"tau_nm_\", ctypes.c_uint32), (\"tau_nm\", ", 1);
    std::fs::write(generated.join("lacuna_messages.py"), moved).expect("written");
    let import = Command::new(&python).args(["-c", "import lacuna_messages"]).env("PYTHONPATH", &generated).output();
    let import = import.expect("Python starts");
    assert!(String::from_utf8_lossy(&import.stderr).contains("another layout than lacuna's"));
}

#[test]
fn a_python_stage_says_what_it_cannot_do() {
    let Some(python) = python("a_python_stage_says_what_it_cannot_do", &PROBE) else { return };
    let bench = Bench::with_motion(0.5);
    let (generated, _) = generated(&bench);
    let model = std::fs::read_to_string(bench.path().join("model.toml")).expect("model");
    bench.write(
        "model.toml",
        &format!("{model}[[term]]\neffect = \"viscous\"\njoints = [\"q1\"]\nparameters = {{ f_v = 0.1 }}\n"),
    );
    let out = up(&bench, &python, &generated, "never.mcap", "launch/replay.toml", "--quiet");
    assert_eq!(out.status.code(), Some(2));
    let line = error_line(&out);
    assert!(line.contains("friction.py") && line.contains("[[term]]"), "{line}");
}

#[test]
fn a_python_stage_runs_live_and_takes_the_end() {
    let Some(python) = python("a_python_stage_runs_live_and_takes_the_end", &PROBE) else { return };
    let bench = Bench::with_motion(2.0);
    let (generated, _) = generated(&bench);
    let done = up(&bench, &python, &generated, "live.mcap", "launch/live.toml", "--json");
    let report = report(&done);
    let (samples, lost) = (report["samples"].as_u64().expect("samples"), report["lost"].as_u64().expect("lost"));
    let got = report["nodes"]["friction"]["received"]["torque"].as_u64().expect("count");
    let missing = report["nodes"]["friction"]["missing"].as_u64().expect("count");
    assert_eq!(got + missing, samples, "what did not come is counted: {report}");
    assert_eq!(done.status.code(), Some(if lost > 0 { 3 } else { 0 }));
    assert_eq!(report["nodes"]["recorder"]["details"]["complete"], true);
}
