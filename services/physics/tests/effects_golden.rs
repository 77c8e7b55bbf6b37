//! Effects with memory against SciPy's integration of textbook equations
//! (`tests/oracles/effects_golden.py` writes `golden/effects.json`).

mod common;
#[path = "common/effects.rs"]
mod support;

use lacuna_physics::effects::find;
use serde_json::Value;
use support::{Robot, Signals, map, torque_of};

fn golden() -> Value {
    serde_json::from_str(include_str!("golden/effects.json")).unwrap()
}

fn list(v: &Value) -> Vec<f64> {
    v.as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect()
}

fn number(v: &Value) -> f64 {
    v.as_f64().unwrap()
}

/// θ = θ0 + A (1 − cos ω t)².
fn drive(p: &Value) -> impl Fn(usize, f64) -> [f64; 3] {
    let (a, w, start) = (list(&p["amplitude"]), list(&p["omega"]), list(&p["start"]));
    move |j, t| {
        let (s, c) = (w[j] * t).sin_cos();
        let u = 1.0 - c;
        [start[j] + a[j] * u * u, 2.0 * a[j] * w[j] * u * s, 2.0 * a[j] * w[j] * w[j] * (s * s + u * c)]
    }
}

/// Difference and size, root mean square.
fn compare(found: &[f64], expected: &[f64]) -> (f64, f64) {
    assert_eq!(found.len(), expected.len());
    let n = found.len() as f64;
    let error: f64 = found.iter().zip(expected).map(|(a, b)| (a - b).powi(2)).sum();
    let size: f64 = expected.iter().map(|b| b * b).sum();
    ((error / n).sqrt(), (size / n).sqrt())
}

#[test]
fn dahl_by_exact_steps() {
    let g = &golden()["dahl"];
    let (t, q, qd, z) = (list(&g["t"]), list(&g["q"]), list(&g["qd"]), list(&g["z"]));
    let text = "kind = \"serial\"\nname = \"m\"\njoints = [\"m\"]\n[[dh]]\na = 0.1\n";
    let robot = Robot::new(text);
    let c = robot.context();
    let zero = vec![vec![0.0; t.len()]];
    let signals = Signals {
        t,
        q: vec![q],
        qd: vec![qd.clone()],
        qdd: zero.clone(),
        direction: zero.clone(),
        link: zero.clone(),
        drive: zero,
        ..Signals::default()
    };
    let shape = map(&[("delta", number(&g["delta"]))]);
    let columns = find("presliding").unwrap().columns(&[0], &shape, &c, &signals.track()).unwrap();
    // Between two samples the path is taken as going one way; a reversal in between is all that is lost.
    let (error, size) = compare(columns.column(0, 0), &z);
    assert!(error < 4e-3 * size, "error {error:.2e} of {size:.2e}");
    // LuGre's rate is the ODE's own right-hand side.
    for k in 0..z.len() {
        let rate = (qd[k] - qd[k].abs() * columns.column(0, 0)[k]) / 0.012;
        assert!((columns.column(1, 0)[k] - rate).abs() < 1e-9, "sample {k}");
    }
}

#[test]
fn elastic_joints_of_a_planar_arm() {
    let g = &golden()["elasticity"];
    let (m, l, r, i) = (list(&g["mass"]), list(&g["length"]), list(&g["com"]), list(&g["inertia"]));
    let rotor = list(&g["rotor"]);
    let mut text =
        "kind = \"serial\"\nname = \"planar\"\njoints = [\"1\", \"2\"]\n[env]\ngravity = [0.0, -9.81, 0.0]\n"
            .to_owned();
    for k in 0..2 {
        text += &format!("[[dh]]\na = {}\n", l[k]);
    }
    for k in 0..2 {
        text += &format!(
            "[[link]]\nmass = {}\ncom = [{}, 0.0, 0.0]\ninertia = [0.0, 0.0, 0.0, 0.0, 0.0, {}]\nrotor_inertia = {}\n",
            m[k],
            r[k] - l[k],
            i[k],
            rotor[k]
        );
    }
    let robot = Robot::new(&text);
    let c = robot.context();
    let parameters = map(&[("k", number(&g["k"])), ("zeta", number(&g["zeta"]))]);
    let errors = |dt: f64, case: &Value| -> f64 {
        let expected: Vec<Vec<f64>> = case["dtau"].as_array().unwrap().iter().map(list).collect();
        let every = (1e-3 * number(&case["every"]) / dt).round() as usize;
        let signals = Signals::new(&c, (expected.len() - 1) * every + 1, dt, drive(g));
        let soft: Vec<usize> = list(&case["soft"]).iter().map(|j| *j as usize).collect();
        let tau = torque_of(find("elasticity").unwrap(), &soft, &parameters, &c, &signals);
        let mut worst: f64 = 0.0;
        for j in 0..2 {
            let found: Vec<f64> = tau[j].iter().copied().step_by(every).collect();
            let wanted: Vec<f64> = expected.iter().map(|row| row[j]).collect();
            let (error, size) = compare(&found, &wanted);
            assert!(size > 0.05, "the golden shows nothing at joint {j}");
            worst = worst.max(error / size);
        }
        worst
    };
    for case in g["cases"].as_array().unwrap() {
        let (coarse, fine) = (errors(1e-3, case), errors(2.5e-4, case));
        println!("soft {}: relative error {coarse:.2e} at 1 kHz, {fine:.2e} at 4 kHz", case["soft"]);
        assert!(coarse < 0.003, "soft {}: {coarse:.2e}", case["soft"]);
        assert!(fine < 6e-4, "soft {}: {fine:.2e}", case["soft"]);
    }
}

#[test]
fn backlash_of_one_axis() {
    let g = &golden()["backlash"];
    let text = format!(
        "kind = \"serial\"\nname = \"axis\"\njoints = [\"1\"]\n[[dh]]\na = 0.1\n[[link]]\nmass = 0.0\n\
         inertia = [0.0, 0.0, 0.0, 0.0, 0.0, {}]\nrotor_inertia = 0.3\n",
        number(&g["J"])
    );
    let robot = Robot::new(&text);
    let c = robot.context();
    let expected = list(&g["dtau"]);
    let every = number(&g["every"]) as usize;
    let parameters = map(&[("k", number(&g["k"])), ("b", number(&g["b"])), ("zeta", number(&g["zeta"]))]);
    let run = |dt: f64, every: usize| {
        let signals = Signals::new(&c, (expected.len() - 1) * every + 1, dt, drive(g));
        let tau = torque_of(find("backlash").unwrap(), &[0], &parameters, &c, &signals);
        let found: Vec<f64> = tau[0].iter().copied().step_by(every).collect();
        compare(&found, &expected)
    };
    let ((coarse, size), (fine, _)) = (run(1e-3, every), run(2.5e-4, 4 * every));
    println!("backlash: {coarse:.2e} at 1 kHz, {fine:.2e} at 4 kHz, of {size:.2e} Nm");
    assert!(size > 1.0);
    assert!(coarse < 0.05 * size, "1 kHz: {coarse:.2e} of {size:.2e}");
    assert!(fine < 0.02 * size, "4 kHz: {fine:.2e} of {size:.2e}");
}
