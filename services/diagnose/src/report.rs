//! From the selected model to findings and model file.

use crate::Outcome;
use crate::base::Base;
use crate::calibration::{Calibration, Evidence, MOST_MARGIN};
use crate::context::context;
use crate::families::Context;
use crate::findings::*;
use crate::gram::Fit;
use crate::intervals::parameters;
use crate::model::{Atom, Model};
use crate::model_file::model_file;
use crate::scene::Scene;
use crate::search::Search;
use crate::select::Selection;
use crate::unknown::Explained;
use crate::words;
use lacuna_estimation::filter::noise_sd;
use lacuna_estimation::stats;
use rand::{RngExt, SeedableRng};

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
}

/// Size of the torque per joint [Nm].
fn torque_rms(m: &Material<'_>) -> Vec<f64> {
    (0..m.scene.joints)
        .map(|j| {
            let count = m.search.layout.joint_count(j).max(1.0);
            (m.base.torque.part[j].iter().map(|v| v * v).sum::<f64>() / count).sqrt()
        })
        .collect()
}

fn rms(search: &Search<'_>, fit: &Fit) -> Vec<f64> {
    (0..search.layout.joints).map(|j| (fit.held_out_joint(j) / search.layout.joint_count(j).max(1.0)).sqrt()).collect()
}

/// Norm of residuals over torques, each joint by its own torque.
fn relative(residual: &[f64], size: &[f64]) -> f64 {
    let share: f64 = residual.iter().zip(size).map(|(r, s)| (r / s.max(1e-12)).powi(2)).sum();
    (share / residual.len().max(1) as f64).sqrt()
}

/// Everything `diagnose` returns.
pub fn outcome(m: &Material<'_>, progress: &mut dyn FnMut(f64, &str)) -> Option<Outcome> {
    let (scene, search, selection) = (m.scene, m.search, m.selection);
    let n = scene.joints;
    let mut empty = Model::new(&m.base.columns);
    let before = search.fit(&mut empty)?;
    let ctx = context(scene, m.base, search, &selection.model, Some(&selection.state));
    let (before_rms, after_rms) = (rms(search, &before.fit), rms(search, &selection.state.fit));
    let size = torque_rms(m);
    let noise = &search.limits.noise_nm;
    progress(0.85, "holding the model against a black box");
    let base_residual = search.residual(&empty, &before);
    let base_box = search.black_box(&ctx, &base_residual);
    let rest_box = search.black_box(&ctx, &search.residual(&selection.model, &selection.state));
    progress(0.93, "locating and writing");
    let mut proof = Vec::new();
    let mut findings = named(m, &ctx, &mut proof)?;
    let (unknown, unknown_finding) = unknown(m, &ctx, &rest_box, &before_rms);
    findings.extend(unknown_finding);
    findings.sort_by(|a, b| gain(b).total_cmp(&gain(a)));
    let excess: Vec<f64> =
        (0..n).map(|j| (before_rms[j].powi(2) - noise[j].powi(2)).max(0.0) * search.layout.joint_count(j)).collect();
    let detected = !findings.is_empty();
    let black: Vec<f64> =
        (0..n).map(|j| (base_box.after[j] / search.layout.joint_count(j).max(1.0)).sqrt().min(before_rms[j])).collect();
    let total_gain = search.compare(&selection.state, &before.fit, &selection.state.fit, Vec::new()).gain;
    let mut out = Findings {
        schema: SCHEMA.into(),
        robot: scene.robot.name.clone(),
        recordings: scene.names.clone(),
        joints: scene.robot.joints.clone(),
        baseline: Baseline {
            rms_nm: before_rms.clone(),
            relative_error: relative(&before_rms, &size),
            noise_floor_nm: noise.clone(),
        },
        mismatch: Mismatch {
            detected,
            significance: if detected { (-total_gain.clamp(0.0, 600.0)).exp() } else { 1.0 },
            r#where: if detected { search.locate(&ctx, &base_residual, &excess, &findings) } else { Vec::new() },
        },
        held_out: HeldOut {
            relative_before: relative(&before_rms, &size),
            relative_after: relative(&after_rms, &size),
            black_box_relative: relative(&black, &size),
            before_rms_nm: before_rms,
            after_rms_nm: after_rms.clone(),
        },
        unknown,
        excluded: excluded(m),
        repairs: scene.repairs.clone(),
        next_experiment: next_experiment(&findings),
        verdict: String::new(),
        findings,
    };
    out.verdict = words::verdict(&out);
    Some(Outcome { findings: out, model: model_file(m, &ctx, after_rms), proof, nulls: m.search.nulls(m.selection) })
}

/// Held-out power that a finding removes.
fn gain(f: &Finding) -> f64 {
    f.held_out.before_rms_nm.powi(2) - f.held_out.after_rms_nm.powi(2)
}

