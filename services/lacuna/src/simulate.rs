//! `lacuna simulate`: closed-loop recordings of a robot, and, elsewhere, the truth behind them.

use crate::progress::Progress;
use crate::{CommandResult, words};
use clap::{ArgGroup, Args, ValueEnum};
use lacuna_interfaces::robot::Kind;
use lacuna_interfaces::{BadInput, RobotFile};
use lacuna_recording::files::read_text;
use lacuna_simulate::demo::DEMO_ROBOT;
use lacuna_simulate::output::robot_toml;
use lacuna_simulate::{CaseOptions, Simulation, SimulationConfig, Truth, demo_delta, draw_case, simulate as run};
use lacuna_stage::Failure;
use serde::Serialize;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

#[derive(Args)]
#[command(group(ArgGroup::new("what").required(true).args(["robot", "demo", "case"])))]
pub struct SimulateArgs {
    /// Simulate this robot.
    #[arg(long, value_name = "FILE")]
    robot: Option<PathBuf>,
    /// What to simulate with it: trajectories, friction, noise, effects. Default: six motions, nothing hidden.
    #[arg(long, value_name = "FILE", requires = "robot")]
    config: Option<PathBuf>,
    /// The demo's Delta robot: thirteen free motions, and a pick-and-place with 3.8 kg.
    #[arg(long)]
    demo: bool,
    /// Draw a robot, its motions, noise and effects from this seed.
    #[arg(long, value_name = "SEED", conflicts_with = "seed")]
    case: Option<u64>,
    /// Folder for the recordings and manifest.json; the demo and cases write their robot.toml too.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// File for the truth (JSON); without it the truth is not written at all.
    #[arg(long, value_name = "FILE")]
    truth: Option<PathBuf>,
    /// Seed of everything drawn, over the configuration's. Default for the demo: 1.
    #[arg(long)]
    seed: Option<u64>,
    /// Write into a folder that holds recordings already.
    #[arg(long)]
    overwrite: bool,
    /// Print what was written as JSON on standard output.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    case_options: CaseArgs,
}

/// Of what kind a drawn case is. (clap drops `requires = "case"` where --case itself is ruled out by --robot or --demo, so
/// these conflict with both instead.)
#[derive(Args)]
struct CaseArgs {
    /// Kind of robot.
    #[arg(long, conflicts_with_all = ["robot", "demo"], value_enum)]
    kind: Option<KindArg>,
    /// Number of effects.
    #[arg(long, conflicts_with_all = ["robot", "demo"])]
    effects: Option<usize>,
    /// This effect first, by its id; may be given several times.
    #[arg(long, conflicts_with_all = ["robot", "demo"], value_name = "ID")]
    effect: Vec<String>,
    /// Draw the last effect from outside the catalogue.
    #[arg(long, conflicts_with_all = ["robot", "demo"])]
    unknown: bool,
    /// Strength of the effects, drawn from this range; 1 is usual.
    #[arg(long, conflicts_with_all = ["robot", "demo"], num_args = 2, value_names = ["LOW", "HIGH"], allow_negative_numbers = true)]
    severity: Option<Vec<f64>>,
    /// Real masses differ from the robot file's by up to this share.
    #[arg(long, conflicts_with_all = ["robot", "demo"], value_name = "SHARE", allow_negative_numbers = true)]
    mass_error: Option<f64>,
    /// Recordings.
    #[arg(long, conflicts_with_all = ["robot", "demo"], value_parser = clap::value_parser!(u32).range(1..=1000))]
    trajectories: Option<u32>,
    /// Length of each [s].
    #[arg(long, conflicts_with_all = ["robot", "demo"], value_name = "SECONDS", allow_negative_numbers = true)]
    duration: Option<f64>,
}

#[derive(Clone, Copy, ValueEnum)]
enum KindArg {
    /// Three-leg Delta.
    Delta,
    /// Open chain.
    Serial,
}

impl CaseArgs {
    fn options(&self) -> CaseOptions {
        let default = CaseOptions::default();
        let kind = match self.kind {
            None => default.kind,
            Some(KindArg::Delta) => Kind::Delta,
            Some(KindArg::Serial) => Kind::Serial,
        };
        let severity = match self.severity.as_deref() {
            Some(&[low, high]) => [low, high],
            _ => default.severity,
        };
        CaseOptions {
            kind,
            effects: self.effects.unwrap_or(default.effects),
            ids: self.effect.clone(),
            unknown: self.unknown,
            severity,
            mass_error: self.mass_error.unwrap_or(default.mass_error),
            trajectories: self.trajectories.unwrap_or(default.trajectories),
            duration_s: self.duration.unwrap_or(default.duration_s),
            measure_effects: default.measure_effects,
        }
    }
}

/// Where the demo's free motions and its pick-and-place go, below the given folder; also their names in its truth.
const DEMO_FOLDERS: [&str; 2] = ["free", "pick_place"];

/// Recordings that belong together: one folder with its manifest, one truth.
struct Part {
    /// Folder below the given one; empty for the folder itself.
    folder: &'static str,
    simulation: Simulation,
}

/// What `--json` prints.
#[derive(Serialize)]
struct Written {
    schema: &'static str,
    robot: String,
    recordings: Vec<PathBuf>,
    #[serde(skip_serializing_if = "Option::is_none")]
    robot_file: Option<PathBuf>,
    #[serde(skip_serializing_if = "Option::is_none")]
    truth: Option<PathBuf>,
    seconds: f64,
    samples: usize,
}

