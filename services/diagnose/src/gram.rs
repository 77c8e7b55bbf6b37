//! Least squares on products: every fold left out costs one small solve.
//!
//! Products of columns are kept per block (fold and joint). With weights w_j per joint and a prior precision
//! per column, β = (Σ w G + P)⁻¹ Σ w g; leaving a fold out subtracts its blocks. Where the residual is coloured the
//! products that are solved are those of whitened columns; the plain ones tell what is left in the torque's own unit.

use crate::scene::Column;
use crate::whiten::Whitening;
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use std::ops::Range;

/// How rows are grouped.
#[derive(Debug, Clone)]
pub struct Layout {
    /// Rows of each fold.
    pub folds: Vec<Range<usize>>,
    /// Number of joints.
    pub joints: usize,
    /// Rows that count, per fold and joint.
    pub count: Vec<Vec<f64>>,
    /// Filter that makes the residual white; none: rows are taken as they are.
    pub whitening: Option<Whitening>,
}

impl Layout {
    /// Number of blocks.
    pub fn blocks(&self) -> usize {
        self.folds.len() * self.joints
    }

    /// Rows that count, per joint.
    pub fn joint_count(&self, j: usize) -> f64 {
        self.count.iter().map(|c| c[j]).sum()
    }

    /// Products of two columns, per block.
    pub fn dots(&self, a: &Column, b: &Column) -> Vec<f64> {
        self.products(&a.part, &b.part)
    }

    fn products(&self, a: &[Vec<f64>], b: &[Vec<f64>]) -> Vec<f64> {
        let mut out = vec![0.0; self.blocks()];
        for j in 0..self.joints {
            let (x, y) = (&a[j], &b[j]);
            if x.is_empty() || y.is_empty() {
                continue;
            }
            for (f, range) in self.folds.iter().enumerate() {
                out[f * self.joints + j] = dot(&x[range.clone()], &y[range.clone()]);
            }
        }
        out
    }
}

/// Sum of products, four at a time.
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut s = [0.0; 4];
    let (ca, cb) = (a.chunks_exact(4), b.chunks_exact(4));
    let rest: f64 = ca.remainder().iter().zip(cb.remainder()).map(|(x, y)| x * y).sum();
    for (x, y) in ca.zip(cb) {
        for l in 0..4 {
            s[l] += x[l] * y[l];
        }
    }
    s[0] + s[1] + s[2] + s[3] + rest
}

/// Products of the target (index 0) and columns (from 1), per block.
#[derive(Debug, Clone)]
pub struct Gram {
    size: usize,
    /// Of the columns as they are.
    blocks: Vec<DMatrix<f64>>,
    /// Of the whitened ones; empty if nothing is whitened.
    white: Vec<DMatrix<f64>>,
}

/// A fit and what it leaves on rows it was not fitted to.
#[derive(Debug, Clone)]
pub struct Fit {
    /// Coefficients from all folds.
    pub beta: Vec<f64>,
    /// Coefficients with each fold left out.
    pub fold_beta: Vec<Vec<f64>>,
    /// Sum of squares on the folds left out, per fold and joint.
    pub held_out: Vec<Vec<f64>>,
    /// The same of the whitened residual: what evidence is counted from.
    pub held_out_white: Vec<Vec<f64>>,
    /// Sum of squares of the fit to all, per joint.
    pub inside: Vec<f64>,
    /// Log of what the prior costs at the fit [nats].
    pub prior_nats: f64,
    /// Diagonal of the inverse of the normal matrix: variances if the weights are 1/σ² of independent rows.
    pub variance: Vec<f64>,
}

impl Fit {
    /// Sum of squares on the folds left out, per joint.
    pub fn held_out_joint(&self, j: usize) -> f64 {
        self.held_out.iter().map(|f| f[j]).sum()
    }

    /// The same of the whitened residual.
    pub fn held_out_white_joint(&self, j: usize) -> f64 {
        self.held_out_white.iter().map(|f| f[j]).sum()
    }
}

impl Gram {
    /// Products of `target` and `columns`.
    pub fn new(layout: &Layout, target: &Column, columns: &[&Column]) -> Self {
        let none = vec![DMatrix::zeros(0, 0); layout.blocks()];
        let white = if layout.whitening.is_some() { none.clone() } else { Vec::new() };
        let empty = Self { size: 0, blocks: none, white };
        let mut all = vec![target];
        all.extend_from_slice(columns);
        empty.extended(layout, &[], &all)
    }

    /// With further columns; `have` are the ones in it, the target first.
    #[must_use]
    pub fn extended(&self, layout: &Layout, have: &[&Column], more: &[&Column]) -> Self {
        let size = self.size + more.len();
        let mut out = Self {
            size,
            blocks: self.blocks.iter().map(|b| grown(b, size)).collect(),
            white: self.white.iter().map(|b| grown(b, size)).collect(),
        };
        for (i, c) in more.iter().enumerate() {
            let col = self.size + i;
            for (k, other) in have.iter().chain(&more[..=i]).enumerate() {
                put(&mut out.blocks, (col, k), layout.dots(c, other));
                if let Some(w) = &layout.whitening {
                    put(&mut out.white, (col, k), layout.products(c.white(w), other.white(w)));
                }
            }
        }
        out
    }

    /// The products that are solved.
    fn solved(&self) -> &[DMatrix<f64>] {
        if self.white.is_empty() { &self.blocks } else { &self.white }
    }

