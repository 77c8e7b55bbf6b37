//! Which columns the data support: not zero, not a combination of others, not drowned in their own uncertainty.

use super::draft::{Data, Draft};
use super::normal::{Choice, Normal};
use super::{Solution, Unexcited, Why};
use crate::columns::Term;
use lacuna_estimation::least_squares::{GRAM_CONDITION_LIMIT, Gram, Pivoting, base_parameters};
use lacuna_interfaces::BadInput;
use nalgebra::DMatrix;

/// Part of a data column outside the span of the others below which the recordings do not tell it apart; raised
/// tenfold where the normal equations are still too ill-conditioned.
const DATA_TOLERANCE: [f64; 4] = [1e-4, 1e-3, 1e-2, 1e-1];

/// A column is zero in the data below this share of its size at random motions: a joint that a controller holds still moves
/// by its encoder's resolution.
const SILENT: f64 = 1e-4;

/// A column of unit length whose part outside the span of the others is below this is a combination of them, as far as a
/// Gram matrix can tell: its rounding, 1e-15, is the square of what it resolves.
const GRAM_FLOOR: f64 = 3e-7;
/// The same by QR, raised where the columns together are still too nearly dependent.
const QR_TOLERANCE: [f64; 3] = [1e-7, 1e-6, 1e-5];
/// Largest condition number of a fit by QR: nine digits of β remain.
const QR_CONDITION_LIMIT: f64 = 1e7;

/// What is known of the columns that are not zero.
struct Moved<'a> {
    /// Base columns.
    list: Vec<usize>,
    /// Those that are.
    zero: Vec<usize>,
    /// A matrix of unit columns with the dependences of the list.
    root: DMatrix<f64>,
    /// Condition number of some columns.
    condition: &'a dyn Fn(&[usize]) -> f64,
    /// XᵀX.
    xtx: DMatrix<f64>,
    /// Rows of all joints.
    rows: usize,
}

/// Base columns that move and that do not.
fn partition(data: Data<'_>, draft: &Draft) -> (Vec<usize>, Vec<usize>) {
    let base = &data.stream.structure.base;
    (0..base.len()).partition(|&b| draft.rms[b] > SILENT * base[b].typical)
}

/// Columns that these data excite and that normal equations tell apart, and the condition number of all that are not zero.
pub(super) fn excited(data: Data<'_>, draft: &Draft, total: &Gram) -> Result<(Choice, f64), BadInput> {
    let (list, zero) = partition(data, draft);
    let root = column_root(&total.select(&list).xtx());
    let condition = |columns: &[usize]| total.select(columns).condition();
    let moved = Moved { list, zero, root, condition: &condition, xtx: total.xtx(), rows: draft.count.iter().sum() };
    let (mut choice, condition) = moved.choose(data, &DATA_TOLERANCE, 0.5 * GRAM_CONDITION_LIMIT)?;
    let resolved = base_parameters(&moved.root, GRAM_FLOOR, Pivoting::InOrder)?.rank();
    choice.lossy = resolved > choice.excited.len();
    Ok((choice, condition))
}

/// The same where the factors of QR tell further ones apart.
pub(super) fn told_apart(data: Data<'_>, draft: &Draft, normal: &Normal) -> Result<(Choice, f64), BadInput> {
    let Some(factors) = &normal.factors else { return excited(data, draft, &normal.total) };
    let (list, zero) = partition(data, draft);
    let mut root = factors.columns(&list);
    root.column_iter_mut().for_each(|mut c| {
        let length = c.norm();
        c.unscale_mut(if length > 0.0 { length } else { 1.0 });
    });
    let condition = |columns: &[usize]| normal.condition(columns);
    let rows = draft.count.iter().sum();
    let moved = Moved { list, zero, root, condition: &condition, xtx: normal.total.xtx(), rows };
    let (mut choice, condition) = moved.choose(data, &QR_TOLERANCE, QR_CONDITION_LIMIT)?;
    choice.lossy = true;
    Ok((choice, condition))
}

impl Moved<'_> {
    /// The most columns, by the lowest of `tolerances` at which their condition number is below `limit`.
    fn choose(&self, data: Data<'_>, tolerances: &[f64], limit: f64) -> Result<(Choice, f64), BadInput> {
        let base = &data.stream.structure.base;
        for &tolerance in tolerances {
            let found = base_parameters(&self.root, tolerance, Pivoting::InOrder)?;
            let mut excited: Vec<usize> = found.independent.iter().map(|&i| self.list[i]).collect();
            excited.sort_unstable();
            if excited.is_empty() {
                break;
            }
            if (self.condition)(&excited) > limit {
                continue;
            }
            // Factors were found for columns of unit length.
            let length = |b: usize| self.xtx[(b, b)].sqrt();
            let dependent = found.dependent.into_iter().map(|d| {
                let column = self.list[d.column];
                let factor = |&(i, k): &(usize, f64)| (self.list[i], k * length(column) / length(self.list[i]));
                Unexcited { base: column, why: Why::Dependent, combination: d.combination.iter().map(factor).collect() }
            });
            let silent = self.zero.iter().map(|&base| Unexcited { base, why: Why::Zero, combination: Vec::new() });
            let mut unexcited: Vec<Unexcited> = dependent.chain(silent).collect();
            unexcited.sort_by_key(|u| u.base);
            let mut fixed = vec![0.0; base.len()];
            unexcited.iter().for_each(|u| fixed[u.base] = base[u.base].nominal);
            let choice = Choice { excited, unexcited, fixed, lossy: false };
            return Ok((choice, (self.condition)(&self.list)));
        }
        Err(BadInput::new(format!(
            "found {} parameters that {} rows of moving joints do not tell apart at any tolerance; expected motion of every \
             joint, and longer recordings",
            self.list.len(),
            self.rows
        )))
    }
}

