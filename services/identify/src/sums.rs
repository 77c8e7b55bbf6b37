//! One pass over the recordings into sums of bounded size, from which every fit and every held-out error follows.
//!
//! Time is cut into blocks (the unit of the intervals) and at the ends of every fold's spans; what lies between two cuts
//! is a cell, which belongs to the training or the test of a fold as a whole. A cell keeps the cross products of
//! everything that is known of its rows ([`crate::layout`]).

use crate::layout::Layout;
use crate::split::Span;
use crate::stream::{Class, Part, PartRows, Stream};
use lacuna_estimation::least_squares::Moments;
use lacuna_interfaces::BadInput;
use std::collections::BTreeMap;
use std::ops::Range;

/// Rows between two cuts.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Cell {
    pub(crate) recording: usize,
    /// Rows of their stretch.
    pub(crate) rows: Range<usize>,
    /// Cells of one recording between the same ends of spans.
    pub(crate) piece: usize,
    pub(crate) block: usize,
    /// Time of the first row [s].
    from_s: f64,
}

/// All cells.
#[derive(Debug, Clone, Default)]
pub(crate) struct Cells {
    pub(crate) list: Vec<Cell>,
    /// Cells of a stretch: `[recording][stretch]`.
    of: Vec<Vec<Range<usize>>>,
    pub(crate) pieces: usize,
    pub(crate) blocks: usize,
}

impl Cells {
    /// Cuts at the ends of `spans` and into blocks of about `block_s`.
    pub(crate) fn new(stream: &Stream<'_>, spans: &[Span], block_s: f64) -> Self {
        let mut out = Self::default();
        for (recording, own) in stream.prepared.iter().enumerate() {
            let mut ends: Vec<(f64, bool)> = spans
                .iter()
                .filter(|s| s.recording == recording)
                .flat_map(|s| [(s.from_s, false), (s.to_s, true)])
                .collect();
            ends.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            ends.dedup();
            // Pieces are numbered over the recording, so that gaps do not multiply them.
            let first_piece = out.pieces;
            out.pieces += ends.len() + 1;
            let mut of = Vec::new();
            for (stretch, s) in own.stretches.iter().enumerate() {
                let time = |row: usize| stream.time_s(recording, stretch, row);
                // The first row behind an end: a span holds both its ends.
                let cut = |&(t, behind): &(f64, bool)| {
                    first_row(s.rows, |row| if behind { time(row) > t } else { time(row) >= t })
                };
                let cuts: Vec<usize> = ends.iter().map(cut).collect();
                let seconds = s.rows as f64 * own.row_period_s();
                let count = ((seconds / block_s).round() as usize).clamp(1, s.rows.max(1));
                let mut starts: Vec<usize> =
                    (0..count).map(|b| (b * s.rows).div_ceil(count)).chain(cuts.clone()).collect();
                starts.retain(|r| *r < s.rows);
                starts.sort_unstable();
                starts.dedup();
                let begin = out.list.len();
                for (i, &start) in starts.iter().enumerate() {
                    let end = starts.get(i + 1).copied().unwrap_or(s.rows);
                    let piece = first_piece + cuts.iter().filter(|c| **c <= start).count();
                    let block = out.blocks + start * count / s.rows.max(1);
                    out.list.push(Cell { recording, rows: start..end, piece, block, from_s: time(start) });
                }
                of.push(begin..out.list.len());
                out.blocks += count;
            }
            out.of.push(of);
        }
        out
    }

    /// Which cells lie in `spans`, whose ends are among the cuts.
    pub(crate) fn within(&self, spans: &[Span]) -> Vec<bool> {
        self.list.iter().map(|c| spans.iter().any(|s| s.holds(c.recording, c.from_s))).collect()
    }

    /// Which pieces do.
    pub(crate) fn pieces_within(&self, cells: &[bool]) -> Vec<bool> {
        let mut out = vec![false; self.pieces];
        self.list.iter().zip(cells).for_each(|(c, inside)| out[c.piece] |= inside);
        out
    }

