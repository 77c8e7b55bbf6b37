//! The structure's minimal identifiable set: which parameters the torque can tell apart at all.
//!
//! The columns are evaluated at random motions, far richer than any recording; what is linearly dependent there is
//! dependent in every recording (Gautier 1991). Dependent parameters merge: with X_d = Σ κ_b X_b the base
//! parameter is β_b = π_b + Σ κ_b π_d.

use crate::columns::{Column, Evaluator, Sample};
use lacuna_estimation::least_squares::{BaseParameters, Pivoting, base_parameters};
use lacuna_interfaces::robot::PerJoint;
use lacuna_interfaces::{BadInput, RobotFile};
use lacuna_physics::{Motion, RigidBody};
use nalgebra::DMatrix;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// Part of a column outside the span of the others below which it counts as dependent. Random motions leave structural
/// dependences at 1e-14 and independent columns far above 1e-6.
const TOLERANCE: f64 = 1e-7;

/// A parameter of the minimal set.
#[derive(Debug, Clone, PartialEq)]
pub struct BaseColumn {
    /// Index into the full list of columns.
    pub column: usize,
    /// (column, κ): parameters that merge into it, with their factors.
    pub merged: Vec<(usize, f64)>,
    /// Value that follows from the robot file: π_b + Σ κ π_d.
    pub nominal: f64,
    /// Root mean square of the column at random motions, over the joint where it is largest: what a recording's column is
    /// measured against before it is called zero.
    pub typical: f64,
}

/// The minimal set of a robot.
#[derive(Debug, Clone, PartialEq)]
pub struct Structure {
    /// All columns.
    pub columns: Vec<Column>,
    /// The minimal set, in order.
    pub base: Vec<BaseColumn>,
    /// Columns that no motion excites.
    pub silent: Vec<usize>,
    /// Base columns that can differ from zero in a joint's torque, by joint; indices into `base`.
    pub active: Vec<Vec<usize>>,
    /// Condition number of the base at random motions.
    pub condition: f64,
}

/// Finds the minimal set of `columns`.
///
/// # Errors
/// [`BadInput`] if random motions within the limits are all out of the robot's reach.
pub fn structure(body: &dyn RigidBody, robot: &RobotFile, columns: Vec<Column>) -> Result<Structure, BadInput> {
    let n = body.joint_count();
    let samples = (3 * columns.len() / n.max(1)).max(60);
    let x = random_regressor(body, robot, &columns, samples)?;
    let BaseParameters { independent, dependent, zero, condition } = base_parameters(&x, TOLERANCE, Pivoting::InOrder)?;
    let mut base: Vec<BaseColumn> = independent
        .iter()
        .map(|&column| BaseColumn {
            column,
            merged: Vec::new(),
            nominal: columns[column].nominal,
            typical: (0..n).map(|j| rms((0..samples).map(|s| x[(s * n + j, column)]))).fold(0.0, f64::max),
        })
        .collect();
    for d in &dependent {
        for &(into, factor) in &d.combination {
            if let Some(b) = base.iter_mut().find(|b| b.column == into) {
                // Geometry is known to a micrometre; the rest is rounding of the decomposition.
                let factor = tidy(factor);
                b.merged.push((d.column, factor));
                b.nominal += factor * columns[d.column].nominal;
            }
        }
    }
    let active = (0..n)
        .map(|j| (0..base.len()).filter(|&b| (0..samples).any(|s| x[(s * n + j, base[b].column)] != 0.0)).collect())
        .collect();
    Ok(Structure { columns, base, silent: zero, active, condition })
}

fn rms(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = values.len().max(1) as f64;
    (values.map(|v| v * v).sum::<f64>() / count).sqrt()
}

fn tidy(factor: f64) -> f64 {
    let rounded = (factor * 1e9).round() / 1e9;
    if (rounded - factor).abs() < 1e-10 * (1.0 + factor.abs()) { rounded } else { factor }
}

/// (samples · n) × columns at random motions.
fn random_regressor(
    body: &dyn RigidBody,
    robot: &RobotFile,
    columns: &[Column],
    samples: usize,
) -> Result<DMatrix<f64>, BadInput> {
    let n = body.joint_count();
    let mut rng = Pcg64Mcg::seed_from_u64(0x5eed);
    let limit = |list: &Option<PerJoint>, j: usize| list.as_ref().and_then(|l| l.get(j));
    // A Delta reaches every pose between these; a serial joint turns.
    let reach = if body.as_delta().is_some() { (-0.6, 1.1) } else { (-3.1, 3.1) };
    let range: Vec<(f64, f64)> = (0..n)
        .map(|j| {
            let low = limit(&robot.limits.q_min_rad, j).unwrap_or(reach.0);
            let high = limit(&robot.limits.q_max_rad, j).unwrap_or(reach.1);
            if high > low { (low, high) } else { reach }
        })
        .collect();
    let mut evaluator = Evaluator::new(body, columns);
    let mut x = DMatrix::zeros(samples * n, columns.len());
    let (mut done, mut tried) = (0, 0);
    while done < samples {
        tried += 1;
        if tried > 50 * samples {
            return Err(BadInput::new(format!(
                "found {done} of {samples} random poses within the robot's reach; expected joint limits that it can take"
            )));
        }
        let q: Vec<f64> = range.iter().map(|&(low, high)| rng.random_range(low..high)).collect();
        let qd: Vec<f64> = (0..n).map(|_| rng.random_range(-3.0..3.0)).collect();
        let qdd: Vec<f64> = (0..n).map(|_| rng.random_range(-10.0..10.0)).collect();
        let sign: Vec<f64> = qd.iter().map(|v: &f64| v.signum()).collect();
        let sample = Sample { motion: Motion { q_rad: &q, qd_rad_s: &qd, qdd_rad_s2: &qdd }, sign: &sign };
        if evaluator.at(&sample).is_err() {
            continue;
        }
        for j in 0..n {
            for c in 0..columns.len() {
                x[(done * n + j, c)] = evaluator.entry(&sample, j, c);
            }
        }
        done += 1;
    }
    Ok(x)
}

impl Structure {
    /// Base parameters of a full parameter vector given as (column, value) pairs, everything else 0.
    pub fn project(&self, values: &[f64]) -> Vec<f64> {
        let at = |c: usize| values.get(c).copied().unwrap_or(0.0);
        self.base.iter().map(|b| at(b.column) + b.merged.iter().map(|&(c, k)| k * at(c)).sum::<f64>()).collect()
    }
}
