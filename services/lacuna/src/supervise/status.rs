//! The status file of a run, kept by a thread of its own: replacing a file can wait for the disk, and the supervisor
//! must not.

use super::Supervisor;
use crate::runs::{NodeStatus, RunStatus, State};
use std::path::PathBuf;
use std::process::Child;
use std::sync::mpsc::{SyncSender, sync_channel};
use std::thread::JoinHandle;
use std::time::Instant;

/// Writes the newest status it was given.
pub(super) struct StatusFile {
    dir: PathBuf,
    newest: Option<SyncSender<RunStatus>>,
    thread: Option<JoinHandle<()>>,
}

impl StatusFile {
    pub fn new(dir: PathBuf) -> Self {
        let (newest, queue) = sync_channel::<RunStatus>(1);
        let to = dir.clone();
        let thread = std::thread::spawn(move || queue.iter().for_each(|status| status.write(&to)));
        Self { dir, newest: Some(newest), thread: Some(thread) }
    }

    /// Hands it over; `false` if the one before has not been taken yet.
    fn offer(&self, status: RunStatus) -> bool {
        self.newest.as_ref().is_some_and(|queue| queue.try_send(status).is_ok())
    }

    /// Writes the last one and returns when it is there.
    fn last(&mut self, status: &RunStatus) {
        self.newest = None;
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
        status.write(&self.dir);
    }
}

impl Supervisor<'_> {
    pub(super) fn status(&self, state: State) -> RunStatus {
        let nodes = self.graph.nodes.iter().zip(&self.nodes);
        let nodes = nodes.map(|(n, s)| NodeStatus {
            name: n.name.clone(),
            pid: s.child.as_ref().map_or(0, Child::id),
            state: s.state,
            restarts: s.restarts,
            samples: s.samples,
            rate_hz: s.rate_hz,
            dropped: s.carried.dropped + s.gauge.dropped,
            missing: s.carried.missing + s.gauge.missing,
            flags: s.flags,
            latency: s.gauge.latency.clone(),
            fault: s.faults.last().map(|f| f.reason.clone()),
        });
        RunStatus {
            run: self.run.path().file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default(),
            graph: self.graph_path.display().to_string(),
            pid: std::process::id(),
            state,
            reason: self.reason.clone(),
            started_s: self.started_s,
            nodes: nodes.collect(),
        }
    }

    /// Publishes the status if something changed, and twice a second.
    pub(super) fn keep_status(&mut self, state: State) {
        if (self.changed || self.status_written.elapsed().as_millis() > 500)
            && self.status_file.offer(self.status(state))
        {
            self.changed = false;
            self.status_written = Instant::now();
        }
    }

    pub(super) fn last_status(&mut self, state: State) {
        let status = self.status(state);
        self.status_file.last(&status);
    }
}
