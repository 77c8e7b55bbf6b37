//! MCAP with ROS 2 JointState messages, of any robot and recorder.
//!
//! - **Topic**: the one asked for; else the file's only JointState topic; else `/measured`; else
//!   `/joint_states`; else an error that lists them.
//! - **Joints** are matched by name (the robot file's, or those of its `columns.joints`), in any order. A message may name more joints than the robot file. One that
//!   names none of them (a gripper on the same topic) is passed over; one that names only some is an error.
//! - **Time** is the header stamp; with [`TimeSource::Auto`] the log time if the first message's header stamp
//!   is 0 and its log time is not.
//! - A file without its end (a crash, a full disk) reads as far as it goes; the cut is counted.
//! - Temperatures, link-side signals and the drive's state come from `<topic>/detail` where our own recorder
//!   wrote it.

use super::{Format, Request};
use crate::condition::repair;
use crate::container::{ChannelRecord, Item, Scan, channels_of};
use crate::ros::cdr::Cursor;
use crate::ros::joint_state::{JointState, Matching, Names, Order};
use crate::ros::schema;
use crate::sample::{About, RawReader, Sample};
use crate::{ReadOptions, TimeSource};
use lacuna_interfaces::{BadInput, JointMeasured, Joints, MAX_JOINTS, Repair, RepairKind, RobotFile, flag};

/// The registry's line.
pub const FORMAT: Format =
    Format { name: "mcap", extensions: &["mcap"], exact: true, sniff: Some(|b| b.starts_with(mcap::MAGIC)), open };

fn open(request: &Request<'_>) -> Result<Box<dyn RawReader>, BadInput> {
    let topics = Topics::choose(channels_of(request.path)?, request.options)?;
    let scan = Scan::open(request.path, false)?;
    Ok(Box::new(McapReader::new(scan, topics, request.robot, request.options)?))
}

struct McapReader {
    scan: Scan,
    topics: Topics,
    about: About,
    time: TimeSource,
    by_log_time: bool,
    columns: Vec<Column>,
    matching: Matching,
    detail: Detail,
    /// The first sample, read when the file was opened.
    first: Option<Sample>,
    /// Messages of the topic so far.
    message: u64,
}

/// The channels that are read.
#[derive(Debug, Default)]
struct Topics {
    topic: String,
    joint_state: Vec<u16>,
    detail: Vec<u16>,
    ignored: Vec<String>,
}

impl Topics {
    fn choose(channels: Vec<(ChannelRecord, String)>, options: &ReadOptions) -> Result<Self, BadInput> {
        let is_joint_state = |s: &str| s == schema::JOINT_STATE.name;
        let mut candidates: Vec<&str> =
            channels.iter().filter(|(_, s)| is_joint_state(s)).map(|(c, _)| c.topic.as_str()).collect();
        candidates.sort_unstable();
        candidates.dedup();
        let topic = match (&options.topic, candidates.as_slice()) {
            (Some(wanted), list) if list.contains(&wanted.as_str()) => wanted.clone(),
            (Some(wanted), list) => {
                return Err(BadInput::new(format!(
                    "found no JointState topic {wanted}; expected one of {}",
                    shown(list, &channels)
                )));
            }
            (None, [only]) => (*only).to_owned(),
            (None, list) => match ["/measured", "/joint_states"].into_iter().find(|t| list.contains(t)) {
                Some(topic) => topic.to_owned(),
                None if list.is_empty() => {
                    return Err(BadInput::new(format!(
                        "found {}; expected a topic of type {}",
                        shown(list, &channels),
                        schema::JOINT_STATE.name
                    )));
                }
                None => {
                    return Err(BadInput::new(format!(
                        "found JointState topics {}; expected the choice of one (topic = …)",
                        shown(list, &channels)
                    )));
                }
            },
        };
        let mut found = Self { topic, ..Self::default() };
        let detail_topic = format!("{}/detail", found.topic);
        for (channel, schema_name) in channels {
            if channel.topic == found.topic && is_joint_state(&schema_name) {
                if channel.encoding != "cdr" {
                    return Err(BadInput::new(format!(
                        "found messages in {} on {}; expected cdr (ROS 2)",
                        channel.encoding, channel.topic
                    )));
                }
                found.joint_state.push(channel.id);
            } else if channel.topic == detail_topic && schema_name == schema::MEASURED_DETAIL.name {
                found.detail.push(channel.id);
            } else {
                found.ignored.push(channel.topic);
            }
        }
        Ok(found)
    }
}

