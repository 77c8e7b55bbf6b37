//! What the recordings of a round hold, held against the kills.

use super::kill::Kill;
use super::round::Setup;
use crate::{BenchError, beside};
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;

/// `lacuna_interfaces::wire::flag::GAP`, as the recorded status carries it.
const GAP: u32 = lacuna_interfaces::flag::GAP;
/// A killed recorder may lose what it took since its last flush …
const FLUSH_MS: f64 = 500.0;
/// … and the disk and the scheduler take their time besides.
const SLACK_MS: f64 = 150.0;

/// Findings of a round.
#[derive(Debug, Default)]
pub struct Recorded {
    pub outages_ms: Vec<f64>,
    pub holes: u64,
    pub flagged: u64,
    pub raw: u64,
    pub unpublished: u64,
    pub recorder_down: u64,
    pub overrun: u64,
    pub unexplained: u64,
    pub recorder_lost_ms: Vec<f64>,
}

/// One file: sequence numbers of the raw stream and of the last one, with the latter's flags.
#[derive(Default)]
struct File {
    raw: Vec<u64>,
    last: Vec<(u64, u32)>,
    /// What the file says is missing of the raw stream: first number, count.
    gaps: Vec<(u64, u64)>,
    /// Last number on the topic of the last stage.
    end: u64,
    /// Missing samples per stream as the file's own end says; `None` if it has no end.
    said: Option<BTreeMap<String, String>>,
}

/// Reads all files and judges every hole.
pub fn check(
    setup: &Setup<'_>,
    paths: &[PathBuf],
    kills: &[Kill],
    report: &Value,
    problems: &mut Vec<String>,
) -> Result<Recorded, BenchError> {
    let mut files = Vec::new();
    for path in paths {
        match read(setup, path) {
            Ok(file) => files.push(file),
            Err(e) => problems.push(format!("{}: {e}", path.display())),
        }
    }
    files.sort_by_key(|f| f.raw.first().copied().unwrap_or(u64::MAX));
    let mut found = Recorded::default();
    let mut end = 0;
    for file in &files {
        count_holes(file, end, setup.options.rate_hz, &mut found, problems);
        unsaid_holes(file, problems);
        end = end.max(file.end);
    }
    let clock = Clock { began_ns: report["began_ns"].as_u64().unwrap_or(0), rate_hz: setup.options.rate_hz };
    let down = Downtimes::of(kills, report);
    recorder_losses(&files, &down, &clock, &mut found, problems);
    let mut raw: Vec<u64> = files.iter().flat_map(|f| f.raw.iter().copied()).collect();
    raw.sort_unstable();
    let all = raw.len();
    raw.dedup();
    if raw.len() != all {
        problems.push(format!("{} raw samples were recorded twice", all - raw.len()));
    }
    found.raw = raw.len() as u64;
    // Before its first sample a file says what its predecessors lack as well; that needs a reason.
    let within =
        |f: &File| f.gaps.iter().filter(|g| f.raw.first().is_some_and(|first| g.0 > *first)).copied().collect();
    let said: Vec<(u64, u64)> = files.iter().flat_map(|f| -> Vec<(u64, u64)> { within(f) }).collect();
    if let Some(first) = explain_missing(&raw, setup.samples, &down, &said, &clock, &mut found) {
        let at = clock.due_ms(first);
        problems.push(format!(
            "{} raw samples are missing although source and recorder were up; the first is number {first}, {} and {}; load {}",
            found.unexplained,
            nearest("source", &down.source, at),
            nearest("recorder", &down.recorder, at),
            std::fs::read_to_string("/proc/loadavg").unwrap_or_default().trim()
        ));
    }
    Ok(found)
}

/// Sequence numbers in time.
struct Clock {
    began_ns: u64,
    rate_hz: f64,
}

impl Clock {
    /// When sample `seq` was due, on CLOCK_MONOTONIC [ms].
    fn due_ms(&self, seq: u64) -> f64 {
        self.began_ns as f64 / 1e6 + seq.saturating_sub(1) as f64 * 1e3 / self.rate_hz
    }
}

/// What a recording's end says is missing of the last stage of the campaign's graph.
const LAST_STREAM: &str = "missing.monitor";

