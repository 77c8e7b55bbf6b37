//! `lacuna`: the command line.

mod bench;
mod calibrate;
mod chosen;
mod demo;
mod diagnose;
mod diagnose_report;
mod echo;
mod excite;
mod export;
mod graph;
mod hz;
mod identify;
mod identify_report;
mod info;
mod install;
mod lines;
mod mapping;
mod messages;
mod payload;
mod payload_report;
mod play;
mod progress;
mod prove;
mod recorded;
mod recover;
mod result;
mod result_rows;
mod runs;
mod simulate;
mod spikes;
mod supervise;
mod survey;
mod top;
mod words;

use clap::{CommandFactory, Parser, Subcommand};
use lacuna_stage::{Failure, usage};
use std::process::ExitCode;

/// Stands at the end of every command's help and man page.
const EXIT_CODES: &str = "\
Exit codes:
  0  done
  1  failed
  2  bad input or use
  3  finished, but samples were lost

Results go to standard output, messages to standard error.";

/// Finds the physics that a robot's model leaves out, and runs the process graph that shows it.
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
    /// Write a recording as CSV, Parquet or MATLAB table, or as a ROS 2 bag folder.
    Export(export::ExportArgs),
    /// Play a recording at its pace: on the terminal, or through a process graph.
    Play(play::PlayArgs),
    /// Print the samples of a recording, or of a live graph that is running.
    Echo(echo::EchoArgs),
    /// Measure how often samples come, topic by topic, in a recording or in a live graph.
    Hz(hz::HzArgs),
    /// Complete an MCAP recording that was cut off or damaged.
    Recover(recover::RecoverArgs),
    /// Print the bus's messages as another language declares them.
    Messages(messages::MessagesArgs),
    /// Print the completions of a shell.
    Completions(install::CompletionsArgs),
    /// Write the man pages.
    Man(install::ManArgs),
    /// The paper's experiment on a simulated robot, through the real process graph.
    Demo(demo::DemoArgs),
    /// Hold the diagnosis against answers that it has not seen.
    Prove(prove::ProveArgs),
    /// Benchmarks, each with its baseline in the same run.
    Bench(bench::BenchArgs),
}

/// The commands with what all of them say.
fn command() -> clap::Command {
    Cli::command().after_long_help(EXIT_CODES).mut_subcommands(|c| c.after_long_help(EXIT_CODES))
}

fn main() -> ExitCode {
    let cli: Cli = match usage::parse(command()) {
        Ok(cli) => cli,
        Err(failure) => {
            // It begins with the command itself.
            eprintln!("{failure}");
            return ExitCode::from(failure.code());
        }
    };
    run(cli.command).unwrap_or_else(|failure| {
        eprintln!("lacuna: {failure}");
        ExitCode::from(failure.code())
    })
}

fn run(chosen: Command) -> CommandResult {
    match chosen {
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
        Command::Export(args) => export::export(&args),
        Command::Play(args) => play::play(&args),
        Command::Echo(args) => echo::echo(&args),
        Command::Hz(args) => hz::hz(&args),
        Command::Recover(args) => recover::recover(&args),
        Command::Messages(args) => messages::messages(&args),
        Command::Completions(args) => install::completions(&args, command()),
        Command::Man(args) => install::man(&args, command()),
        Command::Demo(args) => demo::demo(&args),
        Command::Prove(args) => prove::prove(&args),
        Command::Bench(args) => bench::bench(&args),
    }
}

/// Result of a command.
type CommandResult = Result<ExitCode, Failure>;