/// The candidates, or what else there is if there is none.
fn shown(candidates: &[&str], channels: &[(ChannelRecord, String)]) -> String {
    let mut list: Vec<String> = candidates.iter().map(|t| (*t).to_owned()).collect();
    if list.is_empty() {
        list = channels.iter().map(|(c, s)| format!("{} ({s})", c.topic)).collect();
    }
    match list.len() {
        0 => "no topics".to_owned(),
        n if n > 12 => format!("{} and {} more", list[..12].join(", "), n - 12),
        _ => list.join(", "),
    }
}

/// A further column and where its values come from.
#[derive(Debug, Clone, Copy)]
enum Column {
    Temperature(usize),
    LinkPosition(usize),
    LinkTorque(usize),
    Enabled,
}

impl McapReader {
    fn new(scan: Scan, topics: Topics, robot: &RobotFile, options: &ReadOptions) -> Result<Self, BadInput> {
        let about = About {
            format: FORMAT.name,
            extra_names: Vec::new(),
            ignored: topics.ignored.clone(),
            topic: Some(topics.topic.clone()),
        };
        let mut new = Self {
            scan,
            topics,
            about,
            time: options.time,
            by_log_time: options.time == TimeSource::Log,
            columns: Vec::new(),
            matching: Matching::new(Names::of(robot)),
            detail: Detail::default(),
            first: None,
            message: 0,
        };
        // The first sample tells whether the joints fit, and which further signals there are.
        let mut first = Sample::default();
        if new.advance(&mut first)? {
            if options.extra {
                (new.about.extra_names, new.columns) = columns(robot, &new.detail, &first.measured);
                new.fill_extra(&mut first);
            }
            new.first = Some(first);
        } else if !new.matching.passed.is_empty() {
            return Err(BadInput::new(format!(
                "found joints {} on {}; expected {}, as robot \"{}\" names them",
                new.matching.passed.join(", "),
                new.topics.topic,
                new.matching.joints.expected().join(", "),
                robot.name
            )));
        }
        Ok(new)
    }

    /// Reads on to the next sample.
    fn advance(&mut self, out: &mut Sample) -> Result<bool, BadInput> {
        loop {
            // The scan lends its buffers, so the fields below are borrowed one by one.
            let Some(item) = self.scan.next_item()? else { return Ok(false) };
            let Item::Message(at, data) = item else { continue };
            if self.topics.joint_state.contains(&at.channel) {
                self.message += 1;
                let (message, topic) = (self.message, &self.topics.topic);
                let Some(state) = JointState::parse(data) else {
                    return Err(undecodable(message, topic));
                };
                if message == 1 && self.time == TimeSource::Auto {
                    self.by_log_time = state.stamp_ns == 0 && at.log_time != 0;
                }
                let taken = self.matching.take(&state, &mut out.measured);
                if taken.map_err(|e| e_of(message, topic, e))? {
                    out.measured.header.stamp_ns =
                        if self.by_log_time { at.log_time.min(i64::MAX as u64) as i64 } else { state.stamp_ns };
                    self.detail.apply(state.stamp_ns, &mut out.measured);
                    return Ok(true);
                }
            } else if self.topics.detail.contains(&at.channel) {
                self.detail.read(data, &self.matching.joints);
            }
        }
    }

    fn fill_extra(&self, out: &mut Sample) {
        out.extra.clear();
        let m = &out.measured;
        out.extra.extend(self.columns.iter().map(|column| match *column {
            Column::Temperature(j) => m.temperature_degc[j],
            Column::LinkPosition(j) => m.link_q_rad[j],
            Column::LinkTorque(j) => m.link_tau_nm[j],
            Column::Enabled => f64::from(u8::from(!m.header.has(flag::DRIVE_OFF))),
        }));
    }
}

fn e_of(message: u64, topic: &str, error: BadInput) -> BadInput {
    BadInput { what: format!("message {message} of {topic}: {}", error.what), ..error }
}