/// When source and recorder were down [ms on CLOCK_MONOTONIC], from the kill to the first sample of the next process.
struct Downtimes {
    source: Vec<(f64, f64)>,
    recorder: Vec<(f64, f64)>,
}

impl Downtimes {
    fn of(kills: &[Kill], report: &Value) -> Self {
        let began_ms = report["began_ns"].as_u64().unwrap_or(0) as f64 / 1e6;
        let of = |node: &str| {
            let kills = kills.iter().filter(|k| k.node == node);
            // A process killed again before it flowed, or never, was down until the next one's time.
            let mut spans: Vec<(f64, Option<f64>)> = Vec::new();
            for kill in kills {
                let at = kill.at_ns as f64 / 1e6;
                let ms = kill.flowing_ns.map(|ns| (ns as f64 / 1e6).max(began_ms));
                match spans.last_mut() {
                    Some((_, end @ None)) => *end = ms,
                    _ => spans.push((at, ms)),
                }
            }
            spans.into_iter().map(|(from, to)| (from, to.unwrap_or(f64::INFINITY))).collect()
        };
        Self { source: of("source"), recorder: of("recorder") }
    }
}

fn within(spans: &[(f64, f64)], at: f64, before: f64, after: f64) -> bool {
    spans.iter().any(|(from, to)| (from - before..=to + after).contains(&at))
}

/// Holes in the raw stream of a file that its topic of gaps does not tell.
fn unsaid_holes(file: &File, problems: &mut Vec<String>) {
    for pair in file.raw.windows(2) {
        let [before, after] = pair else { continue };
        let hole = (before + 1, (after - before).saturating_sub(1));
        if *after > before + 1 && !file.gaps.contains(&hole) {
            problems.push(format!("raw sample {after} follows {before}, and the file says nothing of it"));
        }
    }
}

/// Holes within a file: their length, their flag, and whether the file's own count knows them. The file before ended with
/// number `end`.
fn count_holes(file: &File, end: u64, rate_hz: f64, found: &mut Recorded, problems: &mut Vec<String>) {
    let mut missing = file.last.first().map_or(0, |(seq, _)| seq.saturating_sub(end + 1));
    for pair in file.last.windows(2) {
        let [(before, _), (after, flags)] = pair else { continue };
        if after - before > 1 {
            missing += after - before - 1;
            found.holes += 1;
            found.flagged += u64::from(flags & GAP != 0);
            found.outages_ms.push((after - before) as f64 * 1e3 / rate_hz);
            if flags & GAP == 0 {
                problems.push(format!("sample {after} of the last stream follows {before} without the flag \"gap\""));
            }
        }
    }
    if let Some(said) = &file.said {
        // The stream that the status belongs to; one that runs ahead of it, as the smoother's input does, lacks
        // more when the recorder comes back in the middle.
        let count: u64 = said.get(LAST_STREAM).and_then(|n| n.parse().ok()).unwrap_or(0);
        if count != missing {
            problems
                .push(format!("the file says that {count} samples of its last stream are missing; found {missing}"));
        }
    }
}

/// What each kill of the recorder cost.
fn recorder_losses(files: &[File], down: &Downtimes, clock: &Clock, found: &mut Recorded, problems: &mut Vec<String>) {
    for (from, to) in &down.recorder {
        // The last raw sample on disk from before the kill; the kill may have come before the first flush.
        let before = files.iter().filter_map(|f| {
            let first = f.raw.first()?;
            (clock.due_ms(*first) <= *from).then(|| f.raw.iter().rev().find(|s| clock.due_ms(**s) <= *from)).flatten()
        });
        let began = clock.began_ns as f64 / 1e6;
        let last = before.max().map_or(began, |seq| clock.due_ms(*seq));
        if *from > began {
            let lost = from - last;
            found.recorder_lost_ms.push(lost);
            // Another kill shortly before leaves nothing of the time between.
            let twice = down.recorder.iter().any(|(_, end)| end <= from && from - end < FLUSH_MS + SLACK_MS);
            if lost > FLUSH_MS + SLACK_MS && !twice {
                problems.push(format!("a killed recorder's file ends {lost:.0} ms before the kill"));
            }
        }
        if to.is_infinite() {
            problems.push("the recorder took nothing any more after a kill".to_owned());
        }
    }
}

