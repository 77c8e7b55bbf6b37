//! Kills in a replay: the run fails with one line that names the process, and leaves nothing that looks complete.

use super::{kill, recorded};
use crate::chain::remaining;
use crate::{BenchError, beside, motion};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

/// Samples of the recording: more than a replay gets through before the kill.
const SAMPLES: u64 = 1_500_000;

/// Result.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Replays {
    /// Kills, one a run.
    pub kills: usize,
    /// Runs that ended before the kill came.
    pub too_late: usize,
    /// Runs that failed with one line naming the killed process.
    pub one_line: usize,
    /// Recordings left incomplete, as they must be, and readable to where they end.
    pub incomplete: usize,
    /// Runs that died before the recorder had begun a file.
    pub without_file: usize,
    /// Everything that was not as it should be.
    pub problems: Vec<String>,
}

/// Runs `kills` replays and kills one process of each at a random moment.
///
/// # Errors
/// If a run could not be started.
pub fn run(launch: &Path, kills: usize, seed: u64, progress: &mut dyn FnMut(&str)) -> Result<Replays, BenchError> {
    let dir = tempfile::tempdir()?;
    let file = |name: &str| dir.path().join(name);
    std::fs::write(file("robot.toml"), motion::ROBOT)?;
    std::fs::write(file("model.toml"), motion::MODEL)?;
    motion::write_csv(&file("run.csv"), SAMPLES, 1000.0)?;
    let mut random = Pcg64::seed_from_u64(seed);
    let mut all = Replays { kills: 0, too_late: 0, one_line: 0, incomplete: 0, without_file: 0, problems: Vec::new() };
    let nodes = super::nodes_of(&launch.join("replay.toml"))?;
    for turn in 0..kills {
        let node = &nodes[turn % nodes.len()];
        progress(&format!("replay {} of {kills}: {node}", turn + 1));
        let out = file(&format!("run{turn}.mcap"));
        once(launch, dir.path(), &out, node, &mut random, &mut all)?;
        let _ = std::fs::remove_file(&out);
    }
    Ok(all)
}

fn once(
    launch: &Path,
    dir: &Path,
    out: &Path,
    node: &str,
    random: &mut Pcg64,
    all: &mut Replays,
) -> Result<(), BenchError> {
    let set = |key: &str, path: &Path| format!("{key}={}", path.display());
    let child = Command::new(beside("lacuna")?)
        .arg("up")
        .arg(launch.join("replay.toml"))
        .arg("--json")
        .args(["--set", &set("recording", &dir.join("run.csv")), "--set", &set("robot", &dir.join("robot.toml"))])
        .args(["--set", &set("model", &dir.join("model.toml")), "--set", &set("out", out)])
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()?;
    let supervisor = child.id();
    let pid = kill::wait_for(supervisor, node, None, Duration::from_secs(10));
    std::thread::sleep(Duration::from_millis(random.random_range(0..1200)));
    let run = super::round::run_name(supervisor).unwrap_or_default();
    let killed = pid.and_then(kill::kill).is_some();
    let done = child.wait_with_output()?;
    let mut problem = |what: String| all.problems.push(format!("replay, {node} killed: {what}"));
    if !killed || done.status.success() {
        all.too_late += 1;
        return Ok(());
    }
    all.kills += 1;
    let line = String::from_utf8_lossy(&done.stderr).trim().to_owned();
    if done.status.code() == Some(1) && line.lines().count() == 1 && line.contains(&format!("\"{node}\"")) {
        all.one_line += 1;
    } else {
        problem(format!("ended with {} and said: {line}", done.status));
    }
    if !done.stdout.is_empty() {
        problem("printed a report".to_owned());
    }
    let left = remaining(&run);
    if left > 0 || run.is_empty() {
        problem(format!("left {left} files in /dev/shm"));
    }
    match std::fs::read(out) {
        Err(_) => all.without_file += 1,
        // Killed between creating the file and writing its head.
        Ok(bytes) if bytes.is_empty() => all.without_file += 1,
        Ok(bytes) => {
            if mcap::Summary::read(&bytes).is_ok_and(|s| s.is_some()) {
                problem("the recording looks complete".to_owned());
            }
            match recorded::completed(out, &dir.join("recovered.mcap.tmp")).map(|b| readable(&b)) {
                Ok(true) => all.incomplete += 1,
                Ok(false) => problem("the recovered recording does not read to its end".to_owned()),
                Err(e) => problem(e.to_string()),
            }
        }
    }
    Ok(())
}

/// True if the `mcap` crate reads the file from its first message to its last.
fn readable(bytes: &[u8]) -> bool {
    mcap::MessageStream::new(bytes).is_ok_and(|mut messages| messages.all(|m| m.is_ok()))
}
