//! When something was carried, how heavy it was, and how quickly the estimate knew.

use super::{Known, Trace};
use serde::Serialize;

/// The estimate counts as settled within this share of the mass: after a pick of that mass, after a place of zero.
pub const SETTLED: f64 = 0.05;

/// The stage's estimates over a recording.
#[derive(Debug, Clone, Default)]
pub(super) struct Series {
    pub(super) t_s: Vec<f64>,
    pub(super) mass_kg: Vec<f64>,
    pub(super) sd_kg: Vec<f64>,
    /// The motion supports the estimate.
    pub(super) supported: Vec<bool>,
    /// The estimator saw another mass here.
    pub(super) step: Vec<bool>,
    /// Σ φ ΔT and Σ φ² over the joints that move: what a sample says of the mass.
    pub(super) says: Vec<[f64; 2]>,
}

/// A payload carried for a while: when it is known, or as it was found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Carrying {
    pub(super) from_s: f64,
    /// Whether that is a pick; else it was carried before the motion first supports an estimate.
    pub(super) picked: bool,
    /// `None`: until the end of the recording.
    pub(super) to_s: Option<f64>,
    /// Known mass, else the estimate's.
    pub(super) mass_kg: f64,
    pub(super) mass_known: bool,
    pub(super) times_known: bool,
}

/// A payload that was carried for a while.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Interval {
    /// Picked at, in the recording's own time [s]: as known, else where the residuals change from one mass to the other;
    /// absent if that was before the motion first supports an estimate.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub picked_s: Option<f64>,
    /// Placed at [s]; absent if it is carried to the end.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub placed_s: Option<f64>,
    /// Whether both times are known, not found.
    pub times_known: bool,
    /// Mean of the settled estimate [kg]; absent if the motion supports none while it is carried.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mass_kg: Option<f64>,
    /// Standard deviation that the estimator itself gives at the end [kg].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sd_kg: Option<f64>,
    /// Known mass [kg].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub known_kg: Option<f64>,
    /// Time from the pick until the estimate is within [`SETTLED`] of the mass (the known one, else its own) and stays
    /// there [s]; absent if it does not before the place.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub settled_after_s: Option<f64>,
    /// Time from the place until the estimate is within [`SETTLED`] of the mass of zero and stays there until the next
    /// pick [s]; absent if it does not.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub zero_after_s: Option<f64>,
}

impl Series {
    pub(super) fn duration_s(&self) -> f64 {
        self.t_s.last().zip(self.t_s.first()).map_or(0.0, |(b, a)| b - a)
    }

    pub(super) fn trace(&self) -> Trace {
        let mass = |(m, s): (&f64, &bool)| if *s { *m } else { f64::NAN };
        Trace { t_s: self.t_s.clone(), mass_kg: self.mass_kg.iter().zip(&self.supported).map(mass).collect() }
    }

    /// Times and masses of the supported estimates from `from` to before `to`.
    fn between(&self, from: f64, to: f64) -> Vec<(f64, f64)> {
        let range = self.t_s.partition_point(|t| *t < from)..self.t_s.partition_point(|t| *t < to);
        range.filter(|&k| self.supported[k]).map(|k| (self.t_s[k], self.mass_kg[k])).collect()
    }

    /// Median of the supported estimates; `None` without any.
    fn level(&self, from: f64, to: f64) -> Option<f64> {
        let mut masses: Vec<f64> = self.between(from, to).into_iter().map(|(_, m)| m).collect();
        if masses.is_empty() {
            return None;
        }
        let mid = masses.len() / 2;
        Some(*masses.select_nth_unstable_by(mid, f64::total_cmp).1)
    }

    /// When the mass changed from `before` to `after`, which the estimator saw at `seen`, no earlier than `from`: where the
    /// squared residuals of the one mass up to there and of the other from there on are smallest together.
    ///
    /// Where nothing moves in between, the middle of it.
    ///
    /// A sample's e²(before) − e²(after) is 2 (m₁ − m₀) Σ φΔT − (m₁² − m₀²) Σ φ²: negative until the change, then positive.
    fn changed(&self, before: f64, after: f64, from: f64, seen: f64) -> f64 {
        let range = self.t_s.partition_point(|t| *t < from)..self.t_s.partition_point(|t| *t <= seen);
        let (mut sum, mut least, mut last, mut next) = (0.0, 0.0, from, None);
        for k in range.filter(|&k| self.says[k][1] > 0.0) {
            let [product, square] = self.says[k];
            sum += 2.0 * (after - before) * product - (after * after - before * before) * square;
            if sum < least {
                (least, last, next) = (sum, self.t_s[k], None);
            } else {
                next = next.or(Some(self.t_s[k]));
            }
        }
        // A gripper mostly closes on a robot at rest, which says nothing: then it is the middle of the rest.
        0.5 * (last + next.unwrap_or(seen))
    }
}

/// The estimator sees a change this much later at most [s].
const SEEN_AFTER_S: f64 = 0.5;
/// An estimate that stays on the other side of what is noticeable for this long has changed [s].
const HOLD_S: f64 = 0.03;
/// Nothing is carried for less than this [s].
const LEAST_S: f64 = 0.1;

