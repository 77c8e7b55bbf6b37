//! From a fit to the files: model, parameter table, warnings, curves.

use crate::base::Structure;
use crate::bristle;
use crate::columns::Term;
use crate::condition::Prepared;
use crate::curves::report;
use crate::fit::draft::Data;
use crate::fit::{Solution, Why};
use crate::forward::Forward;
use crate::hold_out::{Fitted, Held, Split, time_ranges};
use crate::options::{Method, Options};
use crate::outcome::{
    Conditions, Consistency, HeldOut, Identification, Merged, NotExcited, Outcome, ParameterRow, SCHEMA,
};
use crate::paper::PaperResult;
use crate::stream::Stream;
use crate::sums::Sums;
use crate::warnings::{self, Findings};
use lacuna_interfaces::model::{FrictionModel, NoiseModel, RigidBodyModel};
use lacuna_interfaces::{BadInput, ModelFile, RobotFile};
use lacuna_report::number::significant;
use std::collections::BTreeMap;

/// Everything that is known when the numbers are done.
pub(crate) struct Account<'a> {
    pub(crate) options: &'a Options,
    pub(crate) data: Data<'a>,
    pub(crate) split: &'a Split,
    pub(crate) held: &'a Held,
    pub(crate) forward: Option<Forward>,
}

impl<'a> Account<'a> {
    fn structure(&self) -> &'a Structure {
        self.data.stream.structure
    }

    fn robot(&self) -> &'a RobotFile {
        self.data.stream.robot
    }

    fn fitted(&self) -> &'a Fitted {
        &self.held.last
    }

    fn solution(&self) -> &'a Solution {
        &self.held.last.solution
    }
}

pub(crate) fn account(a: &Account<'_>) -> Result<Outcome, BadInput> {
    let (parameters, not_excited) = parameters(a);
    let (stream, fitted, solution) = (a.data.stream, a.fitted(), a.solution());
    let consistency = fitted.consistent.as_ref().zip(a.held.free).map(|(c, free)| {
        let ratio = |constrained: f64| (constrained.max(0.0) / c.free).sqrt();
        Consistency {
            free_relative_error: free,
            training_residual_ratio: ratio(c.constrained),
            ratio_gap: ratio(c.constrained) - ratio(c.constrained - c.gap),
        }
    });
    let findings = Findings {
        robot: a.robot(),
        structure: a.structure(),
        recordings: stream.prepared,
        survey: &a.data.sums.survey,
        seconds: seconds(stream),
        positions: positions(stream),
        solution,
        plan: stream.plan,
        held_out: &a.held.score,
        with_standstill: a.held.with_standstill,
        by_recording: if a.split.name == "recordings" { &a.held.folds } else { &[] },
        forward: a.forward.as_ref(),
        delay: fitted.delay,
        instruments: fitted.instruments.as_ref(),
        consistency,
    };
    let held_out = HeldOut {
        score: a.held.score.clone(),
        moving_only: a.data.stream.plan.moving_rad_s > 0.0,
        moving_rad_s: a.data.stream.plan.moving_rad_s,
        band_hz: a.data.stream.plan.band_hz,
        split: a.split.name.clone(),
        train: time_ranges(&a.split.train, stream.recordings),
        test: time_ranges(&a.split.test, stream.recordings),
        folds: a.held.folds.clone(),
        fold_delays_s: a.held.shifts_s(),
        nominal_relative_error: a.held.nominal,
        with_standstill: a.held.with_standstill,
    };
    let identification = Identification {
        schema: SCHEMA,
        robot: a.robot().name.clone(),
        joints: a.robot().joints.clone(),
        torque_unit: a.robot().torque_unit.symbol().to_owned(),
        method: match a.options.method {
            Method::Pooled => "pooled",
            Method::Paper => "paper",
        }
        .to_owned(),
        held_out,
        forward: a.forward.clone(),
        parameters,
        not_excited,
        condition_numbers: Conditions {
            structure: a.structure().condition,
            data: a.solution().condition_all,
            fitted: a.solution().condition,
            by_qr: a.solution().by_qr,
        },
        noise_nm: a.solution().sigma.clone(),
        outlier_share: a.solution().outliers.clone(),
        rows: a.solution().rows.clone(),
        blocks: a.solution().blocks,
        delay: fitted.delay,
        instruments: fitted.instruments.clone(),
        bristle_rad: fitted.bristle.iter().map(|b| bristle::width_rad(*b)).collect(),
        conditioning: a.data.stream.plan.clone(),
        consistency,
        paper: a.fitted().paper.as_ref().map(|(_, r)| PaperResult {
            table1: a.held.table1.clone(),
            table1_moving: a.held.table1_moving.clone(),
            ..r.clone()
        }),
        payload: Vec::new(),
        repairs: stream.prepared.iter().flat_map(|p| p.repairs.clone()).collect(),
        warnings: warnings::all(&findings),
    };
    let model = model(a, &identification);
    model.check(a.robot())?;
    Ok(Outcome { model, identification, report: report(a.data, a.held) })
}

