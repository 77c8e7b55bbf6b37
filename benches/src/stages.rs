//! Time per sample of every stage, without the bus, beside copying its message (the least a stage can do).

use crate::{BenchError, median, motion};
use lacuna_friction::Friction;
use lacuna_interfaces::{
    BadInput, FrictionTorque, JointMeasured, JointSmoothed, ModelFile, Recording, RobotFile, Stage, StageContext,
    TorqueModel,
};
use lacuna_monitor::Monitor;
use lacuna_payload::Payload;
use lacuna_smoother::{Smoother, smooth_recording};
use lacuna_torque::Torque;
use serde::Serialize;
use std::hint::black_box;
use std::time::Instant;

const SAMPLES: u64 = 20_000;
const TURNS: usize = 15;

/// One figure.
#[derive(Debug, Clone, Serialize)]
pub struct Row {
    /// What was timed.
    pub what: String,
    /// Median [ns per sample].
    pub ns: f64,
    /// What it is to be held against.
    pub note: String,
}

/// Six revolute joints with inertias, of a common small arm's proportions.
fn six_joints() -> String {
    let dh =
        [(0.0, 0.3, 1.57), (0.45, 0.0, 0.0), (0.05, 0.0, 1.57), (0.0, 0.42, -1.57), (0.0, 0.0, 1.57), (0.0, 0.1, 0.0)];
    let mut text =
        String::from("kind = \"serial\"\nname = \"bench-six\"\njoints = [\"a\", \"b\", \"c\", \"d\", \"e\", \"f\"]\n");
    for (a, d, alpha) in dh {
        text += &format!("[[dh]]\na = {a:?}\nd = {d:?}\nalpha = {alpha:?}\n");
    }
    for i in 0..6 {
        let m = 8.0 / (1.0 + i as f64);
        text += &format!(
            "[[link]]\nmass = {m:?}\ncom = [0.1, 0.02, 0.03]\ninertia = [{0:?}, 0.001, 0.001, {0:?}, 0.001, {0:?}]\nrotor_inertia = 0.05\n",
            0.01 * m
        );
    }
    text
}

fn measured(joints: usize) -> Vec<JointMeasured> {
    let mut all = vec![JointMeasured::default(); SAMPLES as usize];
    for (k, m) in all.iter_mut().enumerate() {
        m.header.seq = k as u64 + 1;
        m.header.stamp_ns = k as i64 * 1_000_000;
        m.header.joints = joints as u32;
        let (q, tau) = motion::sample(k as u64, 1000.0);
        for i in 0..joints {
            m.q_rad[i] = q[i % 3] + 0.1 * (i / 3) as f64;
            m.tau_nm[i] = tau[i % 3];
        }
    }
    all
}

/// Runs a fresh stage over `input` several times; returns ns per sample and the last turn's output.
fn time<S: Stage>(
    config: &str,
    context: &StageContext<'_>,
    input: &[S::Input],
) -> Result<(f64, Vec<S::Output>), BenchError> {
    let fresh = || -> Result<S, BenchError> {
        let parsed: S::Config = toml::from_str(config)?;
        S::new(parsed, context).map_err(|e: BadInput| e.to_string().into())
    };
    let mut ns = Vec::new();
    for _ in 0..TURNS {
        let mut stage = fresh()?;
        // One slot, as on the bus: the message just made is still in the cache when it is handed over.
        let mut slot = S::Output::default();
        let mut take = |out: &S::Output| {
            slot = *out;
            black_box(&slot);
        };
        let started = Instant::now();
        for sample in input {
            stage.step(black_box(sample), &mut take);
        }
        stage.finish(&mut take);
        ns.push(started.elapsed().as_nanos() as f64 / input.len() as f64);
    }
    let mut output = Vec::with_capacity(input.len());
    let mut stage = fresh()?;
    input.iter().for_each(|sample| stage.step(sample, &mut |out| output.push(*out)));
    stage.finish(&mut |out| output.push(*out));
    if output.len() != input.len() {
        return Err(format!("{} gave {} of {} samples", S::NAME, output.len(), input.len()).into());
    }
    Ok((median(&mut ns), output))
}

