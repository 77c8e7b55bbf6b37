//! What is said of a run at its end: counts held against each other, faults, or the one line of its failure.

use super::node::describe;
use super::{Supervisor, TICK};
use lacuna_interfaces::graph::{GraphFile, Mode};
use lacuna_stage::{Failure, StageReport};
use serde::Serialize;
use std::collections::BTreeMap;
use std::time::{Duration, Instant};

/// After the first sign of failure: time for the others to say what they saw, so that the cause can be told.
const CAUSE_WINDOW: Duration = Duration::from_millis(150);
/// Faults a node's list holds; a run that has more says so by its restarts.
const MOST_FAULTS: usize = 2000;

/// Result of a run.
#[derive(Debug, Clone, Serialize)]
pub struct RunReport {
    /// Run name.
    pub run: String,
    /// Samples that entered the graph: the highest number a source gave.
    pub samples: u64,
    /// Seconds from "go" to the end of the last node.
    pub seconds: f64,
    /// Samples that some node of the graph did not get, or that the last one could not keep.
    pub lost: u64,
    /// True if the stream was ended by a stop request.
    pub stopped: bool,
    /// Restarts of all nodes.
    pub restarts: u32,
    /// Reading of CLOCK_MONOTONIC when the stream began [ns].
    pub began_ns: u64,
    /// Processes that died, in order of time.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub faults: Vec<Fault>,
    /// Report of each node (after a restart: of its last process).
    pub nodes: BTreeMap<String, StageReport>,
}

/// A process that died, and how long it took until the next one did its work.
#[derive(Debug, Clone, Serialize)]
pub struct Fault {
    /// Node.
    pub node: String,
    /// What happened to it.
    pub reason: String,
    /// CLOCK_MONOTONIC when the supervisor noticed [ns].
    pub noticed_ns: u64,
    /// … when the next process was ready [ns]; absent if it never was.
    pub ready_ns: Option<u64>,
    /// … when the next process passed on its first sample [ns]; absent if it never did.
    pub flowing_ns: Option<u64>,
}

impl super::node::NodeState {
    /// Takes note of a fault.
    pub(super) fn failed(&mut self, node: &str, reason: String, noticed_ns: u64) {
        if self.faults.len() < MOST_FAULTS {
            self.faults.push(Fault { node: node.to_owned(), reason, noticed_ns, ready_ns: None, flowing_ns: None });
        }
    }
}

impl Supervisor<'_> {
    /// The failure to report: what a stage says of bad input first, then a process that died without a word,
    /// then the complaint furthest down the stream (a writer complains of the reader it lost, not the other way).
    pub(super) fn cause(&mut self) -> Failure {
        let until = Instant::now() + CAUSE_WINDOW;
        while Instant::now() < until {
            if let Ok((index, event)) = self.lines.recv_timeout(TICK) {
                self.handle(index, event);
            }
            for node in &mut self.nodes {
                let status = node.child.as_mut().and_then(|c| c.try_wait().ok().flatten());
                if let Some(status) = status {
                    node.child = None;
                    if !status.success() && node.failure.is_none() {
                        node.failure = Some(Failure::run(describe(status)));
                    }
                }
            }
        }
        let rank = |f: &Failure| match f {
            Failure::Usage(_) => 0,
            Failure::Run(what) if what.starts_with("was killed") => 1,
            Failure::Run(_) => 2,
            Failure::Stopped => 3,
        };
        let named = self.graph.nodes.iter().zip(&self.nodes).filter_map(|(n, s)| Some((n, s.failure.as_ref()?)));
        match named.rev().min_by_key(|(_, f)| rank(f)) {
            Some((_, f @ Failure::Usage(_))) => f.clone(),
            Some((node, f)) => {
                Failure::run(format!("node \"{}\" {}{f}", node.name, if rank(f) == 1 { "" } else { "failed: " }))
            }
            None => Failure::run("a node failed without saying why"),
        }
    }

    /// What to say of a graph that does not get ready.
    pub(super) fn not_ready(&self, seconds: u64) -> Failure {
        let waiting = self.graph.nodes.iter().zip(&self.nodes).filter(|(_, s)| !s.ready).map(|(node, state)| {
            let why = state.faults.last().map_or_else(String::new, |f| format!(" (its last process: {})", f.reason));
            format!("{}{why}", node.name)
        });
        Failure::run(format!("not ready after {seconds} s: {}", waiting.collect::<Vec<_>>().join(", ")))
    }

    /// The highest number that a source gave.
    fn samples(&self) -> u64 {
        let sources = self.graph.nodes.iter().zip(&self.nodes).filter(|(n, _)| n.inputs.is_empty());
        let each = sources.filter_map(|(_, state)| state.report.as_ref()).map(|r| r.last_seq.max(r.published));
        each.max().unwrap_or(0)
    }

    /// Holds the counts against each other.
    pub(super) fn report(&self, seconds: f64, stopped: bool) -> Result<RunReport, Failure> {
        let mut nodes = BTreeMap::new();
        let samples = self.samples();
        let mut missing = 0;
        for (node, state) in self.graph.nodes.iter().zip(&self.nodes) {
            let report = match &state.report {
                Some(report) => report.clone(),
                // Live, a node may die while the graph is being stopped; its faults tell of it.
                None if self.graph.mode == Mode::Live => StageReport::default(),
                None => return Err(Failure::run(format!("node \"{}\" ended without a report", node.name))),
            };
            let mut not_there = report.missing + state.carried.missing;
            if node.output.is_none() {
                // What ends here and was not kept is lost as well.
                not_there += report.dropped + state.carried.dropped;
                not_there += report.while_down + after(samples, report.last_seq);
            }
            missing = missing.max(not_there);
            nodes.insert(node.name.clone(), report);
        }
        let restarts = self.nodes.iter().map(|n| n.restarts).sum();
        // A restarted node counts anew, so then the holes are what the readers themselves saw.
        let lost = if restarts == 0 { missing.max(shortfall(self.graph, &nodes)) } else { missing };
        let mut faults: Vec<Fault> = self.nodes.iter().flat_map(|n| n.faults.iter().cloned()).collect();
        faults.sort_by_key(|f| f.noticed_ns);
        Ok(RunReport {
            run: self.run.path().file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default(),
            samples,
            seconds,
            lost,
            stopped,
            restarts,
            began_ns: self.began_ns.unwrap_or(0),
            faults,
            nodes,
        })
    }
}

/// Samples after number `last`, of which 32 bits are known; 0 for a node that cannot say what it had last.
fn after(samples: u64, last: u64) -> u64 {
    if last == 0 || last > samples { 0 } else { (samples - last) % (1 << 32) }
}

/// Every reader against the writer of its topic: the largest number of samples that did not arrive.
fn shortfall(graph: &GraphFile, nodes: &BTreeMap<String, StageReport>) -> u64 {
    let mut most = 0;
    for node in &graph.nodes {
        for topic in &node.inputs {
            let writer = graph.nodes.iter().find(|w| w.output.as_ref() == Some(topic));
            let written = writer.and_then(|w| nodes.get(&w.name)).map_or(0, |w| w.published);
            let got = nodes.get(&node.name).and_then(|r| r.received.get(topic)).copied().unwrap_or(0);
            most = most.max(written.saturating_sub(got));
        }
    }
    most
}
