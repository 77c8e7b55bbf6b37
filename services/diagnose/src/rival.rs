//! The black box that named models are held against: on top of the base, with the same folds and inputs.

use crate::boost::{Binned, Settings, fit_predict};
use crate::families::Context;
use crate::gram::Fit;
use crate::scene::Column;
use crate::search::Search;
use rayon::prelude::*;
use std::ops::Range;

/// What it is and what it is given, in words.
pub fn words(search: &Search<'_>, ctx: &Context<'_>) -> String {
    let Settings { rounds, depth, .. } = Settings::default();
    let (mut own, mut neighbours) = (Vec::new(), false);
    for name in search.features(ctx, 0).names {
        if name.contains(' ') {
            neighbours = true;
            continue;
        }
        own.push(match name.as_str() {
            "q_rad" => "angle".to_owned(),
            "qd_rad_s" => "velocity".to_owned(),
            "qdd_rad_s2" => "acceleration".to_owned(),
            "load_nm" => "load torque".to_owned(),
            "since_reversal_rad" => "distance since reversal".to_owned(),
            "temperature_degc" => "temperature".to_owned(),
            other => other.to_owned(),
        });
    }
    if neighbours {
        own.push("the neighbours' angles and velocities".to_owned());
    }
    format!("gradient boosting, {rounds} trees of depth {depth} a joint, on {}", own.join(", "))
}

/// What base and black box leave on every fold when both are fitted to the others. `target` and `columns` are the
/// base's, `fit` its fit.
pub fn in_turn(search: &Search<'_>, ctx: &Context<'_>, target: &Column, columns: &[&Column], fit: &Fit) -> Column {
    let n = search.scene.joints;
    let features: Vec<Binned> = (0..n).into_par_iter().map(|j| Binned::new(&search.features(ctx, j).values)).collect();
    let folds = &search.scene.folds;
    let jobs: Vec<(usize, usize)> = (0..n).flat_map(|j| (0..folds.len()).map(move |f| (j, f))).collect();
    let parts: Vec<(usize, Range<usize>, Vec<f64>)> = jobs
        .into_par_iter()
        .map(|(j, f)| {
            let mask = &search.scene.mask[j];
            let y = joint_left(target, columns, fit.fold_beta.get(f).map_or(&[], Vec::as_slice), j);
            let train: Vec<usize> = (0..search.scene.rows).filter(|r| mask[*r] && !folds[f].contains(r)).collect();
            let p = fit_predict(&features[j], &y, &train, &Settings::default());
            let rest = folds[f].clone().map(|r| if mask[r] { y[r] - p[r] } else { 0.0 }).collect();
            (j, folds[f].clone(), rest)
        })
        .collect();
    let mut out = Column::new(vec![vec![0.0; search.scene.rows]; n]);
    for (j, rows, rest) in parts {
        out.part[j][rows].copy_from_slice(&rest);
    }
    out
}

/// What the base leaves at one joint.
fn joint_left(target: &Column, columns: &[&Column], beta: &[f64], j: usize) -> Vec<f64> {
    let mut out = target.part[j].clone();
    for (column, b) in columns.iter().zip(beta) {
        for (x, y) in out.iter_mut().zip(&column.part[j]) {
            *x -= b * y;
        }
    }
    out
}

/// One side of a training and test split: rows, inputs, and what the base leaves there.
pub struct Side<'a> {
    /// Rows.
    pub search: &'a Search<'a>,
    /// Inputs.
    pub ctx: &'a Context<'a>,
    /// Residual of the base.
    pub residual: &'a Column,
}

/// What base and black box leave on the test rows when both are fitted to the training rows.
pub fn on_test(train: &Side<'_>, test: &Side<'_>) -> Column {
    let part = (0..train.search.scene.joints)
        .into_par_iter()
        .map(|j| {
            let (a, b) = (train.search.features(train.ctx, j), test.search.features(test.ctx, j));
            let rows = train.search.scene.rows;
            let values: Vec<Vec<f64>> = a
                .names
                .iter()
                .zip(a.values)
                .filter_map(|(name, mut v)| {
                    // An input that one side lacks is none.
                    let k = b.names.iter().position(|n| n == name)?;
                    v.extend_from_slice(&b.values[k]);
                    Some(v)
                })
                .collect();
            let mut y = train.residual.part[j].clone();
            y.resize(rows, 0.0);
            y.extend_from_slice(&test.residual.part[j]);
            let mask = &train.search.scene.mask[j];
            let fit: Vec<usize> = (0..rows).filter(|r| mask[*r]).collect();
            let p = fit_predict(&Binned::new(&values), &y, &fit, &Settings::default());
            let own = &test.search.scene.mask[j];
            (0..test.search.scene.rows).map(|r| if own[r] { y[rows + r] - p[rows + r] } else { 0.0 }).collect()
        })
        .collect();
    Column::new(part)
}
