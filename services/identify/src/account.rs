//! From a fit to the files: model, parameter table, warnings, curves.

use crate::base::Structure;
use crate::columns::Term;
use crate::condition::{Conditioned, Plan};
use crate::delay::DelayEstimate;
use crate::evaluate::Tally;
use crate::fit::Why;
use crate::hold_out::{Fitted, Held, Split, time_ranges};
use crate::options::{Method, Options};
use crate::outcome::{
    Conditions, Consistency, HeldOut, Identification, JointCurves, Merged, NotExcited, Outcome, ParameterRow,
    ReportData, SCHEMA,
};
use crate::paper::{ErrorTable, PaperResult};
use crate::warnings::{self, Findings};
use lacuna_interfaces::model::{FrictionModel, NoiseModel, RigidBodyModel};
use lacuna_interfaces::{BadInput, ModelFile, RobotFile};
use std::collections::BTreeMap;

/// Everything that is known when the numbers are done.
pub(crate) struct Account<'a> {
    pub(crate) options: &'a Options,
    pub(crate) robot: &'a RobotFile,
    pub(crate) structure: &'a Structure,
    pub(crate) conditioned: &'a [Conditioned],
    pub(crate) plan: &'a Plan,
    pub(crate) split: &'a Split,
    pub(crate) fitted: &'a Fitted,
    pub(crate) held: &'a Held,
    pub(crate) delay: Option<DelayEstimate>,
    pub(crate) names: &'a [String],
}

pub(crate) fn account(a: &Account<'_>) -> Result<Outcome, BadInput> {
    let (parameters, not_excited) = parameters(a);
    let consistency = a.fitted.consistent.as_ref().zip(a.held.free).map(|(c, free)| {
        let ratio = |constrained: f64| (constrained.max(0.0) / c.free).sqrt();
        Consistency {
            free_relative_error: free,
            training_residual_ratio: ratio(c.constrained),
            ratio_gap: ratio(c.constrained) - ratio(c.constrained - c.gap),
        }
    });
    let findings = Findings {
        robot: a.robot,
        structure: a.structure,
        recordings: a.conditioned,
        rows: &a.fitted.rows,
        solution: &a.fitted.solution,
        plan: a.plan,
        held_out: &a.held.score,
        with_standstill: a.held.with_standstill,
        delay: a.delay,
        consistency,
    };
    let held_out = HeldOut {
        score: a.held.score.clone(),
        moving_only: a.plan.moving_rad_s > 0.0,
        moving_rad_s: a.plan.moving_rad_s,
        band_hz: a.plan.band_hz,
        split: a.split.name.clone(),
        train: time_ranges(&a.split.train_ranges, a.names, a.conditioned),
        test: time_ranges(&a.split.test_ranges, a.names, a.conditioned),
        folds: a.held.folds.clone(),
        nominal_relative_error: a.held.nominal,
        with_standstill: a.held.with_standstill,
    };
    let identification = Identification {
        schema: SCHEMA,
        robot: a.robot.name.clone(),
        joints: a.robot.joints.clone(),
        torque_unit: a.robot.torque_unit.symbol().to_owned(),
        method: match a.options.method {
            Method::Pooled => "pooled",
            Method::Paper => "paper",
        }
        .to_owned(),
        held_out,
        parameters,
        not_excited,
        condition_numbers: Conditions {
            structure: a.structure.condition,
            data: a.fitted.solution.condition_all,
            fitted: a.fitted.solution.condition,
        },
        noise_nm: a.fitted.solution.sigma.clone(),
        outlier_share: a.fitted.solution.outliers.clone(),
        rows: a.fitted.solution.rows.clone(),
        blocks: a.fitted.solution.blocks,
        delay: a.delay,
        bristle_rad: a.fitted.bristle_rad.clone(),
        conditioning: a.plan.clone(),
        consistency,
        paper: a.fitted.paper.as_ref().map(|(_, r)| PaperResult {
            table1: a.held.table1.clone(),
            table1_moving: a.held.table1_moving.clone(),
            ..r.clone()
        }),
        repairs: a.conditioned.iter().flat_map(|c| c.repairs.clone()).collect(),
        warnings: warnings::all(&findings),
    };
    let model = model(a, &identification);
    model.check(a.robot)?;
    Ok(Outcome { model, identification, report: report(a) })
}

