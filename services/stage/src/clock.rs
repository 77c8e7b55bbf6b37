//! The one clock of the harness: CLOCK_MONOTONIC, which all processes of a machine share. Between machines there is none;
//! where their wall clocks are synchronised, stamps cross by those.

use rustix::time::{ClockId, clock_gettime};

/// CLOCK_MONOTONIC [ns].
pub fn monotonic_ns() -> u64 {
    let t = clock_gettime(ClockId::Monotonic);
    // Seconds since boot are positive and small; the casts cannot truncate.
    t.tv_sec as u64 * 1_000_000_000 + t.tv_nsec as u64
}

/// CLOCK_REALTIME − CLOCK_MONOTONIC now [ns].
pub fn wall_ahead_ns() -> i64 {
    let before = monotonic_ns();
    let wall = clock_gettime(ClockId::Realtime);
    let monotonic = before.midpoint(monotonic_ns());
    let wall_ns = wall.tv_sec.saturating_mul(1_000_000_000).saturating_add(wall.tv_nsec);
    wall_ns.saturating_sub_unsigned(monotonic)
}
