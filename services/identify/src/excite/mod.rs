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
//!
//! [`separate()`] searches the same motions for the one on which two explanations differ most.

mod motion;
mod separate;

pub use motion::{State, Trajectory};
pub use separate::{Evidence, Explanation, Separation, separate};

use crate::base::{Structure, structure};
use crate::columns::{Evaluator, Sample, Signal, columns};
use lacuna_estimation::least_squares::{Gram, Statistics};
use lacuna_interfaces::robot::Limits;
use lacuna_interfaces::{BadInput, RobotFile};
use lacuna_physics::{Motion, RigidBody};
use motion::{Candidate, INSTANTS, Space};
use serde::{Deserialize, Serialize};

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

/// A designed excitation.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Excitation {
    /// The motion.
    #[serde(flatten)]
    pub motion: Trajectory,
    /// The first candidate, a random motion within the same limits.
    pub before: Quality,
    /// The designed one.
    pub after: Quality,
    /// Geometric mean over the parameters by which the standard errors shrink from the first to the designed motion.
    pub error_ratio: f64,
    /// Candidates that were within reach and workspace.
    pub feasible: usize,
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
    let space = Space::new(robot, options)?;
    let problem = Problem::new(robot, body, options)?;
    let found = space.search(None, &|c| problem.judge(&space, c), &|q: &Quality| q.log_det, progress)?;
    let (before, after) = (found.before, found.after);
    let parameters = problem.structure.base.len() as f64;
    Ok(Excitation {
        motion: found.candidate.into_trajectory(&robot.joints, options.period_s),
        before,
        after,
        error_ratio: ((after.log_det - before.log_det) / (2.0 * parameters)).exp(),
        feasible: found.feasible,
    })
}

struct Problem<'a> {
    body: &'a dyn RigidBody,
    structure: Structure,
    weights: Vec<f64>,
    options: &'a ExciteOptions,
}

impl<'a> Problem<'a> {
    fn new(robot: &RobotFile, body: &'a dyn RigidBody, options: &'a ExciteOptions) -> Result<Self, BadInput> {
        let structure = structure(body, robot, columns(body, Signal::Motor, robot.torque_unit.symbol()))?;
        let weights =
            (0..robot.joint_count()).map(|j| options.sd_tau_nm.get(j).map_or(1.0, |s| 1.0 / (s * s))).collect();
        Ok(Self { body, structure, weights, options })
    }

    /// How well a candidate determines the parameters; `None` out of reach or workspace.
    fn judge(&self, space: &Space<'_>, candidate: &Candidate) -> Option<Quality> {
        let p = self.structure.base.len();
        let n = self.weights.len();
        let mut evaluator = Evaluator::new(self.body, &self.structure.columns);
        let (mut x, mut y, mut w) = (Vec::with_capacity(INSTANTS * n * p), Vec::new(), Vec::new());
        for k in 0..INSTANTS {
            // Half a step in, so that no instant is one of rest.
            let t = (k as f64 + 0.5) / INSTANTS as f64 * self.options.period_s;
            let (q, qd, qdd) = candidate.at(self.options.period_s, t);
            if !space.holds(self.body, &q)? {
                return None;
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
