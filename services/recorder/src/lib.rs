//! The recorder: every message of the graph to an MCAP file.

use lacuna_interfaces::{
    BadInput, FrictionTorque, JointMeasured, JointSmoothed, PayloadEstimate, RobotFile, TorqueModel,
};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::PathBuf;

/// The node's `config` table.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// File to write.
    pub path: PathBuf,
}

/// What the recorder is told about the run.
#[derive(Debug, Clone)]
pub struct Run<'a> {
    /// The robot.
    pub robot: &'a RobotFile,
    /// Messages that will come.
    pub streams: &'a [Stream],
    /// `true`: what the disk cannot take is dropped and counted; `false`: the caller waits.
    pub live: bool,
    /// Files to attach: name, media type, text.
    pub attachments: Vec<(String, String, String)>,
    /// Further facts for the recording's metadata.
    pub facts: BTreeMap<String, String>,
}

/// Messages that can be recorded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Stream {
    /// [`JointMeasured`].
    Measured,
    /// [`JointSmoothed`].
    Smoothed,
    /// [`TorqueModel`].
    Torque,
    /// [`FrictionTorque`].
    Friction,
    /// [`PayloadEstimate`].
    Payload,
}

/// What was recorded.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Counts {
    /// Samples taken per stream.
    pub samples: BTreeMap<Stream, u64>,
    /// Sequence numbers missing per stream.
    pub missing: BTreeMap<Stream, u64>,
    /// Messages written per MCAP topic.
    pub messages: BTreeMap<String, u64>,
    /// Messages dropped because the disk was too slow (live only).
    pub dropped: u64,
}

/// Why recording failed.
pub type RecorderError = BadInput;

/// Writes a recording.
#[derive(Debug)]
pub struct Recorder {}

impl Recorder {
    /// Creates the file.
    ///
    /// # Errors
    /// The file exists, or cannot be written.
    pub fn new(_config: Config, _run: &Run<'_>) -> Result<Self, RecorderError> {
        Err(BadInput::new("the recorder is being written"))
    }
    /// Records a measured sample.
    ///
    /// # Errors
    /// Writing failed.
    pub fn measured(&mut self, _m: &JointMeasured) -> Result<(), RecorderError> {
        Ok(())
    }
    /// Records a smoothed sample.
    ///
    /// # Errors
    /// Writing failed.
    pub fn smoothed(&mut self, _m: &JointSmoothed) -> Result<(), RecorderError> {
        Ok(())
    }
    /// Records model torques.
    ///
    /// # Errors
    /// Writing failed.
    pub fn torque(&mut self, _m: &TorqueModel) -> Result<(), RecorderError> {
        Ok(())
    }
    /// Records friction torques.
    ///
    /// # Errors
    /// Writing failed.
    pub fn friction(&mut self, _m: &FrictionTorque) -> Result<(), RecorderError> {
        Ok(())
    }
    /// Records a payload estimate.
    ///
    /// # Errors
    /// Writing failed.
    pub fn payload(&mut self, _m: &PayloadEstimate) -> Result<(), RecorderError> {
        Ok(())
    }
    /// Completes the file: summary, counts and the mark `complete`.
    ///
    /// # Errors
    /// Writing failed.
    pub fn finish(self) -> Result<Counts, RecorderError> {
        Ok(Counts::default())
    }
}
