//! How far a joint moves after a reversal before its Coulomb friction is complete.
//!
//! Per joint the width with the least residual over moving rows is taken, everything but f_c held at the first fit:
//! what is left of the torque, r = τ − X β + f_c c, is regressed on each candidate direction c.

use crate::condition::BRISTLE_WIDTHS_RAD;
use crate::fit::draft::{Data, Draft};
use crate::layout::Chosen;
use lacuna_estimation::least_squares::Moments;
use nalgebra::DVector;

/// A bristle must take this share off the squared residual, over even and over odd blocks of time, to be preferred to the
/// sign of the velocity.
const WORTH: f64 = 0.02;

/// The best bristle of every joint, by its index in [`BRISTLE_WIDTHS_RAD`]; `None` where the sign of the velocity is as
/// good.
pub(crate) fn choose(data: Data<'_>, draft: &Draft, beta: &DVector<f64>) -> Vec<Option<usize>> {
    (0..data.stream.layout.len()).map(|j| best(data, draft, beta, j)).collect()
}

/// The width behind a choice [rad].
pub(crate) fn width_rad(bristle: Option<usize>) -> Option<f64> {
    bristle.and_then(|i| BRISTLE_WIDTHS_RAD.get(i).copied())
}

fn best(data: Data<'_>, draft: &Draft, beta: &DVector<f64>, j: usize) -> Option<usize> {
    let layout = &data.stream.layout[j];
    let slot = layout.coulomb?;
    let halves = [0, 1].map(|parity| counted(data, draft, j, parity));
    let mut rest = Chosen::plain().residual(layout, beta.as_slice());
    rest.retain(|(place, _)| *place != slot);
    let misfits = |place: usize| {
        let [a, b] = [&halves[0], &halves[1]].map(|half| misfit(half, &rest, place));
        [a + b, a, b]
    };
    let by_sign = misfits(slot);
    let mut least = by_sign[0];
    let mut chosen = None;
    for width in 0..layout.bristles {
        let found = misfits(layout.place(slot, Some(width)));
        let worth = found.iter().zip(by_sign).all(|(a, b)| *a < (1.0 - WORTH) * b);
        if worth && found[0] < least {
            least = found[0];
            chosen = Some(width);
        }
    }
    chosen
}

/// Sums over the counted training rows in blocks of one parity.
fn counted(data: Data<'_>, draft: &Draft, j: usize, parity: usize) -> Moments {
    let mut sum = Moments::new(data.stream.layout[j].len());
    for cell in draft.own_cells().filter(|&c| data.sums.cells.list[c].block % 2 == parity) {
        sum.merge(&data.sums.fitted[cell][j]);
    }
    for piece in (0..draft.pieces.len()).filter(|&i| draft.pieces[i]) {
        sum.merge(&data.sums.counted[2 * piece + parity][j]);
    }
    sum
}

/// Squared residual of `rest` after regression on the column at `place`.
fn misfit(sum: &Moments, rest: &[(usize, f64)], place: usize) -> f64 {
    let own = [(place, 1.0)];
    let (rr, rc, cc) = (sum.product(rest, rest), sum.product(rest, &own), sum.product(&own, &own));
    if cc > 0.0 { rr - rc * rc / cc } else { rr }
}
