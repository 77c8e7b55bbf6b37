//! `lacuna diagnose`: which physics does the model leave out?

use crate::chosen::Chosen;
use crate::progress::Progress;
use crate::result::{self, Job};
use crate::result_rows::{self, Origin};
use crate::{CommandResult, diagnose_report, words};
use clap::Args;
use lacuna_diagnose::findings::Finding;
use lacuna_diagnose::{Conditioning, Options, Outcome};
use lacuna_interfaces::{BadInput, Recording};
use lacuna_recording::LoadedRobot;
use lacuna_report::number::{percent, significant};
use lacuna_simulate::Manifest;
use lacuna_stage::Failure;
use serde::Serialize;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

#[derive(Args, Serialize)]
pub struct DiagnoseArgs {
    /// Robot file: the model that is held against the recordings.
    #[arg(long, value_name = "FILE")]
    #[serde(skip)]
    robot: PathBuf,
    /// Folder for findings.json, model.toml, report.html and result.parquet. A complete result of the same recordings,
    /// options and program that is there already is left as it is.
    #[arg(long, value_name = "DIR")]
    #[serde(skip)]
    out: PathBuf,
    /// Recordings of the robot (CSV, MCAP or ROS 2 bag). A manifest.json beside them tells when each began.
    #[arg(value_name = "RECORDING")]
    #[serde(skip)]
    recordings: Vec<PathBuf>,
    /// Recordings of your own simulator: what does it leave out? Best with the robot's motions, in the same order.
    #[arg(long, num_args = 1.., value_name = "RECORDING")]
    #[serde(skip)]
    sim: Vec<PathBuf>,
    /// Recordings, or parts of them in seconds, to choose and fit the model on: FILE, FILE@from:to.
    #[arg(long, num_args = 1.., value_name = "FILE[@from:to]")]
    train: Vec<String>,
    /// Recordings, or parts of them, to judge it on.
    #[arg(long, num_args = 1.., value_name = "FILE[@from:to]")]
    test: Vec<String>,
    /// How to hold out: recordings, halves or kfold=N. Default: by recording; parts of time for fewer than five.
    #[arg(long, value_name = "HOW")]
    holdout: Option<String>,
    /// Seed of everything drawn.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Speed above which a joint counts as moving [rad/s]. Default: from the recordings.
    #[arg(long, value_name = "RAD_S", allow_negative_numbers = true)]
    moving: Option<f64>,
    /// Band in which torque and model are compared [Hz]. Default: from the recordings.
    #[arg(long, value_name = "HZ", allow_negative_numbers = true)]
    band: Option<f64>,
    /// What to call this set in result.parquet: a serial number, a cell, a date.
    #[arg(long, value_name = "TEXT")]
    label: Option<String>,
    /// Do it again even if a complete result is there.
    #[arg(long)]
    #[serde(skip)]
    force: bool,
    /// Print findings.json on standard output, in place of the summary.
    #[arg(long)]
    #[serde(skip)]
    json: bool,
}

/// `lacuna diagnose`.
pub fn diagnose(args: &DiagnoseArgs) -> CommandResult {
    words::folder_for(&args.out)?;
    let band_hz = args.band.map(|b| words::positive("--band", b)).transpose()?;
    let moving_rad_s = args.moving.map(|v| words::not_negative("--moving", v)).transpose()?;
    let chosen = Chosen::of(&args.recordings, &args.train, &args.test, args.holdout.as_deref())?;
    let progress = Progress::bar();
    progress.step("looking for an earlier result");
    let robot = lacuna_recording::load_robot(&args.robot)?;
    let start_s = start_times(&chosen.paths);
    let job = job(args, &chosen.paths, start_s.as_deref(), &robot)?;
    if !args.force && job.is_done(&args.out) {
        drop(progress);
        result::say_done(&args.out, "findings.json", args.json)?;
        return Ok(ExitCode::SUCCESS);
    }
    progress.step("reading");
    let read = |paths: &[PathBuf]| -> Result<Vec<Recording>, BadInput> {
        paths.iter().map(|path| lacuna_recording::read_all(path, &robot.file)).collect()
    };
    let (recordings, sim) = (read(&chosen.paths)?, read(&args.sim)?);
    let started = start_s.is_some();
    let options = Options {
        robot: robot.file,
        urdf: robot.urdf,
        recordings,
        sim,
        conditioning: Conditioning {
            band_hz,
            moving_rad_s,
            start_s: start_s.unwrap_or_default(),
            split: chosen.split,
            ..Conditioning::default()
        },
        seed: args.seed,
    };
    let outcome = lacuna_diagnose::diagnose(&options, &mut |share, words| progress.at(share, &doing(words)))?;
    progress.step("writing the report");
    let html = lacuna_report::diagnosis_report(&diagnose_report::data(&outcome, &options, started));
    let recordings = &outcome.findings.recordings;
    let origin = Origin { label: args.label.as_deref(), set: job.set(), recordings };
    let rows = result_rows::diagnose(&outcome.findings, &origin)?;
    let stage = job.stage(&args.out)?;
    write(&outcome, stage.path())?;
    words::write(&stage.path().join("report.html"), html.as_bytes())?;
    words::write(&stage.path().join("result.parquet"), &rows)?;
    let names = stage.commit()?;
    drop(progress);
    if args.json {
        words::print_json(&outcome.findings)?;
    } else {
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        let files = words::files(&args.out, &names);
        words::say(&(summary(&outcome, options.robot.torque_unit.symbol()) + &files))?;
    }
    Ok(ExitCode::SUCCESS)
}

