//! A recording that is conditioned part by part: what must be known of the whole of it, and its parts on demand.

use super::signals::{self, Sampling};
use super::{Plan, Saturation, Stretch, mask, motion};
use lacuna_interfaces::{BadInput, Recording, Repair, RobotFile};
use std::ops::Range;

/// Rows keep this many working samples from the ends of a stretch at least: the torque is looked at that far around.
pub(crate) const LEAST_CUT: usize = 3;

/// A gap-free stretch, not conditioned yet.
#[derive(Debug, Clone, PartialEq)]
pub struct Stretched {
    /// Recorded samples.
    range: Range<usize>,
    /// Number of regular samples.
    regular: usize,
    /// Number of working samples.
    pub working: usize,
    /// Number of rows.
    pub rows: usize,
    /// Working samples left out at each end.
    pub cut: usize,
}

/// A recording repaired in place, its sampling and its stretches.
#[derive(Debug, Clone)]
pub struct Prepared {
    /// File name of the recording.
    pub name: String,
    /// Repairs of the reader and of the conditioning.
    pub repairs: Vec<Repair>,
    /// Sampling rate before decimation [Hz].
    pub sample_rate_hz: f64,
    /// Whether the sampling is irregular, so that signals are interpolated to a regular grid.
    pub resampled: bool,
    /// Time in stretches too short to use [s].
    pub dropped_s: f64,
    /// Clipped torques found, per joint.
    pub saturation: Vec<Option<Saturation>>,
    /// Stretches without gaps, in time order.
    pub stretches: Vec<Stretched>,
    sampling: Sampling,
    factor: usize,
    row_step: usize,
}

/// Repairs `recording` in place and finds its stretches.
///
/// # Errors
/// [`BadInput`] with the recording's name: other joints than the robot's, columns of unequal length, values that are
/// not finite, or nothing long enough to filter.
pub fn prepare(recording: &mut Recording, robot: &RobotFile, plan: &Plan) -> Result<Prepared, BadInput> {
    let name = recording.name.clone();
    run(recording, robot, plan).map_err(|e| e.in_file(&name))
}

fn run(recording: &mut Recording, robot: &RobotFile, plan: &Plan) -> Result<Prepared, BadInput> {
    signals::check(recording, robot)?;
    let mut repairs = recording.repairs.clone();
    repairs.extend(signals::repair(recording, plan));
    let saturation = recording.tau_nm.iter().map(|tau| mask::saturation(tau)).collect();
    let sampling = Sampling::of(&recording.t_s, plan)?;
    let cut_s = plan.cut_s.unwrap_or((2.0 / plan.band_hz).min(0.1 * recording.duration_s()));
    let (factor, row_step) = (motion::factor(plan, &sampling), motion::row_step(plan, &sampling));
    let cut = ((cut_s * sampling.rate_hz / factor as f64).ceil() as usize).max(LEAST_CUT);
    let shortest_s = motion::shortest_s(plan, &sampling, cut_s);
    let (mut stretches, mut dropped_s) = (Vec::new(), 0.0);
    for range in &sampling.ranges {
        let regular = sampling.regular_len(&recording.t_s, range);
        if (regular - 1) as f64 / sampling.rate_hz < shortest_s {
            dropped_s += recording.t_s[range.end - 1] - recording.t_s[range.start];
            continue;
        }
        let working = regular.div_ceil(factor);
        let rows = working.saturating_sub(2 * cut).div_ceil(row_step);
        stretches.push(Stretched { range: range.clone(), regular, working, rows, cut });
    }
    if stretches.is_empty() {
        return Err(BadInput::new(format!(
            "found no stretch without gaps longer than the filter's start (longest recording time {:.3} s); expected at \
             least {shortest_s:.3} s at a band of {:.2} Hz",
            recording.duration_s(),
            plan.band_hz
        )));
    }
    Ok(Prepared {
        name: recording.name.clone(),
        repairs,
        sample_rate_hz: sampling.rate_hz,
        resampled: sampling.irregular,
        dropped_s,
        saturation,
        stretches,
        sampling,
        factor,
        row_step,
    })
}

impl Prepared {
    /// Time between working samples [s].
    pub fn working_period_s(&self) -> f64 {
        self.factor as f64 / self.sampling.rate_hz
    }

    /// Time between rows [s].
    pub fn row_period_s(&self) -> f64 {
        self.row_step as f64 * self.working_period_s()
    }

    /// Working sample of row `row` of a stretch.
    pub fn working_of(&self, stretch: &Stretched, row: usize) -> usize {
        stretch.cut + row * self.row_step
    }

    /// Time of row `row` of a stretch [s], in the recording's own time.
    pub fn time_s(&self, recording: &Recording, stretch: &Stretched, row: usize) -> f64 {
        self.sampling.time_s(&recording.t_s, &stretch.range, self.working_of(stretch, row) * self.factor)
    }

    /// Recorded samples over rows of a stretch, as nearly as irregular sampling has them.
    pub fn recorded(&self, stretch: usize, rows: &Range<usize>) -> Range<usize> {
        let own = &self.stretches[stretch];
        let at = |row: usize| {
            let share = (self.working_of(own, row) * self.factor) as f64 / own.regular.max(1) as f64;
            own.range.start + (share * own.range.len() as f64) as usize
        };
        at(rows.start).min(own.range.end)..at(rows.end).min(own.range.end)
    }

    /// Conditions the working samples `part` of stretch `stretch` of the recording that was prepared.
    ///
    /// What lies at the part's ends is only right within the filters' memory if it is an end of the stretch.
    ///
    /// # Errors
    /// [`BadInput`] for a value that is not finite, or a part too short to filter.
    pub fn part(
        &self,
        recording: &Recording,
        robot: &RobotFile,
        plan: &Plan,
        stretch: usize,
        part: Range<usize>,
    ) -> Result<Stretch, BadInput> {
        let measured: Vec<&[f64]> = recording.q_rad.iter().map(Vec::as_slice).collect();
        self.part_at(recording, &measured, robot, plan, stretch, part)
    }

    /// The same with other positions than the measured ones: `[joint][sample]`, as long as the recording.
    ///
    /// # Errors
    /// As [`Prepared::part`].
    pub(crate) fn part_at(
        &self,
        recording: &Recording,
        positions: &[&[f64]],
        robot: &RobotFile,
        plan: &Plan,
        stretch: usize,
        part: Range<usize>,
    ) -> Result<Stretch, BadInput> {
        let own = &self.stretches[stretch];
        let samples = part.start * self.factor..(part.end * self.factor).min(own.regular);
        signals::regular(recording, positions, &own.range, samples, &self.sampling, plan.torque_delay_s)
            .and_then(|regular| motion::stretch(regular, robot, plan, &self.sampling, &self.saturation, own.cut))
            .map_err(|e| e.in_file(&self.name))
    }
}
