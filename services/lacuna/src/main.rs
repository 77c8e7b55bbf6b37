//! `lacuna`: the command line.

mod bench;
mod calibrate;
mod chosen;
mod demo;
mod diagnose;
mod diagnose_report;
mod excite;
mod graph;
mod identify;
mod identify_report;
mod info;
mod payload;
mod payload_report;
mod progress;
mod prove;
mod recorded;
mod recover;
mod runs;
mod simulate;
mod supervise;
mod survey;
mod top;
mod words;

use clap::{Parser, Subcommand};
use lacuna_stage::Failure;
use std::process::ExitCode;

/// Finds the physics that a robot's model leaves out, and runs the process graph that shows it.
///
/// Exit codes: 0 done, 1 failed, 2 bad input or use, 3 finished but samples were lost.
#[derive(Parser)]
#[command(version, max_term_width = 100)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Start a process graph and stay until it ends.
    Up(graph::UpArgs),
    /// Stop a running graph in order: the source first, then everything behind it.
    Down(runs::RunArgs),
    /// Show the runs of this user, or one of them.
    Status(runs::StatusArgs),
    /// Watch a running graph: rates, latencies, drops, restarts, alarms.
    Top(top::TopArgs),
    /// Print the logs of a run.
    Logs(runs::LogsArgs),
    /// Identify a robot's model from recordings, with its error on data it has not seen.
    Identify(identify::IdentifyArgs),
    /// Estimate the payload in recordings under an identified model: picked and placed when, how heavy, how quickly known.
    Payload(payload::PayloadArgs),
    /// Find the physics that the robot's model leaves out: where, what, how large, how sure.
    Diagnose(diagnose::DiagnoseArgs),
    /// Calibrate the diagnosis on simulated robots whose truth is known, or measure how well it is calibrated.
    Calibrate(calibrate::CalibrateArgs),
    /// Simulate closed-loop recordings of a robot; the truth goes to a file of its own.
    Simulate(simulate::SimulateArgs),
    /// Design a motion that identifies the robot best, within its limits.
    Excite(excite::ExciteArgs),
    /// Show what is in a recording.
    Info(info::InfoArgs),
    /// Complete an MCAP recording that was cut off or damaged.
    Recover(recover::RecoverArgs),
    /// The paper's experiment on a simulated robot, through the real process graph.
    Demo(demo::DemoArgs),
    /// Hold the diagnosis against answers that it has not seen.
    Prove(prove::ProveArgs),
    /// Benchmarks, each with its baseline in the same run.
    Bench(bench::BenchArgs),
}

fn main() -> ExitCode {
    let result = match Cli::parse().command {
        Command::Up(args) => graph::up(args),
        Command::Down(args) => runs::down(&args),
        Command::Status(args) => runs::status(&args),
        Command::Top(args) => top::top(&args),
        Command::Logs(args) => runs::logs(&args),
        Command::Identify(args) => identify::identify(&args),
        Command::Payload(args) => payload::payload(&args),
        Command::Diagnose(args) => diagnose::diagnose(&args),
        Command::Calibrate(args) => calibrate::calibrate(&args),
        Command::Simulate(args) => simulate::simulate(&args),
        Command::Excite(args) => excite::excite(&args),
        Command::Info(args) => info::info(&args),
        Command::Recover(args) => recover::recover(&args),
        Command::Demo(args) => demo::demo(&args),
        Command::Prove(args) => prove::prove(&args),
        Command::Bench(args) => bench::bench(&args),
    };
    match result {
        Ok(code) => code,
        Err(failure) => {
            eprintln!("lacuna: {failure}");
            ExitCode::from(failure.code())
        }
    }
}

/// Result of a command.
type CommandResult = Result<ExitCode, Failure>;