/// The parameters that the data support, and those that they do not.
fn parameters(a: &Account<'_>) -> (Vec<ParameterRow>, Vec<NotExcited>) {
    let s = a.structure();
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
    for u in &a.solution().unexcited {
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
            Why::Negative(v) => format!("fitted, this friction is negative ({}){near}", significant(v, 3)),
        };
        rest.push(NotExcited { symbol: symbol(s.base[u.base].column), reason, ci95: None, in_model: false });
    }
    for &b in &a.solution().excited {
        let base = &s.base[b];
        let column = &s.columns[base.column];
        let (free, half) = (a.solution().beta[b], a.solution().half_width(b));
        let ci95 = [free - half, free + half];
        let value = a.fitted().consistent.as_ref().map_or(free, |c| c.beta[b]);
        let contribution_nm = contribution(a, b) * value.abs();
        let rigid = matches!(column.term, Term::Rigid(_)) && base.nominal != 0.0;
        // An interval that includes zero says nothing, unless there is a nominal value that it is narrower than.
        let says_something = half < value.abs() || (rigid && half < base.nominal.abs());
        if !says_something {
            rest.push(NotExcited {
                symbol: column.symbol.clone(),
                reason: format!(
                    "its interval of ± {} {} includes zero; as fitted it moves the torque by {} {}",
                    significant(half, 3),
                    column.unit,
                    significant(contribution_nm, 3),
                    a.robot().torque_unit.symbol()
                ),
                ci95: Some(ci95),
                in_model: true,
            });
            continue;
        }
        let departure = value - base.nominal;
        let beyond = departure.abs() > half && departure.abs() > a.robot().tolerance.mass * base.nominal.abs();
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
    let train = a.data.sums.cells.within(&a.split.train);
    let mut most = 0.0f64;
    for (j, layout) in a.data.stream.layout.iter().enumerate() {
        let Some(slot) = layout.active.iter().position(|x| *x == b) else { continue };
        let place = layout.place(slot, a.fitted().bristle[j]);
        let (mut sum, mut count) = (0.0, 0.0);
        for cell in (0..train.len()).filter(|&c| train[c]) {
            let own = &a.data.sums.fitted[cell][j];
            sum += own.products()[(place, place)];
            count += Sums::rows_in(layout, own);
        }
        if count > 0.0 {
            most = most.max((sum / count).sqrt());
        }
    }
    most
}

/// The model file: the base's values by symbol, zeros for what merged, so that the full regressor gives the fit's torque.
fn model(a: &Account<'_>, identification: &Identification) -> ModelFile {
    let s = a.structure();
    let n = a.robot().joint_count();
    let mut model = ModelFile::nominal(a.robot());
    let mut friction = [vec![0.0; n], vec![0.0; n], vec![0.0; n]];
    let mut rigid_body = RigidBodyModel::default();
    let mut values: BTreeMap<usize, f64> = BTreeMap::new();
    for (b, base) in s.base.iter().enumerate() {
        values.insert(base.column, a.solution().beta[b]);
    }
    if let Some(consistent) = &a.fitted().consistent {
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
    if let Some((_, paper)) = &a.fitted().paper {
        rigid_body = RigidBodyModel { rho1: Some(paper.rho1), rho2: Some(paper.rho2), ..RigidBodyModel::default() };
        // An average of regressions may come out negative; no friction is, and the friction stage refuses it.
        let positive = |list: &[f64]| list.iter().map(|v| v.max(0.0)).collect();
        friction = [positive(&paper.f_v), positive(&paper.f_c), Vec::new()];
    }
    let [f_v, f_c, offset] = friction;
    let standstill_rad_s =
        if a.data.stream.plan.moving_rad_s > 0.0 { vec![a.data.stream.plan.moving_rad_s; n] } else { Vec::new() };
    model.rigid_body = rigid_body;
    model.friction = FrictionModel { f_v, f_c, offset, standstill_rad_s };
    model.noise = NoiseModel { sd_tau_nm: a.solution().sigma.clone(), sd_q_rad: Vec::new() };
    model.origin = format!(
        "identified ({}) from {} recordings, {} parameters; held-out relative error {:.2} % ({}, {:.4} Hz{})",
        identification.method,
        a.data.stream.recordings.len(),
        a.solution().excited.len(),
        100.0 * identification.held_out.score.relative_error,
        identification.held_out.split,
        a.data.stream.plan.band_hz,
        if a.data.stream.plan.moving_rad_s > 0.0 { ", moving" } else { "" },
    );
    model
}

/// Time that the rows cover [s].
fn seconds(stream: &Stream<'_>) -> f64 {
    let of = |p: &Prepared| p.stretches.iter().map(|s| s.rows as f64 * p.row_period_s()).sum::<f64>();
    stream.prepared.iter().map(of).sum()
}

/// Least and largest position per joint over all recordings [rad].
fn positions(stream: &Stream<'_>) -> Vec<(f64, f64)> {
    let of = |j: usize| {
        let all = stream.recordings.iter().flat_map(|r| &r.q_rad[j]);
        all.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), q| (low.min(*q), high.max(*q)))
    };
    (0..stream.layout.len()).map(of).collect()
}