/// All that the result depends on.
fn job(args: &DiagnoseArgs, paths: &[PathBuf], start_s: Option<&[f64]>, robot: &LoadedRobot) -> Result<Job, Failure> {
    let mut files: Vec<(&str, &Path)> = paths.iter().map(|path| ("recording", path.as_path())).collect();
    files.extend(args.sim.iter().map(|path| ("sim", path.as_path())));
    let mut options = serde_json::to_value(args).map_err(|e| Failure::run(format!("options: {e}")))?;
    if let (Some(map), Some(start_s)) = (options.as_object_mut(), start_s) {
        map.insert("start_s".to_owned(), start_s.into());
    }
    Job::new("diagnose", options, robot, &files)
}

/// What the search says of itself, as a user wants to read it.
fn doing(words: &str) -> String {
    let effect = |rest: &str| rest.split_whitespace().next().unwrap_or_default().to_owned();
    if let Some(rest) = words.strip_prefix("  ?") {
        return format!("trying {}", effect(rest));
    }
    if let Some(rest) = words.strip_prefix("+ ") {
        return format!("taking {} in", effect(rest));
    }
    if let Some(rest) = words.strip_prefix("- ") {
        return format!("taking {} out", effect(rest));
    }
    if words.starts_with("band ") || words.starts_with("  ") {
        return "searching for what is missing".to_owned();
    }
    words.to_owned()
}

fn write(outcome: &Outcome, out: &Path) -> Result<(), Failure> {
    let text =
        serde_json::to_string_pretty(&outcome.findings).map_err(|e| Failure::run(format!("findings.json: {e}")))?;
    words::write(&out.join("findings.json"), (text + "\n").as_bytes())?;
    words::write(&out.join("model.toml"), outcome.model.to_toml()?.as_bytes())
}

/// When each recording began, by the manifest.json beside it [s since the drives were switched on]; `None` unless every
/// recording is in one. The file is not ours alone to name: one of another kind says nothing here.
fn start_times(paths: &[PathBuf]) -> Option<Vec<f64>> {
    let start = |path: &PathBuf| -> Option<f64> {
        let text = lacuna_recording::files::read_text(&path.parent()?.join("manifest.json")).ok()?;
        let manifest: Manifest = serde_json::from_str(&text).ok()?;
        let name = path.file_name()?.to_str()?;
        manifest.files.iter().find(|f| f.file == name).map(|f| f.start_time_s).filter(|s| s.is_finite() && *s >= 0.0)
    };
    paths.iter().map(start).collect()
}

/// The verdict first, then what stands behind it.
fn summary(outcome: &Outcome, unit: &str) -> String {
    let findings = &outcome.findings;
    let mut text = format!("{}\n", findings.verdict);
    if !findings.findings.is_empty() {
        text.push('\n');
    }
    // Writing to a String cannot fail.
    for finding in &findings.findings {
        let _ = writeln!(text, "  {}", line(finding, unit));
    }
    let held = &findings.held_out;
    let _ = write!(text, "\nTorque error, held out ({}): ", words::split(&held.split));
    if findings.findings.is_empty() {
        let _ = write!(text, "{}", percent(held.relative_after));
    } else {
        let _ = write!(text, "{} before, {} after", percent(held.relative_before), percent(held.relative_after));
    }
    let [low, high] = held.relative_after_ci95;
    if low < high {
        let _ = write!(text, " (95 % interval {} to {})", percent(low), percent(high));
    }
    if held.black_box_relative.is_finite() {
        let _ = write!(text, "; a black box on the same data {}", percent(held.black_box_relative));
    }
    text.push_str(".\n");
    for (label, words) in &outcome.evidence.simulator {
        let _ = writeln!(text, "{label}: {words}.");
    }
    if let Some(next) = &findings.next_experiment {
        let _ = writeln!(text, "Next experiment: {}", next.words);
    }
    text + &words::warnings(&outcome.evidence.warnings) + &words::repairs(&findings.repairs)
}

fn line(finding: &Finding, unit: &str) -> String {
    let joints = if finding.joints.is_empty() { String::new() } else { format!(", {}", finding.joints.join(", ")) };
    let mut text = format!("{}{joints}: probability {}", finding.effect, significant(finding.probability, 2));
    if finding.group.len() > 1 {
        let others: Vec<&str> = finding.group.iter().map(String::as_str).filter(|id| *id != finding.effect).collect();
        let _ = write!(text, ", not told apart from {}", others.join(", "));
    }
    let gain = &finding.held_out;
    let _ = write!(
        text,
        "; {} to {} {unit}, held out",
        significant(gain.before_rms_nm, 3),
        significant(gain.after_rms_nm, 3)
    );
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn start_times_come_from_a_manifest_that_lists_every_recording() {
        let dir = tempfile::tempdir().unwrap();
        let paths = ["a.csv", "b.csv"].map(|name| dir.path().join(name));
        assert_eq!(start_times(&paths), None);
        let write = |text: &str| std::fs::write(dir.path().join("manifest.json"), text).unwrap();
        write(r#"{"name": "an app", "files": 3}"#);
        assert_eq!(start_times(&paths), None);
        let entry =
            |name: &str, start: f64| format!(r#"{{"file": "{name}", "start_time_s": {start}, "duration_s": 5.0}}"#);
        write(&format!(r#"{{"files": [{}], "note": ""}}"#, entry("b.csv", 9.5)));
        assert_eq!(start_times(&paths), None);
        write(&format!(r#"{{"files": [{}, {}], "note": ""}}"#, entry("b.csv", 9.5), entry("a.csv", 1.0)));
        assert_eq!(start_times(&paths), Some(vec![1.0, 9.5]));
        write(&format!(r#"{{"files": [{}, {}], "note": ""}}"#, entry("b.csv", -9.5), entry("a.csv", 1.0)));
        assert_eq!(start_times(&paths), None);
    }
}
