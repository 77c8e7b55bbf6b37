//! Typed topics of a recording: what a channel holds, declared once, then written without allocation. A live view has
//! the same topics: it declares them elsewhere ([`Declare`]) and sends what is written to them ([`Messages`]).

use crate::container::{Channel, ChannelId, MessageBatch, WriteError, Writer};
use crate::ros::bag::OFFERED_QOS;
use crate::ros::cdr::{Builder, Filler, Template};
use crate::ros::schema::{self, Schema};
use lacuna_interfaces::Header;
use lacuna_interfaces::wire::MAX_HOPS;

/// Where topics are declared.
pub trait Declare {
    /// Declares a channel.
    ///
    /// # Errors
    /// [`WriteError`] if writing failed, or for more channels than there can be.
    fn channel(&mut self, channel: Channel) -> Result<ChannelId, WriteError>;
}

impl Declare for Writer {
    fn channel(&mut self, channel: Channel) -> Result<ChannelId, WriteError> {
        Self::channel(self, channel)
    }
}

/// Where messages go.
pub trait Messages {
    /// Takes a message of `channel` whose bytes `fill` writes, logged at `time_ns`.
    fn message(&mut self, channel: ChannelId, sequence: u32, time_ns: u64, fill: impl FnOnce(&mut Vec<u8>));
}

impl Messages for MessageBatch<'_> {
    #[inline]
    fn message(&mut self, channel: ChannelId, sequence: u32, time_ns: u64, fill: impl FnOnce(&mut Vec<u8>)) {
        Self::message(self, channel, sequence, time_ns, fill);
    }
}

/// Declares a topic with a ROS 2 message type.
///
/// # Errors
/// As [`Declare::channel`].
pub fn declare(place: &mut impl Declare, topic: &str, schema: &Schema) -> Result<ChannelId, WriteError> {
    place.channel(Channel {
        topic: topic.to_owned(),
        schema: schema.name.to_owned(),
        schema_encoding: "ros2msg".to_owned(),
        schema_text: schema.definition().into_bytes(),
        encoding: "cdr".to_owned(),
        metadata: [("offered_qos_profiles".to_owned(), OFFERED_QOS.to_owned())].into(),
    })
}

/// Which lists of a `sensor_msgs/JointState` a topic fills.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Has {
    /// Positions [rad].
    pub position: bool,
    /// Velocities [rad/s].
    pub velocity: bool,
    /// Efforts [Nm or the robot file's `torque_unit`].
    pub effort: bool,
}

/// A topic whose messages have one layout: a template with slots for the numbers.
#[derive(Debug, Clone)]
pub struct Topic {
    channel: ChannelId,
    template: Template,
}

impl Topic {
    /// A `sensor_msgs/JointState` topic; its slots are the lists it has, in the order position, velocity,
    /// effort.
    ///
    /// # Errors
    /// [`WriteError`] if writing failed.
    pub fn joint_state(place: &mut impl Declare, topic: &str, joints: &[String], has: Has) -> Result<Self, WriteError> {
        let n = |there: bool| if there { joints.len() } else { 0 };
        let template = Builder::stamped()
            .strings(joints)
            .numbers(n(has.position))
            .numbers(n(has.velocity))
            .numbers(n(has.effort))
            .template();
        Ok(Self { channel: declare(place, topic, &schema::JOINT_STATE)?, template })
    }

    /// A `lacuna_msgs/MeasuredDetail` topic; slots: temperature, link position, link effort, drive on.
    ///
    /// # Errors
    /// [`WriteError`] if writing failed.
    pub fn measured_detail(place: &mut impl Declare, topic: &str, joints: &[String]) -> Result<Self, WriteError> {
        let n = joints.len();
        let template = Builder::stamped().strings(joints).numbers(n).numbers(n).numbers(n).scalar(1).template();
        Ok(Self { channel: declare(place, topic, &schema::MEASURED_DETAIL)?, template })
    }

    /// A `lacuna_msgs/MotionDetail` topic; slots: acceleration and the standard deviations of position, velocity
    /// and acceleration.
    ///
    /// # Errors
    /// [`WriteError`] if writing failed.
    pub fn motion_detail(place: &mut impl Declare, topic: &str, joints: &[String]) -> Result<Self, WriteError> {
        let n = joints.len();
        let template = Builder::stamped().strings(joints).numbers(n).numbers(n).numbers(n).numbers(n).template();
        Ok(Self { channel: declare(place, topic, &schema::MOTION_DETAIL)?, template })
    }

    /// A `lacuna_msgs/Payload` topic; slots: mass, its standard deviation, excited, step.
    ///
    /// # Errors
    /// [`WriteError`] if writing failed.
    pub fn payload(place: &mut impl Declare, topic: &str) -> Result<Self, WriteError> {
        let template = Builder::stamped().scalar(8).scalar(8).scalar(1).scalar(1).template();
        Ok(Self { channel: declare(place, topic, &schema::PAYLOAD)?, template })
    }

