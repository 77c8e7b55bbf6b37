//! `lacuna info`: what is in a recording.

use crate::progress::Progress;
use crate::spikes::Spikes;
use crate::survey::{Surveyed, survey_of, survey_words};
use crate::{CommandResult, words};
use clap::Args;
use lacuna_interfaces::{BadInput, MAX_JOINTS, Repair, RobotFile, flag};
use lacuna_recording::{FileInfo, ReadOptions, inspect};
use lacuna_report::number::significant;
use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

#[derive(Args)]
pub struct InfoArgs {
    /// Recording: CSV, MCAP, a ROS 2 bag folder, or a capture of EtherCAT traffic.
    file: PathBuf,
    /// Robot file: shows the joints' signals. Without it, what is in the file and what it would need.
    #[arg(long, value_name = "FILE")]
    robot: Option<PathBuf>,
    /// Topic of the joint signals in an MCAP. Default: its only one, /measured or /joint_states.
    #[arg(long, requires = "robot")]
    topic: Option<String>,
    /// Machine-readable output.
    #[arg(long)]
    json: bool,
}

/// What `--json` prints.
#[derive(Debug, Serialize)]
struct Info {
    schema: &'static str,
    file: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    container: Option<Container>,
    #[serde(skip_serializing_if = "Option::is_none")]
    recording: Option<Contents>,
    #[serde(skip_serializing_if = "Option::is_none")]
    survey: Option<Surveyed>,
}

/// An MCAP file, without knowledge of its messages.
#[derive(Debug, Serialize)]
struct Container {
    profile: String,
    library: String,
    was_cut: bool,
    complete: bool,
    topics: BTreeMap<String, Topic>,
    /// Sizes by name [bytes].
    attachments: BTreeMap<String, usize>,
    metadata: BTreeMap<String, BTreeMap<String, String>>,
}

#[derive(Debug, Serialize)]
struct Topic {
    schema: String,
    encoding: String,
    messages: u64,
    duration_s: Option<f64>,
    rate_hz: Option<f64>,
}

/// A robot's signals in a recording.
#[derive(Debug, Serialize)]
struct Contents {
    format: &'static str,
    #[serde(skip_serializing_if = "Option::is_none")]
    topic: Option<String>,
    robot: String,
    torque_unit: &'static str,
    samples: usize,
    first_s: f64,
    duration_s: f64,
    median_rate_hz: Option<f64>,
    shortest_step_s: Option<f64>,
    longest_step_s: Option<f64>,
    gaps: Vec<Gap>,
    joints: Vec<Joint>,
    extra_columns: Vec<String>,
    ignored: Vec<String>,
    repairs: Vec<Repair>,
}

/// Samples are missing between two stamps.
#[derive(Debug, Serialize)]
struct Gap {
    from_s: f64,
    to_s: f64,
}

#[derive(Debug, Serialize)]
struct Joint {
    joint: String,
    q_min_rad: f64,
    q_max_rad: f64,
    tau_min_nm: f64,
    tau_max_nm: f64,
    tau_rms_nm: f64,
    /// Single-sample spikes, left as they are: `identify` and `diagnose` replace them.
    q_spikes: u64,
    tau_spikes: u64,
}

/// `lacuna info`.
pub fn info(args: &InfoArgs) -> CommandResult {
    let progress = Progress::bar();
    progress.step("reading");
    let container = match lacuna_recording::is_mcap(&args.file)? {
        true => Some(container(&inspect(lacuna_recording::file_of(&args.file)?)?)),
        false => None,
    };
    let recording = match &args.robot {
        Some(robot) => {
            let robot = lacuna_recording::load_robot(robot)?.file;
            Some(contents(&args.file, args.topic.clone(), &robot, &progress)?)
        }
        None => None,
    };
    let survey = if args.robot.is_none() { lacuna_recording::survey(&args.file)?.map(|s| survey_of(&s)) } else { None };
    drop(progress);
    let info = Info { schema: "lacuna.info/1", file: args.file.display().to_string(), container, recording, survey };
    if args.json {
        words::print_json(&info)?;
    } else {
        let mut text = format!("{}\n", info.file);
        if let Some(c) = &info.container {
            text.push_str(&container_words(c));
        }
        if let Some(s) = &info.survey {
            text.push_str(&survey_words(s));
        }
        if let Some(r) = &info.recording {
            text.push_str(&contents_words(r));
        }
        words::say(&text)?;
    }
    Ok(ExitCode::SUCCESS)
}

