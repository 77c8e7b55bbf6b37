//! The kill campaign: SIGKILL of every process of a live graph at random moments, and what the stream, the recording
//! and the machine look like afterwards.
//!
//! Each round starts `launch/live.toml` on a synthetic recording, kills processes until the recording is nearly over,
//! and lets the graph end by itself. Some kills fall into the start of the graph, some into the start of a process
//! that has just been restarted. Whether the graph was whole again, and when, is what the restarted process itself
//! reports ("flowing": the first sample was passed on); what the outage cost is read from the recording, completed
//! by `lacuna recover` and opened with the `mcap` crate.

pub mod kill;
mod recorded;
pub mod replay;
mod round;

use crate::{BenchError, launch_file, motion};
use lacuna_interfaces::graph::GraphFile;
use rand::SeedableRng;
use rand_pcg::Pcg64;
use round::Round;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// What a campaign is made of.
#[derive(Debug, Clone, Serialize)]
pub struct Options {
    /// Kills in all.
    pub kills: usize,
    /// Sample rate [Hz].
    pub rate_hz: f64,
    /// Length of a round [s].
    pub round_s: f64,
    /// Seed of moments and victims.
    pub seed: u64,
}

/// Median, 95th percentile and largest of some times [ms].
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct Times {
    /// How many.
    pub count: usize,
    /// Median.
    pub p50_ms: f64,
    /// 95th percentile.
    pub p95_ms: f64,
    /// Largest.
    pub max_ms: f64,
}

impl Times {
    /// Of times in milliseconds, in any order.
    pub fn of(mut ms: Vec<f64>) -> Self {
        ms.sort_by(f64::total_cmp);
        let at = |q: f64| ms.get(((ms.len() as f64 * q).ceil() as usize).saturating_sub(1)).copied().unwrap_or(0.0);
        Self { count: ms.len(), p50_ms: at(0.5), p95_ms: at(0.95), max_ms: at(1.0) }
    }
}

/// What happened to one node.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct NodeFaults {
    /// Node.
    pub node: String,
    /// Times it was killed.
    pub kills: usize,
    /// From the kill to the first sample its next process passed on (the recorder: took).
    pub whole: Times,
}

/// Result of a campaign.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Campaign {
    /// Sample rate [Hz].
    pub rate_hz: f64,
    /// Runs of the graph.
    pub rounds: usize,
    /// Kills in all …
    pub kills: usize,
    /// … of these while the graph was starting (timed to "ready") …
    pub at_start: usize,
    /// … and of a process that was itself just being started again.
    pub again: usize,
    /// Kill to whole graph, all kills in the running graph, the recorder's included.
    pub whole: Times,
    /// Kill to ready, kills while the graph was starting.
    pub ready: Times,
    /// The same by node.
    pub nodes: Vec<NodeFaults>,
    /// Outages in the last stream of the recording, as its stamps show them: the length of each hole.
    pub outages: Times,
    /// Holes in the recorded streams, and how many of them carry the flag "gap" on the sample after.
    pub holes: usize,
    /// See `holes`.
    pub flagged: usize,
    /// Raw samples due in all rounds.
    pub raw_due: u64,
    /// Raw samples in the recordings.
    pub raw_recorded: u64,
    /// Raw samples that were never published, because the source was down.
    pub raw_unpublished: u64,
    /// Raw samples published while the recorder was down, or lost with what it had not written.
    pub raw_recorder_down: u64,
    /// Raw samples that the recorder did not take in time, each of which its file says is missing.
    #[serde(default)]
    pub raw_overrun: u64,
    /// Raw samples missing without such a reason.
    pub raw_unexplained: u64,
    /// How far back from the kill of a recorder its file ended [ms] (the flush interval is 500 ms).
    pub recorder_lost: Times,
    /// Everything that was not as it should be, in words. Empty is what is asked for.
    pub problems: Vec<String>,
}

