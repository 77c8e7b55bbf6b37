//! `lacuna calibrate`: diagnoses simulated robots whose truth is known, and makes thresholds, probabilities and
//! intervals from what came out; or measures those that are built in.

use crate::progress::Progress;
use crate::{CommandResult, words};
use clap::Args;
use lacuna_diagnose::calibration::Calibration;
use lacuna_diagnose::calibration::cases::{CHECK_SEED, MAKE_SEED, WORDS, observe};
use lacuna_diagnose::calibration::fit::{self, Observation, Quality};
use lacuna_interfaces::BadInput;
use lacuna_simulate::case::PROOF_SEEDS_FROM;
use lacuna_stage::Failure;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Mutex;

#[derive(Args)]
pub struct CalibrateArgs {
    /// File for the calibration. services/diagnose/calibration.toml is built in at the next build.
    #[arg(long, value_name = "FILE", required_unless_present = "check")]
    out: Option<PathBuf>,
    /// Make nothing: measure the built-in calibration on robots it was not made from.
    #[arg(long, conflicts_with = "out")]
    check: bool,
    /// Simulated robots.
    #[arg(long, value_name = "N", default_value_t = 160)]
    cases: usize,
    /// First seed. Default: 500000; to check: 600000.
    #[arg(long)]
    seed: Option<u64>,
}

/// `lacuna calibrate`.
pub fn calibrate(args: &CalibrateArgs) -> CommandResult {
    if args.cases == 0 {
        return Err(BadInput::new("--cases: found 0; expected at least one").into());
    }
    let calibration = Calibration::built_in()?;
    let first = args.seed.unwrap_or(if args.check { CHECK_SEED } else { MAKE_SEED });
    if first.saturating_add(args.cases as u64) > PROOF_SEEDS_FROM {
        let what = format!(
            "--seed: found {first}; expected seeds below {PROOF_SEEDS_FROM}, from there on they are the proof's"
        );
        return Err(BadInput::new(what).into());
    }
    let progress = Mutex::new(Progress::bar());
    let seen = observe(first, args.cases, &calibration, &|count| {
        if let Ok(bar) = progress.lock() {
            bar.at(count as f64 / args.cases as f64, &format!("{count} of {} robots", args.cases));
        }
    });
    drop(progress);
    let Some(out) = &args.out else {
        return words::say(&summary(&fit::quality(&calibration, &seen), &seen, args.cases)).map(|()| ExitCode::SUCCESS);
    };
    let made = fit::fit(&seen);
    let body = toml::to_string(&made).map_err(|e| Failure::run(format!("calibration: {e}")))?;
    let header = format!(
        "# Made by `lacuna calibrate --cases {} --seed {first}`:\n# {WORDS}.\n# `lacuna calibrate --check` measures it.\n",
        args.cases
    );
    words::write(out, (header + &body).as_bytes())?;
    words::say(&format!("{}File: {}\n", summary(&fit::quality(&made, &seen), &seen, args.cases), out.display()))?;
    Ok(ExitCode::SUCCESS)
}

fn summary(q: &Quality, seen: &[Observation], cases: usize) -> String {
    let unknown = seen.iter().map(|o| o.unknown.len()).sum::<usize>();
    format!(
        "Robots diagnosed: {} of {cases}\n\
         Named effects: {}, of them right {} ({:.1} %); mean probability given {:.1} %\n\
         Calibration error of the probabilities: {:.3}\n\
         95 % intervals: {:.1} % of {} numbers inside\n\
         \"Unknown\" said: {unknown} times\n\
         Largest gain of an effect that is not missing: {:.2} of its threshold\n",
        seen.len(),
        q.named,
        q.right,
        100.0 * q.right as f64 / q.named.max(1) as f64,
        100.0 * q.mean_probability,
        q.calibration_error,
        100.0 * q.coverage,
        q.numbers,
        q.largest_null,
    )
}