/// Where a moment lies beside the nearest downtime of a process.
fn nearest(what: &str, spans: &[(f64, f64)], at: f64) -> String {
    let distance = |(from, to): &(f64, f64)| if at < *from { from - at } else { at - to };
    match spans.iter().min_by(|a, b| distance(a).total_cmp(&distance(b))) {
        Some(span) if at < span.0 => format!("{:.0} ms before the {what} was killed", distance(span)),
        Some(span) => format!("{:.0} ms after the {what} was back", distance(span)),
        None => format!("the {what} was never killed"),
    }
}

/// Counts missing samples by their reason; returns the first that has none.
fn explain_missing(
    raw: &[u64],
    samples: u64,
    down: &Downtimes,
    said: &[(u64, u64)],
    clock: &Clock,
    found: &mut Recorded,
) -> Option<u64> {
    let mut unexplained = None;
    let mut there = raw.iter().copied().peekable();
    for seq in 1..=samples {
        if there.peek() == Some(&seq) {
            there.next();
            continue;
        }
        let at = clock.due_ms(seq);
        // The timer is late at times: what was due just before a kill had not been sent yet.
        if within(&down.source, at, SLACK_MS, 0.0) {
            found.unpublished += 1;
        } else if down.recorder.iter().any(|(from, to)| at >= from - chain_before(down, *from) && at <= to + SLACK_MS) {
            found.recorder_down += 1;
        } else if said.iter().any(|(first, count)| (*first..first + count).contains(&seq)) {
            found.overrun += 1;
        } else {
            found.unexplained += 1;
            unexplained.get_or_insert(seq);
        }
    }
    unexplained
}

/// How far back a kill of the recorder may reach: the flush interval, and further if it had only just come back.
fn chain_before(down: &Downtimes, from: f64) -> f64 {
    FLUSH_MS
        + SLACK_MS
        + down.recorder.iter().filter(|(_, to)| *to < from && from - to < FLUSH_MS).map(|(a, b)| b - a).sum::<f64>()
}

/// Reads a file; one without its end is completed first, as a user would.
fn read(setup: &Setup<'_>, path: &Path) -> Result<File, BenchError> {
    let bytes = std::fs::read(path)?;
    // Killed between creating the file and writing its head.
    if bytes.is_empty() {
        return Ok(File::default());
    }
    if mcap::Summary::read(&bytes).is_ok_and(|s| s.is_some()) {
        return parse(&bytes);
    }
    let mut file = parse(&completed(path, &setup.folder.join("recovered.mcap.tmp"))?)?;
    file.said = None;
    Ok(file)
}

/// The bytes of the file that `lacuna recover` makes of an incomplete one.
pub fn completed(path: &Path, to: &Path) -> Result<Vec<u8>, BenchError> {
    let out = Command::new(beside("lacuna")?).arg("recover").arg(path).arg(to).arg("--overwrite").output()?;
    if !out.status.success() {
        return Err(format!("cannot be recovered: {}", String::from_utf8_lossy(&out.stderr).trim()).into());
    }
    Ok(std::fs::read(to)?)
}

fn parse(bytes: &[u8]) -> Result<File, BenchError> {
    let mut file = File::default();
    for message in mcap::MessageStream::new(bytes)? {
        let message = message?;
        match message.channel.topic.as_str() {
            "/measured" => file.raw.push(u64::from(message.sequence)),
            "/monitor" => file.end = u64::from(message.sequence),
            "/gaps" => {
                let (stream, first, count) = gap(&message.data).ok_or("a message on /gaps is too short")?;
                if stream == "measured" {
                    file.gaps.push((first, count));
                }
            }
            "/status" => file.last.push(status(&message.data).ok_or("a status message is too short")?),
            _ => {}
        }
    }
    for record in mcap::read::LinearReader::new(bytes)? {
        if let mcap::records::Record::Metadata(m) = record?
            && m.name == "lacuna.end"
        {
            file.said = Some(m.metadata);
        }
    }
    Ok(file)
}

