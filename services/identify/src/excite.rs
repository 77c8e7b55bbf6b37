//! Excitation trajectories: motions after which the parameters are known best.
//!
//! ```text
//! q_j(t) = q0_j + Σ_k a_jk sin(k ω t) + b_jk cos(k ω t),   k = 1 … H                 (Swevers et al. 1997)
//! maximise  log det(D⁻¹ Σ XᵀWX D⁻¹)                                                (D-optimality)
//! ```
//!
//! | symbol | meaning | unit |
//! |---|---|---|
//! | ω | base frequency, 2π over the period | rad/s |
//! | H | harmonics per joint | – |
//! | X | regressor of the minimal set along the trajectory, friction included | |
//! | D | size of every column at random motions, so that no unit outweighs another | |
//!
//! The motion starts and ends at rest: Σ k a_k = 0 and Σ k² b_k = 0 fix the last harmonic. Every candidate is scaled to
//! the joint limits, so the search is free of them; poses outside the workspace or out of reach rule a candidate out.
//! The search is an evolution strategy (one parent, adaptive step), deterministic by seed.

use crate::base::{Structure, structure};
use crate::columns::{Evaluator, Sample, Signal, columns};
use lacuna_estimation::least_squares::{Gram, Statistics};
use lacuna_interfaces::robot::{Limits, PerJoint};
use lacuna_interfaces::{BadInput, RobotFile};
use lacuna_physics::{Motion, RigidBody};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::io::Write;

/// What a user may choose.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ExciteOptions {
    /// Limits; what is absent is taken from the robot file.
    pub limits: Limits,
    /// Box that the tip must stay in, base frame [m]: lowest and highest corner.
    pub workspace_m: Option<[[f64; 3]; 2]>,
    /// Period [s].
    pub period_s: f64,
    /// Harmonics per joint.
    pub harmonics: usize,
    /// Share of the limits that is used.
    pub usage: f64,
    /// Torque noise per joint, for the weights [Nm]; empty: alike.
    pub sd_tau_nm: Vec<f64>,
    /// Candidates tried.
    pub candidates: usize,
    /// Seed of the search.
    pub seed: u64,
}

impl Default for ExciteOptions {
    fn default() -> Self {
        Self {
            limits: Limits::default(),
            workspace_m: None,
            period_s: 10.0,
            harmonics: 5,
            usage: 0.95,
            sd_tau_nm: Vec::new(),
            candidates: 2000,
            seed: 1,
        }
    }
}

/// How well a trajectory determines the parameters.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Quality {
    /// log det of the scaled information matrix.
    pub log_det: f64,
    /// Condition number of the column-scaled regressor.
    pub condition: f64,
}

/// A designed trajectory.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Excitation {
    /// Joint names.
    pub joints: Vec<String>,
    /// Period [s].
    pub period_s: f64,
    /// Middle position per joint [rad].
    pub centre_rad: Vec<f64>,
    /// Sine coefficients `[joint][harmonic]` [rad].
    pub sine_rad: Vec<Vec<f64>>,
    /// Cosine coefficients [rad].
    pub cosine_rad: Vec<Vec<f64>>,
    /// The first candidate, a random motion within the same limits.
    pub before: Quality,
    /// The designed one.
    pub after: Quality,
    /// Geometric mean over the parameters by which the standard errors shrink from the first to the designed motion.
    pub error_ratio: f64,
    /// Candidates that were within reach and workspace.
    pub feasible: usize,
}

/// Instants at which a candidate is judged.
const INSTANTS: usize = 240;
/// Candidates per generation.
const GENERATION: usize = 16;

/// Limits of one joint.
#[derive(Debug, Clone, Copy)]
struct Bound {
    low: f64,
    high: f64,
    speed: f64,
    acceleration: f64,
}

/// Position, velocity and acceleration per joint.
type State = (Vec<f64>, Vec<f64>, Vec<f64>);

/// Coefficients of all joints: centre, then H − 1 sines and H − 1 cosines each; the last harmonic follows.
#[derive(Debug, Clone)]
struct Candidate {
    centre: Vec<f64>,
    sine: Vec<Vec<f64>>,
    cosine: Vec<Vec<f64>>,
}

