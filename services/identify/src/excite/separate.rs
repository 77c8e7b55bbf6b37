//! Motions that tell two explanations apart.
//!
//! ```text
//! D(A|B) = ½ min_{β, γ, shape of B} |a − X β − B γ|²/σ² + Σ β_k²/s_k²        maximise  min(D(A|B), D(B|A))
//! ```
//!
//! | symbol | meaning | unit |
//! |---|---|---|
//! | a | torque of A with its parameters along the motion; b likewise | Nm |
//! | X, β | base columns (rigid body and friction) and what they are free to move by | |
//! | B, γ | columns of the rival and its amplitudes, both free | |
//! | s_k | tolerance of the robot file times the nominal parameter; ∞ where the file has no masses, and for friction | |
//! | σ | torque noise of the joint (model file) | Nm |
//!
//! D is the log-likelihood by which A is expected to beat B where A is true (Hunter and Reiner 1965; the rival takes
//! along all of A that it, the base and the robot's tolerances can imitate): the logarithm of the Bayes factor but for
//! the terms that count parameters. Rows within `STANDING` of standstill are left out: friction holds any torque there.

use super::motion::{Candidate, Space, Trajectory};
use super::{ExciteOptions, excite};
use crate::base::{Structure, structure};
use crate::columns::{Evaluator, Sample, Signal, Term, columns};
use lacuna_interfaces::{BadInput, ModelFile, RobotFile};
use lacuna_physics::effects::{Effect, EffectContext, ParameterSpec, Scope, Track, find, registry};
use lacuna_physics::{Motion, RigidBody, parameters_of};
use nalgebra::{Cholesky, DMatrix, DVector};
use serde::Serialize;
use std::collections::BTreeMap;

/// Rate at which motions are judged [Hz]: rows that are a hundredth of a second apart are nearly independent after
/// the filters of an identification.
const RATE_HZ: f64 = 100.0;
/// Speed below which a joint's rows do not count [rad/s].
const STANDING: f64 = 0.05;
/// Shapes of a rival that are tried at most.
const MOST_SHAPES: usize = 36;

/// An effect as the explanation of a mismatch.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Explanation {
    /// Catalogue id.
    pub effect: String,
    /// Joints it acts on; empty for effects of the whole structure.
    pub joints: Vec<String>,
    /// Parameters that are known; the others take the catalogue's typical value.
    pub parameters: BTreeMap<String, f64>,
}

/// How well a motion separates two explanations: expected log-likelihood ratios over one period [nats].
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Evidence {
    /// For the first where it is true.
    pub first: f64,
    /// For the second where it is true.
    pub second: f64,
}

impl Evidence {
    /// What can be counted on whichever is true.
    pub fn least(&self) -> f64 {
        self.first.min(self.second)
    }
}

/// A motion that separates.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Separation {
    /// The motion.
    #[serde(flatten)]
    pub motion: Trajectory,
    /// The explanations with all parameters they were judged with.
    pub explanations: [Explanation; 2],
    /// The motion that `excite` designs within the same limits.
    pub before: Evidence,
    /// The designed one.
    pub after: Evidence,
    /// Candidates that were within reach and workspace.
    pub feasible: usize,
}

/// Designs the motion within the limits that best separates two explanations. `model` gives base, friction and noise.
///
/// # Errors
/// [`BadInput`] as [`excite`]; also if the model has no noise, an effect is unknown or cannot be had by this robot, or
/// positions and torques of the motor cannot separate the two at all.
pub fn separate(
    robot: &RobotFile,
    urdf: Option<&str>,
    body: &dyn RigidBody,
    model: &ModelFile,
    pair: &[Explanation; 2],
    options: &ExciteOptions,
    progress: &mut dyn FnMut(f64),
) -> Result<Separation, BadInput> {
    let options = ExciteOptions { sd_tau_nm: model.noise.sd_tau_nm.clone(), ..options.clone() };
    let judge = Judge::new(robot, urdf, body, model, pair, options.period_s)?;
    let space = Space::new(robot, &options)?.with_slower();
    let usual = excite(robot, body, &options, &mut |share| progress(0.2 * share))?.motion;
    let share = vec![1.0; usual.joints.len()];
    let start = Candidate { centre: usual.centre_rad, sine: usual.sine_rad, cosine: usual.cosine_rad, share };
    let before = judge.judge(&space, &start).ok_or_else(|| {
        BadInput::new("found a motion on which the effects have no torque; expected effects of this robot")
    })?;
    let found = space.search(Some((start, before)), &|c| judge.judge(&space, c), &Evidence::least, &mut |share| {
        progress(0.2 + 0.8 * share)
    })?;
    Ok(Separation {
        motion: found.candidate.into_trajectory(&robot.joints, options.period_s),
        explanations: judge.rivals.map(|r| r.explanation),
        before,
        after: found.after,
        feasible: found.feasible,
    })
}