/// Sequence number and flags of a `lacuna_msgs/msg/Status` in CDR: after the encapsulation come stamp (2 × 4 bytes),
/// frame id (length, text), and the numbers, each at a multiple of its size.
fn status(data: &[u8]) -> Option<(u64, u32)> {
    let body = data.get(4..)?;
    let text = u32::from_le_bytes(body.get(8..12)?.try_into().ok()?) as usize;
    let at = (12 + text).next_multiple_of(8);
    let seq = u64::from_le_bytes(body.get(at..at + 8)?.try_into().ok()?);
    let flags = u32::from_le_bytes(body.get(at + 8..at + 12)?.try_into().ok()?);
    Some((seq, flags))
}

/// Stream, first number and count of a `lacuna_msgs/msg/Gap` in CDR.
fn gap(data: &[u8]) -> Option<(&str, u64, u64)> {
    let body = data.get(4..)?;
    let word = |at: usize| Some(u32::from_le_bytes(body.get(at..at + 4)?.try_into().ok()?) as usize);
    let long = |at: usize| Some(u64::from_le_bytes(body.get(at..at + 8)?.try_into().ok()?));
    let len_at = (12 + word(8)?).next_multiple_of(4);
    let (from, to) = (len_at + 4, (len_at + 4).checked_add(word(len_at)?)?);
    let numbers = to.next_multiple_of(8);
    Some((std::str::from_utf8(body.get(from..to.checked_sub(1)?)?).ok()?, long(numbers)?, long(numbers + 8)?))
}

#[cfg(test)]
mod tests {
    use super::*;

    const CLOCK: Clock = Clock { began_ns: 10_000_000_000, rate_hz: 1000.0 };

    /// Sample k is due at 10 000 + k − 1 ms.
    fn missing(gone: std::ops::Range<u64>, down: &Downtimes) -> [u64; 3] {
        let raw: Vec<u64> = (1..=5000).filter(|seq| !gone.contains(seq)).collect();
        let mut found = Recorded::default();
        explain_missing(&raw, 5000, down, &[(4000, 10)], &CLOCK, &mut found);
        assert_eq!(found.overrun, gone.clone().filter(|seq| (4000..4010).contains(seq)).count() as u64);
        [found.unpublished, found.recorder_down, found.unexplained]
    }

    #[test]
    fn a_hole_needs_a_reason() {
        let nobody = Downtimes { source: vec![], recorder: vec![] };
        assert_eq!(missing(0..0, &nobody), [0, 0, 0]);
        assert_eq!(missing(2000..2001, &nobody), [0, 0, 1]);
        assert_eq!(missing(4005..4015, &nobody), [0, 0, 5], "what the file says ends with 4009");
        let source = Downtimes { source: vec![(12_000.0, 12_050.0)], recorder: vec![] };
        assert_eq!(missing(2001..2051, &source), [50, 0, 0]);
        assert_eq!(missing(2001..2061, &source), [51, 0, 9], "what came due after the restart must be there");
        let recorder = Downtimes { source: vec![], recorder: vec![(13_000.0, 13_030.0)] };
        assert_eq!(missing(2600..3031, &recorder), [0, 431, 0]);
        assert_eq!(missing(2300..3031, &recorder)[2], 51, "the flush interval reaches back no further");
    }

    #[test]
    fn a_hole_without_a_flag_is_found() {
        let file = File { last: vec![(1, 0), (2, 0), (5, GAP), (6, 0), (9, 0)], ..File::default() };
        let mut found = Recorded::default();
        let mut problems = Vec::new();
        count_holes(&file, 0, 1000.0, &mut found, &mut problems);
        assert_eq!((found.holes, found.flagged, problems.len()), (2, 1, 1), "{problems:?}");
    }

    #[test]
    fn a_raw_hole_that_the_file_does_not_tell_is_found() {
        let mut problems = Vec::new();
        unsaid_holes(&File { raw: vec![1, 2, 5, 9], gaps: vec![(3, 2), (6, 2)], ..File::default() }, &mut problems);
        assert_eq!(problems.len(), 1, "{problems:?}");
        assert!(problems[0].contains("9 follows 5"), "{problems:?}");
    }
}
