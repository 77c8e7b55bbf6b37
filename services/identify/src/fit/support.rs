//! Which columns the data support: not zero, not a combination of others, not drowned in their own uncertainty.

use super::draft::{Data, Draft};
use super::normal::{Choice, Normal};
use super::{Solution, Unexcited, Why};
use crate::columns::Term;
use lacuna_estimation::least_squares::{GRAM_CONDITION_LIMIT, Gram, Pivoting, base_parameters};
use lacuna_interfaces::BadInput;
use nalgebra::{DMatrix, DVector};

/// Part of a data column outside the span of the others below which the recordings do not tell it apart; raised
/// tenfold where the normal equations are still too ill-conditioned.
const DATA_TOLERANCE: [f64; 4] = [1e-4, 1e-3, 1e-2, 1e-1];

/// A column is zero in the data below this share of its size at random motions: a joint that a controller holds still moves
/// by its encoder's resolution.
const SILENT: f64 = 1e-4;

/// Columns that these data excite and tell apart, and the condition number of all that are not zero.
pub(super) fn excited(data: Data<'_>, draft: &Draft, total: &Gram) -> Result<(Choice, f64), BadInput> {
    let base = &data.stream.structure.base;
    let (moved, zero): (Vec<usize>, Vec<usize>) =
        (0..base.len()).partition(|&b| draft.rms[b] > SILENT * base[b].typical);
    let root = column_root(&total.select(&moved).xtx());
    for tolerance in DATA_TOLERANCE {
        let found = base_parameters(&root, tolerance, Pivoting::InOrder)?;
        let mut excited: Vec<usize> = found.independent.iter().map(|&i| moved[i]).collect();
        excited.sort_unstable();
        if excited.is_empty() {
            break;
        }
        if total.select(&excited).condition() > 0.5 * GRAM_CONDITION_LIMIT {
            continue;
        }
        // Factors were found for columns of unit length.
        let xtx = total.xtx();
        let length = |b: usize| xtx[(b, b)].sqrt();
        let dependent = found.dependent.into_iter().map(|d| {
            let column = moved[d.column];
            let combination =
                d.combination.iter().map(|&(i, k)| (moved[i], k * length(column) / length(moved[i]))).collect();
            Unexcited { base: column, why: Why::Dependent, combination }
        });
        let silent = zero.iter().map(|&base| Unexcited { base, why: Why::Zero, combination: Vec::new() });
        let mut unexcited: Vec<Unexcited> = dependent.chain(silent).collect();
        unexcited.sort_by_key(|u| u.base);
        let mut fixed = vec![0.0; base.len()];
        unexcited.iter().for_each(|u| fixed[u.base] = base[u.base].nominal);
        return Ok((Choice { excited, unexcited, fixed, tolerance }, total.select(&moved).condition()));
    }
    Err(BadInput::new(
        "found columns that the recordings do not tell apart at any tolerance; expected motion of every joint",
    ))
}

/// Drops columns that the data do not support until all that are left are.
pub(super) fn settle(data: Data<'_>, draft: &Draft, normal: &Normal) -> Result<Solution, BadInput> {
    let mut choice = draft.choice.clone();
    loop {
        let beta = normal.solve(&choice)?;
        let (covariance, blocks) = normal.jackknife(&choice);
        let solution = Solution {
            condition: normal.total.select(&choice.excited).condition(),
            condition_all: draft.condition_all,
            digits_lost: choice.tolerance > DATA_TOLERANCE[0],
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
            Some((base, why)) => drop_column(data, &normal.total, &mut choice, base, why)?,
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
fn drop_column(data: Data<'_>, total: &Gram, choice: &mut Choice, base: usize, why: Why) -> Result<(), BadInput> {
    choice.excited.retain(|b| *b != base);
    let xtx = total.xtx();
    let rest = total.select(&choice.excited).solve()?;
    let cross = DVector::from_iterator(choice.excited.len(), choice.excited.iter().map(|&b| xtx[(b, base)]));
    let factors = rest.inverse_gram * cross;
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
