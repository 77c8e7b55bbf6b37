//! From the selected model to findings and model file.

use crate::Outcome;
use crate::base::Base;
use crate::findings::*;
use crate::scene::Scene;
use crate::search::{BaseRole, Model, Search};
use crate::select::{Selection, context};
use lacuna_estimation::filter::noise_sd;
use lacuna_estimation::stats;
use lacuna_interfaces::ModelFile;
use lacuna_interfaces::model::{FrictionModel, NoiseModel, Term};

/// What the torque's white noise leaves in the band, per joint [Nm].
pub fn noise_floor(scene: &Scene) -> Vec<f64> {
    // Noise power of the zero-phase filter (order 4, twice): 0.45 of what a brick wall at twice the band has.
    let share = (0.93 * 2.0 * scene.band_hz / scene.rate_hz).min(1.0).sqrt();
    (0..scene.joints)
        .map(|j| {
            let mut all: Vec<f64> = scene.pieces.iter().filter_map(|p| noise_sd(&p.tau[j]).ok()).collect();
            stats::median_in_place(&mut all) * share
        })
        .collect()
}

/// Everything `diagnose` returns.
pub fn outcome(scene: &Scene, base: &Base, search: &Search<'_>, selection: &Selection) -> Option<Outcome> {
    let n = scene.joints;
    let mut empty = Model { base: base.columns.clone(), clamped: Vec::new(), atoms: Vec::new() };
    let before = search.fit(&mut empty)?;
    let count = |j: usize| search.layout.joint_count(j).max(1.0);
    let rms = |fit: &crate::gram::Fit| (0..n).map(|j| (fit.held_out_joint(j) / count(j)).sqrt()).collect::<Vec<f64>>();
    let before_rms = rms(&before.fit);
    let after_rms = rms(&selection.state.fit);
    let size: Vec<f64> =
        (0..n).map(|j| (base.torque.part[j].iter().map(|v| v * v).sum::<f64>() / count(j)).sqrt()).collect();
    let relative = |r: &[f64]| {
        let share: f64 = r.iter().zip(&size).map(|(r, s)| (r / s.max(1e-12)).powi(2)).sum();
        (share / n as f64).sqrt()
    };
    let ctx = context(scene, base, search, &selection.model, Some(&selection.state));
    let mut findings: Vec<Finding> = Vec::new();
    let mut terms = Vec::new();
    for (i, atom) in selection.model.atoms.iter().enumerate() {
        let family = &search.families[atom.family];
        let slots = selection.model.slots(i);
        let amplitude = &selection.state.fit.beta[slots];
        let parameters = family.parameters(&ctx, atom.joint, &atom.shape, amplitude);
        let joints: Vec<String> = family.joints(atom.joint).iter().map(|j| scene.robot.joints[*j].clone()).collect();
        let loss = search.compare(
            &selection.state,
            &search.without(&selection.model, &selection.state, i)?,
            &selection.state.fit,
            Vec::new(),
        );
        terms.push(Term { effect: family.id().to_owned(), joints: joints.clone(), parameters: parameters.clone() });
        let list = parameters.iter().map(|(s, v)| Parameter {
            symbol: s.clone(),
            unit: family.effect.parameters.iter().find(|p| p.symbol == s).map_or("", |p| p.unit).to_owned(),
            value: *v,
            ci95: [*v, *v],
            joint: joints.first().cloned(),
        });
        let probability = 1.0 / (1.0 + (-loss.gain / 20.0).exp());
        match findings.iter_mut().find(|f| f.effect == family.id()) {
            Some(f) => {
                f.joints.extend(joints.iter().filter(|j| !f.joints.contains(j)).cloned().collect::<Vec<_>>());
                f.parameters.extend(list);
                f.held_out.reduction += loss.gain;
            }
            None => findings.push(Finding {
                effect: family.id().to_owned(),
                parameters: list.collect(),
                joints,
                probability,
                status: if family.group().len() > 1 { "group" } else { "named" }.into(),
                alternatives: Vec::new(),
                group: family.group().iter().map(|s| (*s).to_owned()).collect(),
                equation: family.effect.law.to_owned(),
                sentence: family.effect.title.to_owned(),
                held_out: Reduction { before_rms_nm: 0.0, after_rms_nm: 0.0, reduction: loss.gain, ci95: [0.0, 0.0] },
                stage: family.effect.stage.as_str().to_owned(),
                intervals_s: Vec::new(),
            }),
        }
    }
    findings.sort_by(|a, b| b.held_out.reduction.total_cmp(&a.held_out.reduction));
    let mut friction = FrictionModel { f_v: vec![0.0; n], f_c: vec![0.0; n], ..FrictionModel::default() };
    for (slot, i) in selection.model.free_base().into_iter().enumerate() {
        let v = selection.state.fit.beta[slot];
        match selection.model.base[i].role {
            BaseRole::Viscous(j) => friction.f_v[j] = v,
            BaseRole::Coulomb(j) => friction.f_c[j] = v,
            _ => {}
        }
    }
    let mut model = ModelFile::nominal(&scene.robot);
    model.friction = friction;
    model.terms = terms;
    model.noise = NoiseModel { sd_tau_nm: after_rms.clone(), sd_q_rad: Vec::new() };
    let verdict = if findings.is_empty() { "Nothing is missing beyond noise and tolerances.".to_owned() } else { String::new() };
    let findings = Findings {
        schema: SCHEMA.into(),
        robot: scene.robot.name.clone(),
        recordings: scene.names.clone(),
        joints: scene.robot.joints.clone(),
        baseline: Baseline { rms_nm: before_rms.clone(), relative_error: relative(&before_rms), noise_floor_nm: noise_floor(scene) },
        mismatch: Mismatch { detected: !findings.is_empty(), significance: 1.0, r#where: Vec::new() },
        held_out: HeldOut {
            relative_before: relative(&before_rms),
            relative_after: relative(&after_rms),
            before_rms_nm: before_rms,
            after_rms_nm: after_rms,
            black_box_relative: f64::NAN,
        },
        unknown: Unknown { flag: false, share: 0.0, r#where: None, map: None, expression: None },
        excluded: Vec::new(),
        repairs: scene.repairs.clone(),
        next_experiment: None,
        verdict,
        findings,
    };
    Some(Outcome { findings, model })
}
