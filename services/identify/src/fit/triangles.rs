//! The same fit by QR, for columns that are too nearly dependent for normal equations.
//!
//! Normal equations square the condition number: beyond 1e5 they leave fewer than six digits. A further pass over the rows,
//! in double precision, keeps the triangular factor of every block of time instead, joint by joint (TSQR: Demmel et al.
//! 2012); memory grows with blocks and columns, not with rows.
//!
//! ```text
//! R_b = factor of √h \[X y\]/σ over block b,   R = factor of all R_b,   β = argmin ‖R_y − R_X β‖
//! (I − WᵀW) R_X (β₋b − β) = −Wᵀu,   W = R_bX R_X⁻¹,  u = R_by − R_bX β
//! ```
//!
//! The second line is the fit without block b in coordinates in which the whole is the identity: it loses no digits either.

use super::draft::{Data, Draft};
use super::normal::Choice;
use super::robust::HUBER;
use crate::layout::Layout;
use crate::stream::{Class, PartRows};
use lacuna_estimation::least_squares::{Statistics, Tsqr, least_squares};
use lacuna_interfaces::BadInput;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Factors of √h \[x y\] over a joint's active columns, by block of time and joint.
pub(crate) type Triangles = BTreeMap<(usize, usize), Tsqr>;

/// Factors of \[X y\] over all base columns, weighted: per block of time, and of the whole. Each (p + 1) × (p + 1).
#[derive(Debug, Clone)]
pub(crate) struct Factors {
    blocks: Vec<DMatrix<f64>>,
    total: DMatrix<f64>,
}

/// What a part adds: per draft its factors, and Σ (1 − h) and the rows beyond Huber's bound per joint.
type Share = Vec<(Triangles, Vec<(f64, usize)>)>;

/// A pass over all rows for the drafts that need it, weighted by their β and σ; `robust` bounds the influence of residuals.
///
/// # Errors
/// As [`crate::stream::Stream::rows_of`].
pub(super) fn pass(data: Data<'_>, drafts: &mut [Draft], robust: bool) -> Result<(), BadInput> {
    let n = data.stream.layout.len();
    let shared: &[Draft] = drafts;
    let mut all: Share = vec![(Triangles::new(), vec![(0.0, 0); n]); shared.len()];
    let make = |_: usize, part: &crate::stream::Part| {
        let rows = data.stream.rows_of(part, None)?;
        shared.iter().map(|d| share(data, d, &rows, robust)).collect::<Result<Share, BadInput>>()
    };
    data.stream.pass(make, |found| {
        for (to, from) in all.iter_mut().zip(found) {
            for (key, factor) in from.0 {
                match to.0.get_mut(&key) {
                    Some(own) => own.merge(&factor),
                    None => {
                        to.0.insert(key, factor);
                    }
                }
            }
            to.1.iter_mut().zip(from.1).for_each(|(a, b)| *a = (a.0 + b.0, a.1 + b.1));
        }
        Ok(())
    })?;
    for (draft, (triangles, weights)) in drafts.iter_mut().zip(all).filter(|(d, _)| d.choice.lossy) {
        draft.triangles = Some(triangles);
        for (j, (lost, beyond)) in weights.into_iter().enumerate() {
            draft.lost_weight[j] = lost;
            draft.outliers[j] = beyond as f64 / draft.count[j].max(1) as f64;
        }
    }
    Ok(())
}

