//! `lacuna identify`: from recordings to a model, its account and its report.

use crate::payload::{self, CarriedArgs};
use crate::progress::Progress;
use crate::result::{self, Job};
use crate::result_rows::{self, Origin};
use crate::{CommandResult, identify_report, words};
use clap::Args;
use lacuna_identify::condition::Conditioning;
use lacuna_identify::forward::Predicted;
use lacuna_identify::outcome::{Identification, NotExcited, ParameterRow};
use lacuna_identify::paper::PaperResult;
use lacuna_identify::urdf::model_urdf;
use lacuna_identify::{Delay, FileRange, Options, Outcome, Signal};
use lacuna_interfaces::BadInput;
use lacuna_recording::LoadedRobot;
use lacuna_report::number::{percent, significant};
use lacuna_stage::Failure;
use serde::Serialize;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

#[derive(Args, Serialize)]
pub struct IdentifyArgs {
    /// Robot file.
    #[arg(long, value_name = "FILE")]
    #[serde(skip)]
    robot: PathBuf,
    /// Folder for model.toml, identification.json, report.html and result.parquet. A complete result of the same
    /// recordings, options and program that is there already is left as it is.
    #[arg(long, value_name = "DIR")]
    #[serde(skip)]
    out: PathBuf,
    /// Recordings (CSV, MCAP or ROS 2 bag); every one is held out in turn.
    #[arg(value_name = "RECORDING")]
    #[serde(skip)]
    recordings: Vec<PathBuf>,
    /// Recordings, or parts of them in seconds, to train on: FILE, FILE@from:to.
    #[arg(long, num_args = 1.., value_name = "FILE[@from:to]")]
    train: Vec<String>,
    /// Recordings, or parts of them, to test on.
    #[arg(long, num_args = 1.., value_name = "FILE[@from:to]")]
    test: Vec<String>,
    /// How to hold out: recordings, halves or kfold=N. Default: by recording; halves of time for a single one.
    #[arg(long, value_name = "HOW")]
    holdout: Option<String>,
    /// pooled: all parameters of all joints in one weighted, robust fit; paper: the paper's grid search and averages.
    #[arg(long, default_value = "pooled")]
    method: String,
    /// motor: the torque columns; motor-minus-link: less the torque sensor's, which leaves friction and rotors.
    #[arg(long, default_value = "motor")]
    signal: String,
    /// A joint counts as moving above this speed [rad/s]; 0 counts every sample.
    #[arg(long, value_name = "RAD_S", default_value_t = Conditioning::default().moving_rad_s, allow_negative_numbers = true)]
    moving: f64,
    /// Band in which torque and model are compared [Hz]. Default: from the sampling rate.
    #[arg(long, value_name = "HZ", allow_negative_numbers = true)]
    band: Option<f64>,
    /// Low-pass on positions and torques before differentiation [Hz]. Default: twice the band.
    #[arg(long, value_name = "HZ", allow_negative_numbers = true)]
    position_band: Option<f64>,
    /// Time left out at both ends of every recording, where filters start [s]. Default: two periods of the band, at most a
    /// tenth of the recording.
    #[arg(long, value_name = "SECONDS", allow_negative_numbers = true)]
    cut: Option<f64>,
    /// Rate that irregular recordings are brought to [Hz]. Default: that of the median step.
    #[arg(long, value_name = "HZ", allow_negative_numbers = true)]
    rate: Option<f64>,
    /// Fit with positive definite pseudo-inertias, and say what that costs; of a URDF robot, model.urdf is the input with
    /// these inertials.
    #[arg(long)]
    consistent: bool,
    /// Delay between torque and position: estimate, off, or seconds.
    #[arg(long, default_value = "estimate", allow_hyphen_values = true)]
    delay: String,
    /// Instruments against encoder noise in the accelerations: auto, on, off, or command (from the commanded motion, where
    /// recordings have it).
    #[arg(long, default_value = "auto")]
    instruments: String,
    /// Samples this many robust standard deviations off their neighbours are spikes; 0 keeps all.
    #[arg(long, value_name = "SIGMAS", default_value_t = Conditioning::default().spike_threshold, allow_negative_numbers = true)]
    spikes: f64,
    /// Plain least squares: no bound on the influence of outliers.
    #[arg(long)]
    no_robust: bool,
    /// Let Coulomb friction change sign at once, not over a small movement.
    #[arg(long)]
    no_bristle: bool,
    /// Recordings with a payload, kept out of the fit: its mass over time, and the torque error without and with it (the
    /// paper's Table 2 and Fig. 8).
    #[arg(long, num_args = 1.., value_name = "FILE")]
    #[serde(skip)]
    payload: Vec<PathBuf>,
    #[command(flatten)]
    carried: CarriedArgs,
    /// Length of a block of time behind the intervals [s]. Default: from the amount of data.
    #[arg(long, value_name = "SECONDS", allow_negative_numbers = true)]
    block: Option<f64>,
    /// What to call this set in result.parquet: a serial number, a cell, a date.
    #[arg(long, value_name = "TEXT")]
    label: Option<String>,
    /// Do it again even if a complete result is there.
    #[arg(long)]
    #[serde(skip)]
    force: bool,
    /// Print identification.json on standard output, in place of the summary.
    #[arg(long)]
    #[serde(skip)]
    json: bool,
}