/// Drops columns that the data do not support until all that are left are.
pub(super) fn settle(data: Data<'_>, draft: &Draft, normal: &Normal) -> Result<Solution, BadInput> {
    let mut choice = draft.choice.clone();
    loop {
        let beta = normal.solve(&choice)?;
        let (covariance, blocks) = normal.jackknife(&choice);
        let solution = Solution {
            condition: normal.condition(&choice.excited),
            condition_all: draft.condition_all,
            by_qr: normal.factors.is_some(),
            beta,
            covariance,
            blocks,
            excited: choice.excited.clone(),
            unexcited: choice.unexcited.clone(),
            sigma: draft.sigma.clone(),
            outliers: draft.outliers.clone(),
            rows: draft.count.clone(),
            normal: normal.total.clone(),
        };
        // Every turn drops a column, so this ends.
        match unsupported(data, &solution, &draft.size) {
            Some((base, why)) => drop_column(data, normal, &mut choice, base, why)?,
            None => return Ok(solution),
        }
    }
}

/// The fitted column that the data support least, if it is below what a model can use.
fn unsupported(data: Data<'_>, solution: &Solution, size: &[f64]) -> Option<(usize, Why)> {
    let structure = data.stream.structure;
    let term = |b: usize| structure.columns[structure.base[b].column].term;
    let torque = |b: usize| solution.half_width(b) * size[b];
    // Of a Coulomb level and an offset that only appear together, the offset is the one to go.
    let preference = |b: usize| if matches!(term(b), Term::Offset(_)) { 3.0 * torque(b) } else { torque(b) };
    let worst = solution
        .excited
        .iter()
        .filter(|&&b| solution.blocks >= 3 && solution.excited.len() > 1 && torque(b) > 1.0)
        .max_by(|&&a, &&b| preference(a).total_cmp(&preference(b)));
    if let Some(&b) = worst {
        return Some((b, Why::Uncertain(torque(b))));
    }
    let friction = |b: usize| matches!(term(b), Term::Viscous(_) | Term::Coulomb(_));
    let lowest = solution
        .excited
        .iter()
        .filter(|&&b| friction(b) && solution.beta[b] < 0.0 && solution.excited.len() > 1)
        .min_by(|&&a, &&b| (solution.beta[a] * size[a]).total_cmp(&(solution.beta[b] * size[b])));
    lowest.map(|&b| (b, Why::Negative(solution.beta[b])))
}

/// Takes a column out of the fit and notes what it is nearest to.
fn drop_column(data: Data<'_>, normal: &Normal, choice: &mut Choice, base: usize, why: Why) -> Result<(), BadInput> {
    choice.excited.retain(|b| *b != base);
    let xtx = normal.total.xtx();
    let factors = normal.nearest(&choice.excited, base)?;
    let length = xtx[(base, base)].sqrt();
    let combination = choice
        .excited
        .iter()
        .zip(factors.iter())
        .filter(|(b, k)| k.abs() * xtx[(**b, **b)].sqrt() > 0.1 * length)
        .map(|(&b, &k)| (b, k))
        .collect();
    choice.fixed[base] = data.stream.structure.base[base].nominal;
    choice.unexcited.push(Unexcited { base, why, combination });
    choice.unexcited.sort_by_key(|u| u.base);
    Ok(())
}

/// A matrix of unit columns with the column dependences of the regressor whose Gram matrix is given, to half its digits.
fn column_root(xtx: &DMatrix<f64>) -> DMatrix<f64> {
    let scale = xtx.diagonal().map(|d| if d > 0.0 { 1.0 / d.sqrt() } else { 0.0 });
    let scaled = DMatrix::from_fn(xtx.nrows(), xtx.ncols(), |i, j| xtx[(i, j)] * scale[i] * scale[j]);
    let eigen = scaled.symmetric_eigen();
    let mut root = eigen.eigenvectors.transpose();
    for (mut row, value) in root.row_iter_mut().zip(eigen.eigenvalues.iter()) {
        row *= value.max(0.0).sqrt();
    }
    root
}
