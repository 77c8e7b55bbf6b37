//! What `lacuna info` says of a file without knowing its robot: what is in it, and what it would need.

use crate::mapping::mapping;
use crate::words;
use lacuna_recording::{Survey, Table, survey::JointTopic};
use lacuna_report::number::significant;
use serde::Serialize;
use std::fmt::Write as _;

/// What `--json` prints.
#[derive(Debug, Serialize)]
pub struct Surveyed {
    #[serde(skip_serializing_if = "Vec::is_empty")]
    columns: Vec<Column>,
    #[serde(skip_serializing_if = "Option::is_none")]
    time: Option<Time>,
    #[serde(skip_serializing_if = "Option::is_none")]
    rows: Option<u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    frames: Option<u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    ethercat_frames: Option<u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    duration_s: Option<f64>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    datagrams: Vec<Datagram>,
    /// JointState topics of an MCAP file.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    joint_topics: Vec<Joints>,
    needs: Vec<String>,
    /// Lines of a robot file that would let these columns be read.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    mapping: Vec<String>,
}

#[derive(Debug, Serialize)]
struct Joints {
    topic: String,
    joints: Vec<String>,
    position: bool,
    effort: bool,
}

/// A table's column, in its own unit.
#[derive(Debug, Serialize)]
struct Column {
    name: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    min: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    max: Option<f64>,
    /// Rows without a finite number.
    not_numbers: u64,
}

/// The column that looks like the time, in its own unit.
#[derive(Debug, Serialize)]
struct Time {
    column: String,
    median_step: Option<f64>,
    longest_step: f64,
    /// Rows whose time is not later than that of the row before.
    not_increasing: u64,
}

#[derive(Debug, Serialize)]
struct Datagram {
    command: &'static str,
    /// Logical address; of a station command the memory offset.
    address: u32,
    #[serde(skip_serializing_if = "Option::is_none")]
    station: Option<u32>,
    bytes: usize,
    copies: u64,
    returned: u64,
    working_counter: u16,
    #[serde(skip_serializing_if = "Option::is_none")]
    rate_hz: Option<f64>,
}

/// Puts a survey in the form that is printed.
pub fn survey_of(survey: &Survey) -> Surveyed {
    let mut out = Surveyed {
        columns: Vec::new(),
        time: None,
        rows: None,
        frames: None,
        ethercat_frames: None,
        duration_s: None,
        datagrams: Vec::new(),
        joint_topics: Vec::new(),
        needs: Vec::new(),
        mapping: Vec::new(),
    };
    match survey {
        Survey::Table(table) => {
            let names: Vec<String> = table.columns.iter().map(|c| c.name.clone()).collect();
            out.mapping = mapping(table);
            out.needs = needs(&names, &out.mapping);
            out.columns = columns(table);
            out.time = table.time.and_then(|i| table.columns.get(i)).map(|c| Time {
                column: c.name.clone(),
                median_step: c.steps.median(),
                longest_step: c.steps.longest,
                not_increasing: c.steps.not_increasing,
            });
            out.rows = Some(table.rows);
        }
        Survey::Bag(topics) => {
            out.needs = bag_needs(topics);
            let joints = |t: &JointTopic| Joints {
                topic: t.name.clone(),
                joints: t.joints.clone(),
                position: t.position,
                effort: t.effort,
            };
            out.joint_topics = topics.iter().map(joints).collect();
        }
        Survey::Bus(bus) => {
            out.frames = Some(bus.frames);
            out.ethercat_frames = Some(bus.ethercat);
            out.duration_s = bus.stamps_ns.map(|(first, last)| (last - first) as f64 / 1e9);
            let rate = |n: u64| out.duration_s.filter(|d| *d > 0.0).map(|d| n.saturating_sub(1) as f64 / d);
            out.datagrams = bus
                .datagrams
                .iter()
                .map(|d| {
                    let logical = d.command.logical();
                    Datagram {
                        command: d.command.name(),
                        address: if logical { d.address } else { d.address >> 16 },
                        station: (!logical).then_some(d.address & 0xFFFF),
                        bytes: d.bytes,
                        copies: d.copies,
                        returned: d.returned,
                        working_counter: d.working_counter,
                        rate_hz: rate(d.returned),
                    }
                })
                .collect();
            out.needs = if bus.ethercat == 0 {
                vec!["EtherCAT frames (type 0x88A4); there are none".to_owned()]
            } else {
                vec![
                    "a robot file whose [ethercat] says where position (0x6064) and torque (0x6077) of each joint are: \
                     eni = \"…\" of the master, or addresses"
                        .to_owned(),
                    "[drive] gear_ratio, encoder_bits and rated_torque_nm in it, to turn counts into rad and Nm".to_owned(),
                ]
            };
        }
    }
    out
}

/// What a bag lacks, or a robot file must say.
fn bag_needs(topics: &[JointTopic]) -> Vec<String> {
    if topics.is_empty() {
        return vec!["a topic of sensor_msgs/msg/JointState with position and effort; there is none".to_owned()];
    }
    let mut all: Vec<String> = Vec::new();
    for t in topics.iter().filter(|t| !(t.position && t.effort)) {
        let name = &t.name;
        if t.encoding != "cdr" {
            all.push(format!("{name} in cdr (ROS 2) to be read; it is in {}", t.encoding));
        } else if !t.position || t.joints.is_empty() {
            all.push(format!("a position of every joint on {name} to be read"));
        }
    }
    let whole: Vec<&JointTopic> = topics.iter().filter(|t| t.position && t.effort).collect();
    if whole.is_empty() {
        all.push("a topic with position and effort of every joint: positions alone give no torque model".to_owned());
    }
    let topic = if whole.len() > 1 { " --topic TOPIC" } else { "" };
    all.push(format!(
        "a robot file with joints of these names, or with them as columns.joints: --robot FILE{topic} shows its signals"
    ));
    all
}