/// Designs a trajectory for `robot`. `progress` hears the share done.
///
/// # Errors
/// [`BadInput`] for missing or impossible limits, settings out of range, or if no motion fits reach and workspace.
pub fn excite(
    robot: &RobotFile,
    body: &dyn RigidBody,
    options: &ExciteOptions,
    progress: &mut dyn FnMut(f64),
) -> Result<Excitation, BadInput> {
    let problem = Problem::new(robot, body, options)?;
    let mut rng = Pcg64Mcg::seed_from_u64(options.seed);
    let mut feasible = 0;
    let mut parent: Option<(Candidate, Quality)> = None;
    let mut first: Option<Quality> = None;
    let mut step = 0.4;
    let generations = options.candidates.div_ceil(GENERATION).max(1);
    for generation in 0..generations {
        progress(generation as f64 / generations as f64);
        let drawn: Vec<Candidate> =
            (0..GENERATION).map(|_| problem.draw(parent.as_ref().map(|p| &p.0), step, &mut rng)).collect();
        let judged: Vec<Option<Quality>> = drawn.par_iter().map(|c| problem.judge(c)).collect();
        feasible += judged.iter().flatten().count();
        // The first feasible candidate is "a motion within the limits": what the design is measured against.
        first = first.or_else(|| judged.iter().flatten().next().copied());
        let best = drawn
            .into_iter()
            .zip(judged)
            .filter_map(|(c, q)| q.map(|q| (c, q)))
            .max_by(|a, b| a.1.log_det.total_cmp(&b.1.log_det));
        let Some(best) = best else { continue };
        let better = parent.as_ref().is_none_or(|p| best.1.log_det > p.1.log_det);
        // One in five generations should succeed (Rechenberg's rule).
        step = f64::clamp(if better { step * 1.3 } else { step * 0.92 }, 0.01, 0.8);
        if better {
            parent = Some(best);
        }
    }
    progress(1.0);
    let (Some((candidate, after)), Some(before)) = (parent, first) else {
        return Err(BadInput::new(format!(
            "found no motion within reach and workspace in {} candidates; expected wider workspace or narrower joint limits",
            generations * GENERATION
        )));
    };
    let parameters = problem.structure.base.len() as f64;
    Ok(Excitation {
        joints: robot.joints.clone(),
        period_s: options.period_s,
        centre_rad: candidate.centre,
        sine_rad: candidate.sine,
        cosine_rad: candidate.cosine,
        before,
        after,
        error_ratio: ((after.log_det - before.log_det) / (2.0 * parameters)).exp(),
        feasible,
    })
}

impl Excitation {
    /// Position, velocity and acceleration of every joint at time `t_s`.
    pub fn at(&self, t_s: f64) -> State {
        motion(&self.centre_rad, &self.sine_rad, &self.cosine_rad, self.period_s, t_s)
    }

    /// Writes `t,q1…,qd1…,qdd1…` over one period at `rate_hz`, the last sample included.
    ///
    /// # Errors
    /// The writer's.
    pub fn write_csv(&self, rate_hz: f64, out: &mut impl Write) -> std::io::Result<()> {
        let n = self.joints.len();
        let names = |prefix: &str| (1..=n).map(|j| format!("{prefix}{j}")).collect::<Vec<_>>().join(",");
        writeln!(out, "t,{},{},{}", names("q"), names("qd"), names("qdd"))?;
        let samples = (self.period_s * rate_hz).round().max(1.0) as usize;
        for k in 0..=samples {
            let t = k as f64 / rate_hz;
            let (q, qd, qdd) = self.at(t);
            let values: Vec<String> = q.iter().chain(&qd).chain(&qdd).map(|v| format!("{v:.9}")).collect();
            writeln!(out, "{t:.6},{}", values.join(","))?;
        }
        Ok(())
    }
}

fn motion(centre: &[f64], sine: &[Vec<f64>], cosine: &[Vec<f64>], period_s: f64, t_s: f64) -> State {
    let omega = std::f64::consts::TAU / period_s;
    let mut out = (centre.to_vec(), vec![0.0; centre.len()], vec![0.0; centre.len()]);
    for j in 0..centre.len() {
        for (k, (a, b)) in sine[j].iter().zip(&cosine[j]).enumerate() {
            let w = (k + 1) as f64 * omega;
            let (s, c) = (w * t_s).sin_cos();
            out.0[j] += a * s + b * c;
            out.1[j] += w * (a * c - b * s);
            out.2[j] -= w * w * (a * s + b * c);
        }
    }
    out
}

struct Problem<'a> {
    body: &'a dyn RigidBody,
    structure: Structure,
    bounds: Vec<Bound>,
    weights: Vec<f64>,
    options: &'a ExciteOptions,
}

