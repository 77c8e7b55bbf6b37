//! The founding paper's own way (sections 4.1, 4.2), to reproduce it: `method = "paper"`.
//!
//! ```text
//! (ρ1, ρ2)_υ = argmin RMS(T − ρ1 I θ̈ − ρ2 G − Jᵀ M γ)      per trajectory υ, greedy over a grid (eq. 7)
//! (ρ1, ρ2)   = average over trajectories
//! (f_v, f_c)_υ,i = (ΦᵀΦ)⁻¹Φᵀ Δτ,  Φ = [θ̇ sgn θ̇]           per trajectory and joint, then the average
//! ```
//!
//! Both errors of the paper are kept apart from the method: ρ1 and ρ2 are linear, so no grid is needed, and an
//! average of fits is no fit (NOTATION.md, erratum 7); the pooled method of [`crate::fit`] does neither. Here the
//! corrected M_KH is used. All of it follows from the sums of `crate::sums`, as the misfit is quadratic: no row is looked
//! at again.

use crate::base::Structure;
use crate::columns::Term;
use crate::evaluate::Which;
use crate::fit::draft::{Data, chosen};
use crate::hold_out::each_sum;
use crate::layout::{self, Chosen};
use crate::sums::Sums;
use lacuna_estimation::least_squares::Moments;
use lacuna_interfaces::BadInput;
use nalgebra::{DVector, Matrix2, Vector2};
use serde::Serialize;

/// Range of ρ1 and ρ2 searched.
const RANGE: (f64, f64) = (0.2, 5.0);
/// First step of the grid; each refinement is ten times finer, down to 1e-3.
const STEP: f64 = 0.1;

/// Estimates of one trajectory.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Trajectory {
    /// File name.
    pub file: String,
    /// ρ1*.
    pub rho1: f64,
    /// ρ2*.
    pub rho2: f64,
    /// f_v per joint [Nm s/rad].
    pub f_v: Vec<f64>,
    /// f_c per joint [Nm].
    pub f_c: Vec<f64>,
}

/// Mean μ and standard deviation σ of the torque error e = τ − τ̂, per joint [Nm] (the paper's Tables 1 and 2).
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct ErrorTable {
    /// Model name.
    pub model: String,
    /// μ per joint.
    pub mean_nm: Vec<f64>,
    /// σ per joint.
    pub std_nm: Vec<f64>,
}

/// The paper's estimates and its Table 1.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PaperResult {
    /// Average ρ1*.
    pub rho1: f64,
    /// Average ρ2*.
    pub rho2: f64,
    /// Average f_v per joint [Nm s/rad].
    pub f_v: Vec<f64>,
    /// Average f_c per joint [Nm].
    pub f_c: Vec<f64>,
    /// Estimates per trajectory.
    pub trajectories: Vec<Trajectory>,
    /// Table 1 over the held-out rows: M_KH, M_Id, M_Id+F, and the pooled fit beside them.
    pub table1: Vec<ErrorTable>,
    /// The same over moving joints alone: what a stuck joint holds is no model's fault.
    pub table1_moving: Vec<ErrorTable>,
    /// Table 2 over the held-out rows of recordings with a payload: M_Id+F with m_P = 0 and with the estimate. Empty
    /// without such recordings.
    pub table2: Vec<ErrorTable>,
}

/// M_KH, M_Id and M_Id+F as parameter vectors over the base.
#[derive(Debug, Clone, PartialEq)]
pub struct PaperModels {
    /// M_KH.
    pub nominal: DVector<f64>,
    /// M_Id.
    pub identified: DVector<f64>,
    /// M_Id+F.
    pub with_friction: DVector<f64>,
}

/// The base's parameter vector for ρ1, ρ2 and friction.
struct Layout {
    nominal: DVector<f64>,
    inertia: Vec<usize>,
    gravity: Vec<usize>,
    viscous: Vec<Option<usize>>,
    coulomb: Vec<Option<usize>>,
}

impl Layout {
    fn of(structure: &Structure) -> Self {
        let base = &structure.base;
        let named = |prefixes: &[&str]| -> Vec<usize> {
            let symbol = |b: usize| structure.columns[base[b].column].symbol.as_str();
            (0..base.len())
                .filter(|&b| {
                    matches!(structure.columns[base[b].column].term, Term::Rigid(_))
                        && prefixes.contains(&symbol(b).trim_end_matches(|c: char| c.is_ascii_digit()))
                })
                .collect()
        };
        let find = |term: Term| base.iter().position(|b| structure.columns[b.column].term == term);
        let n = structure.active.len();
        Self {
            nominal: DVector::from_iterator(base.len(), base.iter().map(|b| b.nominal)),
            inertia: named(&["I"]),
            gravity: named(&["gc", "gs"]),
            viscous: (0..n).map(|j| find(Term::Viscous(j))).collect(),
            coulomb: (0..n).map(|j| find(Term::Coulomb(j))).collect(),
        }
    }

