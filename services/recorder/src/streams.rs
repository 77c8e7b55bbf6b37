//! Streams, their topics and their counts.

use crate::before::hole;
use crate::{Facts, WriteError};
use lacuna_interfaces::{
    FrictionTorque, Header, JointMeasured, JointSmoothed, MAX_JOINTS, PayloadEstimate, ResidualWatch, TorqueModel, Wire,
};
use lacuna_recording::container::{ChannelId, Finished};
use lacuna_recording::ros::bag;
use lacuna_recording::ros::cdr::Filler;
use lacuna_recording::ros::schema;
use lacuna_recording::topics::{Declare, Has, Messages, StatusTopic, Topic};
use std::collections::BTreeMap;

/// Messages that can be recorded, in the order of the graph.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Stream {
    /// [`lacuna_interfaces::JointMeasured`].
    Measured,
    /// [`lacuna_interfaces::JointSmoothed`].
    Smoothed,
    /// [`lacuna_interfaces::TorqueModel`].
    Torque,
    /// [`lacuna_interfaces::FrictionTorque`].
    Friction,
    /// [`lacuna_interfaces::PayloadEstimate`].
    Payload,
    /// [`lacuna_interfaces::ResidualWatch`].
    Watch,
}

impl Stream {
    /// All, in order.
    pub const ALL: [Self; 6] =
        [Self::Measured, Self::Smoothed, Self::Torque, Self::Friction, Self::Payload, Self::Watch];

    /// The stream of a wire message's name.
    pub fn of_message(name: &str) -> Option<Self> {
        match name {
            JointMeasured::NAME => Some(Self::Measured),
            JointSmoothed::NAME => Some(Self::Smoothed),
            TorqueModel::NAME => Some(Self::Torque),
            FrictionTorque::NAME => Some(Self::Friction),
            PayloadEstimate::NAME => Some(Self::Payload),
            ResidualWatch::NAME => Some(Self::Watch),
            _ => None,
        }
    }

    /// Name in metadata.
    pub fn name(self) -> &'static str {
        match self {
            Self::Measured => "measured",
            Self::Smoothed => "smoothed",
            Self::Torque => "torque",
            Self::Friction => "friction",
            Self::Payload => "payload",
            Self::Watch => "monitor",
        }
    }
}

/// What was recorded.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Counts {
    /// Samples taken per stream (`payload`, or `before/payload` in a namespace).
    pub samples: BTreeMap<String, u64>,
    /// Sequence numbers that never came, per stream (only streams that miss any).
    pub missing: BTreeMap<String, u64>,
    /// Sequence numbers that came again or out of order, per stream (only streams with any).
    pub repeated: BTreeMap<String, u64>,
    /// Messages in the file, per topic.
    pub messages: BTreeMap<String, u64>,
    /// Messages dropped because the disk was too slow (live only).
    pub dropped: u64,
}

impl Counts {
    /// True if nothing is missing, repeated or dropped.
    pub fn lossless(&self) -> bool {
        self.missing.is_empty() && self.repeated.is_empty() && self.dropped == 0
    }

    pub(crate) fn facts(&self) -> Facts {
        let mut facts = Facts::new();
        facts.insert("complete".to_owned(), "true".to_owned());
        facts.insert("lossless".to_owned(), self.lossless().to_string());
        facts.insert("dropped".to_owned(), self.dropped.to_string());
        for (what, list) in [("samples", &self.samples), ("missing", &self.missing), ("repeated", &self.repeated)] {
            for (stream, count) in list {
                facts.insert(format!("{what}.{stream}"), count.to_string());
            }
        }
        facts
    }
}

/// Samples that are missing in a stream.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Hole {
    /// Number of the first.
    pub(crate) first: u64,
    /// How many.
    pub(crate) count: u64,
}

/// Sequence check of each stream.
#[derive(Debug, Default)]
pub(crate) struct Sequences {
    seen: [Seen; Stream::ALL.len()],
    /// The file goes on after an earlier one: what is missing before its first samples is known later.
    resumed: bool,
}

#[derive(Debug, Default, Clone, Copy)]
struct Seen {
    /// The first sample's header.
    first: Option<Header>,
    last: u64,
    samples: u64,
    missing: u64,
    repeated: u64,
    /// Samples that are not in the file, or not whole: the disk was too slow.
    unwritten: u64,
}

impl Sequences {
    pub(crate) fn new(resumed: bool) -> Self {
        Self { resumed, ..Self::default() }
    }

