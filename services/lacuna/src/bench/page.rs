//! docs/RELIABILITY.md, from the JSON of the benchmarks.

use super::words::Faults;
use crate::{CommandResult, words};
use lacuna_benches::conditions::Document;
use lacuna_benches::faults::Times;
use lacuna_benches::{latency, soak, stress, throughput};
use lacuna_interfaces::BadInput;
use lacuna_stage::Failure;
use serde::Deserialize;
use serde::de::DeserializeOwned;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// One benchmark's document of whatever kind.
enum Part {
    Faults(Box<Document<Faults>>),
    Stress(Document<Vec<stress::Row>>),
    Latency(Document<Vec<latency::Row>>),
    Graph(Document<Vec<throughput::Row>>),
    Soak(Document<soak::Soak>),
}

impl Part {
    fn heading(&self) -> &'static str {
        match self {
            Self::Faults(_) => "SIGKILL at random moments",
            Self::Stress(_) => "Lossless replay under stress",
            Self::Latency(_) => "Live latency",
            Self::Graph(_) => "Replay throughput",
            Self::Soak(_) => "Soak",
        }
    }
}

/// `lacuna bench report`: writes the page, or prints it.
pub fn make(files: &[PathBuf], write: Option<&Path>) -> CommandResult {
    let text = of_files(files)?;
    match write {
        Some(path) => words::write(path, text.as_bytes())?,
        None => words::say(&text)?,
    }
    Ok(ExitCode::SUCCESS)
}

/// The page.
fn of_files(files: &[PathBuf]) -> Result<String, Failure> {
    let mut parts = files.iter().map(|f| read(f)).collect::<Result<Vec<_>, _>>()?;
    parts.sort_by_key(|p| match p {
        Part::Faults(_) => 0,
        Part::Stress(_) => 1,
        Part::Latency(_) => 2,
        Part::Graph(_) => 3,
        Part::Soak(_) => 4,
    });
    let mut out = String::from(HEAD);
    let mut heading = "";
    for part in &parts {
        // Figures of one kind under several conditions stand under one heading.
        if part.heading() != heading {
            heading = part.heading();
            let _ = writeln!(out, "\n## {heading}");
        }
        match part {
            Part::Faults(d) => faults(&mut out, d),
            Part::Stress(d) => stress_part(&mut out, d),
            Part::Latency(d) => latency_part(&mut out, d),
            Part::Graph(d) => graph(&mut out, d),
            Part::Soak(d) => soak_part(&mut out, d),
        }
    }
    Ok(out)
}

const HEAD: &str = "# Reliability\n\nWhat happens when processes die, readers stall, processors are busy and hours pass: \
measured on the whole graph of real processes, with the conditions under each table. This page is generated: \
`lacuna bench report --write docs/RELIABILITY.md FILES`, from the files that the commands below print with `--json`.\n";

fn read(path: &Path) -> Result<Part, Failure> {
    #[derive(Deserialize)]
    struct Kind {
        bench: String,
    }
    let text = lacuna_recording::files::read_text(path)?;
    let kind: Kind = parse(path, &text)?;
    Ok(match kind.bench.as_str() {
        "faults" => Part::Faults(Box::new(parse(path, &text)?)),
        "stress" => Part::Stress(parse(path, &text)?),
        "latency" => Part::Latency(parse(path, &text)?),
        "graph" => Part::Graph(parse(path, &text)?),
        "soak" => Part::Soak(parse(path, &text)?),
        other => {
            let what = format!("found the benchmark \"{other}\"; expected faults, stress, latency, graph or soak");
            return Err(BadInput::new(what).in_file(path).into());
        }
    })
}

fn parse<T: DeserializeOwned>(path: &Path, text: &str) -> Result<T, Failure> {
    serde_json::from_str(text)
        .map_err(|e| Failure::usage(format!("{}: {e}; expected what a benchmark prints with --json", path.display())))
}

/// The conditions of a part. Writing to a String cannot fail.
fn conditions<R>(out: &mut String, d: &Document<R>) {
    let c = &d.conditions;
    let _ = writeln!(
        out,
        "\n`{}`, {:.0} s. {}, {} processors, {:.0} GiB, {}; load {:.2} before; Lacuna {}.",
        d.command, d.took_s, c.processor, c.cores, c.memory_gib, c.kernel, c.load_before, c.version
    );
}

fn problems(out: &mut String, list: &[&String]) {
    if list.is_empty() {
        let _ = writeln!(out, "\nNothing was left behind in shared memory, and no count disagrees with another.");
    }
    for what in list {
        let _ = writeln!(out, "\n**Not as it should be:** {what}");
    }
}