/// One of the two, with everything it may look like.
struct Rival {
    effect: &'static Effect,
    joints: Vec<usize>,
    explanation: Explanation,
    /// Amplitudes of the explanation, in column order.
    amplitudes: Vec<f64>,
    /// Shapes that it may take instead, the explanation's own first.
    shapes: Vec<BTreeMap<String, f64>>,
}

impl Rival {
    fn new(given: &Explanation, robot: &RobotFile) -> Result<Self, BadInput> {
        let Some(effect) = find(&given.effect) else {
            let known: Vec<&str> = registry().iter().map(|e| e.id).collect();
            let (found, known) = (&given.effect, known.join(", "));
            return Err(BadInput::new(format!("separate: found effect \"{found}\"; expected one of {known}")));
        };
        let joints = if effect.scope == Scope::Structure { Vec::new() } else { given.joints.clone() };
        let indices = joints
            .iter()
            .map(|name| {
                robot.joints.iter().position(|j| j == name).ok_or_else(|| {
                    let known = robot.joints.join(", ");
                    BadInput::new(format!("separate: found joint \"{name}\"; expected one of {known}"))
                })
            })
            .collect::<Result<Vec<_>, _>>()?;
        let known = |p: &ParameterSpec| given.parameters.get(p.symbol).copied();
        let value = |p: &ParameterSpec| known(p).or(p.default).unwrap_or(p.typical);
        // Of several amplitudes those that are not given are 0, but not all of them.
        let some = effect.amplitudes(robot.kind).any(|p| known(p).is_some());
        let amplitude = |p: &ParameterSpec| if some { value(p) } else { p.typical };
        let amplitudes = match effect.amplitudes(robot.kind).map(amplitude).collect::<Vec<_>>() {
            none if none.is_empty() => vec![1.0],
            some => some,
        };
        let own: BTreeMap<String, f64> = effect.shapes(robot.kind).map(|p| (p.symbol.to_owned(), value(p))).collect();
        let mut shapes = vec![own.clone()];
        for p in effect.shapes(robot.kind) {
            let more: Vec<BTreeMap<String, f64>> = shapes
                .iter()
                .flat_map(|s| {
                    p.grid.iter().map(|v| {
                        let mut next = s.clone();
                        next.insert(p.symbol.to_owned(), *v);
                        next
                    })
                })
                .collect();
            shapes.extend(more.into_iter().take(MOST_SHAPES.saturating_sub(shapes.len())));
        }
        let mut parameters = own;
        let symbols = effect.amplitudes(robot.kind).map(|p| p.symbol.to_owned());
        parameters.extend(symbols.zip(amplitudes.iter().copied()));
        let explanation = Explanation { effect: effect.id.to_owned(), joints, parameters };
        Ok(Self { effect, joints: indices, explanation, amplitudes, shapes })
    }
}

/// Judges motions.
struct Judge<'a> {
    robot: &'a RobotFile,
    urdf: Option<&'a str>,
    body: &'a dyn RigidBody,
    pi: Vec<f64>,
    f_v: Vec<f64>,
    f_c: Vec<f64>,
    sd_nm: Vec<f64>,
    structure: Structure,
    /// 1/s² of the base parameters, in the order of the structure's base.
    precision: Vec<f64>,
    rivals: [Rival; 2],
    period_s: f64,
}

impl<'a> Judge<'a> {
    fn new(
        robot: &'a RobotFile,
        urdf: Option<&'a str>,
        body: &'a dyn RigidBody,
        model: &ModelFile,
        pair: &[Explanation; 2],
        period_s: f64,
    ) -> Result<Self, BadInput> {
        model.check(robot)?;
        let n = robot.joint_count();
        let sd_nm = model.noise.sd_tau_nm.clone();
        if sd_nm.len() != n || sd_nm.iter().any(|v| *v <= 0.0) {
            return Err(BadInput::new(format!(
                "noise.sd_tau_nm: found {sd_nm:?}; expected {n} positive numbers: a model of identify or diagnose has them"
            )));
        }
        let rivals = [Rival::new(&pair[0], robot)?, Rival::new(&pair[1], robot)?];
        let [a, b] = &rivals;
        if a.explanation.effect == b.explanation.effect && a.explanation.joints == b.explanation.joints {
            return Err(BadInput::new(format!("separate: found {} twice; expected two effects", a.effect.id)));
        }
        if a.effect.exact_group.contains(&b.effect.id) && a.explanation.joints == b.explanation.joints {
            return Err(BadInput::new(format!(
                "separate: found {} and {}; expected two effects that position and torque of the motor can tell apart: of these no motion shows a difference",
                a.effect.id, b.effect.id
            )));
        }
        let structure = structure(body, robot, columns(body, Signal::Motor, robot.torque_unit.symbol()))?;
        let precision = precision(&structure, robot.tolerance.mass);
        let pi = parameters_of(body, &model.rigid_body)?;
        let padded = |list: &[f64]| (0..n).map(|j| list.get(j).copied().unwrap_or(0.0)).collect();
        let (f_v, f_c) = (padded(&model.friction.f_v), padded(&model.friction.f_c));
        let out = Self { robot, urdf, body, pi, f_v, f_c, sd_nm, structure, precision, rivals, period_s };
        // What a kernel refuses is said before the search, not by its finding nothing.
        let context = out.context();
        for r in &out.rivals {
            for shape in &r.shapes {
                r.effect.kernel(&r.joints, shape, &context)?;
            }
        }
        Ok(out)
    }