fn undecodable(message: u64, topic: &str) -> BadInput {
    e_of(message, topic, BadInput::new(format!("found bytes that are no {} in CDR", schema::JOINT_STATE.name)))
}

impl RawReader for McapReader {
    fn about(&self) -> &About {
        &self.about
    }

    fn next_sample(&mut self, out: &mut Sample) -> Result<bool, BadInput> {
        if let Some(first) = self.first.take() {
            let header = out.measured.header;
            *out = first;
            out.measured.header.joints = header.joints;
            return Ok(true);
        }
        if !self.advance(out)? {
            return Ok(false);
        }
        if !self.columns.is_empty() {
            self.fill_extra(out);
        }
        Ok(true)
    }

    fn locate(&self, error: BadInput) -> BadInput {
        e_of(self.message, &self.topics.topic, error)
    }

    fn bytes_read(&self) -> u64 {
        self.scan.position()
    }

    fn repairs(&self) -> Vec<Repair> {
        let cut = repair(RepairKind::TruncatedTail, "t", u64::from(self.scan.was_cut()));
        Vec::from_iter((cut.count > 0).then_some(cut))
    }
}

/// Further columns: those the robot file names, and temperatures under their default names if there are any.
fn columns(robot: &RobotFile, detail: &Detail, first: &JointMeasured) -> (Vec<String>, Vec<Column>) {
    let named = &robot.columns;
    let mut list: Vec<(String, Column)> = Vec::new();
    let mut add = |names: &[String], column: fn(usize) -> Column| {
        list.extend(names.iter().enumerate().map(|(j, name)| (name.clone(), column(j))));
    };
    let present = |values: &Joints| values.iter().take(robot.joint_count()).any(|v| !v.is_nan());
    let default_names: Vec<String> = (1..=robot.joint_count()).map(|j| format!("temp{j}")).collect();
    if present(&first.temperature_degc) {
        add(if named.temperature.is_empty() { &default_names } else { &named.temperature }, Column::Temperature);
    }
    if present(&first.link_q_rad) {
        add(&named.link_position, Column::LinkPosition);
    }
    if present(&first.link_tau_nm) {
        add(&named.link_torque, Column::LinkTorque);
    }
    if let (Some(name), Some(_)) = (&named.enabled, detail.stamp_ns) {
        list.push((name.clone(), Column::Enabled));
    }
    list.into_iter().unzip()
}

/// The newest message of the detail topic.
#[derive(Debug, Default)]
struct Detail {
    stamp_ns: Option<i64>,
    order: Order,
    temperature: Joints,
    link_q: Joints,
    link_tau: Joints,
    drive_on: bool,
}

impl Detail {
    /// Takes the next message; one that does not decode counts as none.
    fn read(&mut self, message: &[u8], joints: &Names) {
        self.stamp_ns = self.parse(message, joints);
    }

    fn parse(&mut self, message: &[u8], joints: &Names) -> Option<i64> {
        let mut cursor = Cursor::new(message)?;
        let stamp_ns = cursor.header()?;
        let names = cursor.strings()?;
        self.order.follow(&cursor, names, joints);
        for list in [&mut self.temperature, &mut self.link_q, &mut self.link_tau] {
            let numbers = cursor.numbers()?;
            for (slot, at) in list.iter_mut().zip(&self.order.at) {
                *slot = at.and_then(|i| numbers.get(i)).unwrap_or(f64::NAN);
            }
        }
        self.drive_on = cursor.u8()? != 0;
        Some(stamp_ns)
    }

    /// Adds the signals to the sample of the same stamp.
    fn apply(&self, stamp_ns: i64, m: &mut JointMeasured) {
        const ABSENT: Joints = [f64::NAN; MAX_JOINTS];
        let there = self.stamp_ns == Some(stamp_ns);
        m.temperature_degc = if there { self.temperature } else { ABSENT };
        m.link_q_rad = if there { self.link_q } else { ABSENT };
        m.link_tau_nm = if there { self.link_tau } else { ABSENT };
        if there && !self.drive_on {
            m.header.flags |= flag::DRIVE_OFF;
        }
    }
}
