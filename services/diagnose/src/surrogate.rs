//! How much evidence a residual gives to effects that have nothing to do with it.
//!
//! Thresholds from simulated robots say what chance gives where the residual is noise. What is left on a real robot is
//! neither white nor steady, and on whitened rows it speaks another language of nats. What chance gives there is
//! measured on the residual itself: moved in time within each recording it keeps its colour, its bursts and its slow
//! drift, and loses what ties it to the motion. What a candidate gains on it is chance; an effect has to gain more.
//!
//! Source: permutation tests with shifts of dependent series, e.g. Lancaster et al. 2018, Physics Reports 748, 1-60
//! (surrogate data for hypothesis testing).

use crate::families::Context;
use crate::model::{Atom, Model};
use crate::scene::{Column, Scene};
use crate::search::{Search, State, subtract};
use crate::whiten::Whitening;
use rand::{RngExt, SeedableRng};

/// Moved residuals that are tried.
const SURROGATES: usize = 8;
/// Share of a recording by which it is moved at least.
const LEAST_SHIFT: f64 = 0.15;
/// On top of the largest gain by chance.
const OVER: f64 = 1.3;
/// Least entry threshold [nats].
const LEAST_NATS: f64 = 20.0;
/// Seed of the shifts: the same recordings give the same thresholds.
const SEED: u64 = 0x5EED;

impl Search<'_> {
    /// Entry threshold of each family on the whitened rows of this residual [nats]; none of what cannot be told so.
    pub(crate) fn surrogate_entries(
        &self,
        whitening: &Whitening,
        ctx: &Context<'_>,
        (model, residual): (&Model, &Column),
        pool: &[Atom],
    ) -> Vec<Option<f64>> {
        let mut random = rand_pcg::Pcg64Mcg::seed_from_u64(SEED);
        let mut most: Vec<Option<f64>> = vec![None; self.families.len()];
        let mut limits = self.limits.clone();
        limits.entry.iter_mut().for_each(|e| *e = 0.0);
        for _ in 0..SURROGATES {
            let mut target = self.target.clone();
            subtract(&mut target, residual, 1.0);
            subtract(&mut target, &moved(self.scene, residual, &mut || random.random_range(0.0..1.0)), -1.0);
            let search = Search::new(self.scene, self.families, target, limits.clone()).whitened(whitening.clone());
            let mut model = model.clone();
            let Some(state) = search.fit(&mut model) else { continue };
            for ranked in search.round(ctx, &model, &state, pool) {
                let best = &mut most[ranked.atoms[0].family];
                *best = Some(best.map_or(ranked.merit, |b| b.max(ranked.merit)));
            }
        }
        most.into_iter().map(|m| m.map(|m| (OVER * m).max(LEAST_NATS))).collect()
    }

    /// Candidates that are columns and not simulated.
    pub(crate) fn plain_pool(&self, ctx: &Context<'_>) -> Vec<Atom> {
        self.build(ctx, self.candidates(ctx, |f| !f.driven))
    }

    /// This search with the entry thresholds that the whitened rows of its residual ask for.
    pub(crate) fn with_surrogate_entries(
        mut self,
        whitening: &Whitening,
        ctx: &Context<'_>,
        (model, state): (&Model, &State),
    ) -> Self {
        let residual = self.residual(model, state);
        let pool = self.plain_pool(ctx);
        let entries = self.surrogate_entries(whitening, ctx, (model, &residual), &pool);
        for (entry, own) in self.limits.entry.iter_mut().zip(entries) {
            *entry = own.unwrap_or(*entry);
        }
        self
    }
}

/// `residual` with the counting rows of each recording moved round by a random part of it, all joints alike.
fn moved(scene: &Scene, residual: &Column, unit: &mut dyn FnMut() -> f64) -> Column {
    let mut part = residual.part.clone();
    for piece in &scene.pieces {
        let share = LEAST_SHIFT + (1.0 - 2.0 * LEAST_SHIFT) * unit();
        for (rows, mask) in part.iter_mut().zip(&scene.mask).filter(|(rows, _)| !rows.is_empty()) {
            let counting: Vec<usize> = piece.rows.clone().filter(|r| mask[*r]).collect();
            let values: Vec<f64> = counting.iter().map(|r| rows[*r]).collect();
            let by = (share * values.len() as f64) as usize;
            for (k, row) in counting.iter().enumerate() {
                rows[*row] = values[(k + by) % values.len()];
            }
        }
    }
    Column::new(part)
}
