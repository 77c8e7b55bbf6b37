//! Errors on rows that no fit has seen, with block-bootstrap intervals.
//!
//! Neighbouring rows are not independent: intervals come from drawing whole blocks of time with replacement
//! (Künsch 1989, Annals of Statistics 17, 1217-1241).

use crate::gram::Fit;
use crate::scene::{Column, Scene};
use lacuna_estimation::stats;
use rand::{RngExt, SeedableRng};
use std::ops::Range;

/// Draws of the bootstrap.
const DRAWS: usize = 400;
/// Fewest blocks that are drawn from.
const LEAST_BLOCKS: usize = 8;

/// Rows of one scene in blocks of time, and the draws of them.
pub struct Blocks {
    blocks: Vec<Range<usize>>,
    /// Rows that count, per block and joint.
    count: Vec<Vec<f64>>,
    draws: Vec<Vec<usize>>,
    joints: usize,
}

/// Sums of squares of a residual, per block and joint.
pub struct Squares(Vec<Vec<f64>>);

impl Blocks {
    /// Blocks of a hundredth of the data, from eight periods of the band to 2 s, and no block across two stretches.
    pub fn new(scene: &Scene, seed: u64) -> Self {
        Self::of(scene, &scene.mask, seed)
    }

    /// Blocks of the rows in `mask`, per joint.
    pub fn of(scene: &Scene, mask: &[Vec<bool>], seed: u64) -> Self {
        let rate = scene.row_rate_hz();
        let seconds = (0.01 * scene.rows as f64 / rate).clamp((8.0 / scene.band_hz).min(2.0), 2.0);
        let most = (scene.rows / LEAST_BLOCKS).max(1);
        let length = ((seconds * rate).round() as usize).clamp(1, most);
        let mut blocks = Vec::new();
        for piece in &scene.pieces {
            let parts = ((piece.rows.len() as f64 / length as f64).round() as usize).max(1);
            let at = |k: usize| piece.rows.start + k * piece.rows.len() / parts;
            blocks.extend((0..parts).map(|k| at(k)..at(k + 1)));
        }
        let counted = |j: usize, b: &Range<usize>| {
            mask.get(j).and_then(|m| m.get(b.clone())).map_or(0, |m| m.iter().filter(|m| **m).count()) as f64
        };
        let all = |b: &Range<usize>| -> Vec<f64> { (0..scene.joints).map(|j| counted(j, b)).collect() };
        let (blocks, count): (Vec<_>, Vec<_>) =
            blocks.into_iter().map(|b| (b.clone(), all(&b))).filter(|(_, c)| c.iter().any(|c| *c > 0.0)).unzip();
        let mut random = rand_pcg::Pcg64Mcg::seed_from_u64(seed);
        let n = blocks.len();
        let mut draw = |_| (0..n).map(|_| random.random_range(0..n)).collect();
        let draws = if n == 0 { Vec::new() } else { (0..DRAWS).map(&mut draw).collect() };
        Self { blocks, count, draws, joints: scene.joints }
    }

    /// Sums of squares of `residual`, whose rows that do not count are 0.
    pub fn squares(&self, residual: &Column) -> Squares {
        let sum = |j: usize, b: &Range<usize>| {
            residual.part.get(j).and_then(|r| r.get(b.clone())).unwrap_or_default().iter().map(|v| v * v).sum()
        };
        Squares(self.blocks.iter().map(|b| (0..self.joints).map(|j| sum(j, b)).collect()).collect())
    }

    /// Root mean square over `joints`; `blocks` picks blocks, with repetition.
    fn rms_of(&self, s: &Squares, joints: &[usize], blocks: impl Iterator<Item = usize>) -> f64 {
        let (mut sum, mut count) = (0.0, 0.0f64);
        for b in blocks {
            for &j in joints {
                sum += s.0[b][j];
                count += self.count[b][j];
            }
        }
        (sum / count.max(1.0)).sqrt()
    }

    /// Root mean square over `joints`.
    pub fn rms(&self, s: &Squares, joints: &[usize]) -> f64 {
        self.rms_of(s, joints, 0..self.blocks.len())
    }

    /// Root mean square of every joint.
    pub fn rms_each(&self, s: &Squares) -> Vec<f64> {
        (0..self.joints).map(|j| self.rms(s, &[j])).collect()
    }

    /// 95 % interval of a figure made of root mean squares per joint of several residuals.
    pub fn interval(&self, squares: &[&Squares], figure: impl Fn(&[Vec<f64>]) -> f64) -> [f64; 2] {
        let one = |draw: &Vec<usize>| {
            let each = |s: &&Squares| -> Vec<f64> {
                (0..self.joints).map(|j| self.rms_of(s, &[j], draw.iter().copied())).collect()
            };
            figure(&squares.iter().map(each).collect::<Vec<_>>())
        };
        quantiles(self.draws.iter().map(one).collect())
    }

    /// 1 − after/before over `joints`, and its 95 % interval.
    pub fn reduction(&self, before: &Squares, after: &Squares, joints: &[usize]) -> (f64, [f64; 2]) {
        let share = |a: f64, b: f64| 1.0 - a / b.max(1e-30);
        let one = |d: &Vec<usize>| {
            share(self.rms_of(after, joints, d.iter().copied()), self.rms_of(before, joints, d.iter().copied()))
        };
        let draws = quantiles(self.draws.iter().map(one).collect());
        (share(self.rms(after, joints), self.rms(before, joints)), draws)
    }
}

fn quantiles(mut draws: Vec<f64>) -> [f64; 2] {
    [stats::quantile_in_place(&mut draws, 0.025), stats::quantile_in_place(&mut draws, 0.975)]
}

/// What a fit leaves on folds it has not seen: every fold with the coefficients fitted without it.
pub fn left_out(folds: &[Range<usize>], target: &Column, columns: &[&Column], fit: &Fit) -> Column {
    let mut out = target.clone();
    for (fold, beta) in folds.iter().zip(&fit.fold_beta) {
        for (column, b) in columns.iter().zip(beta) {
            for (x, y) in out.part.iter_mut().zip(&column.part) {
                if y.is_empty() {
                    continue;
                }
                if x.is_empty() {
                    *x = vec![0.0; y.len()];
                }
                let (Some(x), Some(y)) = (x.get_mut(fold.clone()), y.get(fold.clone())) else { continue };
                for (x, y) in x.iter_mut().zip(y) {
                    *x -= b * y;
                }
            }
        }
    }
    out
}