/// `lacuna simulate`.
pub fn simulate(args: &SimulateArgs) -> CommandResult {
    words::folder_for(&args.out)?;
    if !args.overwrite {
        let folders: &[&str] = if args.demo { &DEMO_FOLDERS } else { &[""] };
        folders.iter().try_for_each(|folder| refuse_recordings(&below(&args.out, folder)))?;
    }
    let progress = Progress::spinner();
    progress.step("simulating");
    let (robot_name, robot_toml, parts) = parts(args)?;
    progress.step("writing");
    let mut recordings = Vec::new();
    for part in &parts {
        let written = part.simulation.write(&below(&args.out, part.folder));
        let written = written.map_err(|e| Failure::of_file(e.to_string(), e.kind()))?;
        recordings.extend(written.into_iter().filter(|p| p.extension().is_some_and(|e| e == "csv")));
    }
    let robot_file = robot_toml.as_ref().map(|_| args.out.join("robot.toml"));
    if let (Some(path), Some(text)) = (&robot_file, &robot_toml) {
        words::write(path, text.as_bytes())?;
    }
    if let Some(path) = &args.truth {
        words::write(path, (truth(&parts)? + "\n").as_bytes())?;
    }
    drop(progress);
    let all = || parts.iter().flat_map(|p| &p.simulation.recordings);
    let written = Written {
        schema: "lacuna.simulation/1",
        robot: robot_name,
        recordings,
        robot_file,
        truth: args.truth.clone(),
        seconds: all().map(lacuna_interfaces::Recording::duration_s).sum(),
        samples: all().map(lacuna_interfaces::Recording::len).sum(),
    };
    if args.json {
        words::print_json(&written)?;
    } else {
        words::say(&summary(&written, &args.out))?;
    }
    Ok(ExitCode::SUCCESS)
}

/// A folder below another; the folder itself for an empty name, without the slash that a join would add.
fn below(folder: &Path, name: &str) -> PathBuf {
    if name.is_empty() { folder.to_path_buf() } else { folder.join(name) }
}

/// A folder with recordings of another simulation would become a mixture of both.
fn refuse_recordings(folder: &Path) -> Result<(), BadInput> {
    let found = std::fs::read_dir(folder)
        .into_iter()
        .flatten()
        .flatten()
        .filter(|e| e.path().extension().is_some_and(|x| x == "csv"))
        .count();
    if found > 0 {
        return Err(BadInput::new(format!(
            "found {} in it; expected an empty or new folder (or --overwrite)",
            words::count(found, "recording")
        ))
        .in_file(folder));
    }
    Ok(())
}

/// The simulations asked for, the robot's name, and its file's text where the user does not have it yet.
fn parts(args: &SimulateArgs) -> Result<(String, Option<String>, Vec<Part>), Failure> {
    if let Some(seed) = args.case {
        let case = draw_case(seed, &args.case_options.options())?;
        let text = robot_toml(&case.robot).map_err(|e| Failure::run(e.to_string()))?;
        let simulation = run(&case.robot, None, &case.config)?;
        return Ok((case.robot.name, Some(text), vec![Part { folder: "", simulation }]));
    }
    if let Some(path) = &args.robot {
        let loaded = lacuna_recording::load_robot(path)?;
        let config = config(args, &loaded.file)?;
        let simulation = run(&loaded.file, loaded.urdf.as_deref(), &config).map_err(|e| match &args.config {
            Some(file) => e.in_file(file),
            None => e.in_file(path),
        })?;
        return Ok((loaded.file.name, None, vec![Part { folder: "", simulation }]));
    }
    let demo = demo_delta(args.seed.unwrap_or(1))?;
    let simulations = [demo.free, demo.pick_place];
    let parts = DEMO_FOLDERS.into_iter().zip(simulations).map(|(folder, simulation)| Part { folder, simulation });
    Ok((demo.robot.name, Some(DEMO_ROBOT.to_owned()), parts.collect()))
}

fn config(args: &SimulateArgs, robot: &RobotFile) -> Result<SimulationConfig, BadInput> {
    let mut config = match &args.config {
        Some(path) => {
            let text = read_text(path)?;
            let config = SimulationConfig::parse(&text).map_err(|e| e.in_file(path))?;
            config.validate(robot).map_err(|e| e.in_file(path))?;
            config
        }
        None => SimulationConfig::default(),
    };
    if let Some(seed) = args.seed {
        config.seed = seed;
    }
    Ok(config)
}

/// The truth of one simulation; of several, by the names of their folders.
fn truth(parts: &[Part]) -> Result<String, Failure> {
    if let [only] = parts {
        return Ok(only.simulation.truth.to_json()?);
    }
    let all: std::collections::BTreeMap<&str, &Truth> = parts.iter().map(|p| (p.folder, &p.simulation.truth)).collect();
    serde_json::to_string_pretty(&all).map_err(|e| Failure::run(format!("truth cannot be written as JSON: {e}")))
}

fn summary(written: &Written, out: &Path) -> String {
    let mut text = String::new();
    // Writing to a String cannot fail.
    let _ = writeln!(
        text,
        "{}: {}, {:.1} s, {} samples.",
        written.robot,
        words::count(written.recordings.len(), "recording"),
        written.seconds,
        written.samples
    );
    let _ = writeln!(text, "Recordings: {}", out.display());
    if let Some(path) = &written.robot_file {
        let _ = writeln!(text, "Robot file: {}", path.display());
    }
    let _ = match &written.truth {
        Some(path) => writeln!(text, "Truth: {}", path.display()),
        None => writeln!(text, "Truth: not written (--truth FILE writes it)"),
    };
    text
}
