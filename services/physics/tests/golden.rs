//! Kinematics and dynamics against Pinocchio and MuJoCo (tests/oracles/delta_golden.py, serial_golden.py).

mod common;

use common::relative;
use lacuna_interfaces::RobotFile;
use lacuna_physics::delta::Forearm;
use lacuna_physics::{Delta, Motion, RigidBody, build};
use serde_json::Value;
use std::path::PathBuf;

fn golden(file: &str) -> Value {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/golden").join(file);
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

fn list(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect()
}

fn entries<'a>(value: &'a Value, key: &str) -> &'a [Value] {
    value[key].as_array().unwrap()
}

/// One recorded state.
struct State<'a> {
    value: &'a Value,
    q: Vec<f64>,
    qd: Vec<f64>,
    qdd: Vec<f64>,
}

impl<'a> State<'a> {
    fn new(value: &'a Value) -> Self {
        Self { value, q: list(&value["q"]), qd: list(&value["qd"]), qdd: list(&value["qdd"]) }
    }

    fn motion(&self) -> Motion<'_> {
        Motion { q_rad: &self.q, qd_rad_s: &self.qd, qdd_rad_s2: &self.qdd }
    }

    fn expect(&self, name: &str, key: &str, found: &[f64], limit: f64) {
        let error = relative(found, &list(&self.value[key]), 1e-3);
        assert!(error < limit, "{name}: {key} off by {error:.2e}: {found:?}");
    }
}

/// What deltas and serial chains have in common.
fn check_tip(name: &str, body: &dyn RigidBody, state: &State<'_>, limit: f64) {
    let tip = body.tip_motion(&state.motion()).unwrap();
    state.expect(name, "x", &tip.position_m, limit);
    state.expect(name, "xd", &tip.velocity_m_s, limit);
    state.expect(name, "xdd", &tip.acceleration_m_s2, limit);
    let mut j = vec![0.0; 3 * body.joint_count()];
    body.jacobian(&state.q, &mut j).unwrap();
    state.expect(name, "jacobian", &j, limit);
}

#[test]
fn delta_against_bodies_and_constraints() {
    let file = golden("delta.json");
    let mut states = 0;
    for case in entries(&file, "cases") {
        let name = case["name"].as_str().unwrap();
        let delta = Delta::new(&RobotFile::parse(case["robot"].as_str().unwrap()).unwrap()).unwrap();
        let parameter = |symbol: &str| case["parameters"][symbol].as_f64().unwrap();
        let pi: Vec<f64> = delta.parameters().iter().map(|p| parameter(&p.symbol)).collect();
        if case["robot_file_arms"].as_bool().unwrap() {
            // Our own parameters from the robot file, not only those the oracle computed.
            let ours = match &case["forearm"] {
                Value::Null => delta.nominal(),
                f => {
                    let number = |key: &str| f[key].as_f64().unwrap();
                    let forearm = Forearm {
                        mass_kg: number("mass_kg"),
                        com_fraction: number("com_fraction"),
                        inertia_kg_m2: number("inertia_kg_m2"),
                    };
                    delta.distributed_forearms(&forearm).to_vec()
                }
            };
            assert!(relative(&ours, &pi, 1.0) < 1e-14, "{name}: {ours:?} {pi:?}");
        }
        for value in entries(case, "states") {
            let state = State::new(value);
            let mut tau = [0.0; 3];
            let mut pull = [0.0; 3];
            delta.torque(&state.motion(), &pi, &mut tau).unwrap();
            let force = list(&value["force"]);
            delta.external_force(&state.q, [force[0], force[1], force[2]], &mut pull).unwrap();
            let total: Vec<f64> = tau.iter().zip(&pull).map(|(a, b)| a + b).collect();
            state.expect(name, "tau", &total, 1e-11);
            check_tip(name, &delta, &state, 1e-11);
            states += 1;
        }
    }
    assert_eq!(states, 56);
}

#[test]
fn serial_against_pinocchio() {
    let file = golden("serial.json");
    let mut states = 0;
    for chain in entries(&file, "chains") {
        let name = chain["name"].as_str().unwrap();
        let robot = RobotFile::parse(chain["robot"].as_str().unwrap()).unwrap();
        let body = build(&robot, chain["urdf"].as_str()).unwrap();
        let n = body.joint_count();
        for value in entries(chain, "states") {
            let state = State::new(value);
            let mut out = vec![0.0; 3 * n];
            body.torque(&state.motion(), &body.nominal(), &mut out[..n]).unwrap();
            state.expect(name, "tau", &out[..n], 1e-11);
            body.payload_column(&state.motion(), &mut out[..n]).unwrap();
            state.expect(name, "payload", &out[..n], 1e-11);
            check_tip(name, body.as_ref(), &state, 1e-11);
            body.jacobian_rate(&state.q, &state.qd, &mut out).unwrap();
            state.expect(name, "jacobian_rate", &out, 1e-11);
            let rotation = body.tip(&state.q).unwrap().rotation;
            state.expect(name, "rotation", rotation.as_flattened(), 1e-12);
            states += 1;
        }
    }
    assert_eq!(states, 42);
}

/// URDFs of real robots; read where the shared recordings lie beside the project.
#[test]
fn real_urdfs_against_pinocchio() {
    let shared = std::env::var_os("LACUNA_SHARED_DATA")
        .map_or_else(|| PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data"), PathBuf::from);
    for file in entries(&golden("serial.json"), "files") {
        let path = shared.join(file["urdf"].as_str().unwrap());
        let Ok(urdf) = std::fs::read_to_string(&path) else {
            eprintln!("SKIPPED: {} is not there", path.display());
            continue;
        };
        let joints = file["joints"].to_string();
        let robot = format!("kind = \"serial\"\nname = \"real\"\nurdf = \"real.urdf\"\njoints = {joints}\n");
        let body = build(&RobotFile::parse(&robot).unwrap(), Some(&urdf)).unwrap();
        for value in entries(file, "states") {
            let state = State::new(value);
            let mut tau = vec![0.0; body.joint_count()];
            body.torque(&state.motion(), &body.nominal(), &mut tau).unwrap();
            state.expect(&path.display().to_string(), "tau", &tau, 1e-11);
        }
    }
}
