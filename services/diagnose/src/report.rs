//! From the selected model to findings and model file.

use crate::Outcome;
use crate::base::Base;
use crate::calibration::{self, Calibration, MOST_MARGIN};
use crate::context::context;
use crate::evidence::Evidence;
use crate::families::Context;
use crate::findings::*;
use crate::forward::forward;
use crate::held::{Blocks, Squares, left_out};
use crate::intervals::parameters;
use crate::model::{Atom, Model};
use crate::model_file::model_file;
use crate::proof::{Bare, Proof};
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
use lacuna_interfaces::Repair;

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
    findings.sort_by(|a, b| gain(b).total_cmp(&gain(a)));
    let detected = !findings.is_empty();
    let total_gain = search.compare(&selection.state, &before.fit, &selection.state.fit, Vec::new()).gain;
    let held = held_out(m, &proof);
    let excess: Vec<f64> = (0..n)
        .map(|j| {
            let before = if m.simulator.is_some() { held.before_rms_nm[j] } else { fitted_rms[j] };
            (before.powi(2) - noise[j].powi(2)).max(0.0) * search.layout.joint_count(j)
        })
        .collect();
    let mut recordings: Vec<String> = Vec::new();
    for name in scene.names.iter().chain(m.test.iter().flat_map(|t| &t.scene.names)) {
        if !recordings.contains(name) {
            recordings.push(name.clone());
        }
    }
    let mut out = Findings {
        schema: SCHEMA.into(),
        robot: scene.robot.name.clone(),
        recordings,
        joints: scene.robot.joints.clone(),
        baseline: Baseline {
            rms_nm: held.before_rms_nm.clone(),
            relative_error: held.relative_before,
            noise_floor_nm: noise.clone(),
        },
        mismatch: Mismatch {
            detected,
            // Evidence beyond that is not evidence of the noise any more, but of the model of the noise.
            significance: if detected { (-total_gain).exp().clamp(1e-9, 1.0) } else { 1.0 },
            r#where: if detected { search.locate(&ctx, &base_residual, &excess, &findings) } else { Vec::new() },
        },
        held_out: held,
        unknown,
        excluded: excluded(m),
        repairs: repairs(m),
        next_experiment: next_experiment(&findings),
        verdict: String::new(),
        findings,
    };
    let words = Words { unit: scene.robot.torque_unit.symbol(), split: m.split, against: m.simulator.is_some() };
    for finding in out.findings.iter_mut().filter(|f| f.sentence.is_empty()) {
        finding.sentence = words.sentence(finding);
    }
    out.verdict = words.verdict(&out);
    let mut model = model_file(m, &ctx, out.held_out.after_rms_nm.clone());
    if let Some(simulator) = m.simulator {
        model = simulator.with(&model, scene);
    }
    let mut evidence = Evidence::new(m, &ctx, &proof, &out);
    if detected {
        evidence.forward = forward(m, &proof, bare);
    }
    Some(Outcome { findings: out, model, proof: weighed, nulls: m.search.nulls(m.selection), evidence })
}

/// Held-out errors with their intervals.
fn held_out(m: &Material<'_>, proof: &Proof<'_>) -> HeldOut {
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

/// What was repaired, the stretches of one file together.
fn repairs(m: &Material<'_>) -> Vec<Repair> {
    let mut out: Vec<Repair> = Vec::new();
    for repair in m.scene.repairs.iter().chain(m.test.iter().flat_map(|t| &t.scene.repairs)) {
        match out.iter_mut().find(|r| r.file == repair.file && r.kind == repair.kind && r.signal == repair.signal) {
            Some(same) => same.count += repair.count,
            None => out.push(repair.clone()),
        }
    }
    out
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
        if done.contains(&family.id()) {
            continue;
        }
        done.push(family.id());
        let all: Vec<usize> =
            (0..model.atoms.len()).filter(|i| m.search.families[model.atoms[*i].family].id() == family.id()).collect();
        let mut joints: Vec<usize> = all.iter().flat_map(|i| family.joints(model.atoms[*i].joint)).collect();
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
    let unexplained = over(most) > UNEXPLAINED_SHARE;
    let by_box = size > 1.5 * m.search.limits.floor_nm[worst]
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
    (Unknown { flag, share, r#where: Some(where_), map: found.map(|f| f.1), expression: None }, Some(finding))
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
        } else if r.merit < 0.0 {
            format!("gains {:.1} nats on recordings left out, less than chance can ({:.3} {unit})", r.score.gain, size)
        } else {
            format!("contributes {size:.3} {unit}, below what counts")
        };
        out.push(Excluded { effect: id.to_owned(), reason });
    }
    out
}

/// What to record if two explanations stay open.
fn next_experiment(findings: &[Finding]) -> Option<NextExperiment> {
    let open = findings.iter().find_map(|f| {
        // No motion separates what the motor's position and torque cannot tell apart at all.
        let same = lacuna_physics::effects::find(&f.effect).map_or(&[][..], |e| e.exact_group);
        let a = f.alternatives.iter().find(|a| a.probability > 0.1 && !same.contains(&a.effect.as_str()))?;
        Some((f, a.effect.clone()))
    });
    if let Some((f, other)) = open {
        return Some(NextExperiment {
            separate: vec![f.effect.clone(), other.clone()],
            words: format!(
                "lacuna excite --robot ROBOT --model model.toml --findings findings.json --separate {},{other} --out \
                 motion.csv designs the motion; by hand: {}",
                f.effect,
                advice(&f.effect)
            ),
        });
    }
    let group = findings.iter().find(|f| f.group.len() > 1)?;
    Some(NextExperiment {
        separate: group.group.clone(),
        words: format!(
            "{}; positions and torques in motion alone cannot separate {}",
            advice(&group.effect),
            group.group.join(" and ")
        ),
    })
}

fn advice(effect: &str) -> &'static str {
    match effect {
        "stribeck" | "viscous_power" => "sweep each joint at constant speeds from creeping to fast",
        "coulomb_asym" | "torque_offset" => "hold the joint at rest under a known load, approached from both sides",
        "rotor_inertia" | "arm_inertia" => "repeat with a known mass on the arm, or with the arm taken off the gear",
        "gravity_spring" | "cable_spring" | "base_tilt" => "move slowly over the whole range of every joint",
        "encoder_offset" | "link_length" => "visit the corners of the workspace slowly, then fast",
        "elasticity" | "backlash" | "torque_delay" => {
            "shake each joint with a chirp through its resonance, at two amplitudes"
        }
        "presliding" => "make reversals of a few milliradians",
        _ => "record motions over the whole range of positions and speeds",
    }
}
