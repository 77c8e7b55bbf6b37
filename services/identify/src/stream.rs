//! Rows of recordings, part by part: conditioning, regressor and band filter of a bounded number of samples at a time.
//!
//! A pass goes over all parts in parallel, a few at a time, and hands their rows on in order; what it costs in memory does
//! not depend on the length of the recordings. Parts overlap by what the filters forget. A joint's bristle starts straight
//! at the start of a part, which is forgotten once it has moved a milliradian.

use crate::base::Structure;
use crate::columns::{Evaluator, Sample, unreachable};
use crate::condition::{Plan, Prepared, Stretch};
use crate::fit::{Motion, commanded};
use crate::layout::{Layout, REACH, TORQUES};
use lacuna_interfaces::{BadInput, Recording, RobotFile};
use lacuna_physics::RigidBody;
use rayon::prelude::*;
use std::ops::Range;

/// Rows of a part.
const PART_ROWS: usize = 4096;
/// Overlap of parts in periods of the band. The slowest pole of a fourth-order Butterworth low-pass decays with
/// e^(−2.4 band t): to 4e-11 in 10 periods.
const OVERLAP: f64 = 10.0;
/// Parts in the making at a time, per thread.
const AHEAD: usize = 2;

/// What a row of a joint is good for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Class {
    /// Nothing: the drive is off.
    Unusable,
    /// The drive is on, the joint stands.
    Standing,
    /// Counts in an evaluation, but is too close to slow motion or to the torque's limit for the fit.
    Counted,
    /// Used by the fit.
    Fitted,
}

/// Recordings, and everything that makes rows of them.
pub(crate) struct Stream<'a> {
    pub(crate) body: &'a dyn RigidBody,
    pub(crate) robot: &'a RobotFile,
    pub(crate) structure: &'a Structure,
    pub(crate) plan: &'a Plan,
    pub(crate) recordings: &'a [Recording],
    pub(crate) prepared: &'a [Prepared],
    pub(crate) layout: Vec<Layout>,
    parts: Vec<Part>,
}

/// Rows of one stretch, by their numbers in it.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Part {
    pub(crate) recording: usize,
    /// Stretch of the recording.
    pub(crate) stretch: usize,
    pub(crate) rows: Range<usize>,
}

/// Rows of a part.
pub(crate) struct PartRows {
    pub(crate) part: Part,
    pub(crate) joints: Vec<JointPart>,
}

/// Rows of a joint.
#[derive(Debug, Clone, Default)]
pub(crate) struct JointPart {
    /// Row-major, as the [`Layout`] says.
    pub(crate) z: Vec<f64>,
    /// Velocity [rad/s].
    pub(crate) qd: Vec<f64>,
    pub(crate) class: Vec<Class>,
}

impl<'a> Stream<'a> {
    pub(crate) fn new(
        body: &'a dyn RigidBody,
        robot: &'a RobotFile,
        structure: &'a Structure,
        plan: &'a Plan,
        recordings: &'a [Recording],
        prepared: &'a [Prepared],
    ) -> Self {
        Self::in_parts(body, robot, structure, plan, recordings, prepared, PART_ROWS)
    }

    /// The same in parts of `part_rows` rows.
    pub(crate) fn in_parts(
        body: &'a dyn RigidBody,
        robot: &'a RobotFile,
        structure: &'a Structure,
        plan: &'a Plan,
        recordings: &'a [Recording],
        prepared: &'a [Prepared],
        part_rows: usize,
    ) -> Self {
        let mut parts = Vec::new();
        for (recording, own) in prepared.iter().enumerate() {
            for (stretch, s) in own.stretches.iter().enumerate() {
                let cut = (0..s.rows).step_by(part_rows).map(|r| r..r.saturating_add(part_rows).min(s.rows));
                parts.extend(cut.map(|rows| Part { recording, stretch, rows }));
            }
        }
        let layout = Layout::all(structure, plan);
        Self { body, robot, structure, plan, recordings, prepared, layout, parts }
    }

    /// Time of a row [s].
    pub(crate) fn time_s(&self, recording: usize, stretch: usize, row: usize) -> f64 {
        let own = &self.prepared[recording];
        own.time_s(&self.recordings[recording], &own.stretches[stretch], row)
    }

    /// Number of rows of all recordings.
    pub(crate) fn rows(&self) -> usize {
        self.parts.iter().map(|p| p.rows.len()).sum()
    }