impl<'a> Problem<'a> {
    fn new(robot: &RobotFile, body: &'a dyn RigidBody, options: &'a ExciteOptions) -> Result<Self, BadInput> {
        let n = robot.joint_count();
        let positive = |key: &str, v: f64| {
            if v.is_finite() && v > 0.0 {
                return Ok(());
            }
            Err(BadInput::new(format!("{key}: found {v}; expected a positive number")))
        };
        positive("period_s", options.period_s)?;
        positive("usage", options.usage)?;
        if options.usage > 1.0 {
            return Err(BadInput::new(format!("usage: found {}; expected at most 1", options.usage)));
        }
        if !(2..=20).contains(&options.harmonics) {
            return Err(BadInput::new(format!("harmonics: found {}; expected 2 to 20", options.harmonics)));
        }
        if !options.sd_tau_nm.is_empty() && options.sd_tau_nm.len() != n {
            return Err(BadInput::new(format!(
                "sd_tau_nm: found {} values; expected {n}, one per joint",
                options.sd_tau_nm.len()
            )));
        }
        options.sd_tau_nm.iter().try_for_each(|v| positive("sd_tau_nm", *v))?;
        let bounds = (0..n).map(|j| bound(robot, options, j)).collect::<Result<_, _>>()?;
        let structure = structure(body, robot, columns(body, Signal::Motor, robot.torque_unit.symbol()))?;
        let weights = (0..n).map(|j| options.sd_tau_nm.get(j).map_or(1.0, |s| 1.0 / (s * s))).collect();
        Ok(Self { body, structure, bounds, weights, options })
    }

    /// A random candidate, or a mutation of `parent`, scaled to the joint limits.
    fn draw(&self, parent: Option<&Candidate>, step: f64, rng: &mut Pcg64Mcg) -> Candidate {
        let h = self.options.harmonics;
        let mut out = Candidate { centre: Vec::new(), sine: Vec::new(), cosine: Vec::new() };
        for (j, bound) in self.bounds.iter().enumerate() {
            let half = 0.5 * (bound.high - bound.low);
            let mut normal = || (0..6).map(|_| rng.random_range(-1.0..1.0)).sum::<f64>() / std::f64::consts::SQRT_2;
            let old = parent.map(|p| (p.centre[j], &p.sine[j], &p.cosine[j]));
            let middle = 0.5 * (bound.high + bound.low);
            let (scale, width) = if old.is_some() { (step, step) } else { (1.0, 0.5) };
            let centre = old.map_or(middle, |o| o.0) + 0.3 * width * half * normal();
            let mut sine: Vec<f64> =
                (0..h).map(|k| old.map_or(0.0, |o| o.1[k]) + scale * 0.3 * half * normal() / (k + 1) as f64).collect();
            let mut cosine: Vec<f64> =
                (0..h).map(|k| old.map_or(0.0, |o| o.2[k]) + scale * 0.3 * half * normal() / (k + 1) as f64).collect();
            rest_at_start(&mut sine, &mut cosine);
            let centre = self.fit_in(j, centre, &mut sine, &mut cosine);
            out.centre.push(centre);
            out.sine.push(sine);
            out.cosine.push(cosine);
        }
        out
    }

    /// Scales one joint's coefficients to its limits and returns the centre moved to where they fit.
    fn fit_in(&self, j: usize, centre: f64, sine: &mut [f64], cosine: &mut [f64]) -> f64 {
        let bound = self.bounds[j];
        let usage = self.options.usage;
        let (mut low, mut high, mut speed, mut acceleration) = (0.0f64, 0.0f64, 0.0f64, 0.0f64);
        let (s, c) = ([sine.to_vec()], [cosine.to_vec()]);
        // Four instants per half wave of the highest harmonic and more: peaks between them are at most 4 % higher, which
        // the last division takes care of.
        let instants = (16 * sine.len()).max(INSTANTS);
        for k in 0..instants {
            let t = k as f64 / instants as f64 * self.options.period_s;
            let (q, qd, qdd) = motion(&[0.0], &s, &c, self.options.period_s, t);
            low = low.min(q[0]);
            high = high.max(q[0]);
            speed = speed.max(qd[0].abs());
            acceleration = acceleration.max(qdd[0].abs());
        }
        let middle = 0.5 * (bound.high + bound.low);
        let half = 0.5 * usage * (bound.high - bound.low);
        let room = |extent: f64, limit: f64| if extent > 0.0 { limit / extent } else { f64::INFINITY };
        let factor = room(high - low, 2.0 * half)
            .min(room(speed, usage * bound.speed))
            .min(room(acceleration, usage * bound.acceleration))
            / 1.02;
        let factor = if factor.is_finite() { factor } else { 0.0 };
        sine.iter_mut().chain(cosine.iter_mut()).for_each(|v| *v *= factor);
        let (low, high) = (low * factor, high * factor);
        let (first, last) = (middle - half - low, middle + half - high);
        if first > last { middle - 0.5 * (low + high) } else { centre.clamp(first, last) }
    }

