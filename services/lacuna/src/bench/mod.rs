//! `lacuna bench`: prints what `lacuna-benches` measures.

mod page;
mod words;

use crate::CommandResult;
use crate::progress::Progress;
use crate::words::positive;
use clap::builder::PossibleValuesParser;
use clap::{Args, Subcommand};
use lacuna_benches::conditions::{self, Conditions, Document};
use lacuna_benches::latency::Variant;
use lacuna_benches::stress::{KINDS, Stress};
use lacuna_benches::{faults, latency, memory, soak, stages, stress, throughput};
use lacuna_interfaces::BadInput;
use lacuna_stage::Failure;
use serde::Serialize;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Instant;
use words::{Faults, graph_line, latency_line, soak_text, stress_lines};

#[derive(Args)]
pub struct BenchArgs {
    #[command(subcommand)]
    what: What,
    /// Machine-readable output.
    #[arg(long, global = true)]
    json: bool,
    /// Folder of the launch files.
    #[arg(long, global = true, default_value = "launch")]
    launch: PathBuf,
}

#[derive(Subcommand)]
enum What {
    /// Time per sample of every stage, without the bus.
    Stages,
    /// Replay throughput of the whole graph, as a ratio to a bare chain on the same bus.
    Graph {
        /// Samples of a replay.
        #[arg(long, default_value_t = 300_000)]
        samples: u64,
        /// Turns; medians are printed.
        #[arg(long, default_value_t = 5)]
        turns: usize,
    },
    /// Live latency per hop and end to end, beside the bare chain's; with `--hog` under load.
    Latency {
        /// Sample rates [Hz].
        #[arg(long, value_delimiter = ',', default_values_t = [1000.0, 4000.0])]
        rates: Vec<f64>,
        /// Length of each run [s].
        #[arg(long, default_value_t = 10.0)]
        seconds: f64,
        /// Also beside a busy thread for every processor: as it is, with real-time priority, and pinned besides.
        #[arg(long)]
        hog: bool,
        /// The real-time priority (SCHED_FIFO, 1 to 99) of `--hog`.
        #[arg(long, default_value_t = 50, value_parser = clap::value_parser!(u8).range(1..=99))]
        priority: u8,
    },
    /// Kill campaign: SIGKILL of every process of a live graph and of replays at random moments; what it costs.
    Faults {
        /// Kills in the live graph.
        #[arg(long, default_value_t = 300)]
        kills: usize,
        /// Kills in replays, one a run.
        #[arg(long, default_value_t = 36)]
        replays: usize,
        /// Sample rate [Hz].
        #[arg(long, default_value_t = 4000.0)]
        rate: f64,
        /// Length of a live run [s]; it has a dozen kills or two.
        #[arg(long, default_value_t = 12.0)]
        round: f64,
        /// Seed of moments and victims.
        #[arg(long, default_value_t = 1)]
        seed: u64,
    },
    /// Lossless replay under stress: tiny buffers, slow and stopped readers, any start order, busy processors.
    Stress {
        /// Samples of a replay.
        #[arg(long, default_value_t = 1_000_000)]
        samples: u64,
        /// Replays; the kinds of stress take turns.
        #[arg(long, default_value_t = 100)]
        repeats: usize,
        /// Kinds of stress; all six if not given.
        #[arg(long, value_delimiter = ',', value_parser = PossibleValuesParser::new(KINDS.map(Stress::name)))]
        only: Vec<String>,
        /// Seed of what happens when.
        #[arg(long, default_value_t = 1)]
        seed: u64,
    },
    /// Make docs/RELIABILITY.md from what the other benchmarks printed with `--json`.
    Report {
        /// Files, in any order.
        #[arg(required = true)]
        files: Vec<PathBuf>,
        /// The page to write; standard output if not given.
        #[arg(long)]
        write: Option<PathBuf>,
    },
    /// A live graph over a long time: memory, open files and counts.
    Soak {
        /// Length [min].
        #[arg(long, default_value_t = 30.0)]
        minutes: f64,
        /// Sample rate [Hz].
        #[arg(long, default_value_t = 4000.0)]
        rate: f64,
    },
    /// Resident memory after one minute and after one hour of recording at 1 kHz.
    Memory {
        /// Samples of the long replay.
        #[arg(long, default_value_t = 3_600_000)]
        samples: u64,
    },
}

