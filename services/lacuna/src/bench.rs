//! `lacuna bench`: prints what `lacuna-benches` measures.

use crate::CommandResult;
use crate::progress::Progress;
use clap::{Args, Subcommand};
use lacuna_benches::{latency, memory, stages, throughput};
use lacuna_stage::Failure;
use serde::Serialize;
use std::path::PathBuf;
use std::process::ExitCode;

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
    /// Live latency per hop and end to end, beside the bare chain's.
    Latency {
        /// Sample rates [Hz].
        #[arg(long, value_delimiter = ',', default_values_t = [1000.0, 4000.0])]
        rates: Vec<f64>,
        /// Length of each run [s].
        #[arg(long, default_value_t = 10.0)]
        seconds: f64,
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
    let spinner = Progress::spinner();
    let mut progress = |text: &str| spinner.step(text);
    let fail = |e: lacuna_benches::BenchError| Failure::run(format!("bench: {e}"));
    match &args.what {
        What::Stages => {
            let rows = stages::run(&mut progress).map_err(fail)?;
            drop(spinner);
            print(args.json, &rows, |r| format!("{:<52} {:>9.1} ns/sample  {}", r.what, r.ns, r.note))
        }
        What::Graph { samples, turns } => {
            let rows = throughput::run(&args.launch, *samples, *turns, &mut progress).map_err(fail)?;
            drop(spinner);
            print(args.json, &rows, |r| {
                let [low, high] = r.ratio_range;
                format!(
                    "{:<36} {:>9.0} samples/s   {:.2} of bare ({low:.2} to {high:.2})",
                    r.what, r.rate_per_s, r.ratio_to_bare
                )
            })
        }
        What::Latency { rates, seconds } => {
            let mut rows = Vec::new();
            for rate in rates {
                rows.extend(latency::run(&args.launch, *rate, *seconds, &mut progress).map_err(fail)?);
            }
            drop(spinner);
            print(args.json, &rows, |r| {
                let [p50, p99, p999, max] = r.us;
                format!(
                    "{:>6} Hz  {:<46} p50 {p50:>8.1}  p99 {p99:>8.1}  p99.9 {p999:>8.1}  max {max:>8.1} µs  {} lost",
                    r.rate_hz, r.hop, r.lost
                )
            })
        }
        What::Memory { samples } => {
            let rows = memory::run(&args.launch, 60_000, *samples, &mut progress).map_err(fail)?;
            drop(spinner);
            print(args.json, &rows, |r| {
                format!(
                    "{:<10} {:>7.1} MiB after 60000 samples, {:>7.1} MiB after {samples}",
                    r.node, r.short_mib, r.long_mib
                )
            })
        }
    }
}

fn print<R: Serialize>(json: bool, rows: &[R], line: impl Fn(&R) -> String) -> CommandResult {
    if json {
        println!("{}", serde_json::to_string_pretty(rows).map_err(|e| Failure::run(e.to_string()))?);
    } else {
        rows.iter().for_each(|r| println!("{}", line(r)));
    }
    Ok(ExitCode::SUCCESS)
}
