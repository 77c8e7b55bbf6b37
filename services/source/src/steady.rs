//! Frame stamps that go on steadily when the machine's clock is set.
//!
//! The kernel stamps frames with the wall clock. When that clock is set, by hand or by a time service, the stream's
//! time must neither run backwards nor jump: what the clock was set by is taken out again. The stream keeps the wall
//! clock's rate, so a clock that is slewed moves the stamps by no more than it is slewed.

use std::time::{Instant, SystemTime, UNIX_EPOCH};

/// A difference between wall and monotonic clock from which the clock was set and not slewed [ns].
const STEP_NS: i64 = 1_000_000;
/// Two clocks read further apart than this do not tell of a step [ns].
const APART_NS: i64 = 200_000;
/// How long a frame may have waited for its reader [ns].
const OLDEST_NS: i64 = 2_000_000_000;

/// Both clocks at one moment.
#[derive(Debug, Clone, Copy)]
pub struct Now {
    /// Wall clock [ns since 1970].
    pub wall_ns: i64,
    /// Monotonic clock [ns since some moment].
    pub mono_ns: i64,
}

/// Takes steps of the wall clock out of stamps.
#[derive(Debug)]
pub struct Steady {
    began: Instant,
    /// Wall less monotonic clock as last seen.
    apart_ns: i64,
    /// Added to a stamp of the clock as it is now, and as it was before the last step.
    shift_ns: [i64; 2],
    steps: u64,
}

impl Steady {
    /// Begins with the clocks as they are.
    pub fn new() -> Self {
        let began = Instant::now();
        let mut new = Self { began, apart_ns: 0, shift_ns: [0; 2], steps: 0 };
        new.apart_ns = new.now().map_or_else(wall_ns, |now| now.wall_ns - now.mono_ns);
        new
    }

    /// Both clocks, unless the process was interrupted between the two.
    pub fn now(&self) -> Option<Now> {
        let mono = || i64::try_from(self.began.elapsed().as_nanos()).unwrap_or(i64::MAX);
        let (before, wall_ns, after) = (mono(), wall_ns(), mono());
        (after - before < APART_NS).then_some(Now { wall_ns, mono_ns: before })
    }

    /// The steady stamp of a frame that the kernel stamped `kernel_ns` and that is read at `now` [ns].
    pub fn stamp(&mut self, kernel_ns: i64, now: Option<Now>) -> i64 {
        let Some(now) = now else { return kernel_ns.saturating_add(self.shift_ns[0]) };
        let set_by_ns = (now.wall_ns - now.mono_ns).saturating_sub(self.apart_ns);
        if set_by_ns.abs() >= STEP_NS {
            self.shift_ns = [self.shift_ns[0].saturating_sub(set_by_ns), self.shift_ns[0]];
            self.steps += 1;
        }
        // Slewing is followed, so that it never adds up to a step.
        self.apart_ns = now.wall_ns - now.mono_ns;
        // A frame stamped before the clock was set and read after it is older, or younger, than any frame can be.
        let waited_ns = now.wall_ns.saturating_sub(kernel_ns);
        let old = self.steps > 0 && !(-STEP_NS..OLDEST_NS).contains(&waited_ns);
        kernel_ns.saturating_add(self.shift_ns[usize::from(old)])
    }

    /// How often the clock was set so far.
    pub fn steps(&self) -> u64 {
        self.steps
    }
}

impl Default for Steady {
    fn default() -> Self {
        Self::new()
    }
}

/// The wall clock [ns since 1970].
fn wall_ns() -> i64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| i64::try_from(d.as_nanos()).unwrap_or(i64::MAX))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Frames every 250 µs, each read `waited_ns` after it came; the clock is set by `steps` (frame, ns).
    fn stamps(steps: &[(i64, i64)], waited_ns: i64, slew: f64) -> (Vec<i64>, u64) {
        let mut steady = Steady::new();
        let wall0 = steady.apart_ns;
        let wall_at = |mono_ns: i64| {
            let set: i64 = steps.iter().filter(|(k, _)| mono_ns >= k * 250_000).map(|(_, by)| by).sum();
            wall0 + mono_ns + (mono_ns as f64 * slew) as i64 + set
        };
        let stamps = (0..4000_i64)
            .map(|k| {
                let came = k * 250_000;
                let read = came + waited_ns;
                steady.stamp(wall_at(came), Some(Now { wall_ns: wall_at(read), mono_ns: read })) - wall0
            })
            .collect();
        (stamps, steady.steps())
    }

    #[test]
    fn a_clock_that_is_set_leaves_the_stamps_where_they_were() {
        for by in [-3_600_000_000_000, -5_000_000, 7_000_000, 3_600_000_000_000, 86_400_000_000_000_000] {
            for waited in [20_000, 100_000_000] {
                let (stamps, steps) = stamps(&[(1000, by), (3000, -by / 2)], waited, 0.0);
                assert_eq!(steps, 2);
                for (k, stamp) in stamps.iter().enumerate() {
                    // Steps shorter than a frame may wait cannot be told from waiting.
                    let near = waited > 1_000_000 && by.abs() < 2 * OLDEST_NS;
                    let off = stamp - k as i64 * 250_000;
                    assert!(off == 0 || (near && off.abs() <= by.abs()), "set by {by}: frame {k} is off by {off} ns");
                }
            }
        }
    }

    #[test]
    fn a_clock_that_is_slewed_is_followed_and_never_taken_for_set() {
        let (stamps, steps) = stamps(&[], 20_000, 500e-6);
        assert_eq!(steps, 0);
        assert!(stamps.windows(2).all(|w| (w[1] - w[0] - 250_125).abs() <= 1));
    }

    #[test]
    fn an_interrupted_reading_changes_nothing() {
        let mut steady = Steady::new();
        assert_eq!(steady.stamp(123, None), 123);
    }
}
