//! From the selected model to findings and model file.

use crate::Outcome;
use crate::base::Base;
use crate::calibration::{self, Calibration, MOST_MARGIN};
use crate::context::context;
use crate::deflection::deflection;
use crate::evidence::{Evidence, repairs};
use crate::families::Context;
use crate::findings::*;
use crate::forward::forward;
use crate::held::{Blocks, left_out};
use crate::intervals::parameters;
use crate::model::{Atom, Model};
use crate::model_file::model_file;
use crate::next::next_experiment;
use crate::proof::{Bare, Proof, held_out};
use crate::region;
use crate::rival;
use crate::scene::{Column, Scene};
use crate::search::Search;
use crate::select::Selection;
use crate::sim::Simulator;
use crate::unknown::Explained;
use crate::words::Words;
use lacuna_estimation::filter::noise_sd;
use lacuna_estimation::stats;

/// What the torque's white noise leaves in the band, per joint [Nm].
pub fn noise_floor(scene: &Scene) -> Vec<f64> {
    // Noise power of the zero-phase filter (order 4, twice) over that of a brick wall at the band's edge.
    let share = (0.93 * 2.0 * scene.band_hz / scene.rate_hz).min(1.0).sqrt();
    (0..scene.joints)
        .map(|j| {
            let mut all: Vec<f64> = scene.pieces.iter().filter_map(|p| noise_sd(&p.tau[j]).ok()).collect();
            stats::median_in_place(&mut all) * share
        })
        .collect()
}

/// What the findings are made from.
pub struct Material<'a> {
    /// Recordings.
    pub scene: &'a Scene,
    /// Base.
    pub base: &'a Base,
    /// Search.
    pub search: &'a Search<'a>,
    /// Its result.
    pub selection: &'a Selection,
    /// What evidence means.
    pub calibration: &'a Calibration,
    /// Seed of the bootstrap.
    pub seed: u64,
    /// Torque that a simulator's model was taken to explain already, at the rows.
    pub known: Option<&'a Column>,
    /// Test stretches, if there are any.
    pub test: Option<Judged<'a>>,
    /// What the recordings are compared with, if it is a simulator.
    pub simulator: Option<&'a Simulator>,
    /// How rows are held out.
    pub split: &'a str,
}

/// Rows that judge the model.
#[derive(Clone, Copy)]
pub struct Judged<'a> {
    /// The rows.
    pub scene: &'a Scene,
    /// As [`Material::known`].
    pub known: Option<&'a Column>,
}