    /// Recording of every piece; pieces without rows belong to the first.
    pub(crate) fn recording_of_piece(&self) -> Vec<usize> {
        let mut out = vec![0; self.pieces];
        self.list.iter().for_each(|c| out[c.piece] = c.recording);
        out
    }

    /// Cells of a part, each with its rows counted from the part's first.
    pub(crate) fn of_part(&self, part: &Part) -> Vec<(usize, Range<usize>)> {
        let (first, end) = (part.rows.start, part.rows.end);
        let within = self.of[part.recording][part.stretch].clone();
        let cells = within.filter(|&c| self.list[c].rows.start < end && self.list[c].rows.end > first);
        cells.map(|c| (c, self.list[c].rows.start.max(first) - first..self.list[c].rows.end.min(end) - first)).collect()
    }
}

/// First of `rows` rows for which `behind` holds; it holds for all later ones.
fn first_row(rows: usize, behind: impl Fn(usize) -> bool) -> usize {
    let (mut low, mut high) = (0, rows);
    while low < high {
        let middle = usize::midpoint(low, high);
        if behind(middle) {
            high = middle;
        } else {
            low = middle + 1;
        }
    }
    low
}

/// What is worth knowing of a joint's rows beside their cross products.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Survey {
    pub(crate) rows: usize,
    pub(crate) usable: usize,
    pub(crate) counted: usize,
    pub(crate) fitted: usize,
    /// Counted rows with positive velocity.
    pub(crate) forward: usize,
    /// Largest speed [rad/s].
    pub(crate) fastest: f64,
    /// Largest torque [Nm or the robot file's unit].
    pub(crate) peak: f64,
}

/// A row that is kept for the report, with all joints.
#[derive(Debug, Clone)]
pub(crate) struct Shown {
    pub(crate) cell: usize,
    pub(crate) recording: usize,
    /// Number of the stretch over all recordings.
    pub(crate) time_s: f64,
    /// Per joint: row, class, velocity. Single precision is more than a picture shows.
    pub(crate) joints: Vec<(Vec<f32>, Class, f32)>,
}

/// Most rows that are kept for the report.
pub(crate) const MOST_SHOWN: usize = 16_000;

/// The sums of all recordings.
pub(crate) struct Sums {
    pub(crate) cells: Cells,
    /// Rows of the fit: `[cell][joint]`.
    pub(crate) fitted: Vec<Vec<Moments>>,
    /// Rows that count but are not fitted: `[2 piece + parity of the block][joint]`.
    pub(crate) counted: Vec<Vec<Moments>>,
    /// Rows of a standing joint: `[piece][joint]`.
    pub(crate) standing: Vec<Vec<Moments>>,
    /// Per joint.
    pub(crate) survey: Vec<Survey>,
    pub(crate) shown: Vec<Shown>,
}

/// Where a sum belongs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Place {
    Fitted(usize),
    Counted(usize),
    Standing(usize),
}

/// What one part adds.
struct Share {
    sums: BTreeMap<(Place, usize), Moments>,
    survey: Vec<Survey>,
    shown: Vec<Shown>,
}

impl Sums {
    /// Nothing added yet.
    pub(crate) fn new(stream: &Stream<'_>, cells: Cells) -> Self {
        let empty = |count: usize| -> Vec<Vec<Moments>> {
            vec![stream.layout.iter().map(|l| Moments::new(l.len())).collect(); count]
        };
        Self {
            fitted: empty(cells.list.len()),
            counted: empty(2 * cells.pieces),
            standing: empty(cells.pieces),
            survey: vec![Survey::default(); stream.layout.len()],
            shown: Vec::new(),
            cells,
        }
    }

