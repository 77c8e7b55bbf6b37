//! `lacuna diagnose`: which physics does the model leave out?

use crate::progress::Progress;
use crate::{CommandResult, diagnose_report, words};
use clap::Args;
use lacuna_diagnose::findings::Finding;
use lacuna_diagnose::{Conditioning, Findings, Options};
use lacuna_report::number::{percent, significant};
use lacuna_simulate::Manifest;
use lacuna_stage::Failure;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

#[derive(Args)]
pub struct DiagnoseArgs {
    /// Robot file: the model that is held against the recordings.
    #[arg(long, value_name = "FILE")]
    robot: PathBuf,
    /// Folder for findings.json, model.toml and report.html.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Recordings of the robot (CSV, MCAP or ROS 2 bag). A manifest.json beside them tells when each began.
    #[arg(value_name = "RECORDING", required = true)]
    recordings: Vec<PathBuf>,
    /// Seed of everything drawn.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Speed above which a joint counts as moving [rad/s]. Default: from the recordings.
    #[arg(long, value_name = "RAD_S", allow_negative_numbers = true)]
    moving: Option<f64>,
    /// Band in which torque and model are compared [Hz]. Default: from the recordings.
    #[arg(long, value_name = "HZ", allow_negative_numbers = true)]
    band: Option<f64>,
    /// Print findings.json on standard output, in place of the summary.
    #[arg(long)]
    json: bool,
}

/// `lacuna diagnose`.
pub fn diagnose(args: &DiagnoseArgs) -> CommandResult {
    words::folder_for(&args.out)?;
    let band_hz = args.band.map(|b| words::positive("--band", b)).transpose()?;
    let moving_rad_s = args.moving.map(|v| words::not_negative("--moving", v)).transpose()?;
    let progress = Progress::bar();
    progress.step("reading");
    let robot = lacuna_recording::load_robot(&args.robot)?;
    let recordings = args.recordings.iter().map(|path| lacuna_recording::read_all(path, &robot.file));
    let recordings = recordings.collect::<Result<Vec<_>, _>>()?;
    let start_s = start_times(&args.recordings);
    let started = start_s.is_some();
    let options = Options {
        robot: robot.file,
        urdf: robot.urdf,
        recordings,
        sim: Vec::new(),
        conditioning: Conditioning { band_hz, moving_rad_s, start_s: start_s.unwrap_or_default() },
        seed: args.seed,
    };
    let outcome = lacuna_diagnose::diagnose(&options, &mut |share, words| progress.at(share, words))?;
    progress.step("writing the report");
    let html = lacuna_report::diagnosis_report(&diagnose_report::data(&outcome, &options, started));
    write(&outcome, &args.out)?;
    words::write(&args.out.join("report.html"), html.as_bytes())?;
    drop(progress);
    if args.json {
        words::print_json(&outcome.findings)?;
    } else {
        let files = words::files(&args.out, &["findings.json", "model.toml", "report.html"]);
        words::say(&(summary(&outcome.findings, options.robot.torque_unit.symbol()) + &files))?;
    }
    Ok(ExitCode::SUCCESS)
}

fn write(outcome: &lacuna_diagnose::Outcome, out: &Path) -> Result<(), Failure> {
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
fn summary(findings: &Findings, unit: &str) -> String {
    let mut text = format!("{}\n", findings.verdict);
    if !findings.findings.is_empty() {
        text.push('\n');
    }
    for finding in &findings.findings {
        // Writing to a String cannot fail.
        let _ = writeln!(text, "  {}", line(finding, unit));
    }
    let held = &findings.held_out;
    let _ = write!(text, "\nTorque error, held out: {}", percent(held.relative_before));
    if !findings.findings.is_empty() {
        let _ = write!(text, " before, {} after", percent(held.relative_after));
    }
    if held.black_box_relative.is_finite() {
        let _ = write!(text, "; a black box on the same data {}", percent(held.black_box_relative));
    }
    text.push_str(".\n");
    if let Some(next) = &findings.next_experiment {
        let _ = writeln!(text, "Next experiment: {}", next.words);
    }
    text + &words::repairs(&findings.repairs)
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
        "; {} to {} {unit} on recordings it had not seen",
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
