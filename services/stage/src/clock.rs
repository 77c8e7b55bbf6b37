//! The one clock of the harness: CLOCK_MONOTONIC, which all processes of a machine share.

use rustix::time::{ClockId, clock_gettime};

/// CLOCK_MONOTONIC [ns].
pub fn monotonic_ns() -> u64 {
    let t = clock_gettime(ClockId::Monotonic);
    // Seconds since boot are positive and small; the casts cannot truncate.
    t.tv_sec as u64 * 1_000_000_000 + t.tv_nsec as u64
}
