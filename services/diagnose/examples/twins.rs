//! Diagnoses simulated robots and holds the findings against what was simulated:
//! `cargo run --release -p lacuna-diagnose --example twins -- [--serial] [--cases N] [--effects K] [--unknown]
//! [--clean] [--ids a,b] [--severity LOW,HIGH] [--mass-error SHARE] [--seed S] [--verbose] [--no-masses]`.
//!
//! One line a case; at the end recall per effect, false alarms, wrong names, flagged unknowns.

use anyhow::{Context, bail};
use lacuna_diagnose::{Conditioning, Options, diagnose};
use lacuna_interfaces::robot::Kind;
use lacuna_simulate::case::{CaseOptions, draw_case, drawable};
use lacuna_simulate::effects::Class;
use lacuna_simulate::simulate;
use rayon::prelude::*;
use std::collections::BTreeMap;

struct Result1 {
    line: String,
    truth: Vec<(String, bool, bool)>,
    clean: bool,
    said: usize,
    wrong: usize,
    first: bool,
    unknown: bool,
    ratio: f64,
    seconds: f64,
}

fn main() -> anyhow::Result<()> {
    let mut options = CaseOptions::default();
    let (mut cases, mut seed, mut clean, mut ids) = (0, 1000u64, false, Vec::new());
    let mut how = How::default();
    let mut args = std::env::args().skip(1);
    while let Some(a) = args.next() {
        let mut value = || args.next().with_context(|| format!("{a}: found nothing; expected a value"));
        match a.as_str() {
            "--serial" => options.kind = Kind::Serial,
            "--cases" => cases = value()?.parse()?,
            "--effects" => options.effects = value()?.parse()?,
            "--unknown" => options.unknown = true,
            "--clean" => clean = true,
            "--verbose" => how.verbose = true,
            "--no-masses" => how.no_masses = true,
            "--ids" => ids = value()?.split(',').map(str::to_owned).collect(),
            "--severity" => {
                let v = value()?;
                let (low, high) = v.split_once(',').context("--severity: expected LOW,HIGH")?;
                options.severity = [low.parse()?, high.parse()?];
            }
            "--mass-error" => options.mass_error = value()?.parse()?,
            "--seed" => seed = value()?.parse()?,
            _ => bail!("{a}: unknown option"),
        }
    }
    if clean {
        options.effects = 0;
    }
    let all: Vec<(String, Class)> = drawable(options.kind).into_iter().map(|(i, c)| (i.to_owned(), c)).collect();
    // One effect: every id in turn, so that each class is seen; several: drawn.
    let list: Vec<CaseOptions> = (0..if cases == 0 { all.len() } else { cases })
        .map(|k| {
            let mut o = options.clone();
            if !ids.is_empty() {
                o.ids = vec![ids[k % ids.len()].clone()];
            } else if o.effects == 1 && !o.unknown {
                o.ids = vec![all[k % all.len()].0.clone()];
            }
            o
        })
        .collect();
    let results: Vec<Option<Result1>> =
        list.par_iter().enumerate().map(|(k, o)| one(seed + k as u64, o, how)).collect();
    summary(results.into_iter().flatten().collect());
    Ok(())
}

/// What is told, and what the diagnosis is not.
#[derive(Debug, Clone, Copy, Default)]
struct How {
    verbose: bool,
    /// The robot file gives no masses: the base is fitted freely.
    no_masses: bool,
}

