//! The recorder: every message of the graph to an MCAP file that ROS 2 tools and viewers open as it is.
//!
//! | message | topic | holds |
//! |---|---|---|
//! | [`JointMeasured`] | `/measured` | position, effort |
//! | | `/measured/detail` | temperature, link side, drive state; only where there is any |
//! | [`JointSmoothed`] | `/smoothed` | position, velocity |
//! | | `/smoothed/detail` | acceleration, standard deviations |
//! | [`TorqueModel`] | `/torque/nominal`, `/torque/rigid` | effort |
//! | [`FrictionTorque`] | `/friction` | effort |
//! | [`PayloadEstimate`] | `/residual`, `/residual_payload` | effort |
//! | | `/payload` | mass and its standard deviation |
//! | [`ResidualWatch`] | `/monitor` | block residual, its allowed size, evidence, alarm and region |
//! | the last of them | `/status` | sequence, flags, drops, latencies |
//! | any | `/gaps` | samples that are missing before the one with this stamp; only where any are |
//!
//! Streams of a namespace (`before`, `after`) stand below it: `/before/residual`, `/after/residual`.
//!
//! A recorder that was started again goes on in a new file, and says there what is missing between the two
//! ([`Recorder::continues`]).
//!
//! Pure apart from the file: the bus and the clock are the process's business. Each stream's sequence is
//! checked; what is missing is counted, and only a finished recording carries `complete = true`.

mod before;
mod config;
mod fill;
mod streams;

pub use before::{Before, before};
pub use config::{Branch, Config, Lanes, Run};
pub use lacuna_recording::container::{Attachment, WriteError};
pub use streams::{Counts, Stream, Topics};

use lacuna_interfaces::{
    BadInput, FrictionTorque, Header, JointMeasured, JointSmoothed, PayloadEstimate, ResidualWatch, TorqueModel, flag,
};
use lacuna_recording::container::{Finished, MessageBatch, Writer};
use lacuna_recording::ros::{bag, schema};
use lacuna_recording::topics::GapTopic;
use std::collections::BTreeMap;
use std::path::PathBuf;
use streams::{GAPS, Hole, Sequences, full};

/// Writes a recording.
#[derive(Debug)]
pub struct Recorder {
    writer: Writer,
    /// The streams without a namespace, then those of the branches in their order.
    lanes: Vec<Lane>,
    /// The bag folder and the file's name in it, if there is one.
    bag: Option<(PathBuf, String)>,
}

/// The streams of one namespace.
#[derive(Debug)]
struct Lane {
    namespace: String,
    topics: Topics,
    /// Where holes are said; `None` for a namespace without streams.
    gaps: Option<GapTopic>,
    sequences: Sequences,
}

impl Lane {
    /// The topics, and where holes in them are said.
    fn declare(writer: &mut Writer, run: &Run<'_>, namespace: &str, streams: &[Stream]) -> Result<Self, WriteError> {
        let topics = Topics::declare(writer, &run.robot.joints, namespace, streams)?;
        let gaps = match streams {
            [] => None,
            _ => Some(GapTopic::new(writer, &full(namespace, GAPS), &Stream::ALL.map(Stream::name))?),
        };
        let sequences = Sequences::new(run.resumed);
        Ok(Self { namespace: namespace.to_owned(), topics, gaps, sequences })
    }

    fn bag_topics(&self, finished: &Finished) -> Vec<bag::Topic> {
        let mut all = self.topics.bag_topics(finished);
        all.extend(self.gaps.as_ref().map(|gaps| bag::Topic {
            name: full(&self.namespace, GAPS),
            kind: schema::GAP.name.to_owned(),
            count: finished.messages.get(&gaps.channel()).copied().unwrap_or(0),
        }));
        all
    }

    fn say(&self, batch: &mut MessageBatch<'_>, stream: Stream, header: &Header, hole: Hole) {
        if let Some(gaps) = &self.gaps {
            gaps.write(batch, header, stream as usize, hole.first, hole.count);
        }
    }
}