/// `lacuna bench`.
pub fn bench(args: &BenchArgs) -> CommandResult {
    check(&args.what)?;
    let run = Run { json: args.json, conditions: conditions::now(), started: Instant::now() };
    let spinner = Progress::spinner();
    let mut progress = |text: &str| spinner.step(text);
    let launch = &args.launch;
    match &args.what {
        What::Stages => {
            let rows = stages::run(&mut progress).map_err(fail)?;
            drop(spinner);
            run.rows("stages", &rows, |r| format!("{:<52} {:>9.1} ns/sample  {}", r.what, r.ns, r.note))
        }
        What::Graph { samples, turns } => {
            let rows = throughput::run(launch, *samples, *turns, &mut progress).map_err(fail)?;
            drop(spinner);
            run.rows("graph", &rows, graph_line)
        }
        What::Latency { rates, seconds, hog, priority } => {
            let variants = Variant::under_load(*priority);
            let variants = if *hog { &variants[..] } else { &variants[..1] };
            let mut rows = Vec::new();
            for (rate, variant) in rates.iter().flat_map(|r| variants.iter().map(move |v| (r, v))) {
                rows.extend(latency::run(launch, *rate, *seconds, *variant, &mut progress).map_err(fail)?);
            }
            drop(spinner);
            run.rows("latency", &rows, latency_line)
        }
        What::Memory { samples } => {
            let rows = memory::run(launch, 60_000, *samples, &mut progress).map_err(fail)?;
            drop(spinner);
            run.rows("memory", &rows, |r| words::memory_line(r, *samples))
        }
        What::Faults { kills, replays, rate, round, seed } => {
            let options = faults::Options { kills: *kills, rate_hz: *rate, round_s: *round, seed: *seed };
            let live = faults::run(launch, &options, &mut progress).map_err(fail)?;
            let replay = faults::replay::run(launch, *replays, *seed, &mut progress).map_err(fail)?;
            drop(spinner);
            let fine = live.problems.is_empty() && replay.problems.is_empty();
            run.finish("faults", &Faults { live, replay }, Faults::text, fine)
        }
        What::Stress { samples, repeats, only, seed } => {
            let wanted = |kind: &Stress| only.is_empty() || only.iter().any(|name| name == kind.name());
            let kinds: Vec<Stress> = KINDS.into_iter().filter(wanted).collect();
            let rows = stress::run(launch, &kinds, *samples, *repeats, *seed, &mut progress).map_err(fail)?;
            drop(spinner);
            let fine = rows.iter().all(|r| r.lost == 0);
            run.finish("stress", &rows, |rows| rows.iter().map(stress_lines).collect(), fine)
        }
        What::Report { files, write } => {
            drop(spinner);
            page::make(files, write.as_deref())
        }
        What::Soak { minutes, rate } => {
            let soak = soak::run(launch, *rate, minutes * 60.0, &mut progress).map_err(fail)?;
            drop(spinner);
            let fine = soak.problems.is_empty();
            run.finish("soak", &soak, soak_text, fine)
        }
    }
}

fn fail(e: lacuna_benches::BenchError) -> Failure {
    e.downcast::<BadInput>().map_or_else(|e| Failure::run(format!("bench: {e}")), |bad| (*bad).into())
}

/// Numbers that no benchmark can be run with, before any of it is.
fn check(what: &What) -> Result<(), BadInput> {
    let all = |list: &[(&str, f64)]| list.iter().try_for_each(|(key, value)| positive(key, *value).map(|_| ()));
    match what {
        What::Latency { rates, seconds, .. } => {
            rates.iter().try_for_each(|rate| all(&[("--rates", *rate)]))?;
            all(&[("--seconds", *seconds)])
        }
        What::Faults { rate, round, .. } => all(&[("--rate", *rate), ("--round", *round)]),
        What::Soak { minutes, rate } => all(&[("--minutes", *minutes), ("--rate", *rate)]),
        What::Stages | What::Graph { .. } | What::Stress { .. } | What::Report { .. } | What::Memory { .. } => Ok(()),
    }
}

/// One run of a benchmark.
struct Run {
    json: bool,
    conditions: Conditions,
    started: Instant,
}

impl Run {
    fn rows<R: Serialize>(self, bench: &str, rows: &[R], line: impl Fn(&R) -> String) -> CommandResult {
        self.finish(bench, &rows, |rows| rows.iter().map(|r| line(r) + "\n").collect(), true)
    }

    /// Prints a result; `fine` decides about the exit code.
    fn finish<R: Serialize>(self, bench: &str, result: &R, text: impl Fn(&R) -> String, fine: bool) -> CommandResult {
        if self.json {
            let document = Document {
                bench: bench.to_owned(),
                command: command_line(),
                conditions: self.conditions,
                took_s: self.started.elapsed().as_secs_f64(),
                result,
            };
            crate::words::print_json(&document)?;
        } else {
            crate::words::say(&text(result))?;
        }
        Ok(if fine { ExitCode::SUCCESS } else { ExitCode::FAILURE })
    }
}

/// The command as it was given, without the folder of the executable.
fn command_line() -> String {
    let mut words = vec!["lacuna".to_owned()];
    words.extend(std::env::args().skip(1).filter(|a| a != "--json"));
    words.join(" ")
}
