//! `lacuna export`: a recording as a table for other programs, or as a ROS 2 bag folder.

use crate::progress::Progress;
use crate::{CommandResult, words};
use clap::Args;
use lacuna_export::formats::Format;
use lacuna_export::{ExportError, Exported, Request};
use lacuna_stage::Failure;
use serde::Serialize;
use std::fmt::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;

#[derive(Args)]
pub struct ExportArgs {
    /// Recording: MCAP or ROS 2 bag folder; with --robot any that Lacuna reads.
    recording: PathBuf,
    /// What to write: a file ending in .csv, .parquet or .mat; with --bag a folder.
    #[arg(long, value_name = "FILE")]
    to: PathBuf,
    /// Write a ROS 2 bag folder (MCAP and metadata.yaml).
    #[arg(long, conflicts_with_all = ["topics", "from", "until"])]
    bag: bool,
    /// Robot file: export the samples as other commands read them (joints in its order, spikes and wrapped angles
    /// repaired, doubts in a column of flags), not the messages as they stand in the file.
    #[arg(long, value_name = "FILE")]
    robot: Option<PathBuf>,
    /// These topics only. Default: all whose meaning is known (JointState and Lacuna's own).
    #[arg(long, value_delimiter = ',', value_name = "TOPIC")]
    topics: Vec<String>,
    /// Leave out what lies before this time after the first sample [s].
    #[arg(long, value_name = "SECONDS", default_value_t = 0.0, allow_negative_numbers = true)]
    from: f64,
    /// Stop at this time after the first sample [s].
    #[arg(long, value_name = "SECONDS", allow_negative_numbers = true)]
    until: Option<f64>,
    /// Replace what is there.
    #[arg(long)]
    force: bool,
    /// Machine-readable output.
    #[arg(long)]
    json: bool,
}

/// What `--json` prints.
#[derive(Debug, Serialize)]
struct Report {
    schema: &'static str,
    to: String,
    format: &'static str,
    rows: u64,
    messages: u64,
    bytes: u64,
    columns: Vec<ColumnRow>,
    topics: Vec<String>,
    left_out: Vec<String>,
    late: u64,
    repeated: u64,
    was_cut: bool,
    repairs: Vec<lacuna_interfaces::Repair>,
}

#[derive(Debug, Serialize)]
struct ColumnRow {
    name: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    joint: Option<String>,
    unit: String,
    topic: String,
}

/// `lacuna export`.
pub fn export(args: &ExportArgs) -> CommandResult {
    if !args.bag {
        // Before a robot file is read: the first thing to be told is what cannot be written.
        Format::of(&args.to)?;
    }
    let robot = args.robot.as_ref().map(lacuna_recording::load_robot).transpose()?;
    let progress = Progress::bar();
    progress.step("reading");
    if args.bag {
        let bag = lacuna_export::bag::write(&args.recording, robot.as_ref(), &args.to, args.force).map_err(failure)?;
        drop(progress);
        return say_bag(args, bag);
    }
    let request = Request {
        recording: &args.recording,
        robot: robot.as_ref().map(|r| &r.file),
        topics: &args.topics,
        from_s: args.from,
        to_s: args.until.unwrap_or(f64::INFINITY),
        to: &args.to,
        force: args.force,
    };
    let step = |share: f64| progress.at(share, if share < 0.5 { "looking for columns" } else { "writing" });
    let exported = lacuna_export::export(&request, &mut { step }).map_err(failure)?;
    drop(progress);
    let lost = exported.late > 0;
    if args.json {
        words::print_json(&report(args, exported))?;
    } else {
        words::say(&summary(args, &exported))?;
    }
    Ok(if lost { ExitCode::from(3) } else { ExitCode::SUCCESS })
}

fn failure(e: ExportError) -> Failure {
    match e {
        ExportError::Refused(bad) => bad.into(),
        ExportError::Recorder(e) => crate::recover::failure(e),
        ExportError::Io { ref source, .. } => Failure::of_file(e.to_string(), source.kind()),
        ExportError::Parquet { .. } => Failure::run(e.to_string()),
    }
}

fn say_bag(args: &ExportArgs, bag: lacuna_export::bag::Bag) -> CommandResult {
    if args.json {
        words::print_json(&Report {
            schema: "lacuna.exported/1",
            to: args.to.display().to_string(),
            format: "bag",
            rows: 0,
            messages: bag.messages,
            bytes: 0,
            columns: Vec::new(),
            topics: bag.topics,
            left_out: Vec::new(),
            late: 0,
            repeated: 0,
            was_cut: false,
            repairs: Vec::new(),
        })?;
    } else {
        let (messages, topics) =
            (words::count(bag.messages as usize, "message"), words::count(bag.topics.len(), "topic"));
        words::say(&format!("Bag: {messages} of {topics}.\nFolder: {}\n", args.to.display()))?;
    }
    Ok(ExitCode::SUCCESS)
}

fn report(args: &ExportArgs, e: Exported) -> Report {
    let mut topics: Vec<String> = Vec::new();
    for column in &e.table.columns {
        if !column.topic.is_empty() && !topics.contains(&column.topic) {
            topics.push(column.topic.clone());
        }
    }
    let columns = e.table.columns.into_iter();
    Report {
        schema: "lacuna.exported/1",
        to: args.to.display().to_string(),
        format: e.format,
        rows: e.rows,
        messages: 0,
        bytes: e.bytes,
        columns: columns.map(|c| ColumnRow { name: c.name, joint: c.joint, unit: c.unit, topic: c.topic }).collect(),
        topics,
        left_out: e.left_out,
        late: e.late,
        repeated: e.repeated,
        was_cut: e.was_cut,
        repairs: e.repairs,
    }
}

fn summary(args: &ExportArgs, e: &Exported) -> String {
    let (rows, columns) = (words::count(e.rows as usize, "row"), words::count(e.table.columns.len() + 2, "column"));
    let mut text = format!("{rows}, {columns}:\n  t_s, stamp_ns\n");
    let mut groups: Vec<(&str, &str, Vec<&str>)> = Vec::new();
    for column in &e.table.columns {
        let joint = column.joint.as_deref();
        match groups
            .iter_mut()
            .find(|(group, unit, _)| (*group, *unit) == (column.group.as_str(), column.unit.as_str()))
        {
            Some((_, _, joints)) => joints.extend(joint),
            None => groups.push((&column.group, &column.unit, joint.into_iter().collect())),
        }
    }
    // Writing to a String cannot fail.
    for (group, unit, joints) in groups {
        let of = if joints.is_empty() { String::new() } else { format!("_{{{}}}", joints.join(",")) };
        let unit = if unit.is_empty() { String::new() } else { format!(" [{unit}]") };
        let _ = writeln!(text, "  {group}{of}{unit}");
    }
    if !e.left_out.is_empty() {
        let _ = writeln!(text, "Not exported: {}", e.left_out.join(", "));
    }
    if e.repeated > 0 {
        let _ = writeln!(
            text,
            "{} replaced an earlier one of the same stamp.",
            words::count(e.repeated as usize, "message")
        );
    }
    if e.late > 0 {
        let _ = writeln!(
            text,
            "{} came too late for their row and are MISSING in the table.",
            words::count(e.late as usize, "message")
        );
    }
    if e.was_cut {
        text.push_str("The recording stops before its proper end (lacuna recover completes it).\n");
    }
    text.push_str(&words::repairs(&e.repairs));
    let _ = writeln!(text, "File: {} ({} bytes)", args.to.display(), e.bytes);
    text
}
