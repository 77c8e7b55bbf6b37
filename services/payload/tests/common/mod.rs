//! Recordings with concealed physics (../shared/data beside the project, or LACUNA_SHARED_DATA), run through the
//! stages before this one with the friction that the case's key tells: what an identified model would hold.

use lacuna_interfaces::{FrictionTorque, JointMeasured, ModelFile, RobotFile, Stage, StageContext, TorqueModel};
use serde_json::Value;
use std::path::PathBuf;

/// One recording of a case, as the payload stage sees it.
pub struct Recording {
    pub file: String,
    pub samples: Vec<FrictionTorque>,
    /// Picks and places: (t_on, t_off, mass).
    pub loads: Vec<(f64, f64, f64)>,
}

pub struct Case {
    pub robot: RobotFile,
    pub model: ModelFile,
    pub key: Value,
    pub recordings: Vec<Recording>,
}

/// The folder of the cases, or `None` after saying that the test is skipped.
pub fn cases() -> Option<PathBuf> {
    let root = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../..");
    let data = std::env::var_os("LACUNA_SHARED_DATA").map_or_else(|| root.join("../shared/data"), PathBuf::from);
    let folder = data.join("delta_concealed");
    if folder.join("cases").is_dir() {
        return Some(folder);
    }
    eprintln!("SKIPPED: no recordings at {}", folder.display());
    None
}

pub fn load(name: &str, smoother: &str) -> Option<Case> {
    let folder = cases()?;
    let text = |p: PathBuf| std::fs::read_to_string(&p).unwrap_or_else(|e| panic!("{}: {e}", p.display()));
    let key: Value = serde_json::from_str(&text(folder.join("keys").join(format!("{name}.json")))).unwrap();
    let robot = RobotFile::parse(&text(folder.join("cases").join(name).join("robot.toml"))).unwrap();
    let mut model = ModelFile::nominal(&robot);
    let list = |v: &Value| v.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect::<Vec<f64>>();
    model.friction.f_c = list(&key["base_params"]["fc"]);
    model.friction.f_v = list(&key["base_params"]["fv"]);
    let recordings = (1..=6)
        .map(|i| {
            let file = format!("traj_{i:02}.csv");
            let measured = read(&text(folder.join("cases").join(name).join(&file)));
            let loads = key["events"][&file]
                .as_array()
                .into_iter()
                .flatten()
                .map(|e| (e["t_on"].as_f64().unwrap(), e["t_off"].as_f64().unwrap(), e["mass"].as_f64().unwrap()));
            Recording { loads: loads.collect(), samples: chain(&robot, &model, smoother, &measured), file }
        })
        .collect();
    Some(Case { robot, model, key, recordings })
}

fn read(csv: &str) -> Vec<JointMeasured> {
    csv.lines()
        .skip(1)
        .enumerate()
        .map(|(k, line)| {
            let v: Vec<f64> = line.split(',').map(|v| v.parse().unwrap()).collect();
            let mut m = JointMeasured::default();
            m.header.seq = k as u64 + 1;
            m.header.stamp_ns = (v[0] * 1e9).round() as i64;
            m.header.joints = 3;
            m.q_rad[..3].copy_from_slice(&v[1..4]);
            m.tau_nm[..3].copy_from_slice(&v[4..7]);
            m.temperature_degc = [f64::NAN; 8];
            m
        })
        .collect()
}

/// Smoother, torque and friction stage, one after the other.
fn chain(robot: &RobotFile, model: &ModelFile, smoother: &str, measured: &[JointMeasured]) -> Vec<FrictionTorque> {
    let context = StageContext { robot, urdf: None, model: Some(model) };
    let mut smoother = lacuna_smoother::Smoother::new(toml::from_str(smoother).unwrap(), &context).unwrap();
    let mut torque = lacuna_torque::Torque::new(Default::default(), &context).unwrap();
    let mut friction = lacuna_friction::Friction::new(Default::default(), &context).unwrap();
    let mut smoothed = Vec::new();
    measured.iter().for_each(|m| smoother.step(m, &mut |o| smoothed.push(*o)));
    smoother.finish(&mut |o| smoothed.push(*o));
    let mut rigid: Vec<TorqueModel> = Vec::new();
    smoothed.iter().for_each(|m| torque.step(m, &mut |o| rigid.push(*o)));
    let mut out = Vec::new();
    rigid.iter().for_each(|m| friction.step(m, &mut |o| out.push(*o)));
    out
}
