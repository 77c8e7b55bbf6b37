//! Figures of `lacuna bench` as text.

use lacuna_benches::faults::replay::Replays;
use lacuna_benches::faults::{Campaign, Times};
use lacuna_benches::{latency, memory, soak, stress, throughput};
use serde::{Deserialize, Serialize};
use std::fmt::Write as _;

/// Result of `lacuna bench faults`.
#[derive(Debug, Serialize, Deserialize)]
pub struct Faults {
    /// Kills in the live graph.
    pub live: Campaign,
    /// Kills in replays.
    pub replay: Replays,
}

fn times(t: &Times) -> String {
    format!("p50 {:>6.1}  p95 {:>6.1}  max {:>6.1} ms  ({})", t.p50_ms, t.p95_ms, t.max_ms, t.count)
}

impl Faults {
    pub fn text(&self) -> String {
        let l = &self.live;
        let mut out = String::new();
        // Writing to a String cannot fail.
        let _ = writeln!(
            out,
            "{} kills in {} live runs at {} Hz ({} while starting, {} of a process just restarted)",
            l.kills, l.rounds, l.rate_hz, l.at_start, l.again
        );
        let _ = writeln!(out, "  graph whole again after   {}", times(&l.whole));
        let _ = writeln!(out, "  ready, killed at start    {}", times(&l.ready));
        for n in &l.nodes {
            let _ = writeln!(out, "    {:<10} {:>4} kills    {}", n.node, n.kills, times(&n.whole));
        }
        let _ = writeln!(out, "  holes in the last stream  {}", times(&l.outages));
        let _ = writeln!(out, "  lost before a recorder's kill {}", times(&l.recorder_lost));
        let _ = writeln!(out, "  {} of {} holes carry the flag \"gap\"", l.flagged, l.holes);
        let _ = writeln!(
            out,
            "  raw samples: {} due, {} recorded, {} not published (source down), {} while the recorder was down, {} not taken in time and said so in the file, {} missing without a reason",
            l.raw_due, l.raw_recorded, l.raw_unpublished, l.raw_recorder_down, l.raw_overrun, l.raw_unexplained
        );
        let r = &self.replay;
        let _ = writeln!(
            out,
            "{} kills in replays: {} failed with one line naming the process, {} incomplete recordings readable, {} before there was a file ({} kills came too late)",
            r.kills, r.one_line, r.incomplete, r.without_file, r.too_late
        );
        for p in l.problems.iter().chain(&r.problems) {
            let _ = writeln!(out, "PROBLEM: {p}");
        }
        out
    }
}

pub fn graph_line(r: &throughput::Row) -> String {
    let [low, high] = r.ratio_range;
    format!("{:<36} {:>9.0} samples/s   {:.2} of bare ({low:.2} to {high:.2})", r.what, r.rate_per_s, r.ratio_to_bare)
}

pub fn latency_line(r: &latency::Row) -> String {
    let [p50, p99, p999, max] = r.us;
    format!(
        "{:>6} Hz  {:<38} {:<46} p50 {p50:>8.1}  p99 {p99:>8.1}  p99.9 {p999:>8.1}  max {max:>8.1} µs  {} dropped",
        r.rate_hz, r.load, r.hop, r.dropped
    )
}

pub fn memory_line(r: &memory::Row, samples: u64) -> String {
    format!("{:<10} {:>7.1} MiB after 60000 samples, {:>7.1} MiB after {samples}", r.node, r.short_mib, r.long_mib)
}

pub fn stress_lines(r: &stress::Row) -> String {
    let mut out = format!(
        "{:<16} {:>4} runs  {:>12} samples complete  {:>6} lost  {:>3} runs failed loudly  {:>9.0} samples/s\n",
        format!("{:?}", r.stress),
        r.runs,
        r.samples,
        r.lost,
        r.failed.len(),
        r.rate_per_s
    );
    for line in &r.failed {
        let _ = writeln!(out, "  {line}");
    }
    out
}

pub fn soak_text(s: &soak::Soak) -> String {
    let mut out = format!("{} samples in {:.0} s at {} Hz, {} restarts\n", s.samples, s.seconds, s.rate_hz, s.restarts);
    for p in &s.processes {
        let [early, late] = p.rss_mib;
        let _ = writeln!(
            out,
            "  {:<10} {early:>7.2} MiB early, {late:>7.2} MiB late; {} and {} open files",
            p.node, p.files[0], p.files[1]
        );
    }
    for e in &s.edges {
        let _ = writeln!(out, "  {:<10} {} published, {} dropped, {} gaps", e.topic, e.published, e.dropped, e.gaps);
    }
    for p in &s.problems {
        let _ = writeln!(out, "PROBLEM: {p}");
    }
    out
}
