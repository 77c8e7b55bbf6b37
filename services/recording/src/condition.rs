//! The judgement every recording passes, whatever its format.
//!
//! | found | done |
//! |---|---|
//! | NaN, infinity, or a magnitude no robot has | error with the place |
//! | time running backwards | error with the place |
//! | the stamp of the sample before | dropped, counted ([`RepairKind::DuplicateStamp`]) |
//! | an interval above [`GAP_FACTOR`] × the median of the last 32 | `flag::GAP`, counted; nothing is filled in |
//! | a revolute angle jumping between the two ends of [−π, π] or [0, 2π] | unwrapped, `flag::REPAIRED`, counted |
//! | a single-sample torque spike | nothing: raw stays raw, the offline tools repair it later |

use lacuna_interfaces::robot::JointType;
use lacuna_interfaces::{BadInput, JointMeasured, Joints, MAX_JOINTS, Repair, RepairKind, RobotFile, flag};
use std::f64::consts::{PI, TAU};

/// Largest position taken for real [rad, m].
pub const MAX_POSITION: f64 = 1e6;
/// Largest torque taken for real [Nm, N, A, V].
pub const MAX_TORQUE: f64 = 1e6;
/// Largest temperature magnitude taken for real [°C].
pub const MAX_TEMPERATURE: f64 = 1e4;
/// Latest stamp [s]: what the 32-bit seconds of ROS messages hold. Above it a stamp is surely not in seconds.
pub const MAX_TIME_S: i64 = i32::MAX as i64;
/// An interval this many times the recent median is a gap.
pub const GAP_FACTOR: i64 = 10;
/// How near the ends of its range an angle must be, before and after a jump, to count as wrapped [rad].
pub const WRAP_MARGIN_RAD: f64 = 0.5;

/// What is to become of a sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// A sample.
    Keep,
    /// The sample before, again.
    Drop,
}

/// State of the judgement along one recording.
#[derive(Debug)]
pub struct Conditioner {
    joints: usize,
    last_stamp_ns: Option<i64>,
    period: RecentMedian,
    q: Unwrapper,
    link_q: Unwrapper,
    kept: u64,
    duplicates: u64,
    gaps: u64,
}

impl Conditioner {
    /// Before the first sample.
    pub fn new(robot: &RobotFile) -> Self {
        // A URDF's joint types are not known here. That costs nothing: a prismatic joint cannot go from one
        // end of ±π metres to the other between two samples.
        let revolute = |j: usize| robot.dh.get(j).is_none_or(|row| row.joint == JointType::Revolute);
        Self {
            joints: robot.joint_count().min(MAX_JOINTS),
            last_stamp_ns: None,
            period: RecentMedian::default(),
            q: Unwrapper::new(std::array::from_fn(revolute)),
            link_q: Unwrapper::new(std::array::from_fn(revolute)),
            kept: 0,
            duplicates: 0,
            gaps: 0,
        }
    }

    /// Judges the next sample: refuses it, drops it, or keeps it unwrapped and flagged.
    ///
    /// # Errors
    /// [`BadInput`] without a place: not finite, out of all range, or earlier than the sample before.
    pub fn judge(&mut self, sample: &mut JointMeasured) -> Result<Verdict, BadInput> {
        self.plausible(sample)?;
        let stamp = sample.header.stamp_ns;
        if let Some(last) = self.last_stamp_ns {
            let dt = stamp - last;
            if dt < 0 {
                return Err(BadInput::new(format!(
                    "time runs backwards: found t = {} s after {} s; expected increasing time",
                    seconds(stamp),
                    seconds(last)
                )));
            }
            if dt == 0 {
                self.duplicates += 1;
                // One repeated row is a logger's hiccup. More repeats than samples means that time was
                // written too coarsely, and dropping most of the recording would be a guess.
                if self.duplicates > 100 && self.duplicates > self.kept {
                    return Err(BadInput::new(format!(
                        "found {} samples that repeat the stamp before them and {} that do not; expected a time \
                         column that resolves the sampling",
                        self.duplicates, self.kept
                    )));
                }
                return Ok(Verdict::Drop);
            }
            if self.period.median().is_some_and(|m| dt > m.saturating_mul(GAP_FACTOR)) {
                self.gaps += 1;
                sample.header.flags |= flag::GAP;
            }
            self.period.push(dt);
        }
        self.last_stamp_ns = Some(stamp);
        let n = self.joints;
        if self.q.apply(&mut sample.q_rad, n) | self.link_q.apply(&mut sample.link_q_rad, n) {
            sample.header.flags |= flag::REPAIRED;
        }
        self.kept += 1;
        Ok(Verdict::Keep)
    }

