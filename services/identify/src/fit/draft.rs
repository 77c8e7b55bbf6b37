//! One set of training cells on its way to a fit.

use super::normal::{Choice, Normal};
use super::support;
use super::triangles::{self, Factors, Triangles};
use crate::bristle;
use crate::delay::{self, Delay, DelayEstimate};
use crate::layout::{Chosen, Layout, torque_at};
use crate::split::Span;
use crate::stream::Stream;
use crate::sums::Sums;
use lacuna_estimation::least_squares::{Gram, Mixture, Moments};
use lacuna_interfaces::BadInput;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Recordings, their sums, and what holds for every fit on them.
#[derive(Clone, Copy)]
pub(crate) struct Data<'a> {
    pub(crate) stream: &'a Stream<'a>,
    pub(crate) sums: &'a Sums,
}

/// Choices, weights and estimates of one set of training cells.
pub(crate) struct Draft {
    /// Training cells and pieces.
    pub(crate) cells: Vec<bool>,
    pub(crate) pieces: Vec<bool>,
    /// Bristle of every joint.
    pub(crate) bristle: Vec<Option<usize>>,
    pub(crate) delay: Option<DelayEstimate>,
    /// Delay that the interpolation of the torque undoes [s].
    pub(crate) shift_s: f64,
    pub(crate) sigma: Vec<f64>,
    pub(crate) outliers: Vec<f64>,
    pub(crate) choice: Choice,
    pub(crate) condition_all: f64,
    pub(crate) beta: DVector<f64>,
    /// Root mean square of every base column, and the same in standard deviations of the torque.
    pub(crate) rms: Vec<f64>,
    pub(crate) size: Vec<f64>,
    /// Fitted rows per joint.
    pub(crate) count: Vec<usize>,
    /// What bounded influence takes off the cross products of a cell's joint: Σ (1 − h) \[x y\]ᵀ\[x y\].
    pub(crate) lost: BTreeMap<(usize, usize), Moments>,
    /// Σ (1 − h) per joint.
    pub(crate) lost_weight: Vec<f64>,
    /// Factors of the rows by QR, where normal equations lose digits.
    pub(crate) triangles: Option<Triangles>,
}

impl Draft {
    /// A first, plain fit of `train`, with bristles and delay chosen by these cells alone.
    ///
    /// # Errors
    /// [`BadInput`] if no row is left, or fewer than parameters.
    pub(crate) fn new(data: Data<'_>, train: &[Span], delay: Delay) -> Result<Self, BadInput> {
        let n = data.stream.layout.len();
        let cells = data.sums.cells.within(train);
        let pieces = data.sums.cells.pieces_within(&cells);
        let mut draft = Self {
            cells,
            pieces,
            bristle: vec![None; n],
            delay: None,
            shift_s: 0.0,
            sigma: vec![1.0; n],
            outliers: vec![0.0; n],
            choice: Choice::default(),
            condition_all: f64::INFINITY,
            beta: DVector::zeros(data.stream.structure.base.len()),
            rms: Vec::new(),
            size: Vec::new(),
            count: Vec::new(),
            lost: BTreeMap::new(),
            lost_weight: vec![0.0; n],
            triangles: None,
        };
        let totals = draft.totals(data);
        draft.measure(data, &totals)?;
        draft.plain(data, true)?;
        if data.stream.plan.bristle {
            let settled = support::settle(data, &draft, &draft.normal(data))?;
            draft.bristle = bristle::choose(data, &draft, &settled.beta);
            draft.plain(data, false)?;
        }
        if delay != Delay::Off {
            draft.delay = delay::estimate(data, &draft);
            let late = draft.delay.filter(|d| delay == Delay::Estimate && delay::worth_undoing(d, data, &draft));
            if let Some(late) = late {
                draft.shift_s = late.delay_s;
                draft.delay = Some(DelayEstimate { undone_s: late.delay_s, ..late });
                draft.plain(data, false)?;
            }
        }
        Ok(draft)
    }

    /// Sums over the training cells' fitted rows, per joint.
    fn totals(&self, data: Data<'_>) -> Vec<Moments> {
        let own = data.stream.layout.iter().enumerate();
        own.map(|(j, layout)| {
            let mut total = Moments::new(layout.len());
            self.own_cells().for_each(|c| total.merge(&data.sums.fitted[c][j]));
            total
        })
        .collect()
    }