/// Everything `diagnose` returns.
pub fn outcome(m: &Material<'_>, progress: &mut dyn FnMut(f64, &str)) -> Option<Outcome> {
    let (scene, search, selection) = (m.scene, m.search, m.selection);
    let n = scene.joints;
    let mut empty = Model::new(&m.base.columns);
    let before = search.fit(&mut empty)?;
    let ctx = context(scene, m.base, search, &selection.model, Some(&selection.state));
    let noise = &search.limits.noise_nm;
    progress(0.85, "holding the model against a black box");
    // A simulator is compared as it is, without a friction of its own fitted to it.
    let bare = m.simulator.is_none().then_some(Bare { model: &empty, state: &before });
    let proof = Proof::new(m, &ctx, bare);
    let base_residual = bare.map_or_else(|| m.base.target.clone(), |b| search.residual(b.model, b.state));
    let rest_box = search.black_box(&ctx, &search.residual(&selection.model, &selection.state));
    progress(0.93, "locating and writing");
    let mut weighed = Vec::new();
    let mut findings = named(m, &ctx, &proof, &mut weighed)?;
    if m.simulator.is_some() {
        findings.extend(crate::sim::friction(m, &proof)?);
    }
    let fitted_rms: Vec<f64> =
        (0..n).map(|j| (before.fit.held_out_joint(j) / search.layout.joint_count(j).max(1.0)).sqrt()).collect();
    let (unknown, unknown_finding) = unknown(m, &ctx, &rest_box, &fitted_rms);
    findings.extend(unknown_finding);
    let (wound, not_wound) = deflection(scene, &ctx);
    if !findings.iter().any(|f| f.effect == "elasticity") {
        findings.extend(wound);
    }
    findings.sort_by(|a, b| gain(b).total_cmp(&gain(a)));
    let held = held_out(m, &proof);
    let mut gain = search.compare(&selection.state, &before.fit, &selection.state.fit, Vec::new()).gain;
    if unknown.flag {
        gain = gain.max(above_noise(m));
    }
    let base_rms = if m.simulator.is_some() { &held.before_rms_nm } else { &fitted_rms };
    let mismatch = mismatch(m, &ctx, (&base_residual, base_rms), gain, &findings);
    let mut out = Findings {
        schema: SCHEMA.into(),
        robot: scene.robot.name.clone(),
        recordings: recordings(m),
        joints: scene.robot.joints.clone(),
        baseline: Baseline {
            rms_nm: held.before_rms_nm.clone(),
            relative_error: held.relative_before,
            noise_floor_nm: noise.clone(),
        },
        mismatch,
        held_out: held,
        unknown,
        excluded: not_wound.into_iter().chain(excluded(m)).collect(),
        repairs: repairs(m),
        next_experiment: next_experiment(&findings),
        verdict: String::new(),
        findings,
    };
    let words = Words { unit: scene.robot.torque_unit.symbol(), split: m.split, against: m.simulator.is_some() };
    for finding in out.findings.iter_mut().filter(|f| f.sentence.is_empty()) {
        finding.sentence = words.sentence(finding);
    }
    if let Some(expression) = &out.unknown.expression
        && let Some(finding) = out.findings.iter_mut().find(|f| f.effect == "unknown")
    {
        finding.sentence +=
            &format!(" A small expression holds on folds that had no part in choosing it: {expression}.");
    }
    out.verdict = words.verdict(&out);
    let mut model = model_file(m, &ctx, out.held_out.after_rms_nm.clone());
    if let Some(simulator) = m.simulator {
        model = simulator.with(&model, scene);
    }
    let mut evidence = Evidence::new(m, &ctx, &proof, &out);
    if out.findings.iter().any(|f| f.effect != "unknown") {
        evidence.forward = forward(m, &proof, bare);
    }
    Some(Outcome { findings: out, model, proof: weighed, nulls: m.search.nulls(m.selection), evidence })
}

/// Names of all recordings, each once.
fn recordings(m: &Material<'_>) -> Vec<String> {
    let mut out: Vec<String> = Vec::new();
    for name in m.scene.names.iter().chain(m.test.iter().flat_map(|t| &t.scene.names)) {
        if !out.contains(name) {
            out.push(name.clone());
        }
    }
    out
}

/// What has no name is evidence all the same: by how much the model's residual exceeds the noise [nats].
fn above_noise(m: &Material<'_>) -> f64 {
    let rms = m.search.held_out_rms(&m.selection.state);
    let nats = |(j, (rms, noise)): (usize, (&f64, &f64))| {
        let rows = m.search.layout.joint_count(j) * m.selection.state.independent[j];
        rows * (rms / noise.max(1e-30)).max(1.0).ln()
    };
    rms.iter().zip(&m.search.limits.noise_nm).enumerate().map(nats).sum()
}

