//! A recording in memory, and what a reader did to it.

use std::collections::BTreeMap;

/// What kind of repair a reader made.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RepairKind {
    /// A single-sample outlier was replaced by the mean of its neighbours.
    Spike,
    /// An angle that wraps at ±π was unwrapped.
    Unwrapped,
    /// A row repeated the time stamp of the one before and was dropped.
    DuplicateStamp,
    /// The last row was cut off in mid-write and was dropped.
    TruncatedTail,
    /// Samples are missing (a time gap); nothing was filled in.
    Gap,
    /// Bus cycles without process data of all drives; nothing was filled in.
    MissingCycle,
    /// A fieldbus datagram came back with too low a working counter: a drive did not answer, its cycle was left out.
    WorkingCounter,
}

/// A counted repair of one recording.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Repair {
    /// File it was made in.
    pub file: String,
    /// What was done.
    pub kind: RepairKind,
    /// Signal it was done to (`q2`, `tau1`, or `t`).
    pub signal: String,
    /// How many samples.
    pub count: u64,
}

/// A whole recording in memory: `n` joints, `len` samples. Joint-major, since every offline computation runs
/// along time.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Recording {
    /// File name, without its folder.
    pub name: String,
    /// Joint names, in the robot file's order.
    pub joints: Vec<String>,
    /// Time [s], strictly increasing; length `len`.
    pub t_s: Vec<f64>,
    /// Positions [rad]: `q_rad[joint][sample]`.
    pub q_rad: Vec<Vec<f64>>,
    /// Torques [Nm or the robot file's `torque_unit`]: `tau_nm[joint][sample]`.
    pub tau_nm: Vec<Vec<f64>>,
    /// Further columns by name (`x_temp1`, `x_enable`, …), each of length `len`.
    pub extra: BTreeMap<String, Vec<f64>>,
    /// What the reader repaired.
    pub repairs: Vec<Repair>,
}

impl Recording {
    /// Number of samples.
    pub fn len(&self) -> usize {
        self.t_s.len()
    }

    /// True if there is no sample.
    pub fn is_empty(&self) -> bool {
        self.t_s.is_empty()
    }

    /// Time from the first to the last sample [s]; 0 for fewer than two.
    pub fn duration_s(&self) -> f64 {
        match (self.t_s.first(), self.t_s.last()) {
            (Some(a), Some(b)) => b - a,
            _ => 0.0,
        }
    }

    /// Median sample period [s]; `None` for fewer than two samples.
    pub fn median_period_s(&self) -> Option<f64> {
        let mut dt: Vec<f64> = self.t_s.windows(2).map(|w| w[1] - w[0]).collect();
        if dt.is_empty() {
            return None;
        }
        let mid = dt.len() / 2;
        Some(*dt.select_nth_unstable_by(mid, f64::total_cmp).1)
    }
}