/// Time to copy a message of this type.
fn copy<T: Copy>(input: &[T]) -> f64 {
    let mut ns: Vec<f64> = (0..TURNS)
        .map(|_| {
            let started = Instant::now();
            for from in input {
                let copy = *black_box(from);
                black_box(&copy);
            }
            started.elapsed().as_nanos() as f64 / input.len().max(1) as f64
        })
        .collect();
    median(&mut ns)
}

/// Runs all stages.
///
/// # Errors
/// If a stage refuses its input.
pub fn run(progress: &mut dyn FnMut(&str)) -> Result<Vec<Row>, BenchError> {
    let robot = RobotFile::parse(motion::ROBOT)?;
    let model = ModelFile::parse(motion::MODEL)?;
    let context = StageContext { robot: &robot, urdf: None, model: Some(&model) };
    let mut rows = Vec::new();
    let mut row = |what: &str, ns: f64, note: String| rows.push(Row { what: what.to_owned(), ns, note });
    let copied = |ns: f64| format!("(copying its message alone: {ns:.1} ns)");

    progress("smoother");
    let input = measured(3);
    let (ns, smoothed) = time::<Smoother>("", &context, &input)?;
    row("smoother, 3 joints, fixed lag on the stream", ns, copied(copy::<JointSmoothed>(&smoothed)));
    let offline = offline(&robot, &input)?;
    row("smoother, 3 joints, offline forward-backward", offline, String::new());

    progress("torque");
    let (ns, torque) = time::<Torque>("", &context, &smoothed)?;
    row("torque, Delta: M_KH, M_Id and payload column", ns, copied(copy::<TorqueModel>(&torque)));
    let six = RobotFile::parse(&six_joints())?;
    let six_context = StageContext { robot: &six, urdf: None, model: None };
    let (_, six_smoothed) = time::<Smoother>("", &six_context, &measured(6))?;
    let (ns, _) = time::<Torque>("", &six_context, &six_smoothed)?;
    row("torque, six joints: nominal, identified, payload column", ns, String::new());

    progress("friction");
    let (ns, friction) = time::<Friction>("", &context, &torque)?;
    row("friction, viscous and Coulomb, 3 joints", ns, copied(copy::<FrictionTorque>(&friction)));

    progress("payload");
    let (ns, payload) = time::<Payload>("", &context, &friction)?;
    row("payload, 3 joints", ns, copied(copy(&payload)));

    progress("monitor");
    let (ns, watched) = time::<Monitor>("", &context, &payload)?;
    row("monitor, 3 joints", ns, copied(copy(&watched)));
    Ok(rows)
}

fn offline(robot: &RobotFile, input: &[JointMeasured]) -> Result<f64, BenchError> {
    let column =
        |f: &dyn Fn(&JointMeasured, usize) -> f64| (0..3).map(|j| input.iter().map(|m| f(m, j)).collect()).collect();
    let recording = Recording {
        name: "bench".to_owned(),
        joints: robot.joints.clone(),
        t_s: input.iter().map(|m| m.header.stamp_ns as f64 * 1e-9).collect(),
        q_rad: column(&|m, j| m.q_rad[j]),
        tau_nm: column(&|m, j| m.tau_nm[j]),
        ..Recording::default()
    };
    let config = lacuna_smoother::Config::default();
    let mut ns = Vec::new();
    for _ in 0..TURNS {
        let started = Instant::now();
        black_box(smooth_recording(black_box(&recording), &config, robot, None).map_err(|e| e.to_string())?);
        ns.push(started.elapsed().as_nanos() as f64 / input.len() as f64);
    }
    Ok(median(&mut ns))
}
