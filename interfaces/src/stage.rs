//! The contract of a stage: a pure state machine between two messages.
//!
//! Only [`Stage::new`] may fail; doubt about a sample travels in its flags. A stage has no clock, does no
//! I/O and does not know the bus: the same `step` runs in the process, in tests, in benches and in the
//! offline tools, and two runs over the same input give the same bytes.

use crate::{BadInput, ModelFile, RobotFile, Wire};
use serde::de::DeserializeOwned;

/// What a stage may know when it is made.
#[derive(Debug, Clone, Copy)]
pub struct StageContext<'a> {
    /// The robot file.
    pub robot: &'a RobotFile,
    /// Text of the URDF that the robot file names, if it names one.
    pub urdf: Option<&'a str>,
    /// The model file, if the graph names one.
    pub model: Option<&'a ModelFile>,
}

/// One box of the graph.
pub trait Stage: Sized {
    /// Name in messages and defaults (`smoother`, `torque`, …).
    const NAME: &'static str;
    /// The node's `[config]` table; `deny_unknown_fields`, validated in [`Stage::new`].
    type Config: DeserializeOwned;
    /// What it reads.
    type Input: Wire;
    /// What it writes.
    type Output: Wire;

    /// Checks the configuration against robot and model and allocates everything the stage will ever need.
    ///
    /// # Errors
    /// [`BadInput`] if the configuration, the robot file or the model file cannot be used.
    fn new(config: Self::Config, context: &StageContext<'_>) -> Result<Self, BadInput>;

    /// Takes one sample and emits the samples that are ready because of it, in sequence order. Each input
    /// leads to exactly one output with the same `header.seq`, now or later. The stage copies the header of
    /// the sample an output belongs to; the harness stamps the hop. Never called with the end-of-stream
    /// sentinel; never allocates.
    fn step(&mut self, input: &Self::Input, emit: &mut dyn FnMut(&Self::Output));

    /// The stream ended: emits what the stage still holds back.
    fn finish(&mut self, emit: &mut dyn FnMut(&Self::Output));
}
