//! What the recorders of a run that died left behind: where their files end, and what fell between them.

use crate::streams::{Stream, topics_of};
use lacuna_recording::container::extent;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Earlier files of a run.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Before {
    /// Last sequence number by topic, as messages carry it (32 bits).
    last: BTreeMap<String, u32>,
    /// Samples that fell between two files, by topic.
    between: BTreeMap<String, u64>,
}

impl Before {
    /// Last number of a stream in a namespace (32 bits of it), 0 if there was none; and how many of its samples fell
    /// between the files.
    pub(crate) fn of(&self, stream: Stream, namespace: &str) -> (u32, u64) {
        // The details of measured samples, which may be absent, come first among the topics of their stream.
        let topic = topics_of(stream, namespace).filter(|t| self.last.contains_key(t)).last();
        let Some(topic) = topic else { return (0, 0) };
        (self.last.get(&topic).copied().unwrap_or(0), self.between.get(&topic).copied().unwrap_or(0))
    }

    /// The furthest number of any stream (32 bits of it).
    pub fn furthest(&self) -> u32 {
        self.last.values().copied().max().unwrap_or(0)
    }
}

/// How many numbers lie between `last` and `next`, both 32 bits of a longer number: fewer than 2³², which at 4 kHz is
/// twelve days.
pub(crate) fn hole(last: u32, next: u32) -> u64 {
    u64::from(next.wrapping_sub(last).wrapping_sub(1))
}

/// Looks at the files among `paths` that recorders of `run` wrote, given in their order. A file that is absent, of another
/// run, or damaged in its head, has no part in it.
pub fn before(paths: impl Iterator<Item = PathBuf>, run: &str) -> Before {
    let mut all = Before::default();
    for path in paths {
        let Some(file) = of_run(&path, run) else { continue };
        for (topic, (first, last)) in file {
            let known = all.last.entry(topic.clone()).or_default();
            *all.between.entry(topic).or_default() += hole(*known, first);
            *known = last;
        }
    }
    all
}

/// First and last number by topic, if the file is of this run.
fn of_run(path: &Path, run: &str) -> Option<BTreeMap<String, (u32, u32)>> {
    if !path.is_file() {
        return None;
    }
    let found = extent(path).ok()?;
    (found.metadata.get("lacuna")?.get("run")? == run).then_some(found.topics)
}
