//! Motions and helpers for the tests of the effects.
#![allow(dead_code, reason = "each test file uses a part")]

use lacuna_interfaces::RobotFile;
use lacuna_physics::effects::{Effect, EffectContext, ParameterSpec, Regime, Robots, Role, Scope, Track};
use lacuna_physics::{Motion, RigidBody, build};
use std::collections::BTreeMap;
use std::f64::consts::TAU;

/// Robot file and mechanics that live as long as a test.
pub struct Robot {
    pub file: RobotFile,
    pub body: Box<dyn RigidBody>,
    pub pi: Vec<f64>,
}

impl Robot {
    pub fn new(text: &str) -> Self {
        let file = RobotFile::parse(text).unwrap();
        let body = build(&file, None).unwrap();
        let pi = body.nominal();
        Self { file, body, pi }
    }

    pub fn context(&self) -> EffectContext<'_> {
        EffectContext { robot: &self.file, urdf: None, body: self.body.as_ref(), pi: &self.pi }
    }

    pub fn n(&self) -> usize {
        self.body.joint_count()
    }
}

/// Temperature columns and a gear for the robots of the tests.
pub fn with_drive(text: &str) -> String {
    format!("{text}\n[drive]\ngear_ratio = 10\n[columns]\ntemperature = [\"x_temp\"]\n")
}

/// A motion with everything that effects read: `signal[joint][sample]`.
#[derive(Clone, Default)]
pub struct Signals {
    pub t: Vec<f64>,
    pub start: f64,
    pub q: Vec<Vec<f64>>,
    pub qd: Vec<Vec<f64>>,
    pub qdd: Vec<Vec<f64>>,
    pub direction: Vec<Vec<f64>>,
    pub link: Vec<Vec<f64>>,
    pub drive: Vec<Vec<f64>>,
    pub temperature: Vec<Vec<f64>>,
}

impl Signals {
    /// From q, q̇, q̈ of a joint at a time; torques are those of the context's model.
    pub fn new(c: &EffectContext<'_>, samples: usize, dt: f64, motion: impl Fn(usize, f64) -> [f64; 3]) -> Self {
        let n = c.joint_count();
        let t: Vec<f64> = (0..samples).map(|k| k as f64 * dt).collect();
        let pick =
            |i: usize| -> Vec<Vec<f64>> { (0..n).map(|j| t.iter().map(|&t| motion(j, t)[i]).collect()).collect() };
        let (q, qd, qdd) = (pick(0), pick(1), pick(2));
        let direction =
            qd.iter().map(|s| s.iter().map(|v| if *v == 0.0 { 0.0 } else { v.signum() }).collect()).collect();
        let temperature = vec![vec![25.0; samples]; n];
        let mut out = Self { t, q, qd, qdd, direction, temperature, ..Self::default() };
        out.drive = out.torque(c.body, c.pi);
        let rotor = c.rotor_inertia_kg_m2();
        out.link = (0..n).map(|j| (0..samples).map(|k| out.drive[j][k] - rotor[j] * out.qdd[j][k]).collect()).collect();
        out
    }

    /// Rigid-body torque along the motion.
    pub fn torque(&self, body: &dyn RigidBody, pi: &[f64]) -> Vec<Vec<f64>> {
        let n = body.joint_count();
        let mut out = vec![vec![0.0; self.t.len()]; n];
        let mut tau = vec![0.0; n];
        for k in 0..self.t.len() {
            let [q, qd, qdd] = self.at(k);
            body.torque(&Motion { q_rad: &q, qd_rad_s: &qd, qdd_rad_s2: &qdd }, pi, &mut tau).unwrap();
            (0..n).for_each(|j| out[j][k] = tau[j]);
        }
        out
    }

    pub fn at(&self, k: usize) -> [Vec<f64>; 3] {
        [&self.q, &self.qd, &self.qdd].map(|s| s.iter().map(|s| s[k]).collect())
    }

    pub fn track(&self) -> Track<'_> {
        Track {
            t_s: &self.t,
            start_s: self.start,
            q_rad: &self.q,
            qd_rad_s: &self.qd,
            qdd_rad_s2: &self.qdd,
            direction: &self.direction,
            ramp_rad_s: 0.01,
            tau_link_nm: &self.link,
            tau_drive_nm: &self.drive,
            temperature_degc: &self.temperature,
            resets: &[],
        }
    }
}

/// Middle of joint `j`'s range in the tests.
pub fn centre(j: usize) -> f64 {
    0.3 + 0.1 * j as f64
}

/// Quick movement to and fro of all joints, out of step.
pub fn shaking(j: usize, t: f64) -> [f64; 3] {
    let (w, phase) = (TAU * 5.0, 0.9 * j as f64);
    let (s, c) = (w * t + phase).sin_cos();
    [centre(j) + 0.08 * s, 0.08 * w * c, -0.08 * w * w * s]
}