impl IdentifyArgs {
    fn options(&self) -> Result<Options, BadInput> {
        let ranges = |list: &[String]| list.iter().map(|text| text.parse()).collect::<Result<Vec<FileRange>, _>>();
        Ok(Options {
            robot: self.robot.clone(),
            recordings: self.recordings.clone(),
            train: ranges(&self.train)?,
            test: ranges(&self.test)?,
            holdout: self.holdout.as_deref().map(str::parse).transpose()?,
            method: self.method.parse()?,
            signal: signal(&self.signal)?,
            robust: !self.no_robust,
            consistent: self.consistent,
            delay: delay(&self.delay)?,
            instruments: self.instruments.parse()?,
            conditioning: Conditioning {
                band_hz: self.band,
                position_band_hz: self.position_band,
                moving_rad_s: self.moving,
                cut_s: self.cut,
                rate_hz: self.rate,
                spike_threshold: self.spikes,
                bristle: !self.no_bristle,
                ..Conditioning::default()
            },
            block_s: self.block.map(|s| words::positive("--block", s)).transpose()?,
            ..Options::default()
        })
    }
}

fn signal(text: &str) -> Result<Signal, BadInput> {
    match text {
        "motor" => Ok(Signal::Motor),
        "motor-minus-link" => Ok(Signal::MotorMinusLink),
        _ => Err(BadInput::new(format!("--signal: found \"{text}\"; expected motor or motor-minus-link"))),
    }
}

fn delay(text: &str) -> Result<Delay, BadInput> {
    match (text, text.parse::<f64>()) {
        ("estimate", _) => Ok(Delay::Estimate),
        ("off", _) => Ok(Delay::Off),
        (_, Ok(seconds)) if seconds.is_finite() => Ok(Delay::Fixed(seconds)),
        _ => Err(BadInput::new(format!("--delay: found \"{text}\"; expected estimate, off or seconds"))),
    }
}

/// `lacuna identify`.
pub fn identify(args: &IdentifyArgs) -> CommandResult {
    let options = args.options()?;
    let carried = args.carried.options()?;
    if args.carried.any() && args.payload.is_empty() {
        return Err(Failure::usage(
            "--carried: found times without a recording with a payload; expected --payload FILE",
        ));
    }
    words::folder_for(&args.out)?;
    let progress = Progress::bar();
    progress.step("looking for an earlier result");
    let loaded = lacuna_recording::load_robot(&args.robot)?;
    let (job, recordings) = job(args, &options, &loaded)?;
    if !args.force && job.is_done(&args.out) {
        drop(progress);
        result::say_done(&args.out, "identification.json", args.json)?;
        return Ok(ExitCode::SUCCESS);
    }
    let mut outcome = lacuna_identify::identify(&options, &mut |share, words| progress.at(share, words))?;
    if options.consistent && outcome.identification.consistency.is_none() {
        // Never an ordinary model under the name of a consistent one.
        return Err(Failure::run("--consistent: no physically consistent fit was made for this robot and method"));
    }
    if !args.payload.is_empty() {
        progress.step("estimating the payload");
        let urdf = loaded.urdf.as_deref();
        lacuna_identify::payload::add_to(&mut outcome, &loaded.file, urdf, &args.payload, &carried)?;
    }
    let urdf = loaded.urdf.as_deref().map(|text| model_urdf(&outcome, &loaded.file, text)).transpose()?.flatten();
    progress.step("writing the report");
    let html = lacuna_report::identification_report(&identify_report::data(&outcome));
    let origin = Origin { label: args.label.as_deref(), set: job.set(), recordings: &recordings };
    let rows = result_rows::identify(&outcome.identification, &origin)?;
    let stage = job.stage(&args.out)?;
    write(&outcome, stage.path())?;
    words::write(&stage.path().join("report.html"), html.as_bytes())?;
    words::write(&stage.path().join("result.parquet"), &rows)?;
    if let Some(text) = urdf {
        words::write(&stage.path().join("model.urdf"), text.as_bytes())?;
    }
    let names = stage.commit()?;
    drop(progress);
    if args.json {
        words::print_json(&outcome.identification)?;
    } else {
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        let files = words::files(&args.out, &names);
        words::say(&(summary(&outcome) + &files))?;
    }
    Ok(ExitCode::SUCCESS)
}

