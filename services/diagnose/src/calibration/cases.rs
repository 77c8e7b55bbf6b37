//! Simulated robots whose truth is known, diagnosed: what a calibration is made from and measured on.

use super::fit::{Number, Observation};
use super::{Calibration, NumberKind, size};
use crate::findings::{Finding, Parameter};
use crate::{Conditioning, Options, Outcome, diagnose_with};
use lacuna_interfaces::robot::Kind;
use lacuna_physics::effects;
use lacuna_simulate::case::drawable;
use lacuna_simulate::effects::Class;
use lacuna_simulate::{CaseOptions, EffectTruth, Simulation, Truth, draw_case, simulate};
use rayon::prelude::*;
use std::sync::atomic::{AtomicUsize, Ordering};

/// First seed of the cases that a calibration is made from.
pub const MAKE_SEED: u64 = 500_000;
/// First seed of the cases that one is measured on.
pub const CHECK_SEED: u64 = 600_000;
/// What the cases are, in words.
pub const WORDS: &str = "simulated Deltas and serial arms: one in four without anything missing, three in eight with one \
                         effect, one in four with two, one in eight with an effect outside the catalogue; strengths 0.4 to \
                         1.6 of the usual, masses up to 3 % off";
/// Golden section: spreads mass errors evenly over the cases.
const SPREAD: f64 = 0.618_033_988_75;

/// Diagnoses `cases` robots from seed `first` on. `done` is told how many are.
pub fn observe(first: u64, cases: usize, calibration: &Calibration, done: &(dyn Fn(usize) + Sync)) -> Vec<Observation> {
    let count = AtomicUsize::new(0);
    (0..cases)
        .into_par_iter()
        .filter_map(|k| {
            let observation = one(first + k as u64, &case_options(k), calibration);
            done(count.fetch_add(1, Ordering::Relaxed) + 1);
            observation
        })
        .collect()
}

/// What the `k`-th robot is like.
fn case_options(k: usize) -> CaseOptions {
    let kind = if (k / 8) % 3 == 2 { Kind::Serial } else { Kind::Delta };
    let named: Vec<&str> =
        drawable(kind).into_iter().filter(|(_, class)| *class == Class::Catalogue).map(|(id, _)| id).collect();
    let single = named.get((k / 8 * 3 + k % 8) % named.len().max(1)).map(|id| (*id).to_owned());
    let (effects, ids, unknown) = match k % 8 {
        0 | 1 => (0, Vec::new(), false),
        2..=4 => (1, single.into_iter().collect(), false),
        5 | 6 => (2, Vec::new(), false),
        _ => (1, Vec::new(), true),
    };
    CaseOptions {
        kind,
        effects,
        ids,
        unknown,
        severity: [0.4, 1.6],
        mass_error: 0.03 * (k as f64 * SPREAD).fract(),
        ..CaseOptions::default()
    }
}

/// Draws, simulates and diagnoses a robot; `None` if it cannot be drawn or recorded.
fn one(seed: u64, options: &CaseOptions, calibration: &Calibration) -> Option<Observation> {
    let case = draw_case(seed, options).ok()?;
    let simulation = simulate(&case.robot, None, &case.config).ok()?;
    let request = Options {
        robot: case.robot,
        urdf: None,
        recordings: simulation.recordings.clone(),
        sim: Vec::new(),
        conditioning: Conditioning {
            start_s: simulation.manifest.files.iter().map(|f| f.start_time_s).collect(),
            ..Conditioning::default()
        },
        seed: 1,
    };
    let outcome = diagnose_with(&request, calibration, &mut |_, _| {}).ok()?;
    Some(observation(&outcome, &simulation, options.kind, calibration))
}

/// Whether a finding names this effect.
fn is_right(finding: &Finding, truth: &EffectTruth) -> bool {
    let name =
        truth.also_accept.contains(&finding.effect) || finding.effect == truth.id || finding.group.contains(&truth.id);
    let joints = &truth.joints;
    name && (finding.joints.is_empty() || joints.is_empty() || finding.joints.iter().any(|j| joints.contains(j)))
}

fn observation(outcome: &Outcome, simulation: &Simulation, kind: Kind, calibration: &Calibration) -> Observation {
    let truth: &Truth = &simulation.truth;
    let findings = &outcome.findings.findings;
    let said: Vec<&Finding> = findings.iter().filter(|f| f.effect != "unknown").collect();
    let right = |f: &&Finding| truth.effects.iter().any(|t| is_right(f, t));
    let named = outcome
        .proof
        .iter()
        .filter_map(|(id, evidence)| Some((*evidence, right(said.iter().find(|f| f.effect == *id)?))))
        .collect();
    let outside = truth.effects.iter().any(|t| !t.in_catalogue());
    let unknown = findings.iter().filter(|f| f.effect == "unknown").map(|_| outside).collect();
    let complete = truth.effects.iter().all(|t| said.iter().any(|f| is_right(f, t))) && said.iter().all(right);
    Observation {
        nulls: if complete { outcome.nulls.clone() } else { Vec::new() },
        named,
        unknown,
        numbers: truth
            .effects
            .iter()
            .flat_map(|t| said.iter().filter(|f| f.effect == t.id && is_right(f, t)).map(move |f| (*f, t)))
            .flat_map(|(f, t)| numbers(f, t, kind, calibration))
            .collect(),
    }
}

/// The numbers of a finding that the truth states. Orders and powers of a list are chosen, not measured.
fn numbers(finding: &Finding, truth: &EffectTruth, kind: Kind, calibration: &Calibration) -> Vec<Number> {
    const CHOSEN: [&str; 4] = ["h", "rho", "T_ref", "t_0"];
    let amplitude =
        |symbol: &str| effects::find(&truth.id).is_some_and(|e| e.amplitudes(kind).any(|a| a.symbol == symbol));
    let own = |p: &Parameter| p.joint.as_ref().is_none_or(|j| truth.joints.first().is_none_or(|t| t == j));
    let all: Vec<&Parameter> = finding.parameters.iter().filter(|p| own(p)).collect();
    let given: Vec<(&str, &str, f64)> = all.iter().map(|p| (p.symbol.as_str(), p.unit.as_str(), p.value)).collect();
    all.iter()
        .enumerate()
        .filter(|(_, p)| !CHOSEN.contains(&p.symbol.as_str()))
        // Of several orders of a ripple the truth is one: which is not said here.
        .filter(|(_, p)| given.iter().filter(|g| g.0 == p.symbol).count() == 1)
        .filter_map(|(i, p)| {
            let error = (p.value - truth.params.get(&p.symbol)?).abs();
            let half = 0.5 * (p.ci95[1] - p.ci95[0]);
            let kind = if amplitude(&p.symbol) { NumberKind::Amplitude } else { NumberKind::Shape };
            let size = size(&given, i, kind).max(1e-300);
            let law = calibration.law_error(&truth.id, &p.symbol, kind) * size;
            let statistics = (half * half - law * law).max(0.0);
            Some(Number {
                name: format!("{}.{}", truth.id, p.symbol),
                kind,
                distance: error / half.max(1e-300),
                beyond: (error * error - statistics).max(0.0).sqrt() / size,
            })
        })
        .collect()
}
