//! The proof: what the base, the model and a black box leave on rows that were not used to fit them; with test
//! stretches, not to choose them either.

use crate::context::context;
use crate::families::Context;
use crate::findings::{HeldOut, Reduction};
use crate::gram::Fit;
use crate::held::{Blocks, Squares, left_out};
use crate::model::Model;
use crate::report::Material;
use crate::rival;
use crate::scene::{Column, Scene};
use crate::search::{State, subtract};
use crate::transfer::{Fitted, Transferred};
use lacuna_estimation::stats;

/// Residuals on unseen rows.
pub struct Proof<'a> {
    /// Whose rows they are: the test stretches', or all in turn.
    pub scene: &'a Scene,
    /// Blocks of those rows.
    pub blocks: Blocks,
    /// What the base leaves.
    pub before: Column,
    /// What the model leaves.
    pub after: Column,
    /// What base and black box leave.
    pub rival: Column,
    /// Recorded torque.
    pub torque: Column,
    /// Standard deviation of the torque that was fitted to, per joint.
    spread: Vec<f64>,
    /// Seed of the bootstrap.
    pub seed: u64,
    /// The black box in words.
    pub rival_words: String,
    test: Option<Transferred<'a>>,
}

/// Base without terms and its fit.
#[derive(Clone, Copy)]
pub struct Bare<'a> {
    /// Its columns.
    pub model: &'a Model,
    /// Its fit.
    pub state: &'a State,
}

impl<'a> Proof<'a> {
    /// Works out the residuals of `m`; `bare` is the base alone (`None`: compared with a simulator as it is).
    pub fn new(m: &Material<'a>, ctx: &Context<'_>, bare: Option<Bare<'_>>) -> Self {
        let state = &m.selection.state;
        let fitted = Fitted { base: m.base, model: &m.selection.model, state };
        let rival_words = rival::words(m.search, ctx);
        let torque_of = |torque: &Column, known: Option<&Column>| {
            let mut out = torque.clone();
            if let Some(known) = known {
                subtract(&mut out, known, -1.0);
            }
            out
        };
        let spread = spread(m.scene, &torque_of(&m.base.torque, m.known));
        let Some(judged) = m.test else {
            let folds = &m.search.layout.folds;
            let after = left_out(folds, &state.target, &m.selection.model.columns(), &state.fit);
            let (before, rival) = match bare {
                Some(b) => {
                    let columns = b.model.columns();
                    let before = left_out(folds, &b.state.target, &columns, &b.state.fit);
                    (before, rival::in_turn(m.search, ctx, &b.state.target, &columns, &b.state.fit))
                }
                None => (m.base.target.clone(), rival::in_turn(m.search, ctx, &m.base.target, &[], &state.fit)),
            };
            let torque = torque_of(&m.base.torque, m.known);
            let blocks = Blocks::new(m.scene, m.seed);
            return Self {
                scene: m.scene,
                blocks,
                before,
                after,
                rival,
                torque,
                rival_words,
                spread,
                seed: m.seed,
                test: None,
            };
        };
        let test = Transferred::new(judged.scene, m.search.families, &m.search.limits, fitted);
        let after = test.residual(&test.model, &state.fit.beta);
        let (train_before, before) = match bare {
            Some(b) => {
                let empty = test.of(b.model, &[]);
                (m.search.residual(b.model, b.state), test.residual(&empty, &b.state.fit.beta))
            }
            None => (m.base.target.clone(), test.base.target.clone()),
        };
        let there = context(judged.scene, &test.base, &test.search, &test.model, Some(state));
        let rival = rival::on_test(
            &rival::Side { search: m.search, ctx, residual: &train_before },
            &rival::Side { search: &test.search, ctx: &there, residual: &before },
        );
        let torque = torque_of(&test.base.torque, judged.known);
        let blocks = Blocks::new(judged.scene, m.seed);
        Self {
            scene: judged.scene,
            blocks,
            before,
            after,
            rival,
            torque,
            rival_words,
            spread,
            seed: m.seed,
            test: Some(test),
        }
    }