    /// Number of parts.
    pub(crate) fn parts(&self) -> usize {
        self.parts.len()
    }

    /// At most `count` parts, spread over all.
    pub(crate) fn probes(&self, count: usize) -> Vec<&Part> {
        self.parts.iter().step_by(self.parts.len().div_ceil(count.max(1)).max(1)).collect()
    }

    /// Recorded positions over the rows of a part: `[joint]`.
    pub(crate) fn raw(&self, part: &Part) -> Vec<&[f64]> {
        let samples = self.prepared[part.recording].recorded(part.stretch, &part.rows);
        self.recordings[part.recording].q_rad.iter().map(|q| q.get(samples.clone()).unwrap_or_default()).collect()
    }

    /// Computes `make` of every part in parallel, and hands the results to `take` in order.
    ///
    /// # Errors
    /// The first error of either, in order.
    pub(crate) fn pass<T: Send>(
        &self,
        make: impl Fn(usize, &Part) -> Result<T, BadInput> + Sync,
        take: impl FnMut(T) -> Result<(), BadInput>,
    ) -> Result<(), BadInput> {
        self.pass_over(0..self.parts.len(), make, take)
    }

    /// The same over some parts, by their numbers.
    ///
    /// # Errors
    /// The first error of either, in order.
    pub(crate) fn pass_over<T: Send>(
        &self,
        parts: Range<usize>,
        make: impl Fn(usize, &Part) -> Result<T, BadInput> + Sync,
        mut take: impl FnMut(T) -> Result<(), BadInput>,
    ) -> Result<(), BadInput> {
        let at_once = AHEAD * rayon::current_num_threads().max(1);
        for start in parts.clone().step_by(at_once) {
            let group = start..(start + at_once).min(parts.end).min(self.parts.len());
            let made: Vec<Result<T, BadInput>> = group.into_par_iter().map(|i| make(i, &self.parts[i])).collect();
            made.into_iter().try_for_each(|m| take(m?))?;
        }
        Ok(())
    }

    /// Conditioned signals around the rows of a part, as far as filters of `band_hz` look, by `plan`; and the sample of every
    /// row.
    ///
    /// # Errors
    /// [`BadInput`] naming the recording, for a value that is not finite.
    pub(crate) fn around(&self, part: &Part, plan: &Plan, band_hz: f64) -> Result<(Stretch, Vec<usize>), BadInput> {
        let measured: Vec<&[f64]> = self.recordings[part.recording].q_rad.iter().map(Vec::as_slice).collect();
        self.around_at(part, &measured, plan, band_hz)
    }

    /// The same at the commanded positions, which the recording must have.
    ///
    /// # Errors
    /// As [`Stream::around`].
    pub(crate) fn commanded_around(
        &self,
        part: &Part,
        plan: &Plan,
        band_hz: f64,
    ) -> Result<(Stretch, Vec<usize>), BadInput> {
        let recording = &self.recordings[part.recording];
        let commanded = commanded::columns(recording, self.robot).ok_or_else(|| {
            BadInput::new("found no commanded positions; expected those of columns.reference").in_file(&recording.name)
        })?;
        self.around_at(part, &commanded, plan, band_hz)
    }

    fn around_at(
        &self,
        part: &Part,
        positions: &[&[f64]],
        plan: &Plan,
        band_hz: f64,
    ) -> Result<(Stretch, Vec<usize>), BadInput> {
        let own = &self.prepared[part.recording];
        let of = &own.stretches[part.stretch];
        let seconds = (OVERLAP / band_hz).max(plan.reversal_s);
        let overlap = (seconds / own.working_period_s()).ceil() as usize;
        let first = own.working_of(of, part.rows.start);
        let last = own.working_of(of, part.rows.end.saturating_sub(1));
        let from = first.saturating_sub(overlap);
        // The very end is not cut: there the filter's padding is what the whole stretch would have.
        let to = if last + overlap + of.cut >= of.working { of.working } else { last + overlap + 1 };
        let stretch =
            own.part_at(&self.recordings[part.recording], positions, self.robot, plan, part.stretch, from..to)?;
        Ok((stretch, part.rows.clone().map(|r| own.working_of(of, r) - from).collect()))
    }

