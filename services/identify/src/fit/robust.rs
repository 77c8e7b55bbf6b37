//! A pass over the rows that bounds the influence of large residuals (Huber 1981).

use super::draft::{Data, Draft, chosen};
use crate::layout::{Chosen, Layout};
use crate::options::Options;
use crate::split::Span;
use crate::stream::{Class, Part, PartRows, Stream};
use crate::sums::{Cells, Sums};
use lacuna_estimation::least_squares::Moments;
use lacuna_interfaces::BadInput;
use std::collections::BTreeMap;

/// Residuals beyond this many standard deviations pull no harder than at it. Keeps 98.9 % of the efficiency on normal
/// errors.
pub(super) const HUBER: f64 = 2.5;
/// A row may count for the first time in a later round if its residual from the screen is below this many standard
/// deviations of it; rows beyond are kept.
const SCREEN: f64 = 1.5;
/// How far, in parts of what lies between [`SCREEN`] and [`HUBER`], a draft's residuals may be from the screen's in the mean
/// square: a row that was not kept and is beyond Huber's bound is then five standard deviations of that difference off.
const NEAR: f64 = 0.2;

/// Fitted rows of a part, in single precision: they only decide weights, and make up what the weights take off.
pub(crate) struct Kept {
    joints: Vec<KeptJoint>,
}

#[derive(Default)]
struct KeptJoint {
    cell: Vec<u32>,
    z: Vec<f32>,
}

/// Rows that need not be computed again: all of the first parts, as many as fit into a bounded memory; of the later ones, in
/// as much memory again, those whose residual from a first fit of what came before is not small.
#[derive(Default)]
pub(crate) struct Store {
    whole: Vec<Kept>,
    screened: Vec<Kept>,
    screen: Option<Draft>,
}

impl Kept {
    fn of(stream: &Stream<'_>, cells: &Cells, rows: &PartRows, screen: Option<&Draft>) -> Self {
        let of_part = cells.of_part(&rows.part);
        let joints = stream.layout.iter().zip(&rows.joints).enumerate().map(|(j, (layout, joint))| {
            let m = layout.len();
            let mut residual = vec![0.0; m];
            let mut bound = f64::NEG_INFINITY;
            if let Some(s) = screen {
                let chosen = chosen(stream, rows.part.recording, s.bristle[j], s.shift_s);
                chosen.residual(layout, s.beta.as_slice()).into_iter().for_each(|(i, f)| residual[i] += f);
                bound = SCREEN * s.sigma[j];
            }
            let far = |z: &[f64]| z.iter().zip(&residual).map(|(z, c)| z * c).sum::<f64>().abs() > bound;
            let mut out = KeptJoint::default();
            if screen.is_none() {
                let fitted = joint.class.iter().filter(|c| **c == Class::Fitted).count();
                out = KeptJoint { cell: Vec::with_capacity(fitted), z: Vec::with_capacity(fitted * m) };
            }
            for (cell, range) in &of_part {
                for k in range.clone().filter(|&k| joint.class[k] == Class::Fitted) {
                    let z = &joint.z[k * m..(k + 1) * m];
                    if far(z) {
                        out.cell.push(*cell as u32);
                        out.z.extend(z.iter().map(|v| *v as f32));
                    }
                }
            }
            out
        });
        Self { joints: joints.collect() }
    }

    fn bytes(&self) -> usize {
        self.joints.iter().map(|j| 4 * (j.cell.capacity() + j.z.capacity())).sum()
    }
}

/// Adds up all rows of a stream, and keeps what [`reweigh`] looks at again in about twice `memory` bytes; `train` are the
/// spans of the fit.
///
/// # Errors
/// As [`Stream::rows_of`].
pub(crate) fn gather(
    stream: &Stream<'_>,
    cells: Cells,
    train: &[Span],
    options: &Options,
) -> Result<(Sums, Store), BadInput> {
    let (mut sums, mut store) = (Sums::new(stream, cells), Store::default());
    let parts = stream.parts();
    if !options.robust {
        sums.add(stream, 0..parts, |_, _| (), |()| ())?;
        return Ok((sums, store));
    }
    let row: usize = stream.layout.iter().map(|l| 4 * (l.len() + 1)).sum();
    let rows = stream.rows().div_ceil(parts.max(1)).max(1);
    let room = (options.row_memory / (row * rows).max(1)).clamp(1, parts.max(1)).min(parts);
    sums.add(stream, 0..room, |cells, rows| Kept::of(stream, cells, rows, None), |kept| store.whole.push(kept))?;
    if room == parts {
        return Ok((sums, store));
    }
    // Too little for a fit yet: then the rest is computed again.
    store.screen = Draft::new(Data { stream, sums: &sums }, train, options.delay).ok();
    let screen = store.screen.as_ref();
    let (screened, mut bytes) = (&mut store.screened, 0);
    let keep = |cells: &Cells, rows: &PartRows| screen.map(|s| Kept::of(stream, cells, rows, Some(s)));
    sums.add(stream, room..parts, keep, |kept| {
        if let Some(kept) = kept {
            bytes += kept.bytes();
            // A part's number is its place: once one is missing, so are all later ones.
            if bytes <= options.row_memory {
                screened.push(kept);
            }
        }
    })?;
    Ok((sums, store))
}

impl Store {
    /// Rows of a part that may be beyond Huber's bound, if they are at hand.
    fn part(&self, i: usize, near: bool) -> Option<&Kept> {
        match i.checked_sub(self.whole.len()) {
            None => self.whole.get(i),
            Some(later) if near => self.screened.get(later),
            Some(_) => None,
        }
    }

    /// Whether all drafts are so near to the screen that what it left out is within Huber's bound.
    fn near(&self, data: Data<'_>, drafts: &[Draft]) -> bool {
        let Some(screen) = &self.screen else { return true };
        drafts.iter().all(|draft| {
            data.stream.layout.iter().enumerate().all(|(j, layout)| {
                let (mut square, mut rows) = (0.0, 0.0);
                for cell in draft.own_cells() {
                    let own = &data.sums.fitted[cell][j];
                    let mut apart = draft.chosen(data, cell, j).residual(layout, draft.beta.as_slice());
                    let of_screen = screen.chosen(data, cell, j).residual(layout, screen.beta.as_slice());
                    apart.extend(of_screen.into_iter().map(|(i, f)| (i, -f)));
                    square += own.product(&apart, &apart);
                    rows += Sums::rows_in(layout, own);
                }
                let between = HUBER * draft.sigma[j] - SCREEN * screen.sigma[j];
                rows == 0.0 || (between > 0.0 && square.max(0.0) <= rows * (NEAR * between).powi(2))
            })
        })
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
    let near = store.near(data, shared);
    let make = |i: usize, part: &Part| {
        let own;
        let kept = match store.part(i, near) {
            Some(kept) => kept,
            None => {
                own = Kept::of(stream, &data.sums.cells, &stream.rows_of(part, None)?, None);
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