fn container(info: &FileInfo) -> Container {
    let topic = |t: &lacuna_recording::container::TopicInfo| {
        let duration_s = t.times.map(|(first, last)| last.saturating_sub(first) as f64 / 1e9);
        let rate = duration_s.filter(|d| *d > 0.0).map(|d| t.messages.saturating_sub(1) as f64 / d);
        let (schema, encoding) = (t.schema.clone(), t.encoding.clone());
        Topic { schema, encoding, messages: t.messages, duration_s, rate_hz: rate }
    };
    Container {
        profile: info.profile.clone(),
        library: info.library.clone(),
        was_cut: info.was_cut,
        complete: info.is_complete(),
        topics: info.topics.iter().map(|(name, t)| (name.clone(), topic(t))).collect(),
        attachments: info.attachments.iter().map(|(name, data)| (name.clone(), data.len())).collect(),
        metadata: info.metadata.clone(),
    }
}

/// Reads the robot's signals through, holding nothing but the time stamps.
fn contents(path: &Path, topic: Option<String>, robot: &RobotFile, progress: &Progress) -> Result<Contents, BadInput> {
    const PROGRESS_EVERY: usize = 1 << 14;
    let n = robot.joint_count().min(MAX_JOINTS);
    let mut reader =
        lacuna_recording::open_with(path, robot, &ReadOptions { topic, extra: true, ..ReadOptions::default() })?;
    let mut stamps_ns: Vec<i64> = Vec::new();
    let mut gaps = Vec::new();
    let mut spans = [Span::default(); MAX_JOINTS];
    let mut spikes = Spikes::new(n);
    while let Some(sample) = reader.next_sample()? {
        let m = &sample.measured;
        if m.header.has(flag::GAP)
            && let Some(last) = stamps_ns.last()
        {
            gaps.push(Gap { from_s: seconds(*last), to_s: seconds(m.header.stamp_ns) });
        }
        stamps_ns.push(m.header.stamp_ns);
        spikes.saw(m);
        for (span, (q, tau)) in spans.iter_mut().zip(m.q_rad.iter().zip(&m.tau_nm)) {
            span.add(*q, *tau);
        }
        if stamps_ns.len().is_multiple_of(PROGRESS_EVERY) {
            progress.at(reader.fraction(), "reading");
        }
    }
    let mut steps: Vec<i64> = stamps_ns.windows(2).map(|w| w[1] - w[0]).collect();
    steps.sort_unstable();
    let median = steps.get(steps.len() / 2).map(|ns| seconds(*ns));
    let (first, last) = (stamps_ns.first().copied().unwrap_or(0), stamps_ns.last().copied().unwrap_or(0));
    let about = reader.about();
    let spikes = spikes.finish();
    let joints = robot.joints.iter().zip(spans.iter().zip(&spikes)).take(n);
    Ok(Contents {
        format: about.format,
        topic: about.topic.clone(),
        robot: robot.name.clone(),
        torque_unit: robot.torque_unit.symbol(),
        samples: stamps_ns.len(),
        first_s: seconds(first),
        duration_s: seconds(last - first),
        median_rate_hz: median.filter(|s| *s > 0.0).map(|s| 1.0 / s),
        shortest_step_s: steps.first().map(|ns| seconds(*ns)),
        longest_step_s: steps.last().map(|ns| seconds(*ns)),
        gaps,
        joints: joints.map(|(name, (s, spikes))| s.joint(name, stamps_ns.len(), *spikes)).collect(),
        extra_columns: about.extra_names.clone(),
        ignored: about.ignored.clone(),
        repairs: reader.repairs(),
    })
}