fn columns(table: &Table) -> Vec<Column> {
    let one = |c: &lacuna_recording::survey::Column| Column {
        name: c.name.clone(),
        min: c.range.map(|r| r.0),
        max: c.range.map(|r| r.1),
        not_numbers: table.rows.saturating_sub(c.numbers),
    };
    table.columns.iter().map(one).collect()
}

/// What a table lacks or a robot file must say, its `[columns]` in `mapping` aside.
fn needs(columns: &[String], mapping: &[String]) -> Vec<String> {
    let has = |name: &str| columns.iter().any(|c| c == name);
    let numbered = |prefix: &str| (1..).take_while(|j| has(&format!("{prefix}{j}"))).count();
    let named = |prefix: &str| columns.iter().filter(|c| c.starts_with(&format!("{prefix}_"))).count();
    let (q, tau) = (numbered("q") + named("q"), numbered("tau") + named("tau"));
    let mut all = Vec::new();
    let mapped = |key: &str| mapping.iter().any(|line| line.starts_with(&format!("{key} = ")));
    let named = |key: &str| format!("named as columns.{key} in the robot file if they are called otherwise");
    if !has("t") && !mapped("time") {
        all.push(format!("a column t, the time in seconds; {}", named("time").replace("they are", "it is")));
    }
    if q == 0 && !mapped("position") {
        all.push(format!("columns q1…qn or q_<joint>, positions in rad; {}", named("position")));
    }
    if tau == 0 && !mapped("torque") {
        all.push(format!("columns tau1…taun or tau_<joint>, torques; {}", named("torque")));
    }
    if q != tau && q > 0 && tau > 0 {
        all.push(format!("as many torques as positions (found {tau} and {q})"));
    }
    if !columns.is_empty() && columns.iter().all(|c| c.parse::<f64>().is_ok()) {
        all.push("a header line with the columns' names; the first row holds numbers".to_owned());
    }
    let joints = if q > 0 { format!(" with {}", words::count(q, "joint")) } else { String::new() };
    all.push(format!("a robot file{joints}: --robot FILE shows its signals"));
    all
}

/// In words.
pub fn survey_words(s: &Surveyed) -> String {
    let mut text = String::new();
    // Writing to a String cannot fail.
    if let Some(rows) = s.rows {
        let names: Vec<&str> = s.columns.iter().map(|c| c.name.as_str()).collect();
        let _ = writeln!(text, "CSV: {rows} rows of {}", names.join(", "));
        text.push_str(&columns_words(&s.columns));
    }
    if let Some(time) = &s.time {
        let step = time.median_step.map_or_else(String::new, |step| format!("median step {}, ", significant(step, 4)));
        let back = if time.not_increasing > 0 {
            format!(", {} of its steps are none or backwards", time.not_increasing)
        } else {
            String::new()
        };
        let _ = writeln!(text, "Time: {}, {step}longest step {}{back}", time.column, significant(time.longest_step, 4));
    }
    if let (Some(frames), Some(ethercat)) = (s.frames, s.ethercat_frames) {
        let length = s.duration_s.map_or_else(String::new, |d| format!(" in {} s", significant(d, 4)));
        let _ = writeln!(text, "Capture: {frames} frames{length}, {ethercat} of them EtherCAT");
    }
    for t in &s.joint_topics {
        let what = match (t.position, t.effort) {
            (true, true) => "position and effort",
            (true, false) => "position, no effort",
            (false, true) => "effort, no position",
            (false, false) => "neither position nor effort of every joint",
        };
        let _ = writeln!(text, "Joints on {}: {} ({what})", t.topic, t.joints.join(", "));
    }
    if !s.datagrams.is_empty() {
        let _ = writeln!(text, "Command  Address                 Bytes  Counter  Came back      Rate");
    }
    for d in &s.datagrams {
        let address = match d.station {
            Some(station) => format!("station {station}, {:#06x}", d.address),
            None => format!("{:#010x}", d.address),
        };
        let rate = d.rate_hz.map_or_else(|| "–".to_owned(), |r| format!("{} Hz", significant(r, 4)));
        let (counter, back) = (d.working_counter, d.returned);
        let _ = writeln!(text, "{:7}  {address:22}  {:>5}  {counter:>7}  {back:>9}  {rate:>8}", d.command, d.bytes);
    }
    for need in &s.needs {
        let _ = writeln!(text, "Needs {need}");
    }
    if !s.mapping.is_empty() {
        text.push_str(
            "Needs the meaning of these columns in that robot file; by their names and values perhaps:\n  [columns]\n",
        );
        s.mapping.iter().for_each(|line| text.push_str(&format!("  {line}\n")));
    }
    text
}

fn columns_words(columns: &[Column]) -> String {
    let mut text = String::new();
    let short = |name: &str| name.chars().take(32).collect::<String>();
    let width = columns.iter().map(|c| short(&c.name).chars().count()).max().unwrap_or(0).max(6);
    let _ = writeln!(text, "{:width$}  {:>26}  No number", "Column", "Range");
    for c in columns {
        let range = match (c.min, c.max) {
            (Some(low), Some(high)) => format!("{} to {}", significant(low, 5), significant(high, 5)),
            _ => "–".to_owned(),
        };
        let none = if c.not_numbers > 0 { format!("{:>9}", c.not_numbers) } else { String::new() };
        let _ = writeln!(text, "{}", format!("{:width$}  {range:>26}  {none}", short(&c.name)).trim_end());
    }
    text
}
