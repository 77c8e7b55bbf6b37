//! The motion that follows from the command alone: instruments that no encoder has touched.
//!
//! Where a recording has the commanded positions r, every joint's closed loop is taken from the data as a linear filter, and
//! the command is run through it (the two-stage method: Van den Hof and Schrama 1993). No controller needs to be known, and
//! the simulated motion cannot run away.
//!
//! ```text
//! q̇(t) = Σ_k h_k ṙ(t − d_k) + e      h by least squares, recording by recording and joint by joint
//! q_s(t) = c + Σ_k h_k r(t − d_k)     likewise q̇_s, q̈_s
//! ```

use super::draft::Data;
use super::instruments::BAND_SHARE;
use crate::condition::{Plan, Stretch};
use crate::stream::{Part, Stream};
use lacuna_estimation::filter::unwrap_angles;
use lacuna_estimation::least_squares::Moments;
use lacuna_interfaces::{BadInput, Recording, RobotFile};
use nalgebra::{DMatrix, DVector};
use std::f64::consts::TAU;

/// Delays of the filter [working samples, a tenth of a period of the band]. A loop slower than three periods of the band is
/// followed badly, which the share that is explained shows.
const DELAYS: [i32; 8] = [-1, 0, 1, 2, 4, 8, 16, 32];
/// Entries of a row: ṙ and r at every delay, q̇, q, 1.
const ENTRIES: usize = 2 * DELAYS.len() + 3;
/// Directions of the filter below this share of the largest, by power, are noise.
const RANK: f64 = 1e-10;
/// Share of a moving joint's measured velocity, by power, that the command must explain: with less, a drive did something
/// else than it was told. It is measured below the band of the smoothed instruments, as a coarse encoder's noise, whose
/// power in a velocity grows with the cube of the band, is no reason to doubt the command.
const EXPLAINED: f64 = 0.5;

/// A joint's closed loop in one recording.
#[derive(Debug, Clone, PartialEq)]
struct Filter {
    h: [f64; DELAYS.len()],
    offset: f64,
}

/// The closed loops of all recordings and joints.
#[derive(Debug, Clone)]
pub(crate) struct Loops {
    /// `[recording][joint]`.
    filters: Vec<Vec<Filter>>,
    /// Least share of a moving joint's velocity that the command explains, by power, below [`slow`].
    pub(crate) explained: f64,
}

/// The plan whose positions pass the band of the smoothed instruments alone.
fn slow(plan: &Plan) -> Plan {
    Plan { bristle: false, position_band_hz: BAND_SHARE * plan.band_hz, ..plan.clone() }
}

/// The commanded positions of a recording, `[joint]`; `None` where the robot file does not name one per joint, or the
/// recording lacks one.
pub(crate) fn columns<'a>(recording: &'a Recording, robot: &RobotFile) -> Option<Vec<&'a [f64]>> {
    let names = &robot.columns.reference;
    if names.len() != robot.joint_count() {
        return None;
    }
    let of = |name: &String| {
        let column = recording.extra.get(name)?;
        (column.len() == recording.len() && column.iter().all(|v| v.is_finite())).then_some(column.as_slice())
    };
    names.iter().map(of).collect()
}

/// Takes whole turns out of the commanded positions, so that they run beside the measured ones, which were unwrapped.
pub(crate) fn unwrap(recording: &mut Recording, robot: &RobotFile) {
    if columns(recording, robot).is_none() {
        return;
    }
    for (name, q) in robot.columns.reference.iter().zip(&recording.q_rad) {
        let Some(r) = recording.extra.get_mut(name) else { continue };
        unwrap_angles(r, TAU);
        let mean = q.iter().zip(r.iter()).map(|(q, r)| q - r).sum::<f64>() / q.len().max(1) as f64;
        let turns = (mean / TAU).round() * TAU;
        r.iter_mut().for_each(|v| *v += turns);
    }
}