fn seconds(ns: i64) -> f64 {
    ns as f64 / 1e9
}

/// Range of a joint's signals so far.
#[derive(Debug, Clone, Copy)]
struct Span {
    q: (f64, f64),
    tau: (f64, f64),
    tau_squared: f64,
}

impl Default for Span {
    fn default() -> Self {
        let none = (f64::INFINITY, f64::NEG_INFINITY);
        Self { q: none, tau: none, tau_squared: 0.0 }
    }
}

impl Span {
    fn add(&mut self, q: f64, tau: f64) {
        self.q = (self.q.0.min(q), self.q.1.max(q));
        self.tau = (self.tau.0.min(tau), self.tau.1.max(tau));
        self.tau_squared += tau * tau;
    }

    fn joint(&self, name: &str, samples: usize, [q_spikes, tau_spikes]: [u64; 2]) -> Joint {
        Joint {
            joint: name.to_owned(),
            q_min_rad: self.q.0,
            q_max_rad: self.q.1,
            tau_min_nm: self.tau.0,
            tau_max_nm: self.tau.1,
            tau_rms_nm: (self.tau_squared / samples.max(1) as f64).sqrt(),
            q_spikes,
            tau_spikes,
        }
    }
}

fn container_words(c: &Container) -> String {
    let mut text = String::new();
    let state = match (c.was_cut, c.complete) {
        (true, _) => "cut off before its end (lacuna recover completes it)",
        (false, true) => "complete",
        (false, false) => "properly ended, not marked complete by a Lacuna recorder",
    };
    // Writing to a String cannot fail.
    let _ = writeln!(text, "MCAP, profile \"{}\", written by \"{}\": {state}", c.profile, c.library);
    let width = c.topics.keys().map(|k| k.chars().count()).max().unwrap_or(0).max(5);
    if !c.topics.is_empty() {
        let _ = writeln!(text, "{:width$}  {:>9}  {:>9}  {:>9}  Schema", "Topic", "Messages", "Length", "Rate");
    }
    for (name, t) in &c.topics {
        let length = t.duration_s.map_or_else(|| "–".to_owned(), |s| format!("{} s", significant(s, 4)));
        let rate = t.rate_hz.map_or_else(|| "–".to_owned(), |r| format!("{} Hz", significant(r, 4)));
        let _ =
            writeln!(text, "{name:width$}  {:>9}  {length:>9}  {rate:>9}  {} ({})", t.messages, t.schema, t.encoding);
    }
    if !c.attachments.is_empty() {
        let list: Vec<String> = c.attachments.iter().map(|(name, bytes)| format!("{name} ({bytes} bytes)")).collect();
        let _ = writeln!(text, "Attachments: {}", list.join(", "));
    }
    if !c.metadata.is_empty() {
        let _ = writeln!(text, "Metadata: {}", c.metadata.keys().cloned().collect::<Vec<_>>().join(", "));
    }
    if let Some(end) = c.metadata.get("lacuna.end") {
        let _ = writeln!(text, "{}", counted_words(end));
    }
    text
}

/// Where the numbers hardly are in the units that they are taken for.
fn doubt(r: &Contents) -> Option<String> {
    let period = r.median_rate_hz.map(|hz| 1.0 / hz).filter(|s| *s > 0.1);
    period.map(|s| {
        format!(
            "Doubt: a sample every {} s; if the time is in ms, [columns] time_unit of the robot file says so",
            significant(s, 4)
        )
    })
}