    /// How well a candidate determines the parameters; `None` out of reach or workspace.
    fn judge(&self, candidate: &Candidate) -> Option<Quality> {
        let p = self.structure.base.len();
        let n = self.bounds.len();
        let mut evaluator = Evaluator::new(self.body, &self.structure.columns);
        let (mut x, mut y, mut w) = (Vec::with_capacity(INSTANTS * n * p), Vec::new(), Vec::new());
        for k in 0..INSTANTS {
            // Half a step in, so that no instant is one of rest.
            let t = (k as f64 + 0.5) / INSTANTS as f64 * self.options.period_s;
            let (q, qd, qdd) = motion(&candidate.centre, &candidate.sine, &candidate.cosine, self.options.period_s, t);
            if let Some([low, high]) = self.options.workspace_m {
                let tip = self.body.tip(&q).ok()?.position_m;
                if (0..3).any(|i| tip[i] < low[i] || tip[i] > high[i]) {
                    return None;
                }
            }
            let sign: Vec<f64> = qd.iter().map(|v| v.signum()).collect();
            let sample = Sample { motion: Motion { q_rad: &q, qd_rad_s: &qd, qdd_rad_s2: &qdd }, sign: &sign };
            evaluator.at(&sample).ok()?;
            for j in 0..n {
                x.extend(self.structure.base.iter().map(|b| evaluator.entry(&sample, j, b.column) / b.typical));
                y.push(0.0);
                w.push(self.weights[j] / INSTANTS as f64);
            }
        }
        let mut gram = Gram::new(p);
        gram.add_rows(&x, &y, Some(&w)).ok()?;
        let condition = gram.condition();
        let eigen = gram.xtx().symmetric_eigenvalues();
        // A singular motion is not ruled out, only very bad: the search must find its way from it.
        let floor = 1e-14 * eigen.max();
        let log_det: f64 = eigen.iter().map(|v| v.max(floor).ln()).sum();
        log_det.is_finite().then_some(Quality { log_det, condition })
    }
}

/// Fixes the last harmonic so that velocity and acceleration are zero at t = 0.
fn rest_at_start(sine: &mut [f64], cosine: &mut [f64]) {
    let h = sine.len();
    let last = h as f64;
    let (mut speed, mut acceleration) = (0.0, 0.0);
    for k in 1..h {
        speed += k as f64 * sine[k - 1];
        acceleration += (k * k) as f64 * cosine[k - 1];
    }
    if let (Some(s), Some(c)) = (sine.last_mut(), cosine.last_mut()) {
        *s = -speed / last;
        *c = -acceleration / (last * last);
    }
}

fn bound(robot: &RobotFile, options: &ExciteOptions, j: usize) -> Result<Bound, BadInput> {
    let get = |key: &str, own: &Option<PerJoint>, file: &Option<PerJoint>| {
        own.as_ref().or(file.as_ref()).and_then(|l| l.get(j)).filter(|v| v.is_finite()).ok_or_else(|| {
            BadInput::new(format!(
                "limits.{key}: found none for joint {} ({}); expected one, given or in the robot file",
                j + 1,
                robot.joints[j]
            ))
        })
    };
    let (own, file) = (&options.limits, &robot.limits);
    let out = Bound {
        low: get("q_min_rad", &own.q_min_rad, &file.q_min_rad)?,
        high: get("q_max_rad", &own.q_max_rad, &file.q_max_rad)?,
        speed: get("qd_max_rad_s", &own.qd_max_rad_s, &file.qd_max_rad_s)?,
        acceleration: get("qdd_max_rad_s2", &own.qdd_max_rad_s2, &file.qdd_max_rad_s2)?,
    };
    if out.low >= out.high || out.speed <= 0.0 || out.acceleration <= 0.0 {
        return Err(BadInput::new(format!(
            "limits of joint {}: found {} to {} rad, {} rad/s, {} rad/s²; expected a range and positive limits",
            j + 1,
            out.low,
            out.high,
            out.speed,
            out.acceleration
        )));
    }
    Ok(out)
}
