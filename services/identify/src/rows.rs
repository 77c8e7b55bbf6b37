//! Filtered regressor rows of conditioned recordings.
//!
//! The working signals are taken in pieces of bounded length, overlapping by what the band filter forgets, so that
//! memory beyond the rows themselves does not grow with the recording, and pieces run in parallel.

use crate::base::Structure;
use crate::columns::{Evaluator, Sample, unreachable};
use crate::condition::{Conditioned, Plan, Stretch};
use lacuna_interfaces::BadInput;
use lacuna_physics::{Motion, RigidBody};
use rayon::prelude::*;

/// Working samples per piece.
const PIECE: usize = 8192;
/// Overlap of pieces in periods of the band. The slowest pole of a fourth-order Butterworth low-pass decays with
/// e^(−2.4 band t): to 1e-8 in 8 periods.
const OVERLAP: f64 = 8.0;

/// Rows of one joint.
#[derive(Debug, Clone, Default)]
pub struct JointRows {
    /// Regressor, row-major: one entry per active base column of the joint ([`Structure::active`]).
    pub x: Vec<f64>,
    /// Torque [Nm or the robot file's unit].
    pub y: Vec<f64>,
    /// Velocity [rad/s].
    pub qd: Vec<f64>,
    /// Drive on, moving or not.
    pub usable: Vec<bool>,
    /// Counts in an evaluation.
    pub counted: Vec<bool>,
    /// Used by the fit.
    pub fitted: Vec<bool>,
}

/// Rows of all joints at common instants.
#[derive(Debug, Clone, Default)]
pub struct Rows {
    /// Per joint.
    pub joints: Vec<JointRows>,
    /// Time of every row [s], in its recording's own time.
    pub time_s: Vec<f64>,
    /// Recording of every row.
    pub recording: Vec<usize>,
    /// Consecutive number of the gap-free stretch of every row.
    pub stretch: Vec<usize>,
    /// Block of every row: the unit of the covariance's resampling.
    pub block: Vec<usize>,
    /// Number of blocks.
    pub blocks: usize,
    /// Time between rows within a stretch [s], of the first stretch.
    pub period_s: f64,
}

impl JointRows {
    /// Column `slot` of `width` active ones.
    pub fn column(&self, slot: usize, width: usize) -> impl Iterator<Item = f64> + '_ {
        self.x.iter().skip(slot).step_by(width.max(1)).copied()
    }
}

impl Rows {
    /// Number of instants.
    pub fn len(&self) -> usize {
        self.time_s.len()
    }

    /// True without rows.
    pub fn is_empty(&self) -> bool {
        self.time_s.is_empty()
    }
}

/// Rows of all recordings. Blocks are `block_s` long.
///
/// # Errors
/// [`BadInput`] naming the recording and the time of a pose that the robot cannot take.
pub fn rows(
    body: &dyn RigidBody,
    structure: &Structure,
    recordings: &[Conditioned],
    plan: &Plan,
    block_s: f64,
) -> Result<Rows, BadInput> {
    let mut pieces = Vec::new();
    for (r, recording) in recordings.iter().enumerate() {
        for stretch in &recording.stretches {
            pieces.extend(cut(stretch, plan).into_iter().map(|p| (r, stretch, p)));
        }
    }
    let computed: Vec<Result<Vec<JointRows>, BadInput>> = pieces
        .par_iter()
        .map(|(r, stretch, piece)| {
            compute(body, structure, stretch, piece).map_err(|e| e.in_file(&recordings[*r].name))
        })
        .collect();
    let n = structure.active.len();
    let mut out = Rows { joints: vec![JointRows::default(); n], ..Rows::default() };
    let mut seen: Option<(*const Stretch, usize)> = None;
    for ((r, stretch, piece), part) in pieces.iter().zip(computed) {
        let fresh = seen.is_none_or(|(s, _)| !std::ptr::eq(s, *stretch));
        let index = seen.map_or(0, |(_, i)| i + usize::from(fresh));
        seen = Some((*stretch, index));
        if out.is_empty() {
            out.period_s = stretch.row_period_s();
        }
        append(&mut out, part?, *r, index, stretch, piece);
    }
    number_blocks(&mut out, block_s);
    Ok(out)
}

/// Filtered direction of sliding of `joint` at every row, by the bristle of index `width`.
///
/// # Errors
/// [`BadInput`] if a stretch is too short to filter, which [`rows`] would have said before.
pub fn bristle_column(recordings: &[Conditioned], joint: usize, width: usize) -> Result<Vec<f64>, BadInput> {
    let mut out = Vec::new();
    for stretch in recordings.iter().flat_map(|r| &r.stretches) {
        let Some(column) = stretch.bristles.get(joint).and_then(|b| b.get(width)) else { continue };
        let mut column = column.clone();
        stretch.band(&mut [&mut column])?;
        out.extend(stretch.rows().map(|k| column[k]));
    }
    Ok(out)
}