fn share(
    data: Data<'_>,
    draft: &Draft,
    rows: &PartRows,
    robust: bool,
) -> Result<(Triangles, Vec<(f64, usize)>), BadInput> {
    let mut out = (Triangles::new(), vec![(0.0, 0); data.stream.layout.len()]);
    if !draft.choice.lossy {
        return Ok(out);
    }
    let of_part = data.sums.cells.of_part(&rows.part);
    for (j, (layout, joint)) in data.stream.layout.iter().zip(&rows.joints).enumerate() {
        let (m, w) = (layout.len(), layout.width());
        let chosen = draft.chosen_in(data, rows.part.recording, j);
        let y_of = chosen.y(layout);
        let beta: Vec<f64> = layout.active.iter().map(|&b| draft.beta[b]).collect();
        let bound = HUBER * draft.sigma[j];
        for (cell, range) in of_part.iter().filter(|(c, _)| draft.cells[*c]) {
            let (mut x, mut y, mut h) = (Vec::new(), Vec::new(), Vec::new());
            for k in range.clone().filter(|&k| joint.class[k] == Class::Fitted) {
                let z = &joint.z[k * m..(k + 1) * m];
                x.extend((0..w).map(|slot| z[layout.place(slot, chosen.bristle)]));
                let torque: f64 = y_of.iter().map(|&(i, f)| f * z[i]).sum();
                let model: f64 = x[x.len() - w..].iter().zip(&beta).map(|(a, b)| a * b).sum();
                let weight = if robust { (bound / (torque - model).abs()).min(1.0) } else { 1.0 };
                y.push(torque);
                h.push(weight);
                let (lost, beyond) = &mut out.1[j];
                *lost += 1.0 - weight;
                *beyond += usize::from(weight < 1.0);
            }
            if !y.is_empty() {
                let key = (data.sums.cells.list[*cell].block, j);
                out.0.entry(key).or_insert_with(|| Tsqr::new(w)).add_rows(&x, &y, Some(&h))?;
            }
        }
    }
    Ok(out)
}

/// Σ h e² of joint `j` with the parameters `beta`.
pub(super) fn residual_sum(triangles: &Triangles, layout: &Layout, j: usize, beta: &DVector<f64>) -> f64 {
    let w = layout.width();
    let c = DVector::from_fn(w + 1, |slot, _| layout.active.get(slot).map_or(1.0, |&b| -beta[b]));
    let own = triangles.iter().filter(|((_, joint), _)| *joint == j);
    own.map(|(_, t)| (t.factor() * &c).norm_squared()).sum()
}

impl Factors {
    /// Joins the joints' factors, each weighted by 1/σ².
    ///
    /// # Errors
    /// [`BadInput`] if a factor is not finite.
    pub(super) fn of(triangles: &Triangles, layout: &[Layout], sigma: &[f64], p: usize) -> Result<Self, BadInput> {
        let mut blocks: BTreeMap<usize, Tsqr> = BTreeMap::new();
        for (&(block, j), triangle) in triangles {
            let (r, own) = (triangle.factor(), &layout[j]);
            let w = own.width();
            let mut x = vec![0.0; (w + 1) * p];
            let mut y = Vec::with_capacity(w + 1);
            for i in 0..=w {
                own.active.iter().enumerate().for_each(|(slot, b)| x[i * p + b] = r[(i, slot)] / sigma[j]);
                y.push(r[(i, w)] / sigma[j]);
            }
            blocks.entry(block).or_insert_with(|| Tsqr::new(p)).add_rows(&x, &y, None)?;
        }
        let mut total = Tsqr::new(p);
        blocks.values().for_each(|b| total.merge(b));
        Ok(Self { blocks: blocks.into_values().map(|b| b.factor().clone()).collect(), total: total.factor().clone() })
    }

    /// Columns of the whole, without the torque's.
    pub(super) fn columns(&self, columns: &[usize]) -> DMatrix<f64> {
        self.total.select_columns(columns)
    }

    /// \[R_X r\] of the excited columns, what is fixed taken off the torque.
    fn reduced(r: &DMatrix<f64>, choice: &Choice) -> (DMatrix<f64>, DVector<f64>) {
        let p = r.ncols() - 1;
        let fixed = DVector::from_column_slice(&choice.fixed);
        (r.select_columns(&choice.excited), r.column(p) - r.columns(0, p) * fixed)
    }

