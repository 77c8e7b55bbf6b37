//! A pass over the rows that bounds the influence of large residuals (Huber 1981).

use super::draft::{Data, Draft};
use crate::layout::{Chosen, Layout};
use crate::stream::{Class, Part, PartRows, Stream};
use crate::sums::Cells;
use lacuna_estimation::least_squares::Moments;
use lacuna_interfaces::BadInput;
use std::collections::BTreeMap;

/// Residuals beyond this many standard deviations pull no harder than at it. Keeps 98.9 % of the efficiency on normal
/// errors.
const HUBER: f64 = 2.5;
/// Memory for rows that need not be computed again for the next pass [bytes].
const ROW_MEMORY: usize = 64 << 20;

/// Fitted rows of a part, in single precision: they only decide weights, and make up what the weights take off.
pub(crate) struct Kept {
    joints: Vec<KeptJoint>,
}

#[derive(Default)]
struct KeptJoint {
    cell: Vec<u32>,
    z: Vec<f32>,
}

/// Rows of the first parts, as many as fit into a bounded memory.
#[derive(Default)]
pub(crate) struct Store {
    parts: Vec<Kept>,
}

impl Kept {
    pub(crate) fn of(layout: &[Layout], cells: &Cells, rows: &PartRows) -> Self {
        let of_part = cells.of_part(&rows.part);
        let joints = layout.iter().zip(&rows.joints).map(|(layout, joint)| {
            let m = layout.len();
            let fitted = joint.class.iter().filter(|c| **c == Class::Fitted).count();
            let mut out = KeptJoint { cell: Vec::with_capacity(fitted), z: Vec::with_capacity(fitted * m) };
            for (cell, range) in &of_part {
                for k in range.clone().filter(|&k| joint.class[k] == Class::Fitted) {
                    out.cell.push(*cell as u32);
                    out.z.extend(joint.z[k * m..(k + 1) * m].iter().map(|v| *v as f32));
                }
            }
            out
        });
        Self { joints: joints.collect() }
    }
}

impl Store {
    /// How many parts fit.
    pub(crate) fn room(stream: &Stream<'_>) -> usize {
        let row: usize = stream.layout.iter().map(|l| 4 * (l.len() + 1)).sum();
        let rows = stream.rows().div_ceil(stream.parts().max(1)).max(1);
        ROW_MEMORY / (row * rows).max(1)
    }

    pub(crate) fn push(&mut self, kept: Option<Kept>) {
        self.parts.extend(kept);
    }
}

/// What a part's large residuals take off.
#[derive(Default)]
struct Losses {
    sums: BTreeMap<(usize, usize, usize), Moments>,
    /// (draft, joint): rows beyond the bound, Σ (1 − h).
    counts: BTreeMap<(usize, usize), (usize, f64)>,
}

/// Weights every row of every draft by its residual from the draft's β and σ.
///
/// # Errors
/// As [`Stream::rows_of`].
pub(crate) fn reweigh(data: Data<'_>, store: &Store, drafts: &mut [Draft]) -> Result<(), BadInput> {
    let stream = data.stream;
    let shared: &[Draft] = drafts;
    let mut all = Losses::default();
    let make = |i: usize, part: &Part| {
        let own;
        let kept = match store.parts.get(i) {
            Some(kept) => kept,
            None => {
                own = Kept::of(&stream.layout, &data.sums.cells, &stream.rows_of(part, None)?);
                &own
            }
        };
        Ok(losses(data, kept, part.recording, shared))
    };
    stream.pass(make, |part| {
        for (key, sum) in part.sums {
            match all.sums.get_mut(&key) {
                Some(to) => to.merge(&sum),
                None => {
                    all.sums.insert(key, sum);
                }
            }
        }
        for (key, (beyond, weight)) in part.counts {
            let to = all.counts.entry(key).or_default();
            *to = (to.0 + beyond, to.1 + weight);
        }
        Ok(())
    })?;
    for draft in drafts.iter_mut() {
        draft.lost.clear();
        draft.lost_weight.fill(0.0);
        draft.outliers.fill(0.0);
    }
    for ((d, cell, j), sum) in all.sums {
        drafts[d].lost.insert((cell, j), sum);
    }
    for ((d, j), (beyond, weight)) in all.counts {
        drafts[d].lost_weight[j] = weight;
        drafts[d].outliers[j] = beyond as f64 / drafts[d].count[j].max(1) as f64;
    }
    Ok(())
}

fn losses(data: Data<'_>, kept: &Kept, recording: usize, drafts: &[Draft]) -> Losses {
    let mut out = Losses::default();
    for (j, (layout, joint)) in data.stream.layout.iter().zip(&kept.joints).enumerate() {
        let m = layout.len();
        for (d, draft) in drafts.iter().enumerate() {
            let chosen = draft.chosen_in(data, recording, j);
            let mut count = (0, 0.0);
            beyond(layout, &chosen, draft, j, joint.z.chunks_exact(m), |k, less, row| {
                let cell = joint.cell[k] as usize;
                if draft.cells[cell] {
                    count = (count.0 + 1, count.1 + less);
                    out.sums.entry((d, cell, j)).or_insert_with(|| Moments::new(row.len())).add_row(less, row);
                }
            });
            out.counts.insert((d, j), count);
        }
    }
    out
}

/// Calls `take` with the number, the lost weight 1 − h and \[x y\] of every row whose residual is beyond the bound.
pub(super) fn beyond<'a, T: Copy + Into<f64> + 'a>(
    layout: &Layout,
    chosen: &Chosen,
    draft: &Draft,
    j: usize,
    rows: impl Iterator<Item = &'a [T]>,
    mut take: impl FnMut(usize, f64, &[f64]),
) {
    let mut residual = vec![0.0; layout.len()];
    chosen.residual(layout, draft.beta.as_slice()).into_iter().for_each(|(i, f)| residual[i] += f);
    let y = chosen.y(layout);
    let bound = HUBER * draft.sigma[j];
    let mut row = vec![0.0; layout.width() + 1];
    for (k, z) in rows.enumerate() {
        let e: f64 = z.iter().zip(&residual).map(|(z, c)| (*z).into() * c).sum();
        if e.abs() <= bound {
            continue;
        }
        for slot in 0..layout.width() {
            row[slot] = z[layout.place(slot, chosen.bristle)].into();
        }
        row[layout.width()] = y.iter().map(|&(i, f)| f * z[i].into()).sum();
        take(k, 1.0 - bound / e.abs(), &row);
    }
}