    /// Adds up the rows of some parts of `stream`; `keep` is given the rows of every part, `kept` what it makes of them, in
    /// order.
    ///
    /// # Errors
    /// As [`Stream::rows_of`].
    pub(crate) fn add<K: Send>(
        &mut self,
        stream: &Stream<'_>,
        parts: Range<usize>,
        keep: impl Fn(&Cells, &PartRows) -> K + Sync,
        mut kept: impl FnMut(K),
    ) -> Result<(), BadInput> {
        let Self { cells, fitted, counted, standing, survey, shown } = self;
        let cells: &Cells = cells;
        let step = stream.rows().div_ceil(MOST_SHOWN).max(1);
        let make = |_: usize, part: &Part| {
            let rows = stream.rows_of(part, None)?;
            Ok((share(stream, cells, &rows, step)?, keep(cells, &rows)))
        };
        stream.pass_over(parts, make, |(share, k)| {
            for ((place, j), sum) in &share.sums {
                match place {
                    Place::Fitted(c) => fitted[*c][*j].merge(sum),
                    Place::Counted(p) => counted[*p][*j].merge(sum),
                    Place::Standing(p) => standing[*p][*j].merge(sum),
                }
            }
            survey.iter_mut().zip(share.survey).for_each(|(to, from)| to.add(from));
            shown.extend(share.shown);
            kept(k);
            Ok(())
        })
    }

    /// Rows counted in a sum.
    pub(crate) fn rows_in(layout: &Layout, sum: &Moments) -> f64 {
        sum.products()[(layout.one(), layout.one())]
    }
}

impl Survey {
    fn add(&mut self, other: Self) {
        self.rows += other.rows;
        self.usable += other.usable;
        self.counted += other.counted;
        self.fitted += other.fitted;
        self.forward += other.forward;
        self.fastest = self.fastest.max(other.fastest);
        self.peak = self.peak.max(other.peak);
    }
}

fn share(stream: &Stream<'_>, cells: &Cells, rows: &PartRows, step: usize) -> Result<Share, BadInput> {
    let mut out = Share { sums: BTreeMap::new(), survey: Vec::new(), shown: Vec::new() };
    let of_part = cells.of_part(&rows.part);
    for (j, (layout, joint)) in stream.layout.iter().zip(&rows.joints).enumerate() {
        let m = layout.len();
        let mut picked: Vec<f64> = Vec::new();
        for (cell, range) in &of_part {
            let Cell { piece, block, .. } = cells.list[*cell];
            for (class, place) in [
                (Class::Fitted, Place::Fitted(*cell)),
                (Class::Counted, Place::Counted(2 * piece + block % 2)),
                (Class::Standing, Place::Standing(piece)),
            ] {
                picked.clear();
                for k in range.clone().filter(|&k| joint.class[k] == class) {
                    picked.extend_from_slice(&joint.z[k * m..(k + 1) * m]);
                }
                if !picked.is_empty() {
                    out.sums.entry((place, j)).or_insert_with(|| Moments::new(m)).add_rows(&picked)?;
                }
            }
        }
        let mut survey = Survey { rows: joint.class.len(), ..Survey::default() };
        for (k, class) in joint.class.iter().enumerate() {
            survey.usable += usize::from(*class >= Class::Standing);
            survey.counted += usize::from(*class >= Class::Counted);
            survey.fitted += usize::from(*class == Class::Fitted);
            survey.forward += usize::from(*class >= Class::Counted && joint.qd[k] > 0.0);
            survey.fastest = survey.fastest.max(joint.qd[k].abs());
            survey.peak = survey.peak.max(joint.z[k * m + layout.torque() + crate::layout::REACH].abs());
        }
        out.survey.push(survey);
    }
    for (cell, range) in of_part {
        for k in range.filter(|k| (rows.part.rows.start + k).is_multiple_of(step)) {
            let Part { recording, stretch, .. } = rows.part;
            let joints = stream.layout.iter().zip(&rows.joints);
            let joints = joints.map(|(layout, joint)| {
                let row = joint.z[k * layout.len()..(k + 1) * layout.len()].iter().map(|v| *v as f32).collect();
                (row, joint.class[k], joint.qd[k] as f32)
            });
            let time_s = stream.time_s(recording, stretch, rows.part.rows.start + k);
            out.shown.push(Shown { cell, recording, time_s, joints: joints.collect() });
        }
    }
    Ok(out)
}
