//! `lacuna play`: a recording at its own pace, on the terminal or through a process graph.

use crate::echo::Part;
use crate::lines::{Lines, Printer};
use crate::{CommandResult, graph, words};
use clap::Args;
use lacuna_interfaces::BadInput;
use lacuna_interfaces::graph::GraphFile;
use lacuna_stage::Failure;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::{Duration, Instant};

#[derive(Args)]
pub struct PlayArgs {
    /// Recording: MCAP or ROS 2 bag folder; with --robot any that Lacuna reads.
    recording: PathBuf,
    /// Factor on the recorded speed.
    #[arg(long, default_value_t = 1.0, allow_negative_numbers = true)]
    rate: f64,
    /// Begin at this time after the first sample [s].
    #[arg(long, value_name = "SECONDS", default_value_t = 0.0, allow_negative_numbers = true)]
    from: f64,
    /// Stop at this time after the first sample [s].
    #[arg(long, value_name = "SECONDS", allow_negative_numbers = true)]
    until: Option<f64>,
    /// Robot file. Default with --graph: the one in the recording, if Lacuna recorded it.
    #[arg(long, value_name = "FILE")]
    robot: Option<PathBuf>,
    /// Print these topics only.
    #[arg(long, value_delimiter = ',', value_name = "TOPIC", conflicts_with = "graph")]
    topics: Vec<String>,
    /// Play through this graph (launch/live.toml), its source reading the recording, instead of printing.
    #[arg(long, value_name = "FILE")]
    graph: Option<PathBuf>,
    /// Set a key of the graph's [set] table.
    #[arg(long, value_name = "KEY=VALUE", requires = "graph")]
    set: Vec<String>,
    /// One JSON object a line; with --graph the run's report.
    #[arg(long)]
    json: bool,
}

/// `lacuna play`.
pub fn play(args: &PlayArgs) -> CommandResult {
    let rate = words::positive("--rate", args.rate)?;
    let part = Part::of(args.from, args.until)?;
    match &args.graph {
        Some(graph) => through(args, graph, rate),
        None => on_the_terminal(args, part, rate),
    }
}

fn on_the_terminal(args: &PlayArgs, part: Part, rate: f64) -> CommandResult {
    let mut lines = Lines::open(&args.recording, args.robot.as_ref(), &args.topics)?;
    let mut printer = Printer::new(args.json);
    let mut first_ns = None;
    let mut began: Option<(Instant, i64)> = None;
    while let Some(line) = lines.next_line()? {
        if !part.holds(*first_ns.get_or_insert(line.stamp_ns), line.stamp_ns) {
            continue;
        }
        let (began, at_ns) = *began.get_or_insert_with(|| (Instant::now(), line.at_ns));
        // What was recorded late comes at once.
        let due_s = line.at_ns.saturating_sub(at_ns).max(0) as f64 / 1e9 / rate;
        let due = Duration::try_from_secs_f64(due_s).unwrap_or(Duration::MAX);
        let wait = due.saturating_sub(began.elapsed());
        if !wait.is_zero() {
            if !printer.flush()? {
                break;
            }
            std::thread::sleep(wait);
        }
        if !printer.print(line)? {
            break;
        }
    }
    printer.flush()?;
    Ok(ExitCode::SUCCESS)
}

/// Starts a graph whose source plays the recording.
fn through(args: &PlayArgs, path: &Path, rate: f64) -> CommandResult {
    let (file, _) = lacuna_recording::load_graph(path)?;
    let mut given = graph::pairs(&args.set)?;
    let enclosed = Enclosed::of(args, &file, &given)?;
    let text = |p: &Path| p.display().to_string();
    let offer = |given: &mut Vec<(String, String)>, key: &str, value: Option<String>| {
        if let Some(value) = value
            && file.set.contains_key(key)
            && !given.iter().any(|(k, _)| k == key)
        {
            given.push((key.to_owned(), value));
        }
    };
    if let Some((key, _)) = given.iter().find(|(key, _)| ["recording", "rate"].contains(&key.as_str())) {
        return Err(Failure::usage(format!("--set {key}: play has this of its own; expected --rate or the recording")));
    }
    offer(&mut given, "recording", Some(text(&args.recording)));
    offer(&mut given, "rate", Some(rate.to_string()));
    offer(&mut given, "robot", args.robot.as_deref().or(enclosed.robot.as_deref()).map(text));
    offer(&mut given, "model", enclosed.model.as_deref().map(text));
    let mut graph = file.resolve(&given).map_err(|e| e.in_file(path))?;
    into_source(&mut graph, args, rate).map_err(|e| e.in_file(path))?;
    graph::run(&graph, path, args.json, false)
}