fn faults(out: &mut String, d: &Document<Faults>) {
    let live = &d.result.live;
    let _ = writeln!(
        out,
        "\n{} kills in {} live runs at {} Hz: {} of them while the graph was starting, \
         {} of a process that was just being started again. Time from the kill until the next process has passed on its \
         first sample; for the smoother that includes its lag.\n\n\
         | killed | kills | p50 [ms] | p95 [ms] | max [ms] |\n|---|---:|---:|---:|---:|",
        live.kills, live.rounds, live.rate_hz, live.at_start, live.again
    );
    let mut row = |name: &str, kills: usize, t: &Times| {
        let _ = writeln!(out, "| {name} | {kills} | {:.1} | {:.1} | {:.1} |", t.p50_ms, t.p95_ms, t.max_ms);
    };
    for node in &live.nodes {
        row(&node.node, node.kills, &node.whole);
    }
    row("**any, running graph**", live.whole.count, &live.whole);
    row("any, starting graph (until ready)", live.ready.count, &live.ready);
    row("length of the holes in the last stream", live.outages.count, &live.outages);
    row("recorder: what its file lacks before the kill", live.recorder_lost.count, &live.recorder_lost);
    let _ = writeln!(
        out,
        "\n{} of {} holes carry the flag \"gap\" on the sample after them. Of {} raw samples due, {} are in the \
         recordings, {} were never published because the source was down, {} fell to a recorder that was down or had \
         not written them yet, {} it did not take in time and its file says so, **{} are missing without such a reason**.",
        live.flagged,
        live.holes,
        live.raw_due,
        live.raw_recorded,
        live.raw_unpublished,
        live.raw_recorder_down,
        live.raw_overrun,
        live.raw_unexplained
    );
    let replay = &d.result.replay;
    let _ = writeln!(
        out,
        "\nReplays: {} kills, {} runs failed with one line that names the process, {} recordings left incomplete and \
         readable to where they end, {} killed before there was a file.",
        replay.kills, replay.one_line, replay.incomplete, replay.without_file
    );
    problems(out, &live.problems.iter().chain(&replay.problems).collect::<Vec<_>>());
    conditions(out, d);
}

fn stress_part(out: &mut String, d: &Document<Vec<stress::Row>>) {
    let _ = writeln!(
        out,
        "\n| stress | runs | samples complete | lost | failed loudly | samples/s |\n\
         |---|---:|---:|---:|---:|---:|"
    );
    for r in &d.result {
        let name = match r.stress {
            stress::Stress::BufferOfOne => "edges hold one message",
            stress::Stress::SlowReader => "slow recorder",
            stress::Stress::StoppedReaders => "processes stopped (SIGSTOP) again and again",
            stress::Stress::StartOrder => "start in any order",
            stress::Stress::Hog => "busy processors",
            stress::Stress::Everything => "all of these",
        };
        let failed = r.failed.len();
        let _ = writeln!(out, "| {name} | {} | {} | {} | {failed} | {:.0} |", r.runs, r.samples, r.lost, r.rate_per_s);
    }
    conditions(out, d);
}

fn latency_part(out: &mut String, d: &Document<Vec<latency::Row>>) {
    let _ = writeln!(
        out,
        "\nPer hop from publication to publication, in µs. Drops as the writers counted them; the \
         readers miss exactly as many, or the benchmark fails.\n\n\
         | rate [Hz] | beside it | hop | p50 | p99 | p99.9 | max | dropped |\n|---:|---|---|---:|---:|---:|---:|---:|"
    );
    for r in &d.result {
        let [p50, p99, p999, max] = r.us;
        let _ = writeln!(
            out,
            "| {} | {} | {} | {p50:.0} | {p99:.0} | {p999:.0} | {max:.0} | {} |",
            r.rate_hz, r.load, r.hop, r.dropped
        );
    }
    conditions(out, d);
}

fn graph(out: &mut String, d: &Document<Vec<throughput::Row>>) {
    let _ = writeln!(out, "\n| graph | samples/s | of the bare iceoryx2 chain | range |\n|---|---:|---:|---|");
    for r in &d.result {
        let [low, high] = r.ratio_range;
        let _ = writeln!(out, "| {} | {:.0} | {:.2} | {low:.2} to {high:.2} |", r.what, r.rate_per_s, r.ratio_to_bare);
    }
    conditions(out, d);
}

fn soak_part(out: &mut String, d: &Document<soak::Soak>) {
    let s = &d.result;
    let _ = writeln!(
        out,
        "\n{} samples in {:.0} s at {} Hz, {} restarts. Private memory and open files early (second tenth) \
         and late (last tenth) in the run.\n\n| process | early [MiB] | late [MiB] | files early | late |\n\
         |---|---:|---:|---:|---:|",
        s.samples, s.seconds, s.rate_hz, s.restarts
    );
    for p in &s.processes {
        let ([early, late], [before, after]) = (p.rss_mib, p.files);
        let _ = writeln!(out, "| {} | {early:.2} | {late:.2} | {before} | {after} |", p.node);
    }
    let _ = writeln!(out, "\n| topic | published | dropped | gaps |\n|---|---:|---:|---:|");
    for e in &s.edges {
        let _ = writeln!(out, "| {} | {} | {} | {} |", e.topic, e.published, e.dropped, e.gaps);
    }
    problems(out, &s.problems.iter().collect::<Vec<_>>());
    conditions(out, d);
}