/// Findings of the terms in the model, one per effect.
fn named(m: &Material<'_>, ctx: &Context<'_>, proof: &mut Vec<(&'static str, Evidence)>) -> Option<Vec<Finding>> {
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
        let without = m.search.fit_without(model, &m.selection.state, &all)?;
        let held_out = reduction(m, &without, &where_);
        let nats = m.search.compare(&m.selection.state, &without, &m.selection.state.fit, Vec::new()).gain;
        let group: Vec<String> = family.group().iter().map(|s| (*s).to_owned()).collect();
        let evidence = evidence(m, family.id(), nats, &where_, &group);
        let rivals = m.selection.rivals.iter().find(|r| r.effect == family.id());
        let (probability, alternatives) = m.calibration.probability(&evidence, rivals, &group);
        proof.push((family.id(), evidence));
        let parameters = all.iter().flat_map(|i| parameters(m, ctx, *i, names.len() > 1)).collect();
        let mut finding = Finding {
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
            stage: family.effect.stage.as_str().to_owned(),
            intervals_s: all.iter().flat_map(|i| intervals(m, &model.atoms[*i])).collect(),
        };
        finding.sentence = words::sentence(&finding, m.scene.robot.torque_unit.symbol());
        out.push(finding);
    }
    Some(out)
}

/// What speaks for an effect: what is lost without it, its lead, and what the model leaves at its joints.
fn evidence(m: &Material<'_>, id: &str, nats: f64, joints: &[usize], group: &[String]) -> Evidence {
    let rivals = m.selection.rivals.iter().find(|r| r.effect == id);
    let best = rivals
        .into_iter()
        .flat_map(|r| r.others.iter().filter(|o| !group.iter().any(|g| g == o.0)).map(|o| r.merit - o.1))
        .fold(10.0 * MOST_MARGIN, f64::min);
    let left = rms(m.search, &m.selection.state.fit);
    let over = |j: &usize| left[*j] / m.search.limits.noise_nm[*j].max(1e-30);
    Evidence { nats, margin: best, left: joints.iter().map(over).fold(1.0, f64::max) }
}

/// Held-out residual with and without some terms at `joints`, its interval by bootstrap over folds.
fn reduction(m: &Material<'_>, without: &Fit, joints: &[usize]) -> Reduction {
    let with = &m.selection.state.fit;
    let pick = |fit: &Fit| -> Vec<f64> { fit.held_out.iter().map(|f| joints.iter().map(|j| f[*j]).sum()).collect() };
    let (a, b) = (pick(with), pick(without));
    let count: f64 = joints.iter().map(|j| m.search.layout.joint_count(*j)).sum::<f64>().max(1.0);
    let share = |rows: &[usize]| {
        let (x, y): (f64, f64) = rows.iter().fold((0.0, 0.0), |s, r| (s.0 + a[*r], s.1 + b[*r]));
        1.0 - (x / y.max(1e-30)).sqrt()
    };
    let all: Vec<usize> = (0..a.len()).collect();
    let mut random = rand_pcg::Pcg64Mcg::seed_from_u64(m.seed);
    let mut draws: Vec<f64> =
        (0..400).map(|_| share(&(0..a.len()).map(|_| random.random_range(0..a.len())).collect::<Vec<_>>())).collect();
    Reduction {
        before_rms_nm: (b.iter().sum::<f64>() / count).sqrt(),
        after_rms_nm: (a.iter().sum::<f64>() / count).sqrt(),
        reduction: share(&all),
        ci95: [stats::quantile_in_place(&mut draws, 0.025), stats::quantile_in_place(&mut draws, 0.975)],
    }
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
            .rev()
            .find(|p| t >= p.global_s - 0.1)
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
    let before = (rest.before[worst] / count(worst)).sqrt();
    let after = (rest.after[worst].min(rest.before[worst]) / count(worst)).sqrt();
    let region = found
        .as_ref()
        .map_or_else(String::new, |f| format!(", mostly at {} {:.3} to {:.3}", f.2.variable, f.2.low, f.2.high));
    let finding = Finding {
        effect: "unknown".into(),
        joints: vec![joint.clone()],
        probability: m.calibration.unknown,
        status: "unknown".into(),
        alternatives: Vec::new(),
        group: Vec::new(),
        equation: String::new(),
        sentence: format!(
            "Joint {joint} has a torque of {size:.3} {} that no effect of the catalogue explains{region}; {} on recordings it was not fitted to.",
            m.scene.robot.torque_unit.symbol(),
            if by_box { "a black box predicts it" } else { "a black box does not predict it either" }
        ),
        parameters: Vec::new(),
        held_out: Reduction {
            before_rms_nm: before,
            after_rms_nm: after,
            reduction: 1.0 - after / before.max(1e-30),
            ci95: [0.0, 1.0],
        },
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
        let a = f.alternatives.iter().find(|a| a.probability > 0.1)?;
        Some((f, a.effect.clone()))
    });
    if let Some((f, other)) = open {
        return Some(NextExperiment {
            separate: vec![f.effect.clone(), other.clone()],
            words: format!("lacuna excite --separate {},{other}: {}", f.effect, advice(&f.effect)),
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
