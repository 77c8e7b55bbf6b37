//! `lacuna excite`: a motion after which the parameters are known best, within the robot's limits.

use crate::CommandResult;
use crate::progress::Progress;
use clap::Args;
use lacuna_identify::excite::{Excitation, ExciteOptions, excite as design};
use lacuna_interfaces::BadInput;
use lacuna_interfaces::robot::Limits;
use lacuna_stage::Failure;
use serde::Deserialize;
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

#[derive(Args)]
pub struct ExciteArgs {
    /// Robot file; its [limits] hold unless --limits says otherwise.
    #[arg(long, value_name = "FILE")]
    robot: PathBuf,
    /// TOML with q_min_rad, q_max_rad, qd_max_rad_s, qdd_max_rad_s2 (one value, or one per joint) and, optionally,
    /// workspace_m = [[x, y, z], [x, y, z]], the corners of a box the tip must stay in.
    #[arg(long, value_name = "FILE")]
    limits: Option<PathBuf>,
    /// Where to write the motion: CSV with t, q, qd, qdd.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Period of the motion [s].
    #[arg(long, default_value_t = ExciteOptions::default().period_s)]
    period: f64,
    /// Harmonics per joint.
    #[arg(long, default_value_t = ExciteOptions::default().harmonics)]
    harmonics: usize,
    /// Candidates tried.
    #[arg(long, default_value_t = ExciteOptions::default().candidates)]
    candidates: usize,
    /// Sample rate of the CSV [Hz].
    #[arg(long, default_value_t = 1000.0)]
    rate: f64,
    /// Seed of the search.
    #[arg(long, default_value_t = ExciteOptions::default().seed)]
    seed: u64,
    /// Print coefficients and quality as JSON.
    #[arg(long)]
    json: bool,
}

/// A limits file: the robot file's `[limits]` keys at top level, and the workspace.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct LimitsFile {
    q_min_rad: Option<lacuna_interfaces::robot::PerJoint>,
    q_max_rad: Option<lacuna_interfaces::robot::PerJoint>,
    qd_max_rad_s: Option<lacuna_interfaces::robot::PerJoint>,
    qdd_max_rad_s2: Option<lacuna_interfaces::robot::PerJoint>,
    workspace_m: Option<[[f64; 3]; 2]>,
}

fn limits(path: &Path) -> Result<(Limits, Option<[[f64; 3]; 2]>), BadInput> {
    let text = lacuna_recording::files::read_text(path)?;
    let file: LimitsFile = toml::from_str(&text).map_err(|e| BadInput::from_toml(&e, &text).in_file(path))?;
    let limits = Limits {
        q_min_rad: file.q_min_rad,
        q_max_rad: file.q_max_rad,
        qd_max_rad_s: file.qd_max_rad_s,
        qdd_max_rad_s2: file.qdd_max_rad_s2,
    };
    Ok((limits, file.workspace_m))
}

/// `lacuna excite`.
pub fn excite(args: &ExciteArgs) -> CommandResult {
    if !(args.rate.is_finite() && args.rate > 0.0 && args.rate <= 1e6) {
        return Err(Failure::usage(format!("--rate {}: expected a positive number up to 1e6", args.rate)));
    }
    let loaded = lacuna_recording::load_robot(&args.robot)?;
    let body = lacuna_physics::build(&loaded.file, loaded.urdf.as_deref()).map_err(|e| e.in_file(&args.robot))?;
    let (limits, workspace_m) = match &args.limits {
        Some(path) => limits(path)?,
        None => (Limits::default(), None),
    };
    let options = ExciteOptions {
        limits,
        workspace_m,
        period_s: args.period,
        harmonics: args.harmonics,
        candidates: args.candidates,
        seed: args.seed,
        ..ExciteOptions::default()
    };
    let progress = Progress::bar();
    let motion = design(&loaded.file, body.as_ref(), &options, &mut |share| progress.at(share, "trying motions"))?;
    drop(progress);
    write(&motion, &args.out, args.rate)?;
    if args.json {
        println!("{}", serde_json::to_string_pretty(&motion).map_err(|e| Failure::run(e.to_string()))?);
        return Ok(ExitCode::SUCCESS);
    }
    println!(
        "A motion of {} s within the limits; {} of the motions tried were within reach.",
        motion.period_s, motion.feasible
    );
    println!("                      random motion   designed motion");
    println!("condition number      {:>13.1}   {:>15.1}", motion.before.condition, motion.after.condition);
    println!("log det information   {:>13.2}   {:>15.2}", motion.before.log_det, motion.after.log_det);
    println!(
        "Standard errors of the parameters shrink to 1/{:.2} of the random motion's (geometric mean).",
        motion.error_ratio
    );
    println!("File: {}", args.out.display());
    Ok(ExitCode::SUCCESS)
}

fn write(motion: &Excitation, path: &Path, rate: f64) -> Result<(), Failure> {
    let fail = |e: std::io::Error| Failure::run(format!("{}: cannot be written: {e}", path.display()));
    let mut out = BufWriter::new(std::fs::File::create(path).map_err(fail)?);
    motion.write_csv(rate, &mut out).map_err(fail)?;
    std::io::Write::flush(&mut out).map_err(fail)
}
