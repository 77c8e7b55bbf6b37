//! How far a joint moves after a reversal before its Coulomb friction is complete.
//!
//! Per joint the width with the least residual over moving rows is taken, everything but f_c held at the first fit:
//! what is left of the torque, r = τ − X β + f_c c, is regressed on each candidate direction c.

use crate::base::Structure;
use crate::columns::Term;
use crate::condition::{BRISTLE_WIDTHS_RAD, Conditioned};
use crate::fit::{Solution, predict};
use crate::rows::{Rows, bristle_column};
use lacuna_interfaces::BadInput;
use rayon::prelude::*;

/// A bristle must take this share off the squared residual, in each half of the rows, to be preferred to the sign of
/// the velocity.
const WORTH: f64 = 0.02;

/// Replaces the Coulomb columns by the best bristles and returns their widths [rad], per joint; `None` where the sign of
/// the velocity is as good.
///
/// # Errors
/// As [`bristle_column`].
pub fn choose(
    structure: &Structure,
    conditioned: &[Conditioned],
    rows: &mut Rows,
    train: &[bool],
    solution: &Solution,
) -> Result<Vec<Option<f64>>, BadInput> {
    let n = rows.joints.len();
    let shared: &Rows = rows;
    let found: Vec<Option<Choice>> = (0..n)
        .into_par_iter()
        .map(|j| best(structure, conditioned, shared, train, solution, j))
        .collect::<Result<_, _>>()?;
    let mut widths = vec![None; n];
    for (j, choice) in found.into_iter().enumerate() {
        let Some(Choice { width, slot, column }) = choice else { continue };
        widths[j] = Some(width);
        for (entry, v) in rows.joints[j].x.iter_mut().skip(slot).step_by(structure.active[j].len()).zip(column) {
            *entry = v;
        }
    }
    Ok(widths)
}

/// A better Coulomb column for a joint.
struct Choice {
    width: f64,
    slot: usize,
    column: Vec<f64>,
}

fn best(
    structure: &Structure,
    conditioned: &[Conditioned],
    rows: &Rows,
    train: &[bool],
    solution: &Solution,
    j: usize,
) -> Result<Option<Choice>, BadInput> {
    let active = &structure.active[j];
    let coulomb = |b: &usize| structure.columns[structure.base[*b].column].term == Term::Coulomb(j);
    let Some(slot) = active.iter().position(coulomb) else { return Ok(None) };
    let f_c = solution.beta[active[slot]];
    let model = predict(structure, rows, &solution.beta, j);
    let joint = &rows.joints[j];
    let sign: Vec<f64> = joint.column(slot, active.len()).collect();
    let used: Vec<usize> = (0..rows.len()).filter(|&k| train[k] && joint.counted[k]).collect();
    let rest: Vec<f64> = used.iter().map(|&k| joint.y[k] - model[k] + f_c * sign[k]).collect();
    let half = used.len() / 2;
    let misfits = |c: &[f64]| {
        [misfit(&rest, &used, c), misfit(&rest[..half], &used[..half], c), misfit(&rest[half..], &used[half..], c)]
    };
    let by_sign = misfits(&sign);
    let mut least = by_sign[0];
    let mut chosen = None;
    for (index, &width) in BRISTLE_WIDTHS_RAD.iter().enumerate() {
        let column = bristle_column(conditioned, j, index)?;
        if column.len() != rows.len() {
            break;
        }
        let found = misfits(&column);
        let worth = found.iter().zip(by_sign).all(|(a, b)| *a < (1.0 - WORTH) * b);
        if worth && found[0] < least {
            least = found[0];
            chosen = Some(Choice { width, slot, column });
        }
    }
    Ok(chosen)
}

/// Squared residual of `rest` after regression on the used entries of `column`.
fn misfit(rest: &[f64], used: &[usize], column: &[f64]) -> f64 {
    let (mut rr, mut rc, mut cc) = (0.0, 0.0, 0.0);
    for (r, &k) in rest.iter().zip(used) {
        rr += r * r;
        rc += r * column[k];
        cc += column[k] * column[k];
    }
    if cc > 0.0 { rr - rc * rc / cc } else { rr }
}