    /// A `lacuna_msgs/ResidualWatch` topic; slots in the order of its lists after the names.
    ///
    /// # Errors
    /// [`WriteError`] if writing failed.
    pub fn residual_watch(place: &mut impl Declare, topic: &str, joints: &[String]) -> Result<Self, WriteError> {
        let n = joints.len();
        let lists = Builder::stamped().strings(joints).numbers(n).numbers(n).numbers(n).octets(n).octets(n).numbers(n);
        let template = lists.octets(n).numbers(n).numbers(n).template();
        Ok(Self { channel: declare(place, topic, &schema::RESIDUAL_WATCH)?, template })
    }

    /// The channel.
    pub fn channel(&self) -> ChannelId {
        self.channel
    }

    /// Writes a message at the sample's stamp: `fill` fills the slots in order.
    #[inline]
    pub fn write(&self, to: &mut impl Messages, header: &Header, fill: impl FnOnce(Filler<'_>)) {
        write(self.channel, &self.template, to, header, fill);
    }
}

/// The log time of a stamp. MCAP has no times before 0; a sample before it (a trigger's lead time) is logged at
/// 0, and its header stamp tells the truth.
fn log_time(stamp_ns: i64) -> u64 {
    stamp_ns.max(0).unsigned_abs()
}

#[inline]
fn write(
    channel: ChannelId,
    template: &Template,
    to: &mut impl Messages,
    header: &Header,
    fill: impl FnOnce(Filler<'_>),
) {
    // MCAP's sequence field has 32 bits and may wrap; the whole number is in the status message.
    let sequence = header.seq as u32;
    to.message(channel, sequence, log_time(header.stamp_ns), |out| fill(template.append(out, header.stamp_ns)));
}

/// The `lacuna_msgs/Gap` topic: samples that are missing in the recording.
#[derive(Debug, Clone)]
pub struct GapTopic {
    channel: ChannelId,
    /// By stream.
    templates: Vec<Template>,
}

impl GapTopic {
    /// Declares it for the streams of these names.
    ///
    /// # Errors
    /// [`WriteError`] if writing failed.
    pub fn new(place: &mut impl Declare, topic: &str, streams: &[&str]) -> Result<Self, WriteError> {
        let template = |stream: &&str| Builder::stamped().text(stream).scalar(8).scalar(8).template();
        Ok(Self { channel: declare(place, topic, &schema::GAP)?, templates: streams.iter().map(template).collect() })
    }

    /// The channel.
    pub fn channel(&self) -> ChannelId {
        self.channel
    }

    /// Writes that `count` samples from number `first` on are missing in stream number `stream`, before the sample with
    /// this header.
    pub fn write(&self, to: &mut impl Messages, header: &Header, stream: usize, first: u64, count: u64) {
        let Some(template) = self.templates.get(stream) else { return };
        write(self.channel, template, to, header, |slots| {
            slots.bytes(&first.to_le_bytes()).bytes(&count.to_le_bytes()).done();
        });
    }
}

/// The `lacuna_msgs/Status` topic: how samples fared on their way.
#[derive(Debug, Clone)]
pub struct StatusTopic {
    channel: ChannelId,
    /// By number of latencies.
    templates: [Template; MAX_HOPS],
}

impl StatusTopic {
    /// Declares it.
    ///
    /// # Errors
    /// [`WriteError`] if writing failed.
    pub fn new(place: &mut impl Declare, topic: &str) -> Result<Self, WriteError> {
        let template = |latencies: usize| {
            Builder::stamped().scalar(8).scalar(4).scalar(8).scalar(8).scalar(4).words(latencies).template()
        };
        Ok(Self { channel: declare(place, topic, &schema::STATUS)?, templates: std::array::from_fn(template) })
    }

    /// The channel.
    pub fn channel(&self) -> ChannelId {
        self.channel
    }

    /// Writes a sample's header.
    pub fn write(&self, to: &mut impl Messages, header: &Header) {
        let hops = (header.hops as usize).min(MAX_HOPS);
        let latencies = hops.saturating_sub(1);
        let mut words = [0; 4 * MAX_HOPS];
        for ((pair, word), _) in header.hop_ns.windows(2).zip(words.chunks_exact_mut(4)).zip(0..latencies) {
            // 4.3 s and more are as bad as 4.3 s.
            let ns = u32::try_from(pair[1].saturating_sub(pair[0])).unwrap_or(u32::MAX);
            word.copy_from_slice(&ns.to_le_bytes());
        }
        let Some(template) = self.templates.get(latencies) else { return };
        let words = words.get(..4 * latencies).unwrap_or(&[]);
        write(self.channel, template, to, header, |slots| {
            slots
                .bytes(&header.seq.to_le_bytes())
                .bytes(&header.flags.to_le_bytes())
                .bytes(&header.lag_ns.to_le_bytes())
                .bytes(&header.dropped.to_le_bytes())
                .bytes(&header.restarts.to_le_bytes())
                .bytes(words)
                .done();
        });
    }
}