/// How long after the first of `from` the estimates (time, mass) stay within `tolerance` of `mass` for good, and their mean
/// from there on; `None` if they never do.
pub fn settling(estimates: &[(f64, f64)], from: f64, mass: f64, tolerance: f64) -> Option<(f64, f64)> {
    let last_out = estimates.iter().rposition(|(_, m)| (m - mass).abs() > tolerance || m.is_nan());
    let settled = estimates.get(last_out.map_or(0, |i| i + 1)..)?;
    let first = settled.first()?;
    Some((first.0 - from, settled.iter().map(|s| s.1).sum::<f64>() / settled.len() as f64))
}

/// Where a stretch with another mass may begin: at the estimator's own steps, and where the estimate comes to be noticeable
/// or ceases to be without one (at a recording's start it follows a pick without calling it a step).
fn edges(series: &Series, noticeable_kg: f64) -> Vec<f64> {
    let mut edges: Vec<f64> = series.t_s.first().copied().into_iter().collect();
    let (mut state, mut since) = (None, None);
    for (k, &t) in series.t_s.iter().enumerate() {
        if series.step[k] {
            edges.push(t);
            (state, since) = (None, None);
        }
        if !series.supported[k] {
            continue;
        }
        let carries = series.mass_kg[k] > noticeable_kg;
        if *state.get_or_insert(carries) == carries {
            since = None;
        } else if t - *since.get_or_insert(t) >= HOLD_S {
            edges.extend(since.take());
            state = Some(carries);
        }
    }
    edges.dedup();
    edges
}

/// Payloads as the estimate shows them: stretches between its edges whose mass is noticeable.
pub(super) fn find(series: &Series, noticeable_kg: f64) -> Vec<Carrying> {
    let end = series.t_s.last().map_or(0.0, |t| t + 1.0);
    let edges = edges(series, noticeable_kg);
    let mut out: Vec<Carrying> = Vec::new();
    // Begin and mass of the stretch before the present one.
    let mut last: Option<(f64, f64)> = None;
    for (i, &seen) in edges.iter().enumerate() {
        let to = edges.get(i + 1).copied().unwrap_or(end);
        // A stretch too short for an estimate is on the way from one mass to the next.
        let Some(level) = series.level(seen, to) else { continue };
        let carries = level > noticeable_kg;
        let carried = last.is_some_and(|(_, mass)| mass > noticeable_kg);
        let same = carried && out.last().is_some_and(|c| (c.mass_kg - level).abs() < noticeable_kg);
        if !(carries && same) && (carries || carried) {
            let before =
                last.map_or(seen, |(begun, mass)| series.changed(mass, level, begun.max(seen - SEEN_AFTER_S), seen));
            if carried {
                out.iter_mut().next_back().into_iter().for_each(|c| c.to_s = Some(before));
            }
            if carries {
                let (picked, mass_kg) = (last.is_some(), level);
                out.push(Carrying {
                    from_s: before,
                    picked,
                    to_s: None,
                    mass_kg,
                    mass_known: false,
                    times_known: false,
                });
            }
        }
        last = Some((seen, level));
    }
    out.retain(|c| c.to_s.unwrap_or(end) - c.from_s >= LEAST_S);
    // The mass over all of an interval, not that of its first stretch.
    for c in &mut out {
        c.mass_kg = series.level(c.from_s, c.to_s.unwrap_or(end)).unwrap_or(c.mass_kg);
    }
    out
}

/// Payloads at times that are known.
pub(super) fn known(series: &Series, known: &[Known]) -> Vec<Carrying> {
    let mut out: Vec<Carrying> = known
        .iter()
        .map(|k| Carrying {
            from_s: k.from_s,
            picked: true,
            to_s: Some(k.to_s),
            mass_kg: k.mass_kg.or_else(|| series.level(k.from_s, k.to_s)).unwrap_or(0.0),
            mass_known: k.mass_kg.is_some(),
            times_known: true,
        })
        .collect();
    out.sort_by(|a, b| a.from_s.total_cmp(&b.from_s));
    out
}