    /// Only the columns `keep` (indices from 0, target not counted).
    #[must_use]
    pub fn subset(&self, keep: &[usize]) -> Self {
        let index: Vec<usize> = std::iter::once(0).chain(keep.iter().map(|k| k + 1)).collect();
        let of = |all: &[DMatrix<f64>]| all.iter().map(|b| b.select_rows(&index).select_columns(&index)).collect();
        Self { size: index.len(), blocks: of(&self.blocks), white: of(&self.white) }
    }

    /// With columns (from 0, target not counted) taken off the target at these factors.
    #[must_use]
    pub fn held(&self, slots: &[(usize, f64)]) -> Self {
        if slots.is_empty() {
            return self.clone();
        }
        let mut out = self.clone();
        for m in out.blocks.iter_mut().chain(&mut out.white) {
            for (slot, factor) in slots {
                for k in 0..self.size {
                    let v = m[(slot + 1, k)];
                    m[(0, k)] -= factor * v;
                }
                for k in 0..self.size {
                    let v = m[(k, slot + 1)];
                    m[(k, 0)] -= factor * v;
                }
            }
        }
        let keep: Vec<usize> = (0..self.size - 1).filter(|k| !slots.iter().any(|(s, _)| s == k)).collect();
        out.subset(&keep)
    }

    /// Coefficients from all folds.
    pub fn coefficients(&self, layout: &Layout, weights: &[f64], precision: &[f64]) -> Option<Vec<f64>> {
        let mut total = DMatrix::<f64>::zeros(self.size, self.size);
        for (i, block) in self.solved().iter().enumerate() {
            total += block * weights[i % layout.joints];
        }
        solve(&total, precision).map(|(beta, _, _)| beta.as_slice().to_vec())
    }

    /// Fits with `weights` per joint and `precision` per column, with every fold left out in turn.
    pub fn fit(&self, layout: &Layout, weights: &[f64], precision: &[f64]) -> Option<Fit> {
        let p = self.size - 1;
        let mut total = DMatrix::<f64>::zeros(self.size, self.size);
        let mut per_fold = Vec::with_capacity(layout.folds.len());
        for f in 0..layout.folds.len() {
            let mut m = DMatrix::<f64>::zeros(self.size, self.size);
            for j in 0..layout.joints {
                m += &self.solved()[f * layout.joints + j] * weights[j];
            }
            total += &m;
            per_fold.push(m);
        }
        let (beta, factor, scale) = solve(&total, precision)?;
        let inside = (0..layout.joints)
            .map(|j| (0..layout.folds.len()).map(|f| rest(&self.blocks[f * layout.joints + j], &beta)).sum())
            .collect();
        let mut held_out = Vec::with_capacity(per_fold.len());
        let mut held_out_white = Vec::with_capacity(per_fold.len());
        let mut fold_beta = Vec::with_capacity(per_fold.len());
        for (f, own) in per_fold.iter().enumerate() {
            let (b, _, _) = solve(&(&total - own), precision)?;
            let left = |blocks: &[DMatrix<f64>]| -> Vec<f64> {
                (0..layout.joints).map(|j| rest(&blocks[f * layout.joints + j], &b)).collect()
            };
            held_out.push(left(&self.blocks));
            held_out_white.push(left(self.solved()));
            fold_beta.push(b.as_slice().to_vec());
        }
        let inverse = factor.inverse();
        let variance = (0..p).map(|i| inverse[(i, i)] * scale[i] * scale[i]).collect();
        let prior_nats = beta.iter().zip(precision).map(|(b, w)| 0.5 * b * b * w).sum();
        Some(Fit { beta: beta.as_slice().to_vec(), fold_beta, held_out, held_out_white, inside, prior_nats, variance })
    }
}

/// A matrix with room for more rows and columns.
fn grown(block: &DMatrix<f64>, size: usize) -> DMatrix<f64> {
    let mut out = DMatrix::zeros(size, size);
    out.view_mut((0, 0), block.shape()).copy_from(block);
    out
}

/// Writes a product of every block, on both sides of the diagonal.
fn put(blocks: &mut [DMatrix<f64>], (row, column): (usize, usize), values: Vec<f64>) {
    for (m, v) in blocks.iter_mut().zip(values) {
        m[(row, column)] = v;
        m[(column, row)] = v;
    }
}

/// Residual sum of squares of `beta` in one block.
fn rest(block: &DMatrix<f64>, beta: &DVector<f64>) -> f64 {
    let p = beta.len();
    let g = block.view((1, 0), (p, 1));
    let a = block.view((1, 1), (p, p));
    let quad = (a * beta).dot(beta);
    (block[(0, 0)] - 2.0 * g.dot(beta) + quad).max(0.0)
}

type Solved = (DVector<f64>, Cholesky<f64, Dyn>, Vec<f64>);

/// Solves the normal equations in columns scaled to one.
fn solve(m: &DMatrix<f64>, precision: &[f64]) -> Option<Solved> {
    let p = m.nrows() - 1;
    let scale: Vec<f64> = (0..p)
        .map(|i| {
            let d = m[(i + 1, i + 1)] + precision[i];
            if d > 0.0 { 1.0 / d.sqrt() } else { 0.0 }
        })
        .collect();
    let a = DMatrix::from_fn(p, p, |i, k| {
        let prior = if i == k { precision[i] } else { 0.0 };
        let v = (m[(i + 1, k + 1)] + prior) * scale[i] * scale[k];
        // The ridge keeps columns that are nearly alike solvable; it costs 1e-9 of their size.
        if i == k { v.max(1e-12) + 1e-9 } else { v }
    });
    let g = DVector::from_fn(p, |i, _| m[(i + 1, 0)] * scale[i]);
    let factor = Cholesky::new(a)?;
    let b = factor.solve(&g);
    Some((DVector::from_fn(p, |i, _| b[i] * scale[i]), factor, scale))
}