/// Writes samples of one namespace.
#[derive(Debug)]
pub struct LaneWriter<'a> {
    writer: &'a mut Writer,
    lane: &'a mut Lane,
}

impl Recorder {
    /// Creates the file (or bag folder) and writes what it needs to explain itself: the attached files and a
    /// metadata record `lacuna`.
    ///
    /// # Errors
    /// [`WriteError`]: the configuration makes no sense, the file exists and may not be replaced, or it cannot
    /// be written.
    pub fn new(config: &Config, run: &Run<'_>) -> Result<Self, WriteError> {
        let options = config.options(run.live)?;
        if run.streams.is_empty() && run.branches.iter().all(|b| b.streams.is_empty()) {
            return Err(BadInput::new("found no stream to record; expected at least one").into());
        }
        let (file, bag) = config.place()?;
        let mut writer = Writer::create(&file, "ros2", &options)?;
        writer.metadata("lacuna", &run.facts_with(&config.path))?;
        for attachment in &run.attachments {
            writer.attach(attachment)?;
        }
        let branches = run.branches.iter().map(|b| (b.namespace.as_str(), b.streams.as_slice()));
        let lanes = [("", run.streams)]
            .into_iter()
            .chain(branches)
            .map(|(namespace, streams)| Lane::declare(&mut writer, run, namespace, streams))
            .collect::<Result<_, WriteError>>()?;
        Ok(Self { writer, lanes, bag })
    }

    /// Where samples of lane `index` go: 0 for the streams without a namespace, then the branches from 1.
    ///
    /// # Errors
    /// [`WriteError`] if there is no such lane.
    pub fn lane(&mut self, index: usize) -> Result<LaneWriter<'_>, WriteError> {
        let count = self.lanes.len();
        match self.lanes.get_mut(index) {
            Some(lane) => Ok(LaneWriter { writer: &mut self.writer, lane }),
            None => Err(BadInput::new(format!("found a sample of lane {index}; expected one of {count}")).into()),
        }
    }

    /// Counts so far; messages per topic are known only to [`Recorder::finish`].
    pub fn counts(&self) -> Counts {
        let mut counts = Counts { dropped: self.writer.dropped(), ..Counts::default() };
        for lane in &self.lanes {
            lane.sequences.add_to(&mut counts, &lane.namespace);
        }
        counts
    }

    /// This file goes on after the earlier ones of the run: what is missing between the last of them and this one is
    /// counted and said on the topic of gaps. For a recording that was announced as resumed; once, when all its streams
    /// have begun. Returns how many samples fell between the files of the run, of the stream that lost most.
    ///
    /// # Errors
    /// As [`LaneWriter::measured`].
    pub fn continues(&mut self, before: &Before) -> Result<u64, WriteError> {
        let mut most = 0;
        for lane in &mut self.lanes {
            for stream in Stream::ALL {
                let (last, between) = before.of(stream, &lane.namespace);
                let Some((header, hole)) = lane.sequences.between(stream, last) else { continue };
                most = most.max(between + hole.count);
                if hole.count == 0 {
                    continue;
                }
                let mut batch = self.writer.batch();
                lane.say(&mut batch, stream, &header, hole);
                if !batch.end() {
                    return Err(self.writer.failure());
                }
            }
        }
        Ok(most)
    }

    /// True once every stream that was announced has begun.
    pub fn has_begun(&self) -> bool {
        let begun = |lane: &Lane| Stream::ALL.iter().all(|s| lane.sequences.has(*s) || !lane.topics.holds(*s));
        self.lanes.iter().all(begun)
    }

    /// Samples so far that are not in the file, or not whole, because the disk was too slow; of the stream that lost most.
    pub fn unwritten(&self) -> u64 {
        self.lanes.iter().map(|lane| lane.sequences.unwritten()).max().unwrap_or(0)
    }

    /// The highest sequence number so far.
    pub fn last_seq(&self) -> u64 {
        self.lanes.iter().map(|lane| lane.sequences.last()).max().unwrap_or(0)
    }

    /// Completes the file: what is left, a metadata record `lacuna.end` with the counts and `complete = true`,
    /// the index, the end mark; and the bag folder's `metadata.yaml`.
    ///
    /// # Errors
    /// As [`LaneWriter::measured`]. A recording whose `finish` failed does not count as complete.
    pub fn finish(mut self) -> Result<Counts, WriteError> {
        let mut counts = self.counts();
        self.writer.metadata("lacuna.end", &counts.facts())?;
        let finished = self.writer.finish()?;
        let topics: Vec<bag::Topic> = self.lanes.iter().flat_map(|l| l.bag_topics(&finished)).collect();
        counts.messages = topics.iter().map(|t| (t.name.clone(), t.count)).collect();
        if let Some((folder, file)) = &self.bag {
            write_bag_metadata(folder, file, &topics, &finished)?;
        }
        Ok(counts)
    }
}