/// What the estimate makes of the payloads.
pub(super) fn judge(series: &Series, carrying: &[Carrying]) -> Vec<Interval> {
    let end = series.t_s.last().map_or(0.0, |t| t + 1.0);
    let judged = |(i, c): (usize, &Carrying)| {
        let to = c.to_s.unwrap_or(end);
        let next = carrying.get(i + 1).map_or(end, |n| n.from_s);
        let inside = series.between(c.from_s, to);
        let tolerance = SETTLED * c.mass_kg;
        let settled = settling(&inside, c.from_s, c.mass_kg, tolerance);
        let zero = c.to_s.and_then(|to| settling(&series.between(to, next), to, 0.0, tolerance));
        let last = series.t_s.partition_point(|t| *t < to).checked_sub(1);
        Interval {
            picked_s: c.picked.then_some(c.from_s),
            placed_s: c.to_s,
            times_known: c.times_known,
            mass_kg: settled.map(|s| s.1).or_else(|| series.level(c.from_s, to)),
            sd_kg: last.filter(|_| !inside.is_empty()).and_then(|k| series.sd_kg.get(k)).copied(),
            known_kg: c.mass_known.then_some(c.mass_kg),
            settled_after_s: settled.filter(|_| c.picked).map(|s| s.0),
            zero_after_s: zero.map(|z| z.0),
        }
    };
    carrying.iter().enumerate().map(judged).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The estimator sees a change this many samples late.
    const LATE: usize = 5;

    /// A millisecond apart; the first 20 ms after a change the estimate is on the way.
    fn series(masses: &[(f64, usize)]) -> Series {
        let mut s = Series::default();
        for (mass, count) in masses {
            for k in 0..*count {
                let column = 2.0 + (0.05 * k as f64).sin();
                s.says.push([column * column * mass, column * column]);
                s.t_s.push(s.t_s.len() as f64 * 1e-3);
                s.mass_kg.push(if k < 20 { 0.5 * mass + 0.3 } else { *mass });
                s.sd_kg.push(0.01);
                s.supported.push(k >= 10);
                s.step.push(k == LATE && s.t_s.len() > LATE + 1);
            }
        }
        s
    }

    #[test]
    fn picks_and_places_are_found_and_judged() {
        let s = series(&[(0.01, 300), (3.8, 400), (3.82, 100), (-0.01, 300), (1.0, 200)]);
        let found = find(&s, 0.2);
        let intervals = judge(&s, &found);
        assert_eq!(intervals.len(), 2, "{intervals:?}");
        let first = &intervals[0];
        // Not when they were seen: when the torque changed, between two samples.
        assert!(
            (first.picked_s.unwrap() - 0.2995).abs() < 1e-9 && (first.placed_s.unwrap() - 0.7995).abs() < 1e-9,
            "{first:?}"
        );
        assert!((first.mass_kg.unwrap() - 3.82).abs() < 0.01 && !first.times_known);
        // In at 20 ms; the second step of 3.8 to 3.82 wanders out again until 20 ms after it.
        assert!((first.settled_after_s.unwrap() - 0.4205).abs() < 1e-9);
        assert!((first.zero_after_s.unwrap() - 0.0205).abs() < 1e-9, "{first:?}");
        assert_eq!((intervals[1].placed_s, intervals[1].zero_after_s), (None, None));
    }

    #[test]
    fn a_pick_at_rest_is_in_the_middle_of_the_rest_and_needs_no_step() {
        let mut s = series(&[(0.0, 300), (2.0, 400)]);
        for k in 250..350 {
            (s.says[k], s.supported[k]) = ([0.0; 2], false);
        }
        s.step.fill(false);
        let found = find(&s, 0.2);
        assert_eq!(found.len(), 1);
        // From the last sample that moved, 0.249 s, to the next, 0.350 s.
        assert!((found[0].from_s - 0.2995).abs() < 1e-9, "{found:?}");
    }

    #[test]
    fn known_times_and_masses_are_taken_as_they_are() {
        let s = series(&[(0.0, 300), (2.0, 400), (0.0, 300)]);
        let at = |mass_kg| known(&s, &[Known { from_s: 0.28, to_s: 0.69, mass_kg }]);
        let right = judge(&s, &at(Some(2.0)));
        assert!((right[0].settled_after_s.unwrap() - 0.04).abs() < 1e-9);
        assert_eq!((right[0].known_kg, right[0].times_known), (Some(2.0), true));
        // A tenth off is not settled, but the mass is still told.
        let wrong = judge(&s, &at(Some(2.2)));
        assert_eq!((wrong[0].settled_after_s, wrong[0].mass_kg), (None, Some(2.0)));
    }

    #[test]
    fn nothing_carried_is_nothing_found() {
        assert!(find(&series(&[(0.05, 500), (-0.05, 500)]), 0.2).is_empty());
        assert!(find(&Series::default(), 0.0).is_empty());
        // Carried from the start: no pick to be found, nor to settle after.
        let s = series(&[(2.0, 400), (0.0, 300)]);
        let always = judge(&s, &find(&s, 0.2));
        assert_eq!((always.len(), always[0].picked_s, always[0].settled_after_s), (1, None, None));
        assert!(judge(&Series::default(), &known(&Series::default(), &[])).is_empty());
        assert_eq!(settling(&[], 0.0, 1.0, 0.1), None);
    }

    #[test]
    fn known_stretches_parse() {
        assert_eq!("0.5:1.25:3.8".parse(), Ok(Known { from_s: 0.5, to_s: 1.25, mass_kg: Some(3.8) }));
        assert_eq!("1:2".parse(), Ok(Known { from_s: 1.0, to_s: 2.0, mass_kg: None }));
        for bad in ["", "1", "2:1", "1:2:0", "1:2:nan", "1:x", "1:2:3:4"] {
            assert!(bad.parse::<Known>().unwrap_err().to_string().contains("carried"), "{bad}");
        }
    }
}
