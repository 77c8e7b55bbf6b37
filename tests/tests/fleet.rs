//! Results of many robots: done once, resumed, aggregated.

use lacuna_tests::{Bench, error_line, workspace};
use serde_json::Value;
use std::path::Path;
use std::process::{Command, Output};

const SIMULATION: &str = "seed = SEED\n[friction]\nf_c = [5.2, F_C, 4.9]\nf_v = [0.95, 0.8, 0.9]\n\
[[trajectory]]\nkind = \"fourier\"\nduration_s = 3.0\ncount = 2\n";

fn ok(output: &Output) -> String {
    let errors = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{errors}");
    String::from_utf8(output.stdout.clone()).expect("text")
}

/// Folder `name` with robot.toml and rec/.
fn robot(bench: &Bench, name: &str, seed: usize, f_c: f64) {
    let folder = bench.path().join(name);
    std::fs::create_dir_all(&folder).expect("folder");
    std::fs::write(folder.join("robot.toml"), lacuna_tests::ROBOT).expect("robot file");
    let text = SIMULATION.replace("SEED", &seed.to_string()).replace("F_C", &f_c.to_string());
    bench.write("sim.toml", &text);
    let (robot, out) = (format!("{name}/robot.toml"), format!("{name}/rec"));
    ok(&bench.lacuna(&["simulate", "--robot", &robot, "--config", "sim.toml", "--out", &out]));
}

/// Every file of a folder with its content and the time it was last changed.
fn state(folder: &Path) -> Vec<(String, Vec<u8>, std::time::SystemTime)> {
    let mut all: Vec<_> = std::fs::read_dir(folder)
        .expect("folder")
        .map(|e| {
            let e = e.expect("entry");
            let changed = e.metadata().expect("metadata").modified().expect("time");
            (e.file_name().to_string_lossy().into_owned(), std::fs::read(e.path()).expect("file"), changed)
        })
        .collect();
    all.sort();
    all
}

#[test]
fn a_result_is_made_once_and_a_half_written_one_is_made_again() {
    let bench = Bench::new();
    robot(&bench, "r", 4, 4.6);
    let out = bench.path().join("r/out");
    let cases = [
        (
            "identify",
            "identification.json",
            ["identification.json", "model.toml", "report.html", "result.json", "result.parquet"],
        ),
        ("diagnose", "findings.json", ["findings.json", "model.toml", "report.html", "result.json", "result.parquet"]),
    ];
    for (command, account, files) in cases {
        let run = |more: &[&str]| {
            let args = [command, "--robot", "r/robot.toml", "--out", "r/out", "r/rec/traj_01.csv", "r/rec/traj_02.csv"];
            bench.lacuna(&[&args[..], more].concat())
        };
        let first = ok(&run(&[]));
        assert!(!first.contains("Done already"), "another command's result is none of this one:\n{first}");
        let before = state(&out);
        let names: Vec<&str> = before.iter().map(|(name, ..)| name.as_str()).collect();
        assert_eq!(names, files, "what the other command left is gone");

        let again = ok(&run(&[]));
        assert!(again.contains("Done already") && again.contains("--force") && again.contains(account), "{again}");
        assert_eq!(state(&out), before, "nothing was touched");
        let printed: Value = serde_json::from_str(&ok(&run(&["--json"]))).expect("JSON");
        let text = std::fs::read_to_string(out.join(account)).expect("account");
        assert_eq!(printed, serde_json::from_str::<Value>(&text).expect("JSON"));

        // Other options are another result; so is a changed recording; half a result is none.
        assert!(!ok(&run(&["--label", "cell 7"])).contains("Done already"));
        assert!(ok(&run(&["--label", "cell 7"])).contains("Done already"));
        std::fs::remove_file(out.join("result.json")).expect("manifest");
        assert!(!ok(&run(&["--label", "cell 7"])).contains("Done already"));
        std::fs::write(out.join(account), "{").expect("account");
        assert!(!ok(&run(&["--label", "cell 7"])).contains("Done already"));
        let forced = ok(&run(&["--label", "cell 7", "--force"]));
        assert!(!forced.contains("Done already"));
        let mut now = state(&out);
        assert!(ok(&run(&["--label", "cell 7"])).contains("Done already"));
        let strip = |list: &mut Vec<(String, Vec<u8>, std::time::SystemTime)>| {
            list.iter_mut().map(|(name, bytes, _)| (std::mem::take(name), std::mem::take(bytes))).collect::<Vec<_>>()
        };
        let (now, earlier) = (strip(&mut now), strip(&mut before.clone()));
        for ((name, now), (_, before)) in now.iter().zip(&earlier) {
            let label = ["result.json", "result.parquet"].contains(&name.as_str());
            assert_eq!(
                now == before,
                !label,
                "{name}: the label is in the rows and the manifest, nothing else changes"
            );
        }
    }
    let absent = bench.lacuna(&["identify", "--robot", "r/robot.toml", "--out", "r/new", "r/rec/absent.csv"]);
    assert_eq!(absent.status.code(), Some(2));
    assert!(error_line(&absent).contains("absent.csv") && !bench.path().join("r/new").exists());
}

/// The rows of all `result.parquet` under a pattern, as JSON.
fn rows(python: &str, folder: &Path, pattern: &str) -> Vec<Value> {
    let script = "import glob, sys, pandas as pd\n\
        rows = pd.concat(map(pd.read_parquet, sorted(glob.glob(sys.argv[1]))))\n\
        print(rows.to_json(orient='records', double_precision=15))";
    let output = Command::new(python).args(["-c", script, pattern]).current_dir(folder).output().expect("python");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).expect("rows")
}