/// Sample `k` delayed, the ends going on.
fn delayed(column: &[f64], k: usize, delay: i32) -> f64 {
    let last = column.len().saturating_sub(1) as i64;
    let at = (k as i64 - i64::from(delay)).clamp(0, last.max(0)) as usize;
    column.get(at).copied().unwrap_or(0.0)
}

impl Loops {
    /// Finds the closed loops.
    ///
    /// # Errors
    /// [`BadInput`] for a recording without commanded positions, or where the command explains too little of the motion.
    pub(crate) fn find(data: Data<'_>) -> Result<Self, BadInput> {
        let stream = data.stream;
        if let Some(r) = stream.recordings.iter().find(|r| columns(r, stream.robot).is_none()) {
            return Err(BadInput::new(format!(
                "instruments from the command: found {} of {} commanded positions; expected one column of numbers per \
                 joint, named in columns.reference of the robot file",
                stream.robot.columns.reference.iter().filter(|name| r.extra.contains_key(*name)).count(),
                stream.layout.len()
            ))
            .in_file(&r.name));
        }
        let n = stream.layout.len();
        let plans = [Plan { bristle: false, ..stream.plan.clone() }, slow(stream.plan)];
        let mut sums = vec![vec![[Moments::new(ENTRIES), Moments::new(ENTRIES)]; n]; stream.recordings.len()];
        stream.pass(
            |_, part| Ok((part.recording, moments(stream, part, &plans[0])?, moments(stream, part, &plans[1])?)),
            |(recording, all, slow)| {
                for (to, from) in sums[recording].iter_mut().zip(all.iter().zip(&slow)) {
                    to[0].merge(from.0);
                    to[1].merge(from.1);
                }
                Ok(())
            },
        )?;
        let mut explained = f64::INFINITY;
        let mut filters = Vec::new();
        for (own, recording) in sums.iter().zip(stream.recordings) {
            let mut list = Vec::new();
            for (j, [all, slow]) in own.iter().enumerate() {
                let filter = Filter::fit(all);
                let share = filter.share(slow);
                // A joint that hardly moves has nothing to explain.
                if data.sums.survey[j].fitted > 0 {
                    explained = explained.min(share);
                }
                if explained < EXPLAINED {
                    return Err(BadInput::new(format!(
                        "instruments from the command: it explains {:.0} % of the velocity of joint {} below {:.2} Hz by \
                         power; expected {:.0} % or more",
                        100.0 * share,
                        j + 1,
                        plans[1].position_band_hz,
                        100.0 * EXPLAINED
                    ))
                    .in_file(&recording.name));
                }
                list.push(filter);
            }
            filters.push(list);
        }
        Ok(Self { filters, explained })
    }

    /// The simulated motion over a part, with everything else as measured.
    ///
    /// # Errors
    /// As [`Stream::around`].
    pub(crate) fn motion(
        &self,
        stream: &Stream<'_>,
        part: &Part,
        plan: &Plan,
        measured: &Stretch,
    ) -> Result<Stretch, BadInput> {
        let mut out = stream.commanded_around(part, plan, plan.band_hz)?.0;
        for (j, filter) in self.filters[part.recording].iter().enumerate() {
            out.q_rad[j] = filter.apply(&out.q_rad[j], filter.offset);
            out.qd_rad_s[j] = filter.apply(&out.qd_rad_s[j], 0.0);
            out.qdd_rad_s2[j] = filter.apply(&out.qdd_rad_s2[j], 0.0);
        }
        // Where the friction changes sign is no matter of acceleration noise.
        out.sign.clone_from(&measured.sign);
        Ok(out)
    }
}

impl Filter {
    /// From the sums of a joint's rows.
    fn fit(sums: &Moments) -> Self {
        const K: usize = DELAYS.len();
        let m = sums.products();
        let (rates, places, v, q, one) = (0, K, 2 * K, 2 * K + 1, 2 * K + 2);
        let gram = DMatrix::from_fn(K, K, |i, k| m[(rates + i, rates + k)]);
        let right = DVector::from_fn(K, |i, _| m[(rates + i, v)]);
        let eigen = gram.symmetric_eigen();
        let floor = RANK * eigen.eigenvalues.max();
        let mut solved = DVector::zeros(K);
        for (direction, &value) in eigen.eigenvectors.column_iter().zip(eigen.eigenvalues.iter()) {
            if value > floor && value > 0.0 {
                solved.axpy(direction.dot(&right) / value, &direction, 1.0);
            }
        }
        let h: [f64; K] = std::array::from_fn(|k| solved[k]);
        let rows = m[(one, one)].max(1.0);
        let offset = (m[(q, one)] - (0..K).map(|k| h[k] * m[(places + k, one)]).sum::<f64>()) / rows;
        Self { h, offset }
    }