    /// Takes note of a sample, and says what is missing before it; the first of a stream should be number 1.
    pub(crate) fn saw(&mut self, stream: Stream, header: &Header) -> Option<Hole> {
        let seen = &mut self.seen[stream as usize];
        let seq = header.seq;
        seen.samples += 1;
        let begins = seen.first.is_none();
        if begins {
            seen.first = Some(*header);
        }
        if seq <= seen.last {
            seen.repeated += 1;
            return None;
        }
        let hole = Hole { first: seen.last + 1, count: seq - seen.last - 1 };
        seen.last = seq;
        if hole.count == 0 || (begins && self.resumed) {
            return None;
        }
        seen.missing += hole.count;
        Some(hole)
    }

    /// What is missing between the end of `stream` in the file before (32 bits of its last number) and this file, with
    /// the header of the sample after it, if one has come; counted from here on. Ask once.
    pub(crate) fn between(&mut self, stream: Stream, last: u32) -> Option<(Header, Hole)> {
        let seen = &mut self.seen[stream as usize];
        let header = seen.first?;
        let count = hole(last, header.seq as u32).min(header.seq.saturating_sub(1));
        seen.missing += count;
        Some((header, Hole { first: header.seq - count, count }))
    }

    /// True once a sample of `stream` has come.
    pub(crate) fn has(&self, stream: Stream) -> bool {
        self.seen[stream as usize].first.is_some()
    }

    /// Takes note of a sample that the disk was too slow for.
    pub(crate) fn was_short(&mut self, stream: Stream) {
        self.seen[stream as usize].unwritten += 1;
    }

    /// Samples that the disk was too slow for, of the stream that lost most.
    pub(crate) fn unwritten(&self) -> u64 {
        self.seen.iter().map(|s| s.unwritten).max().unwrap_or(0)
    }

    /// The highest number of any stream.
    pub(crate) fn last(&self) -> u64 {
        self.seen.iter().map(|s| s.last).max().unwrap_or(0)
    }

    /// Adds the counts of the streams of `namespace`.
    pub(crate) fn add_to(&self, counts: &mut Counts, namespace: &str) {
        for (stream, seen) in Stream::ALL.into_iter().zip(&self.seen) {
            let name = in_namespace(namespace, stream.name());
            for (list, n) in [
                (&mut counts.samples, seen.samples),
                (&mut counts.missing, seen.missing),
                (&mut counts.repeated, seen.repeated),
            ] {
                if n > 0 {
                    list.insert(name.clone(), n);
                }
            }
        }
    }
}

/// `before/payload`; without a namespace the name alone.
pub(crate) fn in_namespace(namespace: &str, name: &str) -> String {
    if namespace.is_empty() { name.to_owned() } else { format!("{namespace}/{name}") }
}

/// `/before/residual`; without a namespace the topic as it is.
pub(crate) fn full(namespace: &str, topic: &str) -> String {
    if namespace.is_empty() { topic.to_owned() } else { format!("/{namespace}{topic}") }
}

/// The topics of a namespace; those of streams that do not come are absent. What a message of the graph becomes on
/// them is said once, in [`Topics::measured`] and the like: for recordings, and for whoever shows the same topics.
#[derive(Debug)]
pub struct Topics {
    namespace: String,
    /// Joints of the robot, at most [`lacuna_interfaces::MAX_JOINTS`].
    pub(crate) joints: usize,
    list: [Option<Topic>; NAMES.len()],
    status: Option<(Stream, StatusTopic)>,
}

/// Names of the topics of `stream` in a namespace.
pub(crate) fn topics_of(stream: Stream, namespace: &str) -> impl Iterator<Item = String> {
    NAMES.iter().filter(move |(of, ..)| *of == stream).map(move |(_, name, _)| full(namespace, name))
}

/// Topic names in the order of the constants of [`Topics`], with the stream they belong to and their type.
const NAMES: [(Stream, &str, &str); 11] = [
    (Stream::Measured, "/measured/detail", schema::MEASURED_DETAIL.name),
    (Stream::Measured, "/measured", schema::JOINT_STATE.name),
    (Stream::Smoothed, "/smoothed", schema::JOINT_STATE.name),
    (Stream::Smoothed, "/smoothed/detail", schema::MOTION_DETAIL.name),
    (Stream::Torque, "/torque/nominal", schema::JOINT_STATE.name),
    (Stream::Torque, "/torque/rigid", schema::JOINT_STATE.name),
    (Stream::Friction, "/friction", schema::JOINT_STATE.name),
    (Stream::Payload, "/residual", schema::JOINT_STATE.name),
    (Stream::Payload, "/residual_payload", schema::JOINT_STATE.name),
    (Stream::Payload, "/payload", schema::PAYLOAD.name),
    (Stream::Watch, "/monitor", schema::RESIDUAL_WATCH.name),
];
const STATUS: &str = "/status";
pub(crate) const GAPS: &str = "/gaps";