/// The parameters that the data support, and those that they do not.
fn parameters(a: &Account<'_>) -> (Vec<ParameterRow>, Vec<NotExcited>) {
    let s = a.structure;
    let symbol = |c: usize| s.columns[c].symbol.clone();
    let mut supported = Vec::new();
    let mut rest: Vec<NotExcited> = s
        .silent
        .iter()
        .map(|&c| NotExcited {
            symbol: symbol(c),
            reason: "no motion of this robot excites it".to_owned(),
            ci95: None,
            in_model: false,
        })
        .collect();
    for u in &a.fitted.solution.unexcited {
        let terms: Vec<String> = u
            .combination
            .iter()
            .filter(|(_, k)| k.abs() > 1e-3)
            .take(4)
            .map(|(b, k)| format!("{k:+.3} {}", symbol(s.base[*b].column)))
            .collect();
        let near = if terms.is_empty() { String::new() } else { format!(" (near {})", terms.join(" ")) };
        let reason = match u.why {
            Why::Zero => "its column is zero in these recordings".to_owned(),
            Why::Dependent => format!("in these recordings its column is a combination of others{near}"),
            Why::Uncertain(sd) => {
                format!("its interval alone would move the torque by {sd:.1} standard deviations of the torque{near}")
            }
            Why::Negative(v) => format!("fitted, this friction is negative ({v:.3e}){near}"),
        };
        rest.push(NotExcited { symbol: symbol(s.base[u.base].column), reason, ci95: None, in_model: false });
    }
    for &b in &a.fitted.solution.excited {
        let base = &s.base[b];
        let column = &s.columns[base.column];
        let (free, half) = (a.fitted.solution.beta[b], a.fitted.solution.half_width(b));
        let ci95 = [free - half, free + half];
        let value = a.fitted.consistent.as_ref().map_or(free, |c| c.beta[b]);
        let contribution_nm = contribution(a, b) * value.abs();
        let rigid = matches!(column.term, Term::Rigid(_)) && base.nominal != 0.0;
        // An interval that includes zero says nothing, unless there is a nominal value that it is narrower than.
        let says_something = half < value.abs() || (rigid && half < base.nominal.abs());
        if !says_something {
            rest.push(NotExcited {
                symbol: column.symbol.clone(),
                reason: format!(
                    "its interval of {half:.3e} {} includes zero; as fitted it moves {contribution_nm:.3e} {}",
                    column.unit,
                    a.robot.torque_unit.symbol()
                ),
                ci95: Some(ci95),
                in_model: true,
            });
            continue;
        }
        let departure = value - base.nominal;
        let beyond = departure.abs() > half && departure.abs() > a.robot.tolerance.mass * base.nominal.abs();
        supported.push(ParameterRow {
            symbol: column.symbol.clone(),
            meaning: column.meaning.clone(),
            unit: column.unit.clone(),
            value,
            ci95,
            nominal: rigid.then_some(base.nominal),
            departure: rigid.then_some(departure),
            departs: rigid.then_some(beyond),
            contribution_nm,
            merged_with: base.merged.iter().map(|&(c, factor)| Merged { symbol: symbol(c), factor }).collect(),
        });
    }
    (supported, rest)
}

/// Root mean square of base column `b` over the fitted training rows of the joint where it is largest.
fn contribution(a: &Account<'_>, b: usize) -> f64 {
    let mut most = 0.0f64;
    for (j, active) in a.structure.active.iter().enumerate() {
        let Some(slot) = active.iter().position(|x| *x == b) else { continue };
        let joint = &a.fitted.rows.joints[j];
        let (mut sum, mut count) = (0.0, 0.0);
        for k in (0..a.fitted.rows.len()).filter(|&k| a.split.train[k] && joint.fitted[k]) {
            sum += joint.x[k * active.len() + slot].powi(2);
            count += 1.0;
        }
        if count > 0.0 {
            most = most.max((sum / count).sqrt());
        }
    }
    most
}

/// The model file: the base's values by symbol, zeros for what merged, so that the full regressor gives the fit's torque.
fn model(a: &Account<'_>, identification: &Identification) -> ModelFile {
    let s = a.structure;
    let n = a.robot.joint_count();
    let mut model = ModelFile::nominal(a.robot);
    let mut friction = [vec![0.0; n], vec![0.0; n], vec![0.0; n]];
    let mut rigid_body = RigidBodyModel::default();
    let mut values: BTreeMap<usize, f64> = BTreeMap::new();
    for (b, base) in s.base.iter().enumerate() {
        values.insert(base.column, a.fitted.solution.beta[b]);
    }
    if let Some(consistent) = &a.fitted.consistent {
        // Links that could exist: nothing is merged.
        values = consistent.values.iter().copied().enumerate().collect();
    }
    for (c, column) in s.columns.iter().enumerate() {
        let value = values.get(&c).copied().unwrap_or(0.0);
        match column.term {
            Term::Rigid(_) => {
                rigid_body.parameters.insert(column.symbol.clone(), value);
            }
            Term::Viscous(j) => friction[0][j] = value,
            Term::Coulomb(j) => friction[1][j] = value,
            Term::Offset(j) => friction[2][j] = value,
        }
    }
    if let Some((_, paper)) = &a.fitted.paper {
        rigid_body = RigidBodyModel { rho1: Some(paper.rho1), rho2: Some(paper.rho2), ..RigidBodyModel::default() };
        // An average of regressions may come out negative; no friction is, and the friction stage refuses it.
        let positive = |list: &[f64]| list.iter().map(|v| v.max(0.0)).collect();
        friction = [positive(&paper.f_v), positive(&paper.f_c), Vec::new()];
    }
    let [f_v, f_c, offset] = friction;
    let standstill_rad_s = if a.plan.moving_rad_s > 0.0 { vec![a.plan.moving_rad_s; n] } else { Vec::new() };
    model.rigid_body = rigid_body;
    model.friction = FrictionModel { f_v, f_c, offset, standstill_rad_s };
    model.noise = NoiseModel { sd_tau_nm: a.fitted.solution.sigma.clone(), sd_q_rad: Vec::new() };
    model.origin = format!(
        "identified ({}) from {} recordings, {} parameters; held-out relative error {:.2} % ({}, {:.4} Hz{})",
        identification.method,
        a.names.len(),
        a.fitted.solution.excited.len(),
        100.0 * identification.held_out.score.relative_error,
        identification.held_out.split,
        a.plan.band_hz,
        if a.plan.moving_rad_s > 0.0 { ", moving" } else { "" },
    );
    model
}