/// What the source reads, whatever the graph file says.
fn into_source(graph: &mut GraphFile, args: &PlayArgs, rate: f64) -> Result<(), BadInput> {
    let name = |exec: &str| Path::new(exec).file_name().is_some_and(|n| n == "lacuna-source");
    let Some(source) = graph.nodes.iter_mut().find(|n| n.inputs.is_empty() && name(&n.exec)) else {
        return Err(BadInput::new("found no node that runs lacuna-source; expected one, to play the recording"));
    };
    let config = &mut source.config;
    config.remove("interface");
    config.insert("recording".to_owned(), args.recording.display().to_string().into());
    config.insert("rate".to_owned(), rate.into());
    config.insert("from_s".to_owned(), args.from.into());
    if let Some(until) = args.until {
        config.insert("to_s".to_owned(), until.into());
    }
    Ok(())
}

/// Robot and model file out of a recording of ours, in a folder that goes with this value.
#[derive(Default)]
struct Enclosed {
    robot: Option<PathBuf>,
    model: Option<PathBuf>,
    _folder: Option<tempfile::TempDir>,
}

impl Enclosed {
    fn of(args: &PlayArgs, graph: &GraphFile, given: &[(String, String)]) -> Result<Self, Failure> {
        let wanted = |key: &str| graph.set.contains_key(key) && !given.iter().any(|(k, _)| k == key);
        // A model belongs to the robot file beside it.
        if args.robot.is_some() || !wanted("robot") || !lacuna_recording::is_mcap(&args.recording)? {
            return Ok(Self::default());
        }
        let file = lacuna_recording::file_of(&args.recording)?;
        let attached = lacuna_recording::container::leading_attachments(&file)?;
        if !attached.contains_key("robot.toml") {
            let what = "found no robot file in the recording; expected one, or --robot FILE";
            return Err(BadInput::new(what).in_file(&file).into());
        }
        let folder = tempfile::tempdir().map_err(|e| Failure::run(format!("no folder for temporary files: {e}")))?;
        let robot = unpack(folder.path(), "robot.toml", &robot_text(&attached).map_err(|e| e.in_file(&file))?)?;
        let model = attached.get("model.toml").filter(|_| wanted("model"));
        let model = model.map(|text| unpack(folder.path(), "model.toml", text)).transpose()?;
        if let Some(urdf) = attached.get("robot.urdf") {
            unpack(folder.path(), "robot.urdf", urdf)?;
        }
        Ok(Self { robot: Some(robot), model, _folder: Some(folder) })
    }
}

/// The robot file with its URDF beside it, and without what only captures need.
fn robot_text(attached: &BTreeMap<String, Vec<u8>>) -> Result<Vec<u8>, BadInput> {
    let text = attached.get("robot.toml").map_or(&[][..], Vec::as_slice);
    let text = std::str::from_utf8(text).map_err(|_| BadInput::new("robot.toml: found bytes that are not UTF-8"))?;
    let mut table: toml::Table = text.parse().map_err(|e: toml::de::Error| BadInput::from_toml(&e, text))?;
    table.remove("ethercat");
    if table.contains_key("urdf") {
        table.insert("urdf".to_owned(), "robot.urdf".into());
    }
    Ok(table.to_string().into_bytes())
}

fn unpack(folder: &Path, name: &str, bytes: &[u8]) -> Result<PathBuf, Failure> {
    let path = folder.join(name);
    words::write(&path, bytes)?;
    Ok(path)
}