/// Runs a campaign with the launch files in `launch`.
///
/// # Errors
/// If a round could not be run; what goes wrong in the graph is in [`Campaign::problems`].
pub fn run(launch: &Path, options: &Options, progress: &mut dyn FnMut(&str)) -> Result<Campaign, BenchError> {
    let dir = tempfile::tempdir()?;
    std::fs::write(dir.path().join("robot.toml"), motion::ROBOT)?;
    std::fs::write(dir.path().join("model.toml"), motion::MODEL)?;
    let samples = (options.rate_hz * options.round_s) as u64;
    motion::write_csv(&dir.path().join("run.csv"), samples, options.rate_hz)?;
    let nodes = nodes_of(&launch.join("live.toml"))?;
    let mut random = Pcg64::seed_from_u64(options.seed);
    let mut rounds: Vec<Round> = Vec::new();
    let mut killed = 0;
    while killed < options.kills {
        progress(&format!("round {}: {killed} of {} kills", rounds.len() + 1, options.kills));
        let folder = dir.path().join(format!("round{}", rounds.len()));
        std::fs::create_dir(&folder)?;
        let setup = round::Setup { launch, files: dir.path(), nodes: &nodes, folder: &folder, samples, options };
        let round = round::run(&setup, options.kills - killed, &mut random)?;
        if round.kills.is_empty() {
            return Err("a round ended without a kill; expected rounds of several seconds".into());
        }
        killed += round.kills.len();
        rounds.push(round);
        std::fs::remove_dir_all(&folder)?;
    }
    Ok(sum(options, &rounds, samples))
}

/// Names of the nodes of a launch file; at least one.
fn nodes_of(path: &Path) -> Result<Vec<String>, BenchError> {
    let graph = GraphFile::parse(&launch_file(path)?).map_err(|e| e.in_file(path))?;
    let names: Vec<String> = graph.nodes.into_iter().map(|n| n.name).collect();
    if names.is_empty() { Err(format!("{}: found no node", path.display()).into()) } else { Ok(names) }
}

fn sum(options: &Options, rounds: &[Round], samples: u64) -> Campaign {
    let kills = || rounds.iter().flat_map(|r| &r.kills);
    let running = |node: Option<&str>| {
        let timed = kills().filter(|k| !k.at_start && node.is_none_or(|n| n == k.node));
        Times::of(timed.filter_map(|k| k.whole_ms).collect())
    };
    let mut names: Vec<&str> = kills().map(|k| k.node.as_str()).collect();
    names.sort_unstable();
    names.dedup();
    let nodes = names.iter().map(|name| NodeFaults {
        node: (*name).to_owned(),
        kills: kills().filter(|k| k.node == *name).count(),
        whole: running(Some(name)),
    });
    let total = |of: fn(&recorded::Recorded) -> u64| rounds.iter().map(|r| of(&r.recorded)).sum();
    let all = |of: fn(&recorded::Recorded) -> &Vec<f64>| {
        Times::of(rounds.iter().flat_map(|r| of(&r.recorded).iter().copied()).collect())
    };
    Campaign {
        rate_hz: options.rate_hz,
        rounds: rounds.len(),
        kills: kills().count(),
        at_start: kills().filter(|k| k.at_start).count(),
        again: kills().filter(|k| k.again).count(),
        whole: running(None),
        ready: Times::of(kills().filter(|k| k.at_start).filter_map(|k| k.whole_ms).collect()),
        nodes: nodes.collect(),
        outages: all(|r| &r.outages_ms),
        holes: total(|r| r.holes) as usize,
        flagged: total(|r| r.flagged) as usize,
        raw_due: samples * rounds.len() as u64,
        raw_recorded: total(|r| r.raw),
        raw_unpublished: total(|r| r.unpublished),
        raw_recorder_down: total(|r| r.recorder_down),
        raw_overrun: total(|r| r.overrun),
        raw_unexplained: total(|r| r.unexplained),
        recorder_lost: all(|r| &r.recorder_lost_ms),
        problems: rounds.iter().flat_map(|r| r.problems.iter().cloned()).collect(),
    }
}