    fn plausible(&self, sample: &JointMeasured) -> Result<(), BadInput> {
        let n = self.joints;
        if sample.header.stamp_ns.unsigned_abs() >= MAX_TIME_S.unsigned_abs() * 1_000_000_000 {
            return Err(BadInput::new(format!(
                "found t = {} s; expected seconds below {MAX_TIME_S} (is the time in ms or ns?)",
                seconds(sample.header.stamp_ns)
            )));
        }
        within("q", &sample.q_rad[..n], MAX_POSITION)?;
        within("tau", &sample.tau_nm[..n], MAX_TORQUE)?;
        // NaN stands for "no such column" in the optional signals; a number must be a plausible one.
        within_if_any("temperature", &sample.temperature_degc[..n], MAX_TEMPERATURE)?;
        within_if_any("link position", &sample.link_q_rad[..n], MAX_POSITION)?;
        within_if_any("link torque", &sample.link_tau_nm[..n], MAX_TORQUE)
    }

    /// Number of samples kept.
    pub(crate) fn kept(&self) -> u64 {
        self.kept
    }

    /// What was repaired, with empty file names; only what occurred.
    pub fn repairs(&self) -> Vec<Repair> {
        let mut all =
            vec![repair(RepairKind::DuplicateStamp, "t", self.duplicates), repair(RepairKind::Gap, "t", self.gaps)];
        for j in 0..self.joints {
            all.push(repair(RepairKind::Unwrapped, &format!("q{}", j + 1), self.q.count[j]));
            all.push(repair(RepairKind::Unwrapped, &format!("link_q{}", j + 1), self.link_q.count[j]));
        }
        all.retain(|r| r.count > 0);
        all
    }
}

/// A repair whose file name the caller fills in.
pub(crate) fn repair(kind: RepairKind, signal: &str, count: u64) -> Repair {
    Repair { file: String::new(), kind, signal: signal.to_owned(), count }
}

/// Nanoseconds as exact decimal seconds, for messages.
fn seconds(ns: i64) -> String {
    let whole = ns.unsigned_abs() / 1_000_000_000;
    let part = ns.unsigned_abs() % 1_000_000_000;
    let digits = format!("{part:09}");
    let digits = digits.trim_end_matches('0');
    let sign = if ns < 0 { "-" } else { "" };
    if digits.is_empty() { format!("{sign}{whole}") } else { format!("{sign}{whole}.{digits}") }
}

fn within(signal: &str, values: &[f64], most: f64) -> Result<(), BadInput> {
    match values.iter().position(|v| !(v.is_finite() && v.abs() <= most)) {
        Some(j) => Err(out_of_range(signal, j, values[j], most)),
        None => Ok(()),
    }
}

fn within_if_any(signal: &str, values: &[f64], most: f64) -> Result<(), BadInput> {
    match values.iter().position(|v| v.abs() > most) {
        Some(j) => Err(out_of_range(signal, j, values[j], most)),
        None => Ok(()),
    }
}

fn out_of_range(signal: &str, j: usize, value: f64, most: f64) -> BadInput {
    BadInput::new(format!("found {signal}{} = {value:e}; expected a finite number within ±{most:e}", j + 1))
}

/// Undoes wrapping of angles whose range is [−π, π] or [0, 2π].
#[derive(Debug)]
struct Unwrapper {
    enabled: [bool; MAX_JOINTS],
    last_raw: Option<Joints>,
    offset: Joints,
    count: [u64; MAX_JOINTS],
}

impl Unwrapper {
    fn new(enabled: [bool; MAX_JOINTS]) -> Self {
        Self { enabled, last_raw: None, offset: [0.0; MAX_JOINTS], count: [0; MAX_JOINTS] }
    }

    /// Returns whether a jump was undone in this very sample.
    fn apply(&mut self, q: &mut Joints, n: usize) -> bool {
        let raw = *q;
        let mut jumped = false;
        if let Some(last) = &self.last_raw {
            for j in 0..n {
                if self.enabled[j]
                    && let Some(turn) = wrapped(last[j], raw[j])
                {
                    self.offset[j] += turn;
                    self.count[j] += 1;
                    jumped = true;
                }
            }
        }
        for j in 0..n {
            q[j] += self.offset[j];
        }
        self.last_raw = Some(raw);
        jumped
    }
}

/// ±2π if going from `a` to `b` means leaving one end of [−π, π] or [0, 2π] and coming back at the other.
fn wrapped(a: f64, b: f64) -> Option<f64> {
    let near = |x: f64, end: f64| (x - end).abs() <= WRAP_MARGIN_RAD;
    if (near(a, PI) && near(b, -PI)) || (near(a, TAU) && near(b, 0.0)) {
        Some(TAU)
    } else if (near(a, -PI) && near(b, PI)) || (near(a, 0.0) && near(b, TAU)) {
        Some(-TAU)
    } else {
        None
    }
}

/// Median of the last 32 intervals, refreshed every 32 (and at 4, 8 and 16, so that a gap is seen early).
#[derive(Debug, Default)]
struct RecentMedian {
    ring: [i64; 32],
    pushed: u64,
    median: Option<i64>,
}

impl RecentMedian {
    fn push(&mut self, dt: i64) {
        let at = (self.pushed % 32) as usize;
        self.ring[at] = dt;
        self.pushed += 1;
        if matches!(self.pushed, 4 | 8 | 16) || self.pushed.is_multiple_of(32) {
            let len = self.pushed.min(32) as usize;
            let mut recent = self.ring;
            self.median = Some(*recent[..len].select_nth_unstable(len / 2).1);
        }
    }