fn write(outcome: &Outcome, out: &Path) -> Result<(), Failure> {
    let text = serde_json::to_string_pretty(&outcome.identification)
        .map_err(|e| Failure::run(format!("identification.json: {e}")))?;
    words::write(&out.join("identification.json"), (text + "\n").as_bytes())?;
    words::write(&out.join("model.toml"), outcome.model.to_toml()?.as_bytes())
}

/// All that the result depends on, and the recordings' names.
fn job(args: &IdentifyArgs, options: &Options, robot: &LoadedRobot) -> Result<(Job, Vec<String>), Failure> {
    let ranges = options.train.iter().chain(&options.test).map(|r| r.file.as_path());
    let mut recordings: Vec<&Path> = Vec::new();
    for path in args.recordings.iter().map(PathBuf::as_path).chain(ranges) {
        if !recordings.contains(&path) {
            recordings.push(path);
        }
    }
    let mut files: Vec<(&str, &Path)> = recordings.iter().map(|path| ("recording", *path)).collect();
    files.extend(args.payload.iter().map(|path| ("payload", path.as_path())));
    let options = serde_json::to_value(args).map_err(|e| Failure::run(format!("options: {e}")))?;
    let names = recordings.iter().map(|p| p.file_name().unwrap_or_default().to_string_lossy().into_owned());
    Ok((Job::new("identify", options, robot, &files)?, names.collect()))
}

/// What a user should see first: how good, what is not in the data, what to beware of.
fn summary(outcome: &Outcome) -> String {
    let id = &outcome.identification;
    let held = &id.held_out;
    let mut out = String::new();
    // Writing to a String cannot fail.
    let _ = writeln!(out, "{}", identify_report::verdict(id));
    let moving =
        if held.moving_only { format!("moving above {} rad/s", held.moving_rad_s) } else { "all samples".to_owned() };
    let _ =
        writeln!(out, "Held out: {}; {moving}; 0 to {} Hz.", words::split(&held.split), significant(held.band_hz, 3));
    out.push('\n');
    out.push_str(&joint_table(id));
    out.push('\n');
    out.push_str(&match &id.paper {
        Some(paper) => paper_words(paper, &id.torque_unit),
        None => parameter_words(&id.parameters) + &not_excited(&id.not_excited),
    });
    out.push_str(&forward_words(id));
    for run in &id.payload {
        out.push('\n');
        out.push_str(&payload::summary(run, &id.joints, &id.torque_unit));
    }
    if let Some(c) = &id.consistency {
        let (cost, free) = (percent(c.training_residual_ratio - 1.0), percent(c.free_relative_error));
        let _ =
            writeln!(out, "Physically consistent: costs {cost} of training residual; unconstrained, held out, {free}.");
    }
    out.push_str(&words::repairs(&id.repairs));
    out.push_str(&words::warnings(&id.warnings));
    out.push('\n');
    out
}

