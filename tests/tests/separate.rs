//! `lacuna excite --separate` from the command line.

use lacuna_tests::{Bench, error_line};

const ROBOT: &str = "kind = \"delta\"\nname = \"d\"\n[geometry]\nl1 = 0.35\nl2 = 0.88\nra = 0.2\nrb = 0.05\n[mass]\n\
    platform = 1.1\nupper_arm = 1.8\nforearm_point = 0.22\n\
    [limits]\nq_min_rad = -0.4\nq_max_rad = 1.1\nqd_max_rad_s = 6.0\nqdd_max_rad_s2 = 60.0\n";
const MODEL: &str = "schema = \"lacuna.model/1\"\nrobot = \"d\"\n[friction]\nf_v = [0.8, 0.8, 0.8]\nf_c = [3.0, 3.0, 3.0]\n\
    [noise]\nsd_tau_nm = [0.05, 0.05, 0.05]\n\
    [[term]]\neffect = \"stribeck\"\njoints = [\"q2\"]\n[term.parameters]\nf_sc = 0.5\nv_s = 0.12\n";

fn folder() -> Bench {
    let bench = Bench::new();
    bench.write("robot.toml", ROBOT);
    bench.write("model.toml", MODEL);
    bench
}

const ARGS: [&str; 9] =
    ["excite", "--robot", "robot.toml", "--out", "motion.csv", "--candidates", "64", "--model", "model.toml"];

#[test]
fn the_motion_is_written_with_the_evidence_before_and_after() {
    let bench = folder();
    let done = bench.lacuna(&[&ARGS[..], &["--separate", "stribeck,viscous_power", "--json"]].concat());
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let found: serde_json::Value = serde_json::from_slice(&done.stdout).expect("JSON");
    // Parameters and joint of the model's term; the rival is taken to be on the same joint.
    assert_eq!(found["explanations"][0]["parameters"]["v_s"], 0.12);
    assert_eq!(found["explanations"][1]["joints"], serde_json::json!(["q2"]));
    let least = |side: &str| {
        let of = |which: &str| found[side][which].as_f64().expect("a number");
        of("first").min(of("second"))
    };
    assert!(least("after") >= least("before") && least("before") >= 0.0, "{found}");
    let text = std::fs::read_to_string(bench.path().join("motion.csv")).expect("the motion");
    assert!(text.starts_with("t,q1,q2,q3,qd1,") && text.lines().count() == 10_002);
}

#[test]
fn findings_give_joints_and_parameters() {
    let bench = folder();
    bench.write("model.toml", MODEL.split("[[term]]").next().expect("text"));
    bench.write(
        "findings.json",
        r#"{"schema": "lacuna.findings/1", "findings": [{"effect": "stribeck", "joints": ["q3"],
            "parameters": [{"symbol": "f_sc", "unit": "Nm", "value": 0.7, "ci95": [0.6, 0.8]}]}]}"#,
    );
    let more = ["--separate", "viscous_power,stribeck", "--findings", "findings.json", "--json"];
    let done = bench.lacuna(&[&ARGS[..], &more].concat());
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let found: serde_json::Value = serde_json::from_slice(&done.stdout).expect("JSON");
    assert_eq!(found["explanations"][1]["parameters"]["f_sc"], 0.7);
    assert_eq!(found["explanations"][0]["joints"], serde_json::json!(["q3"]));
}

#[test]
fn wishes_without_sense_exit_2_with_one_line() {
    let bench = folder();
    bench.write("silent.toml", MODEL.split("[noise]").next().expect("text"));
    bench.write("findings.json", "[]");
    let cases: [(&[&str], &str); 5] = [
        (&["--separate", "stribeck"], "expected two effects"),
        (&["--separate", "stribeck,stribek"], "stribek"),
        (&["--separate", "torque_offset,coulomb_asym", "--joints", "q1"], "no motion shows a difference"),
        (&["--separate", "stribeck,viscous_power", "--joints", "q7"], "q7"),
        (&["--separate", "stribeck,viscous_power", "--findings", "findings.json"], "findings.json"),
    ];
    for (more, expected) in cases {
        let done = bench.lacuna(&[&ARGS[..], more].concat());
        let line = error_line(&done);
        assert_eq!(done.status.code(), Some(2), "{line}");
        assert!(line.contains(expected), "expected '{expected}' in: {line}");
        assert!(!bench.path().join("motion.csv").exists());
    }
    let silent: Vec<&str> = ARGS.iter().map(|a| if *a == "model.toml" { "silent.toml" } else { a }).collect();
    let done = bench.lacuna(&[&silent[..], &["--separate", "stribeck,viscous_power", "--joints", "q1"]].concat());
    assert!(error_line(&done).contains("noise.sd_tau_nm"));
}