    fn context(&self) -> EffectContext<'_> {
        EffectContext { robot: self.robot, urdf: self.urdf, body: self.body, pi: &self.pi }
    }

    /// Evidence of a motion; `None` out of reach or workspace.
    fn judge(&self, space: &Space<'_>, candidate: &Candidate) -> Option<Evidence> {
        let run = self.run(space, candidate)?;
        let p = self.structure.base.len();
        let mut columns = run.base;
        // Per rival: its torque, then the columns of each shape.
        let mut layout = Vec::new();
        for r in &self.rivals {
            let mut shapes = Vec::new();
            let mut target = None;
            for shape in &r.shapes {
                let made = r.effect.columns(&r.joints, shape, &self.context(), &run.track.view()).ok()?;
                let first = columns.len();
                for c in 0..made.count() {
                    columns.push(self.rows(&run.track, |j, k| made.column(c, j).get(k).copied().unwrap_or(0.0)));
                }
                if target.is_none() {
                    let sum: Vec<f64> = (0..columns[first].len())
                        .map(|row| r.amplitudes.iter().zip(&columns[first..]).map(|(a, c)| a * c[row]).sum())
                        .collect();
                    target = Some(sum);
                }
                shapes.push(first..columns.len());
            }
            columns.push(target?);
            layout.push((columns.len() - 1, shapes));
        }
        let rows = columns.first().map_or(0, Vec::len);
        let z = DMatrix::from_fn(rows, columns.len(), |i, c| columns[c][i]);
        let gram = z.tr_mul(&z);
        let against = |target: usize, shapes: &[std::ops::Range<usize>]| {
            let one = |shape: &std::ops::Range<usize>| {
                let regressors: Vec<usize> = (0..p).chain(shape.clone()).collect();
                left(&gram, target, &regressors, &self.precision)
            };
            shapes.iter().map(one).fold(f64::INFINITY, f64::min)
        };
        let (a, b) = (&layout[0], &layout[1]);
        let evidence = Evidence { first: 0.5 * against(a.0, &b.1), second: 0.5 * against(b.0, &a.1) };
        (evidence.first.is_finite() && evidence.second.is_finite()).then_some(evidence)
    }

    /// A signal as rows in noise units: joint after joint, standing samples 0.
    fn rows(&self, track: &Signals, value: impl Fn(usize, usize) -> f64) -> Vec<f64> {
        let mut out = Vec::with_capacity(self.sd_nm.len() * track.t_s.len());
        for (j, sd) in self.sd_nm.iter().enumerate() {
            out.extend(
                (0..track.t_s.len()).map(
                    |k| {
                        if track.qd_rad_s[j][k].abs() < STANDING { 0.0 } else { value(j, k) / sd }
                    },
                ),
            );
        }
        out
    }

    /// The motion with everything that effects need of it, and the base columns.
    fn run(&self, space: &Space<'_>, candidate: &Candidate) -> Option<Run> {
        let n = self.sd_nm.len();
        let samples = ((self.period_s * RATE_HZ).round() as usize).clamp(10, 10_000);
        let mut s = Signals::new(n, samples);
        let mut evaluator = Evaluator::new(self.body, &self.structure.columns);
        let rotor = self.context().rotor_inertia_kg_m2();
        let mut entries = vec![vec![0.0; n * samples]; self.structure.base.len()];
        let mut tau = vec![0.0; n];
        for k in 0..samples {
            let t = (k as f64 + 0.5) / samples as f64 * self.period_s;
            let (q, qd, qdd) = candidate.at(self.period_s, t);
            if !space.holds(self.body, &q)? {
                return None;
            }
            let sign: Vec<f64> = qd.iter().map(|v| v.signum()).collect();
            let sample = Sample { motion: Motion { q_rad: &q, qd_rad_s: &qd, qdd_rad_s2: &qdd }, sign: &sign };
            self.body.torque(&sample.motion, &self.pi, &mut tau).ok()?;
            evaluator.at(&sample).ok()?;
            s.t_s.push(t);
            for j in 0..n {
                if qd[j].abs() >= STANDING {
                    for (column, b) in entries.iter_mut().zip(&self.structure.base) {
                        column[j * samples + k] = evaluator.entry(&sample, j, b.column) / self.sd_nm[j];
                    }
                }
                s.q_rad[j].push(q[j]);
                s.qd_rad_s[j].push(qd[j]);
                s.qdd_rad_s2[j].push(qdd[j]);
                s.direction[j].push(sign[j]);
                s.link_nm[j].push(tau[j] - rotor[j] * qdd[j]);
                s.drive_nm[j].push(tau[j] + self.f_v[j] * qd[j] + self.f_c[j] * sign[j]);
            }
        }
        Some(Run { base: entries, track: s })
    }
}

