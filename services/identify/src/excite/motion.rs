//! The motions that are searched: a truncated Fourier series per joint, at rest at both ends, within limits.

use super::ExciteOptions;
use lacuna_interfaces::robot::PerJoint;
use lacuna_interfaces::{BadInput, RobotFile};
use lacuna_physics::RigidBody;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;
use serde::Serialize;
use std::io::Write;

/// Instants at which a motion is held against its limits, and excitation is judged.
pub(super) const INSTANTS: usize = 240;
/// Candidates per generation.
const GENERATION: usize = 16;

/// A designed motion.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Trajectory {
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
}

/// Limits of one joint.
#[derive(Debug, Clone, Copy)]
struct Bound {
    low: f64,
    high: f64,
    speed: f64,
    acceleration: f64,
}

/// Position, velocity and acceleration per joint.
pub type State = (Vec<f64>, Vec<f64>, Vec<f64>);

/// Coefficients of all joints: centre, then H − 1 sines and H − 1 cosines each; the last harmonic follows.
#[derive(Debug, Clone)]
pub(super) struct Candidate {
    pub centre: Vec<f64>,
    pub sine: Vec<Vec<f64>>,
    pub cosine: Vec<Vec<f64>>,
    /// Share of what the limits allow that each joint moves by, at most 1.
    pub share: Vec<f64>,
}

impl Candidate {
    pub fn at(&self, period_s: f64, t_s: f64) -> State {
        motion(&self.centre, &self.sine, &self.cosine, period_s, t_s)
    }

    pub fn into_trajectory(self, joints: &[String], period_s: f64) -> Trajectory {
        Trajectory {
            joints: joints.to_vec(),
            period_s,
            centre_rad: self.centre,
            sine_rad: self.sine,
            cosine_rad: self.cosine,
        }
    }
}

impl Trajectory {
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

/// What a search found.
pub(super) struct Found<Q> {
    pub candidate: Candidate,
    /// Quality of the start, or of the first feasible candidate.
    pub before: Q,
    pub after: Q,
    pub feasible: usize,
}

/// The motions of a robot within its limits.
pub(super) struct Space<'a> {
    bounds: Vec<Bound>,
    options: &'a ExciteOptions,
    /// Motions need not go to the limits: slow and small ones are searched too.
    slower: bool,
}

/// Smallest share of the limits that is searched.
const LEAST_SHARE: f64 = 0.02;

impl<'a> Space<'a> {
    /// Checks the options and the limits.
    pub fn new(robot: &RobotFile, options: &'a ExciteOptions) -> Result<Self, BadInput> {
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
        Ok(Self { bounds, options, slower: false })
    }

    /// The same space with slower and smaller motions in it.
    pub fn with_slower(self) -> Self {
        Self { slower: true, ..self }
    }

    /// True if the tip stays in the workspace box, where there is one; `None` out of reach.
    pub fn holds(&self, body: &dyn RigidBody, q_rad: &[f64]) -> Option<bool> {
        let Some([low, high]) = self.options.workspace_m else { return Some(true) };
        let tip = body.tip(q_rad).ok()?.position_m;
        Some((0..3).all(|i| tip[i] >= low[i] && tip[i] <= high[i]))
    }

    /// An evolution strategy with one parent and adaptive step, deterministic by seed. `judge` is `None` for a motion
    /// out of reach or workspace; the largest value wins.
    pub fn search<Q: Copy + Send>(
        &self,
        start: Option<(Candidate, Q)>,
        judge: &(dyn Fn(&Candidate) -> Option<Q> + Sync),
        value: &dyn Fn(&Q) -> f64,
        progress: &mut dyn FnMut(f64),
    ) -> Result<Found<Q>, BadInput> {
        let mut rng = Pcg64Mcg::seed_from_u64(self.options.seed);
        let mut feasible = 0;
        let mut first: Option<Q> = start.as_ref().map(|s| s.1);
        let mut parent = start;
        let mut step = 0.4;
        let generations = self.options.candidates.div_ceil(GENERATION).max(1);
        for generation in 0..generations {
            progress(generation as f64 / generations as f64);
            let drawn: Vec<Candidate> =
                (0..GENERATION).map(|_| self.draw(parent.as_ref().map(|p| &p.0), step, &mut rng)).collect();
            let judged: Vec<Option<Q>> = drawn.par_iter().map(judge).collect();
            feasible += judged.iter().flatten().count();
            // The first feasible candidate is "a motion within the limits": what the design is measured against.
            first = first.or_else(|| judged.iter().flatten().next().copied());
            let best = drawn
                .into_iter()
                .zip(judged)
                .filter_map(|(c, q)| q.map(|q| (c, q)))
                .max_by(|a, b| value(&a.1).total_cmp(&value(&b.1)));
            let Some(best) = best else { continue };
            let better = parent.as_ref().is_none_or(|p| value(&best.1) > value(&p.1));
            // One in five generations should succeed (Rechenberg's rule).
            step = f64::clamp(if better { step * 1.3 } else { step * 0.92 }, 0.01, 0.8);
            if better {
                parent = Some(best);
            }
        }
        progress(1.0);
        match (parent, first) {
            (Some((candidate, after)), Some(before)) => Ok(Found { candidate, before, after, feasible }),
            _ => Err(BadInput::new(format!(
                "found no motion within reach and workspace in {} candidates; expected wider workspace or narrower joint limits",
                generations * GENERATION
            ))),
        }
    }

    /// A random candidate, or a mutation of `parent`, scaled to the joint limits.
    fn draw(&self, parent: Option<&Candidate>, step: f64, rng: &mut Pcg64Mcg) -> Candidate {
        let h = self.options.harmonics;
        let mut out = Candidate { centre: Vec::new(), sine: Vec::new(), cosine: Vec::new(), share: Vec::new() };
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
            let mut share = parent.map_or(1.0, |p| p.share[j]);
            if self.slower {
                share = (share * (2.0 * scale * normal()).exp()).clamp(LEAST_SHARE, 1.0);
            }
            let centre = self.fit_in(j, centre, share, &mut sine, &mut cosine);
            out.share.push(share);
            out.centre.push(centre);
            out.sine.push(sine);
            out.cosine.push(cosine);
        }
        out
    }

    /// Scales one joint's coefficients to `share` of its limits and returns the centre moved to where they fit.
    fn fit_in(&self, j: usize, centre: f64, share: f64, sine: &mut [f64], cosine: &mut [f64]) -> f64 {
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
            / 1.02
            * share;
        let factor = if factor.is_finite() { factor } else { 0.0 };
        sine.iter_mut().chain(cosine.iter_mut()).for_each(|v| *v *= factor);
        let (low, high) = (low * factor, high * factor);
        let (first, last) = (middle - half - low, middle + half - high);
        if first > last { middle - 0.5 * (low + high) } else { centre.clamp(first, last) }
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