    /// β of the excited columns, the others at their fixed value.
    pub(super) fn solve(&self, choice: &Choice) -> Result<DVector<f64>, BadInput> {
        let (a, b) = Self::reduced(&self.total, choice);
        let own = least_squares(&a, &b)?.beta;
        let mut beta = DVector::from_column_slice(&choice.fixed);
        choice.excited.iter().zip(own.iter()).for_each(|(&b, v)| beta[b] = *v);
        Ok(beta)
    }

    /// β without each block in turn; blocks without which it is not determined are left out.
    pub(super) fn leave_one_out(&self, choice: &Choice) -> Vec<DVector<f64>> {
        let (a, b) = Self::reduced(&self.total, choice);
        let Ok(fit) = least_squares(&a, &b) else { return Vec::new() };
        let root = a.qr().r();
        self.blocks
            .par_iter()
            .filter_map(|block| {
                let (own, y) = Self::reduced(block, choice);
                let u = y - &own * &fit.beta;
                // Wᵀ = R_X⁻ᵀ R_bXᵀ.
                let mut wt = own.transpose();
                root.tr_solve_upper_triangular_mut(&mut wt).then_some(())?;
                let e = wt.nrows();
                let rest = DMatrix::identity(e, e) - &wt * wt.transpose();
                let mut step = rest.cholesky()?.solve(&-(&wt * u));
                root.solve_upper_triangular_mut(&mut step).then_some(())?;
                let mut beta = DVector::from_column_slice(&choice.fixed);
                choice.excited.iter().enumerate().for_each(|(i, &b)| beta[b] = fit.beta[i] + step[i]);
                beta.iter().all(|v| v.is_finite()).then_some(beta)
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use lacuna_estimation::least_squares::Gram;
    use rand::{RngExt, SeedableRng};

    const BLOCKS: usize = 5;
    const ROWS: usize = 60;
    const P: usize = 6;

    /// Rows of two joints with two nearly equal columns each: (block, joint, weight, x over the base, y).
    type Row = (usize, usize, f64, [f64; P], f64);

    fn rows(layout: &[Layout]) -> Vec<Row> {
        let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(7);
        let mut out = Vec::new();
        for block in 0..BLOCKS {
            for (j, own) in layout.iter().enumerate() {
                for _ in 0..ROWS {
                    let mut u = || rng.random_range(-1.0..1.0);
                    let mut x = [0.0; P];
                    own.active.iter().for_each(|&b| x[b] = u());
                    if j == 0 {
                        x[1] = x[0] + 2e-6 * u();
                    } else {
                        x[5] = x[4] + 2e-6 * u();
                    }
                    let y = x.iter().zip([1.0, 2.0, -1.0, 0.5, 3.0, 1.5]).map(|(a, b)| a * b).sum::<f64>();
                    out.push((block, j, 0.5 + 0.5 * u().abs(), x, y + 1e-7 * u()));
                }
            }
        }
        out
    }

    /// Least squares of a dense matrix by singular values, refined until its residual is orthogonal, and the condition number.
    fn dense(x: &DMatrix<f64>, y: &DVector<f64>) -> (DVector<f64>, f64) {
        let svd = x.clone().svd(true, true);
        let mut beta = DVector::zeros(x.ncols());
        for _ in 0..5 {
            beta += svd.solve(&(y - x * &beta), 0.0).unwrap();
        }
        (beta, svd.singular_values.max() / svd.singular_values.min())
    }

    /// The same weighted problem, dense, by singular values: X and y of the rows that `keep` names.
    fn by_svd(rows: &[Row], sigma: &[f64], keep: impl Fn(&Row) -> bool) -> (DVector<f64>, f64) {
        let own: Vec<&Row> = rows.iter().filter(|r| keep(r)).collect();
        let root = |r: &Row| r.2.sqrt() / sigma[r.1];
        let x = DMatrix::from_fn(own.len(), P, |i, b| root(own[i]) * own[i].3[b]);
        let y = DVector::from_fn(own.len(), |i, _| root(own[i]) * own[i].4);
        dense(&x, &y)
    }

    #[test]
    fn a_condition_number_of_a_million_costs_no_digits_that_it_need_not() {
        let of = |active: Vec<usize>| Layout { active, coulomb: None, bristles: 0 };
        let (layout, sigma) = ([of(vec![0, 1, 2, 3]), of(vec![2, 3, 4, 5])], [0.7, 2.0]);
        let rows = rows(&layout);
        let (mut triangles, mut gram) = (Triangles::new(), Gram::new(P));
        for (block, j, h, x, y) in &rows {
            let own: Vec<f64> = layout[*j].active.iter().map(|&b| x[b]).collect();
            let to = triangles.entry((*block, *j)).or_insert_with(|| Tsqr::new(own.len()));
            to.add_rows(&own, &[*y], Some(&[*h])).unwrap();
            gram.add_rows(x, &[*y], Some(&[h / (sigma[*j] * sigma[*j])])).unwrap();
        }
        let factors = Factors::of(&triangles, &layout, &sigma, P).unwrap();
        let all = Choice { excited: (0..P).collect(), fixed: vec![0.0; P], ..Choice::default() };
        let (truth, condition) = by_svd(&rows, &sigma, |_| true);
        assert!(condition > 1e6, "{condition:e}");
        let off = |beta: &DVector<f64>, truth: &DVector<f64>| (beta - truth).amax() / truth.amax();
        let own = off(&factors.solve(&all).unwrap(), &truth);
        // Normal equations by Cholesky, without the guard that refuses them.
        let plain = gram.xtx().cholesky().map(|c| off(&c.solve(&gram.xty()), &truth)).unwrap_or(f64::INFINITY);
        eprintln!("condition {condition:.1e}: off by {own:.1e} by QR, {plain:.1e} by normal equations");
        assert!(gram.solve().is_err() && own < 1e-8 && plain > 1e3 * own);
        // Fixed columns, and every block left out in turn.
        let part =
            Choice { excited: vec![0, 1, 2, 3, 4], fixed: vec![0.0, 0.0, 0.0, 0.0, 0.0, 1.5], ..Choice::default() };
        let shifted: Vec<Row> = rows.iter().map(|r| (r.0, r.1, r.2, r.3, r.4 - 1.5 * r.3[5])).collect();
        let no_last: Vec<Row> =
            shifted.iter().map(|r| (r.0, r.1, r.2, [r.3[0], r.3[1], r.3[2], r.3[3], r.3[4], 0.0], r.4)).collect();
        let svd = |keep: &dyn Fn(&Row) -> bool| {
            let own: Vec<&Row> = no_last.iter().filter(|r| keep(r)).collect();
            let root = |r: &Row| r.2.sqrt() / sigma[r.1];
            let x = DMatrix::from_fn(own.len(), P - 1, |i, b| root(own[i]) * own[i].3[b]);
            let y = DVector::from_fn(own.len(), |i, _| root(own[i]) * own[i].4);
            dense(&x, &y).0.insert_row(P - 1, 1.5)
        };
        let whole = svd(&|_| true);
        let own = off(&factors.solve(&part).unwrap(), &whole);
        eprintln!("with a fixed column off by {own:.1e}");
        assert!(own < 1e-7, "{own:e}");
        let without = factors.leave_one_out(&part);
        assert_eq!(without.len(), BLOCKS);
        for (b, beta) in without.iter().enumerate() {
            let truth = svd(&|r: &Row| r.0 != b);
            // Held against how far the block moves the estimate.
            assert!((beta - &truth).amax() < 1e-4 * (&truth - &whole).amax() + 1e-7, "{b}: {beta} {truth}");
        }
        // Residuals of a joint, as the rows have them.
        let direct: f64 = rows
            .iter()
            .filter(|r| r.1 == 1)
            .map(|r| r.2 * (r.4 - r.3.iter().zip(whole.iter()).map(|(a, b)| a * b).sum::<f64>()).powi(2))
            .sum();
        let found = residual_sum(&triangles, &layout[1], 1, &whole);
        assert!((found / direct - 1.0).abs() < 1e-6, "{found:e} {direct:e}");
    }
}