impl Topics {
    pub(crate) const MEASURED_DETAIL: usize = 0;
    pub(crate) const MEASURED: usize = 1;
    pub(crate) const SMOOTHED: usize = 2;
    pub(crate) const SMOOTHED_DETAIL: usize = 3;
    pub(crate) const TORQUE_NOMINAL: usize = 4;
    pub(crate) const TORQUE_RIGID: usize = 5;
    pub(crate) const FRICTION: usize = 6;
    pub(crate) const RESIDUAL: usize = 7;
    pub(crate) const RESIDUAL_PAYLOAD: usize = 8;
    pub(crate) const PAYLOAD: usize = 9;
    pub(crate) const WATCH: usize = 10;

    /// Declares the topics of the streams that will come in `namespace`.
    ///
    /// # Errors
    /// [`WriteError`] if the place refuses one.
    pub fn declare(
        place: &mut impl Declare,
        joints: &[String],
        namespace: &str,
        streams: &[Stream],
    ) -> Result<Self, WriteError> {
        let mut list = [const { None }; NAMES.len()];
        for (i, slot) in list.iter_mut().enumerate() {
            let (stream, name, _) = NAMES[i];
            if !streams.contains(&stream) {
                continue;
            }
            let name = &full(namespace, name);
            let has = |position, velocity, effort| Has { position, velocity, effort };
            *slot = Some(match i {
                Self::MEASURED_DETAIL => Topic::measured_detail(place, name, joints)?,
                Self::SMOOTHED_DETAIL => Topic::motion_detail(place, name, joints)?,
                Self::PAYLOAD => Topic::payload(place, name)?,
                Self::WATCH => Topic::residual_watch(place, name, joints)?,
                Self::MEASURED => Topic::joint_state(place, name, joints, has(true, false, true))?,
                Self::SMOOTHED => Topic::joint_state(place, name, joints, has(true, true, false))?,
                _ => Topic::joint_state(place, name, joints, has(false, false, true))?,
            });
        }
        let status = match streams.iter().max() {
            Some(&last) => Some((last, StatusTopic::new(place, &full(namespace, STATUS))?)),
            None => None,
        };
        let joints = joints.len().min(MAX_JOINTS);
        Ok(Self { namespace: namespace.to_owned(), joints, list, status })
    }

    /// Whether a stream's topics were declared.
    pub(crate) fn holds(&self, stream: Stream) -> bool {
        NAMES.iter().zip(&self.list).any(|((of, ..), topic)| *of == stream && topic.is_some())
    }

    /// Writes to a topic, if it is recorded.
    #[inline]
    pub(crate) fn write(&self, topic: usize, to: &mut impl Messages, header: &Header, fill: impl FnOnce(Filler<'_>)) {
        if let Some(Some(topic)) = self.list.get(topic) {
            topic.write(to, header, fill);
        }
    }

    /// Writes the status of a sample of the last stream.
    pub(crate) fn status(&self, stream: Stream, to: &mut impl Messages, header: &Header) {
        if let Some((last, topic)) = &self.status
            && *last == stream
        {
            topic.write(to, header);
        }
    }

    fn channels(&self) -> impl Iterator<Item = (String, &'static str, ChannelId)> {
        let typed = NAMES.iter().zip(&self.list);
        let listed = typed.filter_map(|((_, name, kind), topic)| Some((*name, *kind, topic.as_ref()?.channel())));
        let status = self.status.iter().map(|(_, topic)| (STATUS, schema::STATUS.name, topic.channel()));
        listed.chain(status).map(|(name, kind, channel)| (full(&self.namespace, name), kind, channel))
    }

    /// Topics with their messages in the file.
    pub(crate) fn bag_topics(&self, finished: &Finished) -> Vec<bag::Topic> {
        let count = |id| finished.messages.get(&id).copied().unwrap_or(0);
        self.channels().map(|(name, kind, id)| bag::Topic { name, kind: kind.to_owned(), count: count(id) }).collect()
    }
}