fn one(seed: u64, options: &CaseOptions, how: How) -> Option<Result1> {
    let case = match draw_case(seed, options) {
        Ok(c) => c,
        Err(e) => {
            println!("{seed} not drawn: {e}");
            return None;
        }
    };
    let simulation = match simulate(&case.robot, None, &case.config) {
        Ok(s) => s,
        Err(e) => {
            println!("{seed} not simulated: {e}");
            return None;
        }
    };
    let clock = std::time::Instant::now();
    let mut given = case.robot.clone();
    if how.no_masses {
        for link in &mut given.link {
            (link.mass, link.inertia, link.rotor_inertia) = (0.0, [0.0; 6], 0.0);
        }
    }
    let request = Options {
        robot: given,
        urdf: None,
        recordings: simulation.recordings.clone(),
        sim: Vec::new(),
        conditioning: Conditioning {
            start_s: simulation.manifest.files.iter().map(|f| f.start_time_s).collect(),
            ..Conditioning::default()
        },
        seed: 1,
    };
    let outcome = diagnose(&request, &mut |_, what| {
        if how.verbose {
            eprintln!("{seed} {what}");
        }
    });
    let truth = &simulation.truth;
    let findings = match outcome {
        Ok(o) => o.findings,
        Err(e) => {
            println!("{seed} refused: {e}");
            return None;
        }
    };
    // Effect names that are right for each true effect.
    let right: Vec<Vec<String>> = truth
        .effects
        .iter()
        .map(|t| {
            let mut names = t.also_accept.clone();
            names.push(if t.in_catalogue() { t.id.clone() } else { "unknown".to_owned() });
            names
        })
        .collect();
    let ok = |f: &lacuna_diagnose::findings::Finding, t: usize| {
        right[t].contains(&f.effect) || f.group.contains(&truth.effects[t].id)
    };
    let unknown = findings.findings.iter().any(|f| f.effect == "unknown") || findings.unknown.flag;
    let oracle = &truth.oracle.from_csv_rms_40hz;
    let norm = |v: &[f64]| v.iter().map(|x| x * x).sum::<f64>().sqrt();
    let line = format!(
        "{seed} truth {:?} said {:?} after/oracle {:.2} base/oracle {:.1} dof {}",
        truth.effects.iter().map(|e| format!("{}{:?}", e.id, e.joints)).collect::<Vec<_>>(),
        findings
            .findings
            .iter()
            .map(|f| format!("{}{:?} {:.2}", f.effect, f.joints, f.probability))
            .collect::<Vec<_>>(),
        norm(&findings.held_out.after_rms_nm) / norm(oracle),
        norm(&findings.held_out.before_rms_nm) / norm(oracle),
        case.robot.joint_count(),
    );
    let found: Vec<(String, bool, bool)> = truth
        .effects
        .iter()
        .enumerate()
        .map(|(i, t)| {
            let hit = findings.findings.iter().any(|f| ok(f, i)) || (!t.in_catalogue() && unknown);
            (t.id.clone(), t.in_catalogue(), hit)
        })
        .collect();
    let wrong =
        findings.findings.iter().filter(|f| f.effect != "unknown" && !(0..right.len()).any(|t| ok(f, t))).count();
    let first = findings.findings.first().is_some_and(|f| (0..right.len()).any(|t| ok(f, t)));
    println!(
        "{} {line}",
        if truth.effects.is_empty() {
            if findings.findings.is_empty() { "ok  " } else { "ALARM" }
        } else if first && wrong == 0 && found.iter().all(|f| f.2) {
            "HIT "
        } else {
            "miss"
        }
    );
    Some(Result1 {
        clean: truth.effects.is_empty(),
        said: findings.findings.len(),
        truth: found,
        wrong,
        first,
        unknown,
        ratio: norm(&findings.held_out.after_rms_nm) / norm(oracle),
        line,
        seconds: clock.elapsed().as_secs_f64(),
    })
}

fn summary(results: Vec<Result1>) {
    let mut per: BTreeMap<String, [usize; 2]> = BTreeMap::new();
    for (id, _, hit) in results.iter().flat_map(|r| &r.truth) {
        let p = per.entry(id.clone()).or_default();
        p[0] += usize::from(*hit);
        p[1] += 1;
    }
    for (id, [hit, all]) in &per {
        println!("  {id:20} {hit}/{all}");
    }
    let clean: Vec<&Result1> = results.iter().filter(|r| r.clean).collect();
    let other: Vec<&Result1> = results.iter().filter(|r| !r.clean).collect();
    let catalogue = |r: &&&Result1| r.truth.iter().all(|t| t.1);
    let mut ratio: Vec<f64> = other.iter().map(|r| r.ratio).collect();
    ratio.sort_by(f64::total_cmp);
    println!(
        "clean with alarm {}/{} | top-1 {}/{} | recall {}/{} | wrong names {}/{} | unknown flagged {}/{} | catalogue called unknown {}/{} | after/oracle median {:.2} | {:.1} s a case",
        clean.iter().filter(|r| r.said > 0).count(),
        clean.len(),
        other.iter().filter(|r| r.first).count(),
        other.len(),
        other.iter().flat_map(|r| &r.truth).filter(|t| t.2).count(),
        other.iter().map(|r| r.truth.len()).sum::<usize>(),
        other.iter().map(|r| r.wrong).sum::<usize>(),
        other.iter().map(|r| r.said).sum::<usize>(),
        other.iter().flat_map(|r| &r.truth).filter(|t| !t.1 && t.2).count(),
        other.iter().flat_map(|r| &r.truth).filter(|t| !t.1).count(),
        other.iter().filter(catalogue).filter(|r| r.unknown).count(),
        other.iter().filter(catalogue).count(),
        ratio.get(ratio.len() / 2).copied().unwrap_or(f64::NAN),
        results.iter().map(|r| r.seconds).sum::<f64>() / results.len().max(1) as f64,
    );
    let _ = results.iter().map(|r| r.line.len()).sum::<usize>();
}