/// What the recorder counted that is not in the file.
fn counted_words(end: &BTreeMap<String, String>) -> String {
    let of = |what: &str| -> Vec<String> {
        let named = end.iter().filter_map(|(key, n)| Some(format!("{n} of {}", key.strip_prefix(what)?)));
        named.collect()
    };
    let mut parts = Vec::new();
    for (what, words) in [("missing.", "samples missing"), ("repeated.", "repeated or out of order")] {
        let list = of(what);
        if !list.is_empty() {
            parts.push(format!("{words}: {}", list.join(", ")));
        }
    }
    if let Some(n) = end.get("dropped").filter(|n| *n != "0") {
        parts.push(format!("{n} messages dropped before a slow disk"));
    }
    match parts.as_slice() {
        [] => "Counts: no sample missing".to_owned(),
        parts => format!("Counts: {} (/gaps has the places)", parts.join("; ")),
    }
}

fn contents_words(r: &Contents) -> String {
    let mut text = String::new();
    let topic = r.topic.as_ref().map_or_else(String::new, |t| format!(", topic {t}"));
    let rate =
        r.median_rate_hz.map_or_else(|| "no rate".to_owned(), |hz| format!("{} Hz (median)", significant(hz, 4)));
    // Writing to a String cannot fail.
    let _ = writeln!(
        text,
        "{} of {}{topic}: {} samples, {} s from t = {} s, {rate}",
        r.format, r.robot, r.samples, r.duration_s, r.first_s
    );
    if let (Some(low), Some(high)) = (r.shortest_step_s, r.longest_step_s) {
        let _ = writeln!(text, "Steps: {} to {} ms", significant(1e3 * low, 4), significant(1e3 * high, 4));
    }
    let unit = r.torque_unit;
    let width = r.joints.iter().map(|j| j.joint.chars().count()).max().unwrap_or(0).max(5);
    let [angle, torque, rms] = ["Position [rad]".to_owned(), format!("Torque [{unit}]"), format!("RMS [{unit}]")];
    let _ = writeln!(text, "{:width$}  {angle:>20}  {torque:>20}  {rms:>10}", "Joint");
    for j in &r.joints {
        let range = |low: f64, high: f64| format!("{} to {}", significant(low, 4), significant(high, 4));
        let [q, tau] = [range(j.q_min_rad, j.q_max_rad), range(j.tau_min_nm, j.tau_max_nm)];
        let _ = writeln!(text, "{:width$}  {q:>20}  {tau:>20}  {:>10}", j.joint, significant(j.tau_rms_nm, 3));
    }
    let list = |names: &[String]| if names.is_empty() { "none".to_owned() } else { names.join(", ") };
    let _ = writeln!(text, "Further columns: {}", list(&r.extra_columns));
    if !r.ignored.is_empty() {
        let _ = writeln!(text, "Not read: {}", r.ignored.join(", "));
    }
    let _ = match r.gaps.iter().map(|g| g.to_s - g.from_s).max_by(f64::total_cmp) {
        None => writeln!(text, "Gaps: none"),
        Some(longest) => {
            writeln!(text, "Gaps: {}, the longest {} s (--json lists them)", r.gaps.len(), significant(longest, 3))
        }
    };
    for j in r.joints.iter().filter(|j| j.q_spikes + j.tau_spikes > 0) {
        let some = [(j.q_spikes, "position"), (j.tau_spikes, "torque")].into_iter().filter(|(n, _)| *n > 0);
        let list: Vec<String> = some.map(|(n, signal)| format!("{n} of {signal}")).collect();
        let _ = writeln!(
            text,
            "{}: single-sample spikes, {}; left as they are, identify and diagnose replace them",
            j.joint,
            list.join(", ")
        );
    }
    if let Some(doubt) = doubt(r) {
        let _ = writeln!(text, "{doubt}");
    }
    let repairs = words::repairs(&r.repairs);
    text + if repairs.is_empty() { "Repaired: nothing\n" } else { &repairs }
}