/// How far the simulated motion is from the measured one at the longest horizon.
fn forward_words(id: &Identification) -> String {
    let Some(forward) = &id.forward else { return String::new() };
    let list = |p: &Predicted| {
        let last = p.rms_rad.last().map_or(&[][..], Vec::as_slice);
        last.iter().map(|v| significant(1e3 * v, 3)).collect::<Vec<_>>().join(", ")
    };
    let horizon = forward.horizons_s.last().copied().unwrap_or(0.0);
    let nominal = forward.nominal.as_ref().map_or_else(String::new, |n| format!("; robot file {}", list(n)));
    format!(
        "Simulated {} ms ahead from the measured state and torque, held out, RMS per joint [mrad]: identified {}{nominal}; velocity held {}.\n",
        significant(1e3 * horizon, 3),
        list(&forward.identified),
        list(&forward.held_velocity)
    )
}

fn parameter_words(parameters: &[ParameterRow]) -> String {
    let departing = parameters.iter().filter(|p| p.departs == Some(true)).count();
    let departs = match departing {
        0 if parameters.iter().all(|p| p.nominal.is_none_or(|v| v == 0.0)) => {
            "the robot file has no masses to compare them with".to_owned()
        }
        0 => "none departs from the robot file beyond interval and tolerance".to_owned(),
        1 => "one departs from the robot file beyond interval and tolerance (report.html shows it)".to_owned(),
        n => format!("{n} depart from the robot file beyond interval and tolerance (report.html shows them)"),
    };
    format!("{} identified; {departs}.\n", words::count(parameters.len(), "parameter"))
}

fn paper_words(paper: &PaperResult, unit: &str) -> String {
    let list = |values: &[f64]| values.iter().map(|v| significant(*v, 3)).collect::<Vec<_>>().join(", ");
    format!(
        "ρ1 {}, ρ2 {}; f_v {} {unit} s/rad; f_c {} {unit}: averages over {}.\n",
        significant(paper.rho1, 4),
        significant(paper.rho2, 4),
        list(&paper.f_v),
        list(&paper.f_c),
        words::count(paper.trajectories.len(), "recording")
    )
}

fn joint_table(id: &Identification) -> String {
    let score = &id.held_out.score;
    let width = id.joints.iter().map(|j| j.chars().count()).max().unwrap_or(0).max(5);
    let mut out = String::new();
    let unit = &id.torque_unit;
    let rms = format!("RMS [{unit}]");
    let _ = writeln!(out, "{:width$}  {rms:>12}  {:>12}  {:>12}  {:>10}", "Joint", "mean", "std", "relative");
    for (j, name) in id.joints.iter().enumerate() {
        let get = |list: &[f64]| list.get(j).map_or_else(String::new, |v| significant(*v, 3));
        let relative = score.relative_error_per_joint.get(j).map_or_else(String::new, |v| percent(*v));
        let [rms, mean, std] = [get(&score.rms_nm), get(&score.mean_nm), get(&score.std_nm)];
        let _ = writeln!(out, "{name:width$}  {rms:>12}  {mean:>12}  {std:>12}  {relative:>10}");
    }
    out
}

/// Longest list of reasons that is still read.
const REASONS: usize = 8;

/// Parameters that the data do not support, together where the reason is the same. Of many reasons the account alone tells.
fn not_excited(list: &[NotExcited]) -> String {
    if list.is_empty() {
        return String::new();
    }
    let mut groups: Vec<(&str, Vec<&str>)> = Vec::new();
    for row in list {
        match groups.iter_mut().find(|(reason, _)| *reason == row.reason) {
            Some((_, symbols)) => symbols.push(&row.symbol),
            None => groups.push((&row.reason, vec![&row.symbol])),
        }
    }
    let kept = list.iter().filter(|row| row.in_model).count();
    let kept = if kept > 0 {
        format!(" ({kept} of them stay in the model at values no better than zero)")
    } else {
        String::new()
    };
    let mut out = format!("{} not supported by these data{kept}:\n", words::count(list.len(), "parameter"));
    let mut others: Vec<&str> = Vec::new();
    let many = groups.len() > REASONS;
    for (reason, symbols) in groups {
        if many && symbols.len() == 1 {
            others.extend(symbols);
        } else {
            // Writing to a String cannot fail.
            let _ = writeln!(out, "  {}: {reason}", symbols.join(", "));
        }
    }
    if !others.is_empty() {
        let _ = writeln!(
            out,
            "  {}: not told from zero or from others; identification.json gives the figures",
            others.join(", ")
        );
    }
    out
}