/// μ and σ per joint of several models.
pub(crate) fn error_tables(models: &[&str], tallies: &[Tally]) -> Vec<ErrorTable> {
    models
        .iter()
        .zip(tallies)
        .filter_map(|(model, tally)| {
            let score = tally.score()?;
            Some(ErrorTable { model: (*model).to_owned(), mean_nm: score.mean_nm, std_nm: score.std_nm })
        })
        .collect()
}

/// Most points of a curve.
const CURVE_POINTS: usize = 4000;
/// Bins of the residual over velocity.
const BINS: usize = 40;

fn report(a: &Account<'_>) -> ReportData {
    let rows = &a.fitted.rows;
    let step = rows.len().div_ceil(CURVE_POINTS).max(1);
    let picked: Vec<usize> = (0..rows.len()).step_by(step).collect();
    let mut starts: Vec<(f64, String)> = Vec::new();
    let mut time_s = Vec::with_capacity(picked.len());
    let (mut offset, mut last_recording) = (0.0, None);
    for k in 0..rows.len() {
        let r = rows.recording[k];
        if last_recording != Some(r) {
            let end = if k == 0 { 0.0 } else { offset + rows.time_s[k - 1] + rows.period_s };
            offset = end - rows.time_s[k];
            starts.push((end, a.names[r].clone()));
            last_recording = Some(r);
        }
        if k % step == 0 {
            time_s.push(offset + rows.time_s[k]);
        }
    }
    ReportData {
        torque_unit: a.robot.torque_unit.symbol().to_owned(),
        time_s,
        recordings: starts,
        held_out: picked.iter().map(|&k| a.held.held_out[k]).collect(),
        joints: (0..rows.joints.len()).map(|j| curves(a, j, &picked)).collect(),
    }
}

fn curves(a: &Account<'_>, j: usize, picked: &[usize]) -> JointCurves {
    let joint = &a.fitted.rows.joints[j];
    let model = &a.held.model[j];
    let (bin_qd_rad_s, bin_residual_nm, bin_std_nm) = binned(a, j);
    JointCurves {
        joint: a.robot.joints[j].clone(),
        measured_nm: picked.iter().map(|&k| joint.y[k] as f32).collect(),
        model_nm: picked.iter().map(|&k| model[k] as f32).collect(),
        qd_rad_s: picked.iter().map(|&k| joint.qd[k] as f32).collect(),
        counted: picked.iter().map(|&k| joint.counted[k]).collect(),
        bin_qd_rad_s,
        bin_residual_nm,
        bin_std_nm,
    }
}

/// Mean and standard deviation of the residual in bins of velocity, over counted rows.
fn binned(a: &Account<'_>, j: usize) -> (Vec<f32>, Vec<f32>, Vec<f32>) {
    let joint = &a.fitted.rows.joints[j];
    let most = joint.qd.iter().fold(0.0, |m: f64, v| m.max(v.abs()));
    let mut sums = [[0.0f64; 3]; BINS];
    if most > 0.0 {
        for k in (0..a.fitted.rows.len()).filter(|&k| joint.counted[k]) {
            let place = (joint.qd[k] / most + 1.0) * 0.5 * BINS as f64;
            let bin = &mut sums[(place as usize).min(BINS - 1)];
            let e = joint.y[k] - a.held.model[j][k];
            bin[0] += 1.0;
            bin[1] += e;
            bin[2] += e * e;
        }
    }
    let (mut centre, mut mean, mut spread) = (Vec::new(), Vec::new(), Vec::new());
    for (i, [count, sum, square]) in sums.iter().enumerate().filter(|(_, s)| s[0] >= 5.0) {
        let m = sum / count;
        centre.push((((i as f64 + 0.5) / BINS as f64 * 2.0 - 1.0) * most) as f32);
        mean.push(m as f32);
        spread.push((square / count - m * m).max(0.0).sqrt() as f32);
    }
    (centre, mean, spread)
}
