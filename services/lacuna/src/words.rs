//! What the offline commands print alike: counts, repairs, warnings, files; and how they write files.

use lacuna_interfaces::{BadInput, Repair, RepairKind};
use lacuna_stage::Failure;
use serde::Serialize;
use std::io::Write;
use std::path::Path;

/// `1 parameter`, `3 parameters`.
pub fn count(n: usize, noun: &str) -> String {
    format!("{n} {noun}{}", if n == 1 { "" } else { "s" })
}

/// A repair as a user would say it.
pub fn repair(kind: RepairKind) -> &'static str {
    match kind {
        RepairKind::Spike => "single-sample spike replaced",
        RepairKind::Unwrapped => "wrapped angle unwrapped",
        RepairKind::DuplicateStamp => "repeated stamp dropped",
        RepairKind::TruncatedTail => "row cut off in mid-write dropped",
        RepairKind::Gap => "gap in time, nothing filled in",
        RepairKind::MissingCycle => "bus cycle missing, nothing filled in",
        RepairKind::WorkingCounter => "cycle left out, working counter too low",
    }
}

/// How rows were held out, in words.
pub fn split(name: &str) -> String {
    match name {
        "files" => "the test recordings given".to_owned(),
        "recordings" => "every recording in turn".to_owned(),
        "parts" => "part by part of the recordings' time, in turn".to_owned(),
        "halves" => "both halves of time in turn".to_owned(),
        other => match other.strip_prefix("kfold=") {
            Some(n) => format!("each of {n} parts of time in turn"),
            None => other.to_owned(),
        },
    }
}

/// The repairs, one line each; empty without any.
pub fn repairs(list: &[Repair]) -> String {
    let line = |r: &Repair| format!("  {}: {}, {} × {}\n", r.file, r.signal, r.count, repair(r.kind));
    if list.is_empty() { String::new() } else { format!("Repaired:\n{}", list.iter().map(line).collect::<String>()) }
}

/// The warnings, one line each; empty without any.
pub fn warnings(list: &[String]) -> String {
    let line = |w: &String| format!("  {w}\n");
    if list.is_empty() { String::new() } else { format!("Warnings:\n{}", list.iter().map(line).collect::<String>()) }
}

/// Where files lie, on one line.
pub fn files(folder: &Path, names: &[&str]) -> String {
    let paths: Vec<String> = names.iter().map(|name| folder.join(name).display().to_string()).collect();
    format!("Files: {}\n", paths.join(", "))
}

/// Checks, before minutes of work, that `path` can be a folder for results.
///
/// # Errors
/// If something else is there.
pub fn folder_for(path: &Path) -> Result<(), BadInput> {
    if path.exists() && !path.is_dir() {
        return Err(BadInput::new("found a file; expected a folder, or a name that is free").in_file(path));
    }
    Ok(())
}

/// A file or folder that cannot be written.
pub fn cannot_write(path: &Path, e: &std::io::Error) -> Failure {
    Failure::of_file(format!("{}: cannot be written: {e}", path.display()), e.kind())
}

/// Writes a file, with its folder.
///
/// # Errors
/// If the operating system refuses.
pub fn write(path: &Path, bytes: &[u8]) -> Result<(), Failure> {
    let fail = |e| cannot_write(path, &e);
    if let Some(folder) = path.parent().filter(|f| !f.as_os_str().is_empty()) {
        std::fs::create_dir_all(folder).map_err(fail)?;
    }
    std::fs::write(path, bytes).map_err(fail)
}

/// Prints words on standard output: names out of files may hold terminal controls, which are shown and not obeyed. A
/// reader that has gone away (`| head`) is not an error.
///
/// # Errors
/// If the operating system refuses, e.g. because the disk is full.
pub fn say(text: &str) -> Result<(), Failure> {
    let obeyed = |c: char| c.is_control() && !matches!(c, '\n' | '\t');
    if text.contains(obeyed) { print(&text.replace(obeyed, "\u{fffd}")) } else { print(text) }
}

fn print(text: &str) -> Result<(), Failure> {
    let mut out = std::io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(e) if e.kind() != std::io::ErrorKind::BrokenPipe => {
            Err(Failure::run(format!("standard output: cannot be written: {e}")))
        }
        _ => Ok(()),
    }
}

/// Prints a line on standard output, as [`say`].
///
/// # Errors
/// As [`say`].
pub fn line(text: std::fmt::Arguments<'_>) -> Result<(), Failure> {
    say(&format!("{text}\n"))
}

/// Prints a value as JSON on standard output.
///
/// # Errors
/// If the value cannot be written.
pub fn print_json(value: &impl Serialize) -> Result<(), Failure> {
    let text = serde_json::to_string_pretty(value).map_err(|e| Failure::run(format!("JSON: {e}")))?;
    print(&(text + "\n"))
}

/// A positive option value.
///
/// # Errors
/// If it is not.
pub fn positive(key: &str, value: f64) -> Result<f64, BadInput> {
    if value.is_finite() && value > 0.0 {
        return Ok(value);
    }
    Err(BadInput::new(format!("{key}: found {value}; expected a positive number")))
}

/// An option value that is zero or more.
///
/// # Errors
/// If it is not.
pub fn not_negative(key: &str, value: f64) -> Result<f64, BadInput> {
    if value.is_finite() && value >= 0.0 {
        return Ok(value);
    }
    Err(BadInput::new(format!("{key}: found {value}; expected zero or a positive number")))
}