/// Whether and where something is missing: `residual` and `rms` are what is left without findings, at the rows and per joint.
fn mismatch(
    m: &Material<'_>,
    ctx: &Context<'_>,
    (residual, rms): (&Column, &[f64]),
    gain: f64,
    findings: &[Finding],
) -> Mismatch {
    if findings.is_empty() {
        return Mismatch { detected: false, significance: 1.0, r#where: Vec::new() };
    }
    let excess: Vec<f64> = rms
        .iter()
        .zip(&m.search.limits.noise_nm)
        .enumerate()
        .map(|(j, (rms, noise))| (rms.powi(2) - noise.powi(2)).max(0.0) * m.search.layout.joint_count(j))
        .collect();
    Mismatch {
        detected: true,
        // Evidence beyond that is not evidence of the noise any more, but of the model of the noise.
        significance: (-gain).exp().clamp(1e-9, 1.0),
        r#where: m.search.locate(ctx, residual, &excess, findings),
    }
}

/// Held-out power that a finding removes.
fn gain(f: &Finding) -> f64 {
    f.held_out.before_rms_nm.powi(2) - f.held_out.after_rms_nm.powi(2)
}

/// Findings of the terms in the model, one per effect.
fn named(
    m: &Material<'_>,
    ctx: &Context<'_>,
    proof: &Proof<'_>,
    weighed: &mut Vec<(&'static str, calibration::Evidence)>,
) -> Option<Vec<Finding>> {
    let model = &m.selection.model;
    let mut out = Vec::new();
    let mut done: Vec<&str> = Vec::new();
    for atom in &model.atoms {
        let family = &m.search.families[atom.family];
        if done.contains(&family.id()) || m.search.is_part_of_coupling(model, atom) {
            continue;
        }
        done.push(family.id());
        let belongs = |a: &Atom| match m.search.is_part_of_coupling(model, a) {
            true => family.id() == "axis_coupling",
            false => m.search.effect_of(a) == family.id(),
        };
        let all: Vec<usize> = (0..model.atoms.len()).filter(|i| belongs(&model.atoms[*i])).collect();
        let acts_on = |a: &Atom| m.search.families[a.family].joints(a.joint);
        let mut joints: Vec<usize> = all.iter().flat_map(|i| acts_on(&model.atoms[*i])).collect();
        joints.sort_unstable();
        joints.dedup();
        let names: Vec<String> = joints.iter().map(|j| m.scene.robot.joints[*j].clone()).collect();
        let where_: Vec<usize> = if joints.is_empty() { (0..m.scene.joints).collect() } else { joints };
        let (left, without) = proof.without(m, &all)?;
        let held_out = proof.reduction(&left, &proof.after, &where_);
        let nats = m.search.compare(&m.selection.state, &without, &m.selection.state.fit, Vec::new()).gain;
        let group: Vec<String> = family.group().iter().map(|s| (*s).to_owned()).collect();
        let evidence = weigh(m, family.id(), nats, &where_, &group);
        let rivals = m.selection.rivals.iter().find(|r| r.effect == family.id());
        let (probability, alternatives) = m.calibration.probability(&evidence, rivals, &group);
        weighed.push((family.id(), evidence));
        let parameters: Vec<Parameter> = all.iter().flat_map(|i| parameters(m, ctx, *i, names.len() > 1)).collect();
        let region = region::of(family.id(), &parameters);
        let in_region = region.as_ref().and_then(|r| region::reduction(proof, r, &left, &where_));
        // A few rows that happen to lie there do not speak for the effect.
        let in_region = in_region.filter(|r| r.reduction > 0.5 * held_out.reduction);
        let region = region.filter(|_| in_region.is_some());
        out.push(Finding {
            effect: family.id().to_owned(),
            joints: names,
            probability,
            status: if group.len() > 1 { "group" } else { "named" }.into(),
            alternatives,
            group,
            equation: family.effect.law.to_owned(),
            sentence: String::new(),
            parameters,
            held_out,
            region: region.into_iter().collect(),
            in_region,
            stage: family.effect.stage.as_str().to_owned(),
            intervals_s: all.iter().flat_map(|i| intervals(m, &model.atoms[*i])).collect(),
        });
    }
    Some(out)
}

/// What speaks for an effect: what is lost without it, its lead, and what the model leaves at its joints.
fn weigh(m: &Material<'_>, id: &str, nats: f64, joints: &[usize], group: &[String]) -> calibration::Evidence {
    let rivals = m.selection.rivals.iter().find(|r| r.effect == id);
    let best = rivals
        .into_iter()
        .flat_map(|r| r.others.iter().filter(|o| !group.iter().any(|g| g == o.0)).map(|o| r.merit - o.1))
        .fold(10.0 * MOST_MARGIN, f64::min);
    let left = m.search.held_out_rms(&m.selection.state);
    let over = |j: &usize| left[*j] / m.search.limits.noise_nm[*j].max(1e-30);
    calibration::Evidence { nats, margin: best, left: joints.iter().map(over).fold(1.0, f64::max) }
}

/// Times in which a term acts, per file.
fn intervals(m: &Material<'_>, atom: &Atom) -> Vec<(String, f64, f64)> {
    let mut times = atom.carries.clone();
    if m.search.families[atom.family].id() == "collision"
        && let [t_0, duration, ..] = atom.shape[..]
    {
        times.push((t_0, t_0 + duration));
    }
    let file = |t: f64| {
        m.scene
            .pieces
            .iter()
            .filter(|p| t >= p.global_s - 0.1)
            .max_by(|a, b| a.global_s.total_cmp(&b.global_s))
            .map(|p| (m.scene.names[p.recording].clone(), p.global_s - p.t0_s))
    };
    times.into_iter().filter_map(|(a, b)| file(a).map(|(name, zero)| (name, a - zero, b - zero))).collect()
}

/// Share of a joint's base mismatch that must be left unnamed, and explained by the black box, to be a finding.
const UNKNOWN_SHARE: f64 = 0.15;
/// Share of a joint's torque that an unnamed one must have where the base is fitted freely.
const UNKNOWN_TORQUE: f64 = 0.03;
/// Share of a joint's base mismatch that, left unnamed, is a finding even if no black box explains it.
const UNEXPLAINED_SHARE: f64 = 0.4;

fn unknown(m: &Material<'_>, ctx: &Context<'_>, rest: &Explained, before_rms: &[f64]) -> (Unknown, Option<Finding>) {
    let n = m.scene.joints;
    let noise = &m.search.limits.noise_nm;
    let count = |j: usize| m.search.layout.joint_count(j).max(1.0);
    let excess: f64 = (0..n).map(|j| (before_rms[j].powi(2) - noise[j].powi(2)).max(0.0) * count(j)).sum();
    let taken = |j: usize| (rest.before[j] - rest.after[j]).max(0.0);
    let share = ((0..n).map(taken).sum::<f64>() / excess.max(1e-30)).min(1.0);
    let worst = (0..n)
        .max_by(|a, b| {
            (taken(*a) / m.search.limits.floor_nm[*a].powi(2))
                .total_cmp(&(taken(*b) / m.search.limits.floor_nm[*b].powi(2)))
        })
        .unwrap_or(0);
    let size = (taken(worst) / count(worst)).sqrt();
    let own = taken(worst) / ((before_rms[worst].powi(2) - noise[worst].powi(2)).max(1e-30) * count(worst));
    // Or: nothing explains most of what is there, not even the black box.
    let over = |j: usize| {
        let left = (rest.before[j] / count(j) - noise[j].powi(2)).max(0.0);
        let all = (before_rms[j].powi(2) - noise[j].powi(2)).max(1e-30);
        if left.sqrt() > 3.0 * m.search.limits.floor_nm[j].max(0.6 * noise[j]) { left / all } else { 0.0 }
    };
    let most = (0..n).max_by(|a, b| over(*a).total_cmp(&over(*b))).unwrap_or(0);
    // Where the base is fitted freely nothing is claimed to be complete: drive noise is then no mystery.
    let unexplained = ctx.nominal_base && over(most) > UNEXPLAINED_SHARE;
    // A freely fitted base, whose parameters friction bends, is not exact to the last per cent.
    let least = if ctx.nominal_base {
        0.0
    } else {
        UNKNOWN_TORQUE * (m.base.torque.part[worst].iter().map(|v| v * v).sum::<f64>() / count(worst)).sqrt()
    };
    let by_box = size > least
        && size > 1.5 * m.search.limits.floor_nm[worst]
        && own > UNKNOWN_SHARE
        && taken(worst) > 0.2 * rest.before[worst]
        && rest.folds[worst] > 0.6;
    let flag = by_box || unexplained;
    let worst = if by_box { worst } else { most };
    let size = if by_box { size } else { (rest.before[worst] / count(worst) - noise[worst].powi(2)).max(0.0).sqrt() };
    if !flag {
        return (
            Unknown {
                flag,
                share: share.min(0.4) * f64::from(u8::from(size > m.search.limits.floor_nm[worst])),
                r#where: None,
                map: None,
                expression: None,
            },
            None,
        );
    }
    let residual = m.search.residual(&m.selection.model, &m.selection.state);
    let found = m.search.map(ctx, &residual, worst);
    let joint = m.scene.robot.joints[worst].clone();
    let where_ = Where {
        joint: joint.clone(),
        share: 1.0,
        stage: "friction".into(),
        region: found.iter().map(|f| f.2.clone()).collect(),
        intervals_s: Vec::new(),
        rms_nm: size,
    };
    // How much of it a black box predicts, on every fold from the others.
    let state = &m.selection.state;
    let columns = m.selection.model.columns();
    let blocks = Blocks::new(m.scene, m.seed);
    let left = blocks.squares(&left_out(&m.search.layout.folds, &state.target, &columns, &state.fit));
    let boxed = blocks.squares(&rival::in_turn(m.search, ctx, &state.target, &columns, &state.fit));
    let (reduction, ci95) = blocks.reduction(&left, &boxed, &[worst]);
    let expression = m.search.expression(ctx, &m.selection.model, &m.selection.state, worst);
    let finding = Finding {
        effect: "unknown".into(),
        joints: vec![joint.clone()],
        probability: m.calibration.unknown,
        status: "unknown".into(),
        alternatives: Vec::new(),
        group: Vec::new(),
        equation: String::new(),
        sentence: String::new(),
        parameters: Vec::new(),
        held_out: Reduction {
            before_rms_nm: blocks.rms(&left, &[worst]),
            after_rms_nm: blocks.rms(&boxed, &[worst]),
            reduction,
            ci95,
        },
        region: found.iter().map(|f| f.2.clone()).collect(),
        in_region: None,
        stage: "friction".into(),
        intervals_s: Vec::new(),
    };
    (
        Unknown { flag, share, r#where: Some(where_), map: found.map(|f| f.1), expression: expression.map(|e| e.text) },
        Some(finding),
    )
}

/// Candidates that were looked at and not taken, with the reason.
fn excluded(m: &Material<'_>) -> Vec<Excluded> {
    let mut out: Vec<Excluded> = Vec::new();
    for r in &m.selection.excluded {
        let id = m.search.families[r.atoms[0].family].id();
        let taken = m.selection.model.atoms.iter().any(|a| m.search.families[a.family].id() == id);
        if taken || out.iter().any(|e| e.effect == id) {
            continue;
        }
        let size = r.score.size_nm.iter().copied().fold(0.0, f64::max);
        let unit = m.scene.robot.torque_unit.symbol();
        let reason = if r.score.gain < 0.0 {
            format!("worsens the prediction of recordings left out (by {:.1} nats)", -r.score.gain)
        } else if let Some((low, high)) = uneven(&r.score.by_fold) {
            format!(
                "is not uniform over the recordings: on parts left out it takes {:.0} % to {:.0} % off the residual",
                100.0 * low,
                100.0 * high
            )
        } else if r.merit < 0.0 {
            format!("gains {:.1} nats on recordings left out, less than chance can ({:.3} {unit})", r.score.gain, size)
        } else {
            format!("contributes {size:.3} {unit}, below what counts")
        };
        out.push(Excluded { effect: id.to_owned(), reason });
    }
    out
}

/// Least and largest share taken off a fold, if they differ so much that the effect is not one thing everywhere.
fn uneven(by_fold: &[f64]) -> Option<(f64, f64)> {
    let low = by_fold.iter().copied().fold(f64::INFINITY, f64::min);
    let high = by_fold.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    (high > 0.03 && low < 0.4 * high).then_some((low, high))
}