    pub(crate) fn own_cells(&self) -> impl Iterator<Item = usize> + '_ {
        self.cells.iter().enumerate().filter(|(_, own)| **own).map(|(c, _)| c)
    }

    /// Sizes of columns and torques: what the first weights and the support of columns are measured by.
    fn measure(&mut self, data: Data<'_>, totals: &[Moments]) -> Result<(), BadInput> {
        let p = self.beta.len();
        (self.rms, self.size) = (vec![0.0; p], vec![0.0; p]);
        for (j, (layout, total)) in data.stream.layout.iter().zip(totals).enumerate() {
            let rows = Sums::rows_in(layout, total);
            let y = Chosen::plain().y(layout);
            let mean = total.product(&y, &[(layout.one(), 1.0)]) / rows.max(1.0);
            let spread = ((total.product(&y, &y) - rows * mean * mean) / (rows - 1.0).max(1.0)).max(0.0).sqrt();
            self.sigma[j] = if spread.is_finite() && spread > 0.0 { spread } else { 1.0 };
            self.count.push(rows as usize);
            for (slot, &b) in layout.active.iter().enumerate() {
                let own = (total.products()[(slot, slot)] / rows.max(1.0)).sqrt();
                self.rms[b] = self.rms[b].max(own);
                self.size[b] = self.size[b].max(own / self.sigma[j]);
            }
        }
        let rows = self.count.iter().sum::<usize>();
        if rows <= p {
            return Err(BadInput::new(format!(
                "found {rows} rows of moving joints in the training recordings; expected more than {p}, one per \
                 parameter (lower the moving speed, or record motion)"
            )));
        }
        Ok(())
    }

    /// Fits without bounds on influence; `first`: weights are the torque's size still, so twice.
    fn plain(&mut self, data: Data<'_>, first: bool) -> Result<(), BadInput> {
        for _ in 0..1 + usize::from(first) {
            let normal = self.normal(data);
            (self.choice, self.condition_all) = support::excited(data, self, &normal.total)?;
            self.beta = normal.solve(&self.choice)?;
            self.rescale(data);
        }
        Ok(())
    }

    /// Fits with the weights that were found last; `choose` anew which columns the data tell apart.
    pub(crate) fn refit(&mut self, data: Data<'_>, choose: bool) -> Result<(), BadInput> {
        let normal = self.normal(data);
        if choose {
            (self.choice, self.condition_all) = support::excited(data, self, &normal.total)?;
        }
        self.beta = normal.solve(&self.choice)?;
        self.rescale(data);
        Ok(())
    }

    /// Fits by QR, with every column that it tells apart.
    pub(crate) fn refit_by_qr(&mut self, data: Data<'_>) -> Result<(), BadInput> {
        let normal = self.factored(data)?;
        (self.choice, self.condition_all) = support::told_apart(data, self, &normal)?;
        self.beta = normal.solve(&self.choice)?;
        self.rescale(data);
        Ok(())
    }

    /// Weighted normal equations, and beside them the factors by QR where there are any.
    pub(crate) fn factored(&self, data: Data<'_>) -> Result<Normal, BadInput> {
        let factors = match &self.triangles {
            Some(own) => Some(Factors::of(own, &data.stream.layout, &self.sigma, self.beta.len())?),
            None => None,
        };
        Ok(Normal { factors, ..self.normal(data) })
    }

    /// σ of every joint from the weighted residuals of β.
    pub(crate) fn rescale(&mut self, data: Data<'_>) {
        for j in 0..self.sigma.len() {
            let weight = self.count[j] as f64 - self.lost_weight[j];
            let rms = (self.residual_sum(data, j, &self.beta) / weight.max(1.0)).sqrt();
            if rms > 0.0 && rms.is_finite() {
                self.sigma[j] = rms;
            }
        }
    }

    /// Σ h e² of a joint.
    fn residual_sum(&self, data: Data<'_>, j: usize, beta: &DVector<f64>) -> f64 {
        let layout = &data.stream.layout[j];
        if let Some(own) = &self.triangles {
            return triangles::residual_sum(own, layout, j, beta);
        }
        let lost: Vec<(usize, f64)> = self.lost_residual(layout, beta);
        self.own_cells()
            .map(|c| {
                let e = self.chosen(data, c, j).residual(layout, beta.as_slice());
                let lost = self.lost.get(&(c, j)).map_or(0.0, |m| m.product(&lost, &lost));
                data.sums.fitted[c][j].product(&e, &e) - lost
            })
            .sum::<f64>()
            .max(0.0)
    }

    fn lost_residual(&self, layout: &Layout, beta: &DVector<f64>) -> Vec<(usize, f64)> {
        let model = layout.active.iter().enumerate().map(|(slot, &b)| (slot, -beta[b]));
        model.chain([(layout.width(), 1.0)]).collect()
    }

    /// The choice of columns of joint `j` in a cell.
    pub(crate) fn chosen(&self, data: Data<'_>, cell: usize, j: usize) -> Chosen {
        self.chosen_in(data, data.sums.cells.list[cell].recording, j)
    }

    /// The same in a recording.
    pub(crate) fn chosen_in(&self, data: Data<'_>, recording: usize, j: usize) -> Chosen {
        chosen(data.stream, recording, self.bristle[j], self.shift_s)
    }

    /// Weighted normal equations of the training cells.
    pub(crate) fn normal(&self, data: Data<'_>) -> Normal {
        let p = self.beta.len();
        let own: Vec<usize> = self.own_cells().collect();
        let parts: Vec<(usize, Gram)> =
            own.into_par_iter().map(|c| (data.sums.cells.list[c].block, self.cell(data, c, p))).collect();
        let mut blocks: BTreeMap<usize, Gram> = BTreeMap::new();
        for (block, gram) in parts {
            use lacuna_estimation::least_squares::Statistics;
            if gram.rows() > 0 {
                blocks.entry(block).or_insert_with(|| Gram::new(p)).merge(&gram);
            }
        }
        Normal::of(blocks.into_values().collect(), p)
    }

    pub(super) fn cell(&self, data: Data<'_>, cell: usize, p: usize) -> Gram {
        let mut products = DMatrix::zeros(p + 1, p + 1);
        let mut rows = 0.0;
        for (j, layout) in data.stream.layout.iter().enumerate() {
            let weight = 1.0 / (self.sigma[j] * self.sigma[j]);
            let sum = &data.sums.fitted[cell][j];
            rows += Sums::rows_in(layout, sum);
            sum.mix_into(&mut products, &self.chosen(data, cell, j).pooled(layout, p), weight);
            if let Some(lost) = self.lost.get(&(cell, j)) {
                lost.mix_into(&mut products, &lost_mixture(layout, p), -weight);
            }
        }
        Gram::from_products(products, rows as u64)
    }

    /// Plain normal equations over every usable row, standing joints included.
    pub(crate) fn at_rest(&self, data: Data<'_>) -> Normal {
        let p = self.beta.len();
        let mut products = DMatrix::zeros(p + 1, p + 1);
        let mut rows = 0.0;
        let recordings = data.sums.cells.recording_of_piece();
        for (j, layout) in data.stream.layout.iter().enumerate() {
            let weight = 1.0 / (self.sigma[j] * self.sigma[j]);
            let mut add = |sum: &Moments, recording: usize| {
                rows += Sums::rows_in(layout, sum);
                sum.mix_into(&mut products, &self.chosen_in(data, recording, j).pooled(layout, p), weight);
            };
            self.own_cells().for_each(|c| add(&data.sums.fitted[c][j], data.sums.cells.list[c].recording));
            for piece in (0..self.pieces.len()).filter(|&i| self.pieces[i]) {
                add(&data.sums.counted[2 * piece][j], recordings[piece]);
                add(&data.sums.counted[2 * piece + 1][j], recordings[piece]);
                add(&data.sums.standing[piece][j], recordings[piece]);
            }
        }
        Normal::of(vec![Gram::from_products(products, rows as u64)], p)
    }
}

/// Columns of a joint in a recording.
pub(crate) fn chosen(stream: &Stream<'_>, recording: usize, bristle: Option<usize>, shift_s: f64) -> Chosen {
    Chosen { bristle, torque: torque_at(shift_s / stream.prepared[recording].working_period_s(), 0) }
}

/// Rows of [`Draft::lost`] over the base columns.
fn lost_mixture(layout: &Layout, p: usize) -> Vec<Mixture> {
    let x = layout.active.iter().enumerate().map(|(slot, &b)| (slot, b, 1.0));
    x.chain([(layout.width(), p, 1.0)]).collect()
}