    /// The share of the velocity's power that it explains over these rows: 1 − Σe²/Σq̇².
    fn share(&self, sums: &Moments) -> f64 {
        const V: (usize, f64) = (2 * DELAYS.len(), 1.0);
        let left: Vec<(usize, f64)> =
            self.h.iter().enumerate().map(|(k, h)| (k, -h)).chain(std::iter::once(V)).collect();
        let all = sums.product(&[V], &[V]);
        if all > 0.0 { 1.0 - sums.product(&left, &left) / all } else { 1.0 }
    }

    fn apply(&self, column: &[f64], offset: f64) -> Vec<f64> {
        let at = |k: usize| DELAYS.iter().zip(self.h).map(|(&d, h)| h * delayed(column, k, d)).sum::<f64>();
        (0..column.len()).map(|k| offset + at(k)).collect()
    }
}

/// Sums over the rows of a part by `plan`, per joint.
fn moments(stream: &Stream<'_>, part: &Part, plan: &Plan) -> Result<Vec<Moments>, BadInput> {
    let band_hz = plan.position_band_hz.min(plan.band_hz);
    let (measured, at) = stream.around(part, plan, band_hz)?;
    let (commanded, _) = stream.commanded_around(part, plan, band_hz)?;
    let joint = |j: usize| {
        let (r, rd) = (&commanded.q_rad[j], &commanded.qd_rad_s[j]);
        let mut rows = Vec::with_capacity(at.len() * ENTRIES);
        for &k in at.iter().filter(|&&k| measured.usable[k]) {
            rows.extend(DELAYS.iter().map(|&d| delayed(rd, k, d)));
            rows.extend(DELAYS.iter().map(|&d| delayed(r, k, d)));
            rows.extend([measured.qd_rad_s[j][k], measured.q_rad[j][k], 1.0]);
        }
        let mut out = Moments::new(ENTRIES);
        out.add_rows(&rows)?;
        Ok(out)
    };
    (0..stream.layout.len()).map(joint).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lagging_loop_is_followed() {
        // q̇ = (ṙ one sample ago + ṙ two samples ago)/2 and an offset of 0.3.
        let r: Vec<f64> = (0..4000).map(|k| (0.05 * f64::from(k)).sin() + 0.3 * (0.13 * f64::from(k)).cos()).collect();
        let rd: Vec<f64> =
            (0..4000).map(|k| 0.05 * (0.05 * f64::from(k)).cos() - 0.039 * (0.13 * f64::from(k)).sin()).collect();
        let late = |x: &[f64], k: usize| 0.5 * (delayed(x, k, 1) + delayed(x, k, 2));
        let mut rows = Vec::new();
        for k in 50..3950 {
            rows.extend(DELAYS.iter().map(|&d| delayed(&rd, k, d)));
            rows.extend(DELAYS.iter().map(|&d| delayed(&r, k, d)));
            rows.extend([late(&rd, k), 0.3 + late(&r, k), 1.0]);
        }
        let mut sums = Moments::new(ENTRIES);
        sums.add_rows(&rows).unwrap();
        let filter = Filter::fit(&sums);
        let share = filter.share(&sums);
        assert!((share - 1.0).abs() < 1e-6, "{share}");
        let q = filter.apply(&r, filter.offset);
        for k in (100..3900).step_by(97) {
            assert!((q[k] - 0.3 - late(&r, k)).abs() < 1e-4, "{k}: {} {}", q[k], 0.3 + late(&r, k));
        }
    }
}
