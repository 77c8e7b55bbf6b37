//! Latency per hop, from the stamps in the header.

use crate::clock::monotonic_ns;
use crate::control::{Gauge, HopLatency};
use hdrhistogram::Histogram;
use lacuna_interfaces::Header;
use lacuna_interfaces::wire::MAX_HOPS;

/// Histograms of every hop and of the whole way. 1 ns to 100 s at three digits; values beyond are clamped.
pub struct LatencyMeter {
    hops: Vec<Histogram<u64>>,
    total: Histogram<u64>,
    first_less_lag: Histogram<u64>,
    total_less_lag: Histogram<u64>,
    lagged: bool,
}

const HIGHEST_NS: u64 = 100_000_000_000;

impl LatencyMeter {
    /// Allocates all histograms; recording does not allocate.
    pub fn new() -> Self {
        let histogram = || Histogram::new_with_bounds(1, HIGHEST_NS, 3).expect("constant, valid bounds");
        Self {
            hops: (0..MAX_HOPS).map(|_| histogram()).collect(),
            total: histogram(),
            first_less_lag: histogram(),
            total_less_lag: histogram(),
            lagged: false,
        }
    }

    /// Records a sample that arrived at `now_ns`.
    pub fn record(&mut self, header: &Header, now_ns: u64) {
        let n = (header.hops as usize).min(MAX_HOPS);
        for i in 0..n {
            let next = if i + 1 < n { header.hop_ns[i + 1] } else { now_ns };
            self.hops[i].saturating_record(next.saturating_sub(header.hop_ns[i]).max(1));
        }
        if n > 0 {
            let total = now_ns.saturating_sub(header.hop_ns[0]);
            self.total.saturating_record(total.max(1));
            // The smoother is the first stage after the source; its lag is chosen, not lost on the way.
            let first = if n > 1 { header.hop_ns[1].saturating_sub(header.hop_ns[0]) } else { total };
            self.lagged |= header.lag_ns > 0;
            self.first_less_lag.saturating_record(first.saturating_sub(header.lag_ns).max(1));
            self.total_less_lag.saturating_record(total.saturating_sub(header.lag_ns).max(1));
        }
    }

    /// Percentiles of every hop that was seen, then end to end.
    pub fn report(&self) -> Vec<HopLatency> {
        let last = self.hops.iter().rposition(|h| !h.is_empty());
        let Some(last) = last else { return Vec::new() };
        let name = |i: usize| if i == last { format!("{i}→here") } else { format!("{i}→{}", i + 1) };
        let mut all: Vec<HopLatency> = (0..=last).map(|i| summary(name(i), &self.hops[i])).collect();
        all.push(summary("end to end".to_owned(), &self.total));
        if self.lagged {
            all.push(summary("0→1 less the smoother's lag".to_owned(), &self.first_less_lag));
            all.push(summary("end to end less the smoother's lag".to_owned(), &self.total_less_lag));
        }
        all
    }
}

fn summary(hop: String, h: &Histogram<u64>) -> HopLatency {
    HopLatency {
        hop,
        p50_us: h.value_at_quantile(0.5) as f64 / 1e3,
        p99_us: h.value_at_quantile(0.99) as f64 / 1e3,
        p999_us: h.value_at_quantile(0.999) as f64 / 1e3,
        max_us: h.max() as f64 / 1e3,
        count: h.len(),
    }
}

/// What one live process sees of latency and flags between two of its progress lines.
pub struct EdgeMeter {
    incoming: Histogram<u64>,
    age: Histogram<u64>,
    flags: u32,
    /// Replays are as fast as they can be; how long a sample waits in a full buffer says nothing.
    live: bool,
}

impl EdgeMeter {
    /// Allocates; recording does not.
    pub fn new(live: bool) -> Self {
        let histogram = || Histogram::new_with_bounds(1, HIGHEST_NS, 2).expect("constant, valid bounds");
        Self { incoming: histogram(), age: histogram(), flags: 0, live }
    }

    /// Takes note of a sample's flags only.
    pub fn flags_of(&mut self, header: &Header) {
        self.flags |= header.flags;
    }

    /// Takes note of a sample that has just been received.
    pub fn record(&mut self, header: &Header) {
        self.flags |= header.flags;
        if !self.live {
            return;
        }
        let now_ns = monotonic_ns();
        if let Some(last) = (header.hops as usize).min(MAX_HOPS).checked_sub(1) {
            self.incoming.saturating_record(now_ns.saturating_sub(header.hop_ns[last]).max(1));
            let age = now_ns.saturating_sub(header.hop_ns[0]).saturating_sub(header.lag_ns);
            self.age.saturating_record(age.max(1));
        }
    }

    /// What was seen since the last call.
    pub fn take(&mut self, dropped: u64, missing: u64) -> Gauge {
        let latency = if self.incoming.is_empty() {
            Vec::new()
        } else {
            vec![summary("in".to_owned(), &self.incoming), summary("age".to_owned(), &self.age)]
        };
        self.incoming.reset();
        self.age.reset();
        Gauge { dropped, missing, flags: std::mem::take(&mut self.flags), latency }
    }
}