/// A motion and its base columns as rows.
struct Run {
    base: Vec<Vec<f64>>,
    track: Signals,
}

/// `signal[joint][sample]`.
struct Signals {
    t_s: Vec<f64>,
    q_rad: Vec<Vec<f64>>,
    qd_rad_s: Vec<Vec<f64>>,
    qdd_rad_s2: Vec<Vec<f64>>,
    direction: Vec<Vec<f64>>,
    link_nm: Vec<Vec<f64>>,
    drive_nm: Vec<Vec<f64>>,
}

impl Signals {
    fn new(n: usize, samples: usize) -> Self {
        let empty = || vec![Vec::with_capacity(samples); n];
        Self {
            t_s: Vec::with_capacity(samples),
            q_rad: empty(),
            qd_rad_s: empty(),
            qdd_rad_s2: empty(),
            direction: empty(),
            link_nm: empty(),
            drive_nm: empty(),
        }
    }

    fn view(&self) -> Track<'_> {
        Track {
            t_s: &self.t_s,
            start_s: 0.0,
            q_rad: &self.q_rad,
            qd_rad_s: &self.qd_rad_s,
            qdd_rad_s2: &self.qdd_rad_s2,
            direction: &self.direction,
            ramp_rad_s: STANDING,
            tau_link_nm: &self.link_nm,
            tau_drive_nm: &self.drive_nm,
            temperature_degc: &[],
            resets: &[],
        }
    }
}

/// 1/s² of the base parameters: what the robot file's tolerance leaves open; 0 where nothing is known. A parameter
/// that is nominally 0 is as uncertain as the largest of its unit.
fn precision(structure: &Structure, tolerance: f64) -> Vec<f64> {
    let size = |b: &crate::base::BaseColumn| {
        let unit = &structure.columns[b.column].unit;
        let alike = structure.base.iter().filter(|o| &structure.columns[o.column].unit == unit);
        if b.nominal != 0.0 { b.nominal.abs() } else { alike.map(|o| o.nominal.abs()).fold(0.0, f64::max) }
    };
    let one = |b: &crate::base::BaseColumn| match structure.columns[b.column].term {
        Term::Rigid(_) if size(b) > 0.0 && tolerance > 0.0 => (tolerance * size(b)).powi(-2),
        _ => 0.0,
    };
    structure.base.iter().map(one).collect()
}

/// Squared size of column `target` that the `regressors` leave; `precision` belongs to the first of them.
fn left(gram: &DMatrix<f64>, target: usize, regressors: &[usize], precision: &[f64]) -> f64 {
    let used: Vec<(usize, f64)> = regressors
        .iter()
        .enumerate()
        .map(|(i, &c)| (c, precision.get(i).copied().unwrap_or(0.0)))
        .filter(|(c, _)| gram[(*c, *c)] > 0.0)
        .collect();
    // Scaled to unit diagonal; the small addition makes dependent columns solvable and costs a relative 1e-10.
    let scale: Vec<f64> = used.iter().map(|&(c, s)| (gram[(c, c)] + s).sqrt()).collect();
    let m = DMatrix::from_fn(used.len(), used.len(), |i, j| {
        let own = if i == j { used[i].1 } else { 0.0 };
        (gram[(used[i].0, used[j].0)] + own) / (scale[i] * scale[j]) + if i == j { 1e-10 } else { 0.0 }
    });
    let v = DVector::from_fn(used.len(), |i, _| gram[(used[i].0, target)] / scale[i]);
    let total = gram[(target, target)];
    match Cholesky::new(m) {
        Some(c) => (total - v.dot(&c.solve(&v))).max(0.0),
        None => 0.0,
    }
}
