//! `lacuna excite`: a motion after which the parameters are known best, or on which two explanations of a mismatch
//! differ most, within the robot's limits.

use crate::progress::Progress;
use crate::words::line;
use crate::{CommandResult, words};
use clap::Args;
use lacuna_identify::excite::{
    ExciteOptions, Explanation, Separation, Trajectory, excite as design, separate as design_separation,
};
use lacuna_interfaces::robot::Limits;
use lacuna_interfaces::{BadInput, ModelFile};
use lacuna_stage::Failure;
use serde::Deserialize;
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Evidence above which an explanation is taken to be settled [nats]: 150 to 1 (Kass and Raftery 1995).
const DECISIVE: f64 = 5.0;

#[derive(Args)]
pub struct ExciteArgs {
    /// Robot file; its [limits] hold unless --limits says otherwise.
    #[arg(long, value_name = "FILE")]
    robot: PathBuf,
    /// TOML with q_min_rad, q_max_rad, qd_max_rad_s, qdd_max_rad_s2 (one value, or one per joint) and, optionally,
    /// workspace_m = [[x, y, z], [x, y, z]], the corners of a box the tip must stay in.
    #[arg(long, value_name = "FILE")]
    limits: Option<PathBuf>,
    /// Design the motion that best separates these two effects of the catalogue, as in stribeck,viscous_power; needs
    /// --model. Both act on the same joints: those of --joints, else of the model's term or the finding.
    #[arg(long, value_name = "A,B", value_delimiter = ',', num_args = 1.., requires = "model")]
    separate: Vec<String>,
    /// Model file: base, friction, noise, and the parameters of its terms.
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// findings.json of `lacuna diagnose`: joints and parameters of the findings.
    #[arg(long, value_name = "FILE", requires = "separate")]
    findings: Option<PathBuf>,
    /// Joints that both effects act on (comma-separated names).
    #[arg(long, value_name = "JOINT", value_delimiter = ',', requires = "separate")]
    joints: Vec<String>,
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
    workspace_m: Option<Workspace>,
}

/// Lowest and highest corner of where the tip may go [m].
type Workspace = [[f64; 3]; 2];

fn limits(path: &Path) -> Result<(Limits, Option<Workspace>), BadInput> {
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
    let mut options = ExciteOptions {
        limits,
        workspace_m,
        period_s: args.period,
        harmonics: args.harmonics,
        candidates: args.candidates,
        seed: args.seed,
        ..ExciteOptions::default()
    };
    let model = match &args.model {
        Some(path) => Some(lacuna_recording::load_model(path, &loaded.file)?.0),
        None => None,
    };
    if let (Some(model), false) = (&model, args.separate.is_empty()) {
        let pair = explanations(args, model)?;
        let progress = Progress::bar();
        let found = design_separation(
            &loaded.file,
            loaded.urdf.as_deref(),
            body.as_ref(),
            model,
            &pair,
            &options,
            &mut |share| progress.at(share, "trying motions"),
        )?;
        drop(progress);
        write(&found.motion, &args.out, args.rate)?;
        return show(args, &found);
    }
    if let Some(model) = &model {
        options.sd_tau_nm = model.noise.sd_tau_nm.clone();
    }
    let progress = Progress::bar();
    let motion = design(&loaded.file, body.as_ref(), &options, &mut |share| progress.at(share, "trying motions"))?;
    drop(progress);
    write(&motion.motion, &args.out, args.rate)?;
    if args.json {
        words::print_json(&motion)?;
        return Ok(ExitCode::SUCCESS);
    }
    line(format_args!(
        "A motion of {} s within the limits; {} of the motions tried were within reach.",
        motion.motion.period_s, motion.feasible
    ))?;
    line(format_args!("                      random motion   designed motion"))?;
    line(format_args!("condition number      {:>13.1}   {:>15.1}", motion.before.condition, motion.after.condition))?;
    line(format_args!("log det information   {:>13.2}   {:>15.2}", motion.before.log_det, motion.after.log_det))?;
    line(format_args!(
        "Standard errors of the parameters shrink to 1/{:.2} of the random motion's (geometric mean).",
        motion.error_ratio
    ))?;
    line(format_args!("File: {}", args.out.display()))?;
    Ok(ExitCode::SUCCESS)
}

