//! `lacuna up`: from a graph file to running processes and a summary.

use crate::supervise::{RunReport, Supervisor};
use crate::{CommandResult, runs, words};
use clap::Args;
use lacuna_interfaces::graph::{GraphFile, Mode};
use lacuna_interfaces::robot::TorqueUnit;
use lacuna_stage::Failure;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

#[derive(Args)]
pub struct UpArgs {
    /// Graph file, e.g. launch/replay.toml.
    graph: PathBuf,
    /// Set a key of the graph's [set] table.
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Start these nodes only (comma-separated).
    #[arg(long, value_delimiter = ',', value_name = "NODE")]
    only: Vec<String>,
    /// Show what would be started, and start nothing.
    #[arg(long)]
    dry_run: bool,
    /// Print the run's report as JSON on standard output.
    #[arg(long)]
    json: bool,
    /// No progress bar and no summary.
    #[arg(long, short)]
    quiet: bool,
}

/// The keys and values of `--set`.
///
/// # Errors
/// For one without `=`.
pub fn pairs(set: &[String]) -> Result<Vec<(String, String)>, Failure> {
    let pair = |pair: &String| {
        let (key, value) =
            pair.split_once('=').ok_or_else(|| Failure::usage(format!("--set {pair}: expected KEY=VALUE")))?;
        Ok((key.trim().to_owned(), value.to_owned()))
    };
    set.iter().map(pair).collect()
}

/// Reads and resolves a graph file.
fn load(args: &UpArgs) -> Result<GraphFile, Failure> {
    let overrides = pairs(&args.set)?;
    let (file, _) = lacuna_recording::load_graph(&args.graph)?;
    let graph = file.resolve(&overrides).map_err(|e| e.in_file(&args.graph))?;
    if args.only.is_empty() { Ok(graph) } else { Ok(graph.only(&args.only).map_err(|e| e.in_file(&args.graph))?) }
}

/// Where an executable is: a path as it is, a bare name beside this executable, else on PATH.
fn locate(exec: &str) -> Result<PathBuf, Failure> {
    let path = Path::new(exec);
    if exec.contains('/') {
        return if path.is_file() {
            Ok(path.to_path_buf())
        } else {
            Err(Failure::usage(format!("{exec}: no such executable")))
        };
    }
    let beside = std::env::current_exe().ok().and_then(|p| Some(p.parent()?.join(exec)));
    let on_path = std::env::var_os("PATH")
        .map(|p| std::env::split_paths(&p).map(|dir| dir.join(exec)).collect::<Vec<_>>())
        .unwrap_or_default();
    beside.into_iter().chain(on_path).find(|p| p.is_file()).ok_or_else(|| {
        Failure::usage(format!("{exec}: no such executable beside lacuna or on PATH; expected every stage installed (docs/INSTALL.md) or the whole workspace built"))
    })
}

/// `lacuna up`.
pub fn up(args: UpArgs) -> CommandResult {
    let graph = load(&args)?;
    if args.dry_run {
        let (_, executables) = check(&graph)?;
        words::say(&plan(&graph, &executables))?;
        return Ok(ExitCode::SUCCESS);
    }
    run(&graph, &args.graph, args.json, args.quiet)
}

/// Holds a graph against its robot, models and executables.
fn check(graph: &GraphFile) -> Result<(TorqueUnit, Vec<PathBuf>), Failure> {
    let robot = lacuna_recording::load_robot(Path::new(&graph.robot))?;
    let own = graph.branch_models().into_iter().map(|(_, model)| model);
    for model in own.chain([graph.model.as_str()]).filter(|m| !m.is_empty()) {
        lacuna_recording::load_model(Path::new(model), &robot.file)?;
    }
    let executables = graph.nodes.iter().map(|n| locate(&n.exec)).collect::<Result<Vec<_>, _>>()?;
    Ok((robot.file.torque_unit, executables))
}

/// Runs a resolved graph to its end and says what became of it.
pub fn run(graph: &GraphFile, path: &Path, json: bool, quiet: bool) -> CommandResult {
    let (torque_unit, executables) = check(graph)?;
    let dir = runs::create(&graph.name)?;
    let started = Supervisor::start(path, graph, &executables, &dir, !quiet && !json);
    // A run that never began has nothing to tell later.
    let report = started.inspect_err(|_| drop(std::fs::remove_dir_all(&dir)))?.run()?;
    if json {
        words::print_json(&report)?;
    } else if !quiet {
        words::say(&summary(graph, &report, torque_unit))?;
    }
    Ok(if report.lost > 0 { ExitCode::from(3) } else { ExitCode::SUCCESS })
}

fn plan(graph: &GraphFile, executables: &[PathBuf]) -> String {
    let mut out = String::new();
    // Writing to a String cannot fail.
    let mode = if graph.mode == Mode::Replay { "replay, lossless" } else { "live, drops are counted" };
    let _ = writeln!(out, "graph {} ({mode}, buffer {})", graph.name, graph.buffer);
    let _ = writeln!(out, "robot {}", graph.robot);
    let _ = writeln!(out, "model {}", if graph.model.is_empty() { "none" } else { &graph.model });
    for (space, model) in graph.branch_models() {
        let _ = writeln!(out, "model {model} in {space}/");
    }
    for (node, exec) in graph.nodes.iter().zip(executables) {
        let inputs = if node.inputs.is_empty() { "-".to_owned() } else { node.inputs.join(" + ") };
        let _ = writeln!(
            out,
            "  {:<12} {inputs} → {}   {}{}",
            node.name,
            node.output.as_deref().unwrap_or("-"),
            exec.display(),
            node.buffer.map_or_else(String::new, |n| format!(" (buffer {n})"))
        );
    }
    out
}

fn summary(graph: &GraphFile, report: &RunReport, torque_unit: TorqueUnit) -> String {
    let mut out = String::new();
    // Writing to a String cannot fail.
    let rate = report.samples as f64 / report.seconds.max(1e-9);
    let _ =
        writeln!(out, "{}: {} samples in {:.2} s ({:.0} samples/s)", graph.name, report.samples, report.seconds, rate);
    for (name, node) in &report.nodes {
        for l in &node.latency {
            let _ = writeln!(
                out,
                "  {name}: {:<34} p50 {:>9.1} µs  p99 {:>9.1} µs  p99.9 {:>9.1} µs  max {:>9.1} µs",
                l.hop, l.p50_us, l.p99_us, l.p999_us, l.max_us
            );
        }
        if let Some(path) = node.details.get("path").and_then(|p| p.as_str()) {
            let _ = writeln!(out, "  {name}: wrote {path}");
        }
    }
    if report.restarts > 0 {
        let mut names: Vec<&str> = report.faults.iter().map(|f| f.node.as_str()).collect();
        names.sort_unstable();
        names.dedup();
        let _ = writeln!(out, "  {} restarts ({}); --json has each fault", report.restarts, names.join(", "));
    }
    if report.lost > 0 {
        let _ = writeln!(out, "  {} samples were LOST on the way; see the node counts with --json", report.lost);
    }
    if torque_unit != TorqueUnit::Nm {
        let _ = writeln!(out, "  all torques of this robot are in {}, as its file says", torque_unit.symbol());
    }
    out
}
