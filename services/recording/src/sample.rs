//! What a log format hands over: samples, still as recorded, and where they came from.

use lacuna_interfaces::{BadInput, JointMeasured, Repair};

/// One sample with its further columns.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Sample {
    /// Signals of the robot file's joints. The header holds `stamp_ns`, `joints` and `flags`; `seq` counts the
    /// samples of this reader from 1.
    pub measured: JointMeasured,
    /// Further columns in the order of [`About::extra_names`]; empty unless they were asked for.
    pub extra: Vec<f64>,
}

/// What a reader found in a recording before the first sample.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct About {
    /// Format name (`csv`, `mcap`).
    pub format: &'static str,
    /// Columns that become [`Sample::extra`].
    pub extra_names: Vec<String>,
    /// Columns or topics that are not read.
    pub ignored: Vec<String>,
    /// The topic that is read, if the format has topics.
    pub topic: Option<String>,
}

/// A log format's reader: bytes to samples, no judgement. Time order, plausibility, wrapped angles and gaps
/// are judged once for all formats, by [`crate::Reader`].
pub trait RawReader: Send {
    /// What is in the recording.
    fn about(&self) -> &About;

    /// Overwrites `out` with the next sample; `false` at the end. Fields without a signal are NaN, unused
    /// joints 0.
    ///
    /// # Errors
    /// [`BadInput`] with the place, if what follows is not a sample.
    fn next_sample(&mut self, out: &mut Sample) -> Result<bool, BadInput>;

    /// Adds the place of the sample returned last to an error.
    fn locate(&self, error: BadInput) -> BadInput;

    /// Bytes of the file used so far, for progress.
    fn bytes_read(&self) -> u64;

    /// Repairs that only the format itself can see (a row cut off in mid-write), with empty file names.
    fn repairs(&self) -> Vec<Repair>;
}
