//! `lacuna recover`: a complete MCAP file from one that was cut off or damaged.

use crate::progress::Progress;
use crate::{CommandResult, words};
use clap::Args;
use lacuna_interfaces::BadInput;
use lacuna_recording::container::{WriteError, WriterOptions};
use lacuna_stage::Failure;
use serde::Serialize;
use std::fmt::Write as _;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

#[derive(Args)]
pub struct RecoverArgs {
    /// The file that was cut off or damaged; it is not changed.
    input: PathBuf,
    /// The new file.
    output: PathBuf,
    /// Replace the new file if it exists.
    #[arg(long)]
    overwrite: bool,
    /// Machine-readable output.
    #[arg(long)]
    json: bool,
}

/// What `--json` prints.
#[derive(Serialize)]
struct Report {
    schema: &'static str,
    output: String,
    messages: u64,
    bytes: u64,
    duration_s: Option<f64>,
    was_cut: bool,
    damages: Vec<String>,
}

/// `lacuna recover`.
pub fn recover(args: &RecoverArgs) -> CommandResult {
    if same_file(&args.input, &args.output) {
        // Replacing the output would destroy the only copy of the input.
        return Err(Failure::usage(format!(
            "{}: found the same file twice; expected a new file",
            args.output.display()
        )));
    }
    if args.output.exists() && !args.overwrite {
        let what = "found an existing file; expected none, or --overwrite";
        return Err(BadInput::new(what).in_file(&args.output).into());
    }
    let progress = Progress::spinner();
    progress.step("copying what can be read");
    let options = WriterOptions { overwrite: args.overwrite, ..WriterOptions::default() };
    let done = lacuna_recording::recover(&args.input, &args.output, &options).map_err(failure)?;
    drop(progress);
    let report = Report {
        schema: "lacuna.recovered/1",
        output: args.output.display().to_string(),
        messages: done.finished.messages.values().sum(),
        bytes: done.finished.bytes,
        duration_s: done.finished.times.map(|(first, last)| last.saturating_sub(first) as f64 / 1e9),
        was_cut: done.was_cut,
        damages: done.damages.iter().map(ToString::to_string).collect(),
    };
    if args.json {
        words::print_json(&report)?;
    } else {
        words::say(&summary(&report))?;
    }
    Ok(ExitCode::SUCCESS)
}

/// Why a recording could not be written.
pub fn failure(e: WriteError) -> Failure {
    match e {
        WriteError::Refused(bad) => bad.into(),
        WriteError::Io { ref source, .. } => Failure::of_file(e.to_string(), source.kind()),
        WriteError::Lost(_) => Failure::run(e.to_string()),
    }
}

fn same_file(a: &Path, b: &Path) -> bool {
    match (std::fs::metadata(a), std::fs::metadata(b)) {
        (Ok(a), Ok(b)) => (a.dev(), a.ino()) == (b.dev(), b.ino()),
        _ => false,
    }
}

fn summary(report: &Report) -> String {
    let state = if report.was_cut { "the file was cut off before its end" } else { "the file had its proper end" };
    let length = report.duration_s.map_or_else(String::new, |s| format!(" over {s:.3} s"));
    let mut text = format!("Recovered {}{length}; {state}.\n", words::count(report.messages as usize, "message"));
    for damage in &report.damages {
        // Writing to a String cannot fail.
        let _ = writeln!(text, "Left out: {damage}");
    }
    let _ = writeln!(text, "File: {} ({} bytes)", report.output, report.bytes);
    text
}