    fn grey_box(&self, rho1: f64, rho2: f64) -> DVector<f64> {
        let mut beta = self.nominal.clone();
        self.inertia.iter().for_each(|&b| beta[b] *= rho1);
        self.gravity.iter().for_each(|&b| beta[b] *= rho2);
        beta
    }
}

/// A recording's sums over its usable training rows, per joint, and the choice of columns in them.
struct Own {
    sums: Vec<Moments>,
    chosen: Chosen,
}

impl Own {
    fn of(data: Data<'_>, train: &[bool], recording: usize, shift_s: f64) -> Self {
        let cells: Vec<bool> =
            data.sums.cells.list.iter().zip(train).map(|(c, train)| *train && c.recording == recording).collect();
        let sum = |j: usize| {
            let mut total = Moments::new(data.stream.layout[j].len());
            each_sum(data, &cells, j, Which::Usable, |_, sum| total.merge(sum));
            total
        };
        // The paper's models have the sign of the velocity, as the stages that run them do.
        let chosen = chosen(data.stream, recording, None, shift_s);
        Self { sums: (0..data.stream.layout.len()).map(sum).collect(), chosen }
    }

    fn rows(&self, data: Data<'_>) -> f64 {
        data.stream.layout.iter().zip(&self.sums).map(|(l, s)| Sums::rows_in(l, s)).fold(0.0, f64::max)
    }
}

/// Estimates ρ1, ρ2 and friction from the cells where `train` is true, with the torque moved by `shift_s`. `files` names
/// the recordings.
///
/// # Errors
/// [`BadInput`] if no recording has a training row, or a joint does not move.
pub(crate) fn fit(
    data: Data<'_>,
    train: &[bool],
    shift_s: f64,
    files: &[String],
) -> Result<(PaperModels, PaperResult), BadInput> {
    let parts = Layout::of(data.stream.structure);
    let n = data.stream.layout.len();
    let mut trajectories = Vec::new();
    let mut own = Vec::new();
    for (r, file) in files.iter().enumerate() {
        let sums = Own::of(data, train, r, shift_s);
        if sums.rows(data) < 10.0 {
            continue;
        }
        let (rho1, rho2) = greedy(&misfit(data, &parts, &sums));
        trajectories.push(Trajectory { file: file.clone(), rho1, rho2, f_v: Vec::new(), f_c: Vec::new() });
        own.push(sums);
    }
    if trajectories.is_empty() {
        return Err(BadInput::new("found no training recording of at least 10 rows; expected one trajectory or more"));
    }
    let mean = |f: &dyn Fn(&Trajectory) -> f64| trajectories.iter().map(f).sum::<f64>() / trajectories.len() as f64;
    let (rho1, rho2) = (mean(&|t| t.rho1), mean(&|t| t.rho2));
    let identified = parts.grey_box(rho1, rho2);
    for (trajectory, sums) in trajectories.iter_mut().zip(&own) {
        for j in 0..n {
            let [f_v, f_c] = friction(data, &parts, sums, j, &identified).ok_or_else(|| {
                BadInput::new(format!("joint {} does not move enough to tell f_v from f_c; expected motion", j + 1))
                    .in_file(&trajectory.file)
            })?;
            trajectory.f_v.push(f_v);
            trajectory.f_c.push(f_c);
        }
    }
    let average = |f: &dyn Fn(&Trajectory) -> &Vec<f64>| -> Vec<f64> {
        (0..n).map(|j| trajectories.iter().map(|t| f(t)[j]).sum::<f64>() / trajectories.len() as f64).collect()
    };
    let (f_v, f_c) = (average(&|t| &t.f_v), average(&|t| &t.f_c));
    let mut with_friction = identified.clone();
    for j in 0..n {
        if let (Some(v), Some(c)) = (parts.viscous[j], parts.coulomb[j]) {
            with_friction[v] = f_v[j];
            with_friction[c] = f_c[j];
        }
    }
    let models = PaperModels { nominal: parts.nominal.clone(), identified, with_friction };
    let (table1, table1_moving, table2) = (Vec::new(), Vec::new(), Vec::new());
    Ok((models, PaperResult { rho1, rho2, f_v, f_c, trajectories, table1, table1_moving, table2 }))
}