/// Working samples of a piece, and which of them become rows.
struct Piece {
    span: std::ops::Range<usize>,
    rows: Vec<usize>,
}

fn cut(stretch: &Stretch, plan: &Plan) -> Vec<Piece> {
    let overlap = (OVERLAP / (plan.band_hz * stretch.period_s)).ceil() as usize;
    let all: Vec<usize> = stretch.rows().collect();
    let per_piece = (PIECE / stretch.row_step.max(1)).max(1);
    all.chunks(per_piece)
        .map(|rows| {
            let (first, last) = (rows[0], rows[rows.len() - 1]);
            // The stretch's own ends are not cut: there the filter's padding is what the whole stretch would have.
            let start = if first < overlap + stretch.cut { 0 } else { first - overlap };
            let end = if last + overlap + stretch.cut >= stretch.len() { stretch.len() } else { last + overlap + 1 };
            Piece { span: start..end, rows: rows.to_vec() }
        })
        .collect()
}

fn compute(
    body: &dyn RigidBody,
    structure: &Structure,
    stretch: &Stretch,
    piece: &Piece,
) -> Result<Vec<JointRows>, BadInput> {
    let n = structure.active.len();
    let span = piece.span.clone();
    let len = span.len();
    let mut columns: Vec<Vec<Vec<f64>>> = structure.active.iter().map(|a| vec![vec![0.0; len]; a.len()]).collect();
    let mut evaluator = Evaluator::new(body, &structure.columns);
    let (mut q, mut qd, mut qdd, mut sign) = (vec![0.0; n], vec![0.0; n], vec![0.0; n], vec![0.0; n]);
    for (i, k) in span.clone().enumerate() {
        for j in 0..n {
            q[j] = stretch.q_rad[j][k];
            qd[j] = stretch.qd_rad_s[j][k];
            qdd[j] = stretch.qdd_rad_s2[j][k];
            sign[j] = stretch.sign[j][k];
        }
        let sample = Sample { motion: Motion { q_rad: &q, qd_rad_s: &qd, qdd_rad_s2: &qdd }, sign: &sign };
        evaluator.at(&sample).map_err(|e| unreachable(stretch.time_s(k), e))?;
        for (j, active) in structure.active.iter().enumerate() {
            for (slot, &b) in active.iter().enumerate() {
                columns[j][slot][i] = evaluator.entry(&sample, j, structure.base[b].column);
            }
        }
    }
    let mut torque: Vec<Vec<f64>> = stretch.tau_nm.iter().map(|c| c[span.clone()].to_vec()).collect();
    let mut all: Vec<&mut [f64]> =
        columns.iter_mut().flatten().chain(torque.iter_mut()).map(Vec::as_mut_slice).collect();
    stretch.band(&mut all)?;
    Ok((0..n).map(|j| pick(stretch, piece, j, &columns[j], &torque[j])).collect())
}

fn pick(stretch: &Stretch, piece: &Piece, j: usize, columns: &[Vec<f64>], torque: &[f64]) -> JointRows {
    let at = piece.span.start;
    let mut out = JointRows::default();
    out.x.reserve(piece.rows.len() * columns.len());
    for &k in &piece.rows {
        out.x.extend(columns.iter().map(|c| c[k - at]));
        out.y.push(torque[k - at]);
        out.qd.push(stretch.qd_rad_s[j][k]);
        out.usable.push(stretch.usable[k]);
        out.counted.push(stretch.counted[j][k]);
        out.fitted.push(stretch.fitted[j][k]);
    }
    out
}

fn append(out: &mut Rows, part: Vec<JointRows>, recording: usize, index: usize, stretch: &Stretch, piece: &Piece) {
    for (to, from) in out.joints.iter_mut().zip(part) {
        to.x.extend(from.x);
        to.y.extend(from.y);
        to.qd.extend(from.qd);
        to.usable.extend(from.usable);
        to.counted.extend(from.counted);
        to.fitted.extend(from.fitted);
    }
    for &k in &piece.rows {
        out.time_s.push(stretch.time_s(k));
        out.recording.push(recording);
        out.stretch.push(index);
    }
}

/// Cuts every stretch into equal blocks of about `block_s`.
fn number_blocks(rows: &mut Rows, block_s: f64) {
    let len = rows.len();
    rows.block = vec![0; len];
    let mut next = 0;
    let mut start = 0;
    while start < len {
        let end = (start..len).find(|&k| rows.stretch[k] != rows.stretch[start]).unwrap_or(len);
        let duration = rows.time_s[end - 1] - rows.time_s[start];
        let count = (duration / block_s).round().max(1.0) as usize;
        for k in start..end {
            rows.block[k] = next + (k - start) * count / (end - start);
        }
        next += count;
        start = end;
    }
    rows.blocks = next;
}