/// The two explanations: joints and parameters of the model's term or of the finding, where there is one.
fn explanations(args: &ExciteArgs, model: &ModelFile) -> Result<[Explanation; 2], Failure> {
    let [a, b] = args.separate.as_slice() else {
        let found = args.separate.join(",");
        return Err(Failure::usage(format!("--separate {found}: expected two effects, as in stribeck,viscous_power")));
    };
    let mut known: Vec<Explanation> = model
        .terms
        .iter()
        .map(|t| Explanation { effect: t.effect.clone(), joints: t.joints.clone(), parameters: t.parameters.clone() })
        .collect();
    if let Some(path) = &args.findings {
        known.extend(findings(path)?);
    }
    let mut pair = [a, b].map(|effect| {
        let found = known.iter().find(|k| &k.effect == effect).cloned();
        found.unwrap_or(Explanation { effect: effect.clone(), ..Explanation::default() })
    });
    if !args.joints.is_empty() {
        for e in &mut pair {
            e.joints = args.joints.clone();
        }
    }
    // What is known of one place holds for both explanations of it.
    let [a, b] = &mut pair;
    if a.joints.is_empty() {
        a.joints = b.joints.clone();
    } else if b.joints.is_empty() {
        b.joints = a.joints.clone();
    }
    Ok(pair)
}

/// Part of findings.json that matters here.
#[derive(Deserialize)]
struct Findings {
    findings: Vec<Finding>,
}

#[derive(Deserialize)]
struct Finding {
    effect: String,
    joints: Vec<String>,
    parameters: Vec<Parameter>,
}

#[derive(Deserialize)]
struct Parameter {
    symbol: String,
    value: f64,
}

fn findings(path: &Path) -> Result<Vec<Explanation>, BadInput> {
    let text = lacuna_recording::files::read_text(path)?;
    let read: Findings = serde_json::from_str(&text)
        .map_err(|e| BadInput::new(format!("{e}; expected findings.json of lacuna diagnose")).in_file(path))?;
    let explanation = |f: Finding| Explanation {
        effect: f.effect,
        joints: f.joints,
        parameters: f.parameters.into_iter().map(|p| (p.symbol, p.value)).collect(),
    };
    Ok(read.findings.into_iter().map(explanation).collect())
}

/// What `--separate` found, in words or as JSON.
fn show(args: &ExciteArgs, found: &Separation) -> CommandResult {
    if args.json {
        words::print_json(found)?;
        return Ok(ExitCode::SUCCESS);
    }
    line(format_args!(
        "A motion of {} s within the limits; {} of the motions tried were within reach.",
        found.motion.period_s, found.feasible
    ))?;
    for e in &found.explanations {
        let values: Vec<String> = e.parameters.iter().map(|(s, v)| format!("{s} = {v:.4}")).collect();
        let place = if e.joints.is_empty() { String::new() } else { format!(" on {}", e.joints.join(", ")) };
        line(format_args!("  {}{place}: {}", e.effect, values.join(", ")))?;
    }
    let [a, b] = &found.explanations;
    line(format_args!("Expected evidence for the truth, per period [nats]   usual excitation   designed motion"))?;
    for (true_one, other, before, after) in
        [(a, b, found.before.first, found.after.first), (b, a, found.before.second, found.after.second)]
    {
        let what = format!("{} true, against {}", true_one.effect, other.effect);
        line(format_args!("  {what:<48} {before:>18.1}   {after:>15.1}"))?;
    }
    if found.after.least() < DECISIVE {
        line(format_args!(
            "Even on this motion the two remain hard to tell apart ({:.1} nats): repeat it, or take a longer --period.",
            found.after.least()
        ))?;
    }
    line(format_args!("File: {}", args.out.display()))?;
    Ok(ExitCode::SUCCESS)
}

fn write(motion: &Trajectory, path: &Path, rate: f64) -> Result<(), Failure> {
    let fail = |e| words::cannot_write(path, &e);
    let mut out = BufWriter::new(std::fs::File::create(path).map_err(fail)?);
    motion.write_csv(rate, &mut out).map_err(fail)?;
    std::io::Write::flush(&mut out).map_err(fail)
}