    /// What the model without the terms `gone` leaves, the rest fitted anew.
    pub fn without(&self, m: &Material<'_>, gone: &[usize]) -> Option<(Column, Fit)> {
        let (model, state) = (&m.selection.model, &m.selection.state);
        let (rest, fit) = m.search.model_without(model, state, gone)?;
        let keep: Vec<usize> = (0..model.atoms.len()).filter(|i| !gone.contains(i)).collect();
        if let Some(test) = &self.test {
            let mut judged = model.clone();
            judged.clamped.clone_from(&rest.clamped);
            let rest = test.of(&judged, &keep);
            return Some((test.residual(&rest, &fit.beta), fit));
        }
        // The rest may hold other columns at their limits than the whole.
        let mut target = state.target.clone();
        model.clamped.iter().for_each(|(i, v)| subtract(&mut target, &model.base[*i].column, -v));
        rest.clamped.iter().for_each(|(i, v)| subtract(&mut target, &rest.base[*i].column, *v));
        for atom in gone.iter().filter_map(|i| model.atoms.get(*i)).filter(|a| a.fixed) {
            atom.columns.iter().for_each(|c| subtract(&mut target, c, -1.0));
        }
        Some((left_out(&m.search.layout.folds, &target, &rest.columns(), &fit), fit))
    }

    /// What another base, fitted beside the same terms, leaves; `state` is its fit.
    pub fn with_base(&self, m: &Material<'_>, model: &Model, state: &State) -> Column {
        match &self.test {
            None => left_out(&m.search.layout.folds, &state.target, &model.columns(), &state.fit),
            Some(test) => {
                let all: Vec<usize> = (0..model.atoms.len()).collect();
                test.residual(&test.of(model, &all), &state.fit.beta)
            }
        }
    }

    /// Norm of residuals (RMS per joint) over that of torques; each joint counts by the spread of the torque it was
    /// fitted to, as `identify` has it.
    pub fn relative(&self, residual: &[f64], torque: &[f64]) -> f64 {
        let count = |j: usize| self.scene.mask.get(j).map_or(0, |m| m.iter().filter(|m| **m).count()) as f64;
        let norm = |rms: &[f64]| -> f64 {
            rms.iter().zip(&self.spread).enumerate().map(|(j, (r, s))| count(j) * (r / s.max(1e-12)).powi(2)).sum()
        };
        (norm(residual) / norm(torque).max(1e-30)).sqrt()
    }

    /// Sums of squares of a residual.
    pub fn squares(&self, residual: &Column) -> Squares {
        self.blocks.squares(residual)
    }

    /// What a finding is worth at `joints`.
    pub fn reduction(&self, before: &Column, after: &Column, joints: &[usize]) -> Reduction {
        let (before, after) = (self.squares(before), self.squares(after));
        let (reduction, ci95) = self.blocks.reduction(&before, &after, joints);
        Reduction {
            before_rms_nm: self.blocks.rms(&before, joints),
            after_rms_nm: self.blocks.rms(&after, joints),
            reduction,
            ci95,
        }
    }
}

/// Standard deviation of a torque over the rows that count, per joint.
fn spread(scene: &Scene, torque: &Column) -> Vec<f64> {
    let of = |(part, mask): (&Vec<f64>, &Vec<bool>)| {
        let counted: Vec<f64> = part.iter().zip(mask).filter(|(_, m)| **m).map(|(v, _)| *v).collect();
        stats::standard_deviation(&counted)
    };
    torque.part.iter().zip(&scene.mask).map(of).collect()
}

/// Held-out errors with their intervals.
pub fn held_out(m: &Material<'_>, proof: &Proof<'_>) -> HeldOut {
    let (before, after) = (proof.squares(&proof.before), proof.squares(&proof.after));
    let (rival, torque) = (proof.squares(&proof.rival), proof.squares(&proof.torque));
    let blocks = &proof.blocks;
    let (before_rms, after_rms) = (blocks.rms_each(&before), blocks.rms_each(&after));
    let (rival_rms, size) = (blocks.rms_each(&rival), blocks.rms_each(&torque));
    let each =
        |s: &Squares| -> Vec<[f64; 2]> { (0..m.scene.joints).map(|j| blocks.interval(&[s], |r| r[0][j])).collect() };
    let relative = |residual: &[f64], size: &[f64]| proof.relative(residual, size);
    HeldOut {
        relative_before: relative(&before_rms, &size),
        relative_after: relative(&after_rms, &size),
        black_box_relative: relative(&rival_rms, &size),
        before_ci95_nm: each(&before),
        after_ci95_nm: each(&after),
        relative_after_ci95: blocks.interval(&[&after, &torque], |r| relative(&r[0], &r[1])),
        black_box_rms_nm: rival_rms,
        split: m.split.to_owned(),
        before_rms_nm: before_rms,
        after_rms_nm: after_rms,
    }
}