    fn median(&self) -> Option<i64> {
        self.median
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn robot() -> RobotFile {
        RobotFile::parse(
            "kind = \"serial\"\nname = \"r\"\njoints = [\"a\", \"b\"]\n[[dh]]\n[[dh]]\njoint = \"prismatic\"\n",
        )
        .unwrap()
    }

    fn sample(stamp_ns: i64, q: [f64; 2]) -> JointMeasured {
        let mut m = JointMeasured { temperature_degc: [f64::NAN; 8], ..Default::default() };
        m.link_q_rad = [f64::NAN; 8];
        m.link_tau_nm = [f64::NAN; 8];
        m.header.stamp_ns = stamp_ns;
        m.q_rad[..2].copy_from_slice(&q);
        m
    }

    fn count(c: &Conditioner, kind: RepairKind) -> u64 {
        c.repairs().iter().filter(|r| r.kind == kind).map(|r| r.count).sum()
    }

    #[test]
    fn wrapped_angles_become_continuous_and_are_counted() {
        for low in [-PI, 0.0] {
            let mut c = Conditioner::new(&robot());
            let mut expected = Vec::new();
            let mut found = Vec::new();
            for k in 0..4000_i64 {
                // Three turns forward, three back; joint 2 is prismatic and must stay as it is.
                let angle = 0.1 + 6.0 * PI * (1.0 - (k as f64 / 2000.0 - 1.0).abs());
                let raw = (angle - low).rem_euclid(TAU) + low;
                let mut m = sample(k * 1_000_000, [raw, raw]);
                assert_eq!(c.judge(&mut m), Ok(Verdict::Keep));
                expected.push(angle);
                found.push(m.q_rad[0]);
                assert_eq!(m.q_rad[1], raw);
            }
            let shift = found[0] - expected[0];
            for (a, b) in found.iter().zip(&expected) {
                assert!((a - b - shift).abs() < 1e-9, "{a} {b}");
            }
            assert_eq!(count(&c, RepairKind::Unwrapped), 6);
        }
    }

    #[test]
    fn a_fast_joint_inside_the_range_is_not_unwrapped() {
        let mut c = Conditioner::new(&robot());
        for (k, q) in [2.0, -2.0, 1.0, 3.0, -2.2, 7.0, 0.7].into_iter().enumerate() {
            let mut m = sample(k as i64, [q, 0.0]);
            c.judge(&mut m).unwrap();
            assert_eq!(m.q_rad[0], q);
        }
    }

    #[test]
    fn gaps_follow_the_sampling() {
        let mut c = Conditioner::new(&robot());
        let mut t = 0;
        let mut flagged = Vec::new();
        for k in 0..400 {
            // 1 kHz with one gap, then 50 Hz: the first slow intervals look like gaps, then the rate is known.
            t += if k == 100 {
                50_000_000
            } else if k < 200 {
                1_000_000
            } else {
                20_000_000
            };
            let mut m = sample(t, [0.0; 2]);
            c.judge(&mut m).unwrap();
            if m.header.has(flag::GAP) {
                flagged.push(k);
            }
        }
        assert_eq!(flagged[0], 100);
        assert!(flagged[1..].iter().all(|k| (200..264).contains(k)), "{flagged:?}");
        assert_eq!(count(&c, RepairKind::Gap), flagged.len() as u64);
    }

    #[test]
    fn bad_samples_are_refused_in_words() {
        for (m, expect) in [
            (sample(5, [f64::NAN, 0.0]), "q1 = NaN"),
            (sample(5, [0.0, 1e293]), "q2 = 1e293"),
            (sample(-1, [0.0; 2]), "backwards"),
            (sample(i64::MAX, [0.0; 2]), "ms or ns"),
            (sample(i64::MIN, [0.0; 2]), "ms or ns"),
        ] {
            let mut c = Conditioner::new(&robot());
            c.judge(&mut sample(0, [0.0; 2])).unwrap();
            let mut m = m;
            let e = c.judge(&mut m).unwrap_err();
            assert!(e.what.contains(expect), "{e}");
        }
    }

    #[test]
    fn a_repeated_stamp_is_dropped_and_too_many_are_an_error() {
        let mut c = Conditioner::new(&robot());
        let verdicts: Vec<_> = [0, 0, 1, 2, 2].map(|t| c.judge(&mut sample(t, [0.0; 2])).unwrap()).to_vec();
        use Verdict::{Drop, Keep};
        assert_eq!(verdicts, [Keep, Drop, Keep, Keep, Drop]);
        assert_eq!(count(&c, RepairKind::DuplicateStamp), 2);
        let refused = (0..1000).find_map(|k| c.judge(&mut sample(3 + k / 4, [0.0; 2])).err());
        assert!(refused.unwrap().what.contains("resolves the sampling"));
    }
}