impl LaneWriter<'_> {
    /// Records a measured sample.
    ///
    /// # Errors
    /// [`WriteError`] if writing failed; the file stays readable up to there.
    pub fn measured(&mut self, m: &JointMeasured) -> Result<(), WriteError> {
        self.record(Stream::Measured, &m.header, |topics, batch| topics.measured(m, batch))
    }

    /// Records a smoothed sample.
    ///
    /// # Errors
    /// As [`LaneWriter::measured`].
    pub fn smoothed(&mut self, m: &JointSmoothed) -> Result<(), WriteError> {
        self.record(Stream::Smoothed, &m.header, |topics, batch| topics.smoothed(m, batch))
    }

    /// Records model torques.
    ///
    /// # Errors
    /// As [`LaneWriter::measured`].
    pub fn torque(&mut self, m: &TorqueModel) -> Result<(), WriteError> {
        self.record(Stream::Torque, &m.header, |topics, batch| topics.torque(m, batch))
    }

    /// Records friction torques.
    ///
    /// # Errors
    /// As [`LaneWriter::measured`].
    pub fn friction(&mut self, m: &FrictionTorque) -> Result<(), WriteError> {
        self.record(Stream::Friction, &m.header, |topics, batch| topics.friction(m, batch))
    }

    /// Records a payload estimate and the residuals.
    ///
    /// # Errors
    /// As [`LaneWriter::measured`].
    pub fn payload(&mut self, m: &PayloadEstimate) -> Result<(), WriteError> {
        self.record(Stream::Payload, &m.header, |topics, batch| topics.payload(m, batch))
    }

    /// Records what the monitor makes of the residual.
    ///
    /// # Errors
    /// As [`LaneWriter::measured`].
    pub fn watch(&mut self, m: &ResidualWatch) -> Result<(), WriteError> {
        self.record(Stream::Watch, &m.header, |topics, batch| topics.watch(m, batch))
    }

    fn record(
        &mut self,
        stream: Stream,
        header: &Header,
        write: impl FnOnce(&Topics, &mut MessageBatch<'_>),
    ) -> Result<(), WriteError> {
        if header.has(flag::END_OF_STREAM) {
            return Ok(());
        }
        if !self.lane.topics.holds(stream) {
            let what = format!("found a sample of stream {}, which was not announced", stream.name());
            return Err(BadInput::new(what).into());
        }
        let hole = self.lane.sequences.saw(stream, header);
        let mut batch = self.writer.batch();
        if let Some(hole) = hole {
            self.lane.say(&mut batch, stream, header, hole);
        }
        write(&self.lane.topics, &mut batch);
        if batch.is_short() {
            self.lane.sequences.was_short(stream);
        }
        if batch.end() { Ok(()) } else { Err(self.writer.failure()) }
    }
}

fn write_bag_metadata(
    folder: &std::path::Path,
    file: &str,
    topics: &[bag::Topic],
    finished: &Finished,
) -> Result<(), WriteError> {
    let (start, end) = finished.times.unwrap_or((0, 0));
    let text = bag::metadata_yaml(file, start, end, topics);
    let path = folder.join("metadata.yaml");
    std::fs::write(&path, text).map_err(|source| WriteError::Io { path, action: "written", source })
}

/// Facts as a metadata record holds them.
type Facts = BTreeMap<String, String>;