/// Σ (τ − c − ρ1 a − ρ2 b)² over the given rows as a quadratic form: constant, linear, quadratic part.
struct Quadratic {
    constant: f64,
    linear: [f64; 2],
    quadratic: [f64; 3],
}

impl Quadratic {
    fn at(&self, rho1: f64, rho2: f64) -> f64 {
        self.constant - 2.0 * (self.linear[0] * rho1 + self.linear[1] * rho2)
            + self.quadratic[0] * rho1 * rho1
            + 2.0 * self.quadratic[1] * rho1 * rho2
            + self.quadratic[2] * rho2 * rho2
    }
}

fn misfit(data: Data<'_>, parts: &Layout, own: &Own) -> Quadratic {
    let mut q = Quadratic { constant: 0.0, linear: [0.0; 2], quadratic: [0.0; 3] };
    // What neither ρ touches, then what each scales.
    let rest = parts.grey_box(0.0, 0.0);
    let scaled = [parts.grey_box(1.0, 0.0) - &rest, parts.grey_box(0.0, 1.0) - &rest];
    for (layout, sum) in data.stream.layout.iter().zip(&own.sums) {
        let e = own.chosen.residual(layout, rest.as_slice());
        let [a, b] = scaled.each_ref().map(|beta| model(layout, beta));
        q.constant += sum.product(&e, &e);
        q.linear[0] += sum.product(&e, &a);
        q.linear[1] += sum.product(&e, &b);
        q.quadratic[0] += sum.product(&a, &a);
        q.quadratic[1] += sum.product(&a, &b);
        q.quadratic[2] += sum.product(&b, &b);
    }
    q
}

/// X β of a joint as a mixture of its columns.
fn model(layout: &layout::Layout, beta: &DVector<f64>) -> Vec<(usize, f64)> {
    layout.active.iter().enumerate().map(|(slot, &b)| (slot, beta[b])).collect()
}

/// Best grid point, then finer grids around it (the paper's "greedy approach over a range of values").
fn greedy(q: &Quadratic) -> (f64, f64) {
    let mut best = (1.0, 1.0);
    let (mut low, mut high, mut step) = ([RANGE.0; 2], [RANGE.1; 2], STEP);
    while step > 5e-4 {
        let mut least = f64::INFINITY;
        let count = |i: usize| ((high[i] - low[i]) / step).round() as usize;
        let centre = best;
        for i in 0..=count(0) {
            for k in 0..=count(1) {
                let point = (low[0] + i as f64 * step, low[1] + k as f64 * step);
                let value = q.at(point.0, point.1);
                if value < least {
                    (least, best) = (value, point);
                }
            }
        }
        if !least.is_finite() {
            return centre;
        }
        (low, high) = ([best.0 - step, best.1 - step], [best.0 + step, best.1 + step]);
        step /= 10.0;
    }
    best
}

/// \[f_v, f_c\] of one joint over a recording's rows, by the paper's linear regression.
fn friction(data: Data<'_>, parts: &Layout, own: &Own, j: usize, identified: &DVector<f64>) -> Option<[f64; 2]> {
    let layout = &data.stream.layout[j];
    let slot = |b: Option<usize>| layout.active.iter().position(|a| Some(*a) == b);
    let (v, c) = (slot(parts.viscous[j])?, slot(parts.coulomb[j])?);
    let sum = &own.sums[j];
    let left = own.chosen.residual(layout, identified.as_slice());
    let products = sum.products();
    let phi = Matrix2::new(products[(v, v)], products[(v, c)], products[(c, v)], products[(c, c)]);
    let rhs = Vector2::new(sum.product(&[(v, 1.0)], &left), sum.product(&[(c, 1.0)], &left));
    // Speed and sign nearly proportional, or no motion: the regression has no answer.
    let independent = phi.determinant() / (phi[(0, 0)] * phi[(1, 1)]);
    if independent.is_nan() || independent < 1e-9 {
        return None;
    }
    let solved = phi.try_inverse()? * rhs;
    Some([solved[0], solved[1]])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_grid_finds_the_least_squares_point() {
        // (ρ1, ρ2) = (1.234, 0.877) as the minimum of a quadratic form with a strong cross term.
        let (a, b, c) = (2.0, 0.9, 1.5);
        let (x, y) = (1.234, 0.877);
        let q = Quadratic {
            constant: a * x * x + 2.0 * b * x * y + c * y * y,
            linear: [a * x + b * y, b * x + c * y],
            quadratic: [a, b, c],
        };
        let (rho1, rho2) = greedy(&q);
        assert!((rho1 - x).abs() < 1.1e-3 && (rho2 - y).abs() < 1.1e-3, "{rho1} {rho2}");
    }
}