#[test]
fn rows_of_results_say_what_the_accounts_say() {
    let Ok(python) = std::env::var("LACUNA_TEST_PYTHON_TABLES") else {
        eprintln!("SKIPPED: LACUNA_TEST_PYTHON_TABLES names no Python with pandas and pyarrow");
        return;
    };
    let bench = Bench::new();
    robot(&bench, "r", 4, 4.6);
    let recordings = ["r/rec/traj_01.csv", "r/rec/traj_02.csv"];
    let run = |command: &str, out: &str| {
        let args = [command, "--robot", "r/robot.toml", "--out", out, "--label", "no. 17", "--json"];
        let printed = ok(&bench.lacuna(&[&args[..], &recordings].concat()));
        serde_json::from_str::<Value>(&printed).expect("JSON")
    };
    let (id, findings) = (run("identify", "r/model"), run("diagnose", "r/findings"));
    let joints = rows(&python, bench.path(), "r/model/result.parquet");
    assert_eq!(joints.len(), 3);
    for (j, row) in joints.iter().enumerate() {
        assert_eq!((&row["robot"], &row["label"]), (&id["robot"], &Value::from("no. 17")));
        assert_eq!((&row["joint"], row["joint_index"].as_u64()), (&id["joints"][j], Some(j as u64 + 1)));
        assert_eq!(row["recordings"], "traj_01.csv;traj_02.csv");
        assert_eq!(row["set"].as_str().map(str::len), Some(64));
        let close = |a: &Value, b: &Value| {
            let (a, b) = (a.as_f64().expect("number"), b.as_f64().expect("number"));
            assert!((a - b).abs() <= 1e-12 * b.abs().max(1.0), "{a} {b}");
        };
        close(&row["relative_error"], &id["held_out"]["relative_error"]);
        close(&row["rms_nm"], &id["held_out"]["rms_nm"][j]);
        let symbol = format!("f_c{}", j + 1);
        let friction = id["parameters"].as_array().into_iter().flatten().find(|p| p["symbol"] == symbol.as_str());
        close(&row["f_c"], &friction.expect("f_c")["value"]);
        close(&row["f_c_high"], &friction.expect("f_c")["ci95"][1]);
    }
    let found = rows(&python, bench.path(), "r/findings/result.parquet");
    let n = findings["findings"].as_array().map_or(0, Vec::len);
    assert_eq!(found.len(), n.max(1), "a robot without a finding is counted as well");
    for (i, row) in found.iter().enumerate() {
        assert_eq!((&row["verdict"], row["findings"].as_u64()), (&findings["verdict"], Some(n as u64)));
        assert_eq!(row["detected"], findings["mismatch"]["detected"]);
        let effect = findings["findings"].get(i).map_or(&Value::Null, |f| &f["effect"]);
        assert_eq!(&row["effect"], effect);
    }
}

/// The Python block of docs/FLEET.md that runs a fleet with Ray.
fn ray_block() -> String {
    let page = std::fs::read_to_string(workspace().join("docs/FLEET.md")).expect("page");
    let at = page.find("```python\n").expect("a block") + "```python\n".len();
    page[at..at + page[at..].find("```").expect("its end")].to_owned()
}

#[test]
#[ignore = "long: Ray is large, and three dozen robots are identified"]
fn a_fleet_is_identified_with_ray_and_resumed() {
    const ROBOTS: usize = 36;
    let Ok(python) = std::env::var("LACUNA_TEST_PYTHON_LONG") else {
        eprintln!("SKIPPED: LACUNA_TEST_PYTHON_LONG names no Python with ray");
        return;
    };
    let bench = Bench::new();
    // Robot 11 rubs more than the others.
    for k in 0..ROBOTS {
        robot(&bench, &format!("fleet/r{k:02}"), 800_000 + k, if k == 11 { 9.0 } else { 4.6 });
    }
    let page = bench.write("fleet.py", &ray_block());
    let run = || {
        let path = format!("{}:{}", lacuna_tests::bin_dir().display(), std::env::var("PATH").unwrap_or_default());
        // The page's jobs are found by their name, as an installed program is.
        Command::new(&python).arg(&page).current_dir(bench.path()).env("PATH", path).output().expect("python")
    };
    // One recording is broken: its robot fails, the others do not.
    let broken = bench.path().join("fleet/r05/rec/traj_02.csv");
    let whole = std::fs::read(&broken).expect("recording");
    std::fs::write(&broken, "t,q1\n0,0\n").expect("recording");
    let output = run();
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success() && errors.contains("r05: ") && errors.contains("traj_02.csv"), "{errors}");
    let done = |k: usize| bench.path().join(format!("fleet/r{k:02}/model/result.json"));
    assert!((0..ROBOTS).all(|k| done(k).exists() == (k != 5)));
    // Mended and run again: only what is missing is done, and one that was cut short.
    std::fs::write(&broken, whole).expect("recording");
    std::fs::remove_file(done(20)).expect("manifest");
    let changed = |k: usize| std::fs::metadata(done(k)).and_then(|m| m.modified()).ok();
    let before: Vec<_> = (0..ROBOTS).map(changed).collect();
    let output = run();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    for k in 0..ROBOTS {
        assert_eq!(changed(k) == before[k], k != 5 && k != 20, "robot {k}");
    }
    let rows = rows(&python, bench.path(), "fleet/*/model/result.parquet");
    assert_eq!(rows.len(), 3 * ROBOTS);
    let odd: Vec<&str> = rows
        .iter()
        .filter(|r| r["joint"] == "q2" && r["f_c"].as_f64().is_some_and(|f| f > 1.5 * 4.6))
        .filter_map(|r| r["label"].as_str())
        .collect();
    assert_eq!(odd, ["r11"]);
}