/// The motion of a regime. For regimes that change the robot, `c` must be the changed one.
pub fn regime(c: &EffectContext<'_>, regime: Regime) -> Signals {
    let steady = |speed: f64| move |j: usize, t: f64| [centre(j) - 0.3 + speed * t, speed, 0.0];
    let still = |j: usize, _: f64| [centre(j), 0.0, 0.0];
    let signals = |motion: &dyn Fn(usize, f64) -> [f64; 3]| Signals::new(c, 400, 1e-3, motion);
    let mut out = match regime {
        Regime::Rest | Regime::WeightlessRest | Regime::LowTorque => signals(&still),
        Regime::SlowSliding => signals(&steady(0.05)),
        Regime::FastSliding | Regime::SlidingUnloaded | Regime::SlidingWarm => signals(&steady(1.5)),
        Regime::Reversals => signals(&|j, t| {
            let (s, c) = (TAU * 5.0 * t).sin_cos();
            [centre(j) + 0.01 * s, 0.01 * TAU * 5.0 * c, -0.01 * (TAU * 5.0).powi(2) * s]
        }),
        Regime::Shaking | Regime::Massless | Regime::OutsideEvent => signals(&shaking),
    };
    match regime {
        Regime::SlidingUnloaded => {
            for s in out.link.iter_mut().chain(&mut out.drive) {
                s.fill(0.0);
            }
        }
        Regime::LowTorque => out.drive.iter_mut().flatten().for_each(|v| *v *= 1e-3),
        Regime::SlidingWarm => {
            out.start = 1e6;
            out.temperature.iter_mut().flatten().for_each(|v| *v = 40.0);
        }
        Regime::OutsideEvent => out.start = 1000.0,
        _ => {}
    }
    out
}

/// Parameters of the effect that exist for this robot.
pub fn specs(effect: &Effect, file: &RobotFile) -> impl Iterator<Item = &'static ParameterSpec> {
    let kind = file.kind;
    effect.parameters.iter().filter(move |p| p.robots.include(kind))
}

/// All parameters at their typical sizes.
pub fn typical(effect: &Effect, file: &RobotFile) -> BTreeMap<String, f64> {
    specs(effect, file).map(|p| (p.symbol.to_owned(), p.typical)).collect()
}

/// The shape parameters at their typical sizes.
pub fn shapes(effect: &Effect, file: &RobotFile) -> BTreeMap<String, f64> {
    specs(effect, file).filter(|p| p.role == Role::Shape).map(|p| (p.symbol.to_owned(), p.typical)).collect()
}

/// Joints to try an effect on.
pub fn joints(effect: &Effect, n: usize) -> Vec<usize> {
    match effect.scope {
        Scope::Joint => vec![1.min(n - 1)],
        Scope::Pair => vec![n - 2, n - 1],
        Scope::Drive | Scope::Structure => Vec::new(),
    }
}

/// True if the robot can have the effect.
pub fn fits(effect: &Effect, file: &RobotFile) -> bool {
    effect.robots.include(file.kind) && (effect.robots != Robots::Delta || file.geometry.is_some())
}

/// Parameters by literals.
pub fn map(list: &[(&str, f64)]) -> BTreeMap<String, f64> {
    list.iter().map(|(k, v)| ((*k).to_owned(), *v)).collect()
}

/// Torque of an effect along a motion: columns times amplitudes. `[joint][sample]`.
pub fn torque_of(
    effect: &'static Effect,
    joints: &[usize],
    parameters: &BTreeMap<String, f64>,
    c: &EffectContext<'_>,
    signals: &Signals,
) -> Vec<Vec<f64>> {
    let columns = effect.columns(joints, parameters, c, &signals.track()).unwrap();
    let amplitude = |i: usize| columns.symbols().get(i).map_or(1.0, |s| parameters.get(*s).copied().unwrap_or(0.0));
    (0..c.joint_count())
        .map(|j| {
            let mut sum = vec![0.0; signals.t.len()];
            for i in 0..columns.count() {
                sum.iter_mut().zip(columns.column(i, j)).for_each(|(s, v)| *s += amplitude(i) * v);
            }
            sum
        })
        .collect()
}

/// Root mean square over all joints and the second half of the samples.
pub fn rms(signal: &[Vec<f64>]) -> f64 {
    let tail = |s: &Vec<f64>| s[s.len() / 2..].to_vec();
    let all: Vec<f64> = signal.iter().flat_map(tail).collect();
    (all.iter().map(|v| v * v).sum::<f64>() / all.len() as f64).sqrt()
}