    /// The rows of a part. With `instruments`, ζ comes from that motion.
    ///
    /// # Errors
    /// [`BadInput`] naming the recording and the time of a pose that the robot cannot take.
    pub(crate) fn rows_of(&self, part: &Part, instruments: Option<&Motion>) -> Result<PartRows, BadInput> {
        let own = &self.prepared[part.recording];
        let band = match instruments {
            Some(Motion::Smoothed { band_hz }) => band_hz.min(self.plan.band_hz),
            _ => self.plan.band_hz,
        };
        let (stretch, at) = self.around(part, self.plan, band)?;
        let columns = self.columns(&stretch, &own.name)?;
        let shadow = match instruments {
            Some(motion) => Some(self.columns(&motion.of(self, part, &stretch)?, &own.name)?),
            None => None,
        };
        let joints = (0..self.layout.len())
            .into_par_iter()
            .map(|j| self.joint(&stretch, j, &at, &columns[j], shadow.as_ref().map(|s| s[j].as_slice())))
            .collect::<Result<_, BadInput>>()?;
        Ok(PartRows { part: part.clone(), joints })
    }

    /// Active base columns at every working sample, band-filtered: `[joint][slot][sample]`.
    fn columns(&self, stretch: &Stretch, name: &str) -> Result<Vec<Vec<Vec<f64>>>, BadInput> {
        let n = self.layout.len();
        let len = stretch.len();
        let mut columns: Vec<Vec<Vec<f64>>> = self.layout.iter().map(|l| vec![vec![0.0; len]; l.width()]).collect();
        let mut evaluator = Evaluator::new(self.body, &self.structure.columns);
        let (mut q, mut qd, mut qdd, mut sign) = (vec![0.0; n], vec![0.0; n], vec![0.0; n], vec![0.0; n]);
        for k in 0..len {
            for j in 0..n {
                q[j] = stretch.q_rad[j][k];
                qd[j] = stretch.qd_rad_s[j][k];
                qdd[j] = stretch.qdd_rad_s2[j][k];
                sign[j] = stretch.sign[j][k];
            }
            let sample =
                Sample { motion: lacuna_physics::Motion { q_rad: &q, qd_rad_s: &qd, qdd_rad_s2: &qdd }, sign: &sign };
            evaluator.at(&sample).map_err(|e| unreachable(stretch.time_s(k), e).in_file(name))?;
            for (j, layout) in self.layout.iter().enumerate() {
                for (slot, &b) in layout.active.iter().enumerate() {
                    columns[j][slot][k] = evaluator.entry(&sample, j, self.structure.base[b].column);
                }
            }
        }
        let mut all: Vec<&mut [f64]> = columns.iter_mut().flatten().map(Vec::as_mut_slice).collect();
        stretch.band(&mut all)?;
        Ok(columns)
    }

    /// Rows of a joint at the working samples `at`.
    fn joint(
        &self,
        stretch: &Stretch,
        j: usize,
        at: &[usize],
        columns: &[Vec<f64>],
        shadow: Option<&[Vec<f64>]>,
    ) -> Result<JointPart, BadInput> {
        let layout = &self.layout[j];
        let mut torque = stretch.tau_nm[j].clone();
        let mut bristles: Vec<Vec<f64>> = stretch.bristles[j].iter().take(layout.bristles).cloned().collect();
        let mut more: Vec<&mut [f64]> = bristles.iter_mut().chain([&mut torque]).map(Vec::as_mut_slice).collect();
        stretch.band(&mut more)?;
        let mut out = JointPart::default();
        out.z.reserve(at.len() * (layout.len() + shadow.map_or(0, <[_]>::len)));
        for &k in at {
            out.z.extend(columns.iter().map(|c| c[k]));
            out.z.extend(bristles.iter().map(|c| c[k]));
            out.z.push(1.0);
            // Rows keep REACH samples from both ends of their stretch.
            let low = k.saturating_sub(REACH).min(torque.len().saturating_sub(TORQUES));
            out.z.extend((low..low + TORQUES).map(|i| torque.get(i).copied().unwrap_or(0.0)));
            out.z.extend(shadow.into_iter().flatten().map(|c| c[k]));
            out.qd.push(stretch.qd_rad_s[j][k]);
            out.class.push(match (stretch.usable[k], stretch.counted[j][k], stretch.fitted[j][k]) {
                (_, _, true) => Class::Fitted,
                (_, true, _) => Class::Counted,
                (true, _, _) => Class::Standing,
                _ => Class::Unusable,
            });
        }
        Ok(out)
    }
}
