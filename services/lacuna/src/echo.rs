//! `lacuna echo`: the samples of a recording, or of a live graph that is running, as lines.

use crate::lines::{Lines, Printer, of_message};
use crate::runs::{self, RunArgs, RunStatus, State};
use crate::{CommandResult, words};
use clap::Args;
use lacuna_stage::observe::Observer;
use lacuna_stage::{AnyMessage, Failure, RunDir};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// How often an observer looks.
const LOOK: Duration = Duration::from_millis(5);
/// How often it asks whether the run is still there.
const ASK: Duration = Duration::from_millis(500);

#[derive(Args)]
pub struct EchoArgs {
    #[command(flatten)]
    what: WhatArgs,
    /// Leave out what lies before this time after the first sample [s].
    #[arg(long, value_name = "SECONDS", default_value_t = 0.0, allow_negative_numbers = true)]
    from: f64,
    /// Stop at this time after the first sample [s].
    #[arg(long, value_name = "SECONDS", allow_negative_numbers = true)]
    until: Option<f64>,
    /// Stop after so many lines.
    #[arg(long, value_name = "LINES")]
    limit: Option<u64>,
    /// One JSON object a line.
    #[arg(long)]
    json: bool,
}

/// What is looked at.
#[derive(Args)]
pub struct WhatArgs {
    /// Recording: MCAP or ROS 2 bag folder; with --robot any that Lacuna reads.
    #[arg(required_unless_present = "run", conflicts_with = "run")]
    pub recording: Option<PathBuf>,
    /// A live graph that is running: its name or part of it, or its folder. "" is the newest.
    #[arg(long, value_name = "NAME")]
    pub run: Option<String>,
    /// These topics only.
    #[arg(long, value_delimiter = ',', value_name = "TOPIC")]
    pub topics: Vec<String>,
    /// Robot file, for a recording without topics (CSV, capture).
    #[arg(long, value_name = "FILE", conflicts_with = "run")]
    pub robot: Option<PathBuf>,
}

/// The part of a recording's time that is asked for.
#[derive(Debug, Clone, Copy)]
pub struct Part {
    from_s: f64,
    to_s: f64,
}

impl Part {
    /// From the options.
    ///
    /// # Errors
    /// If there is nothing between them.
    pub fn of(from_s: f64, until_s: Option<f64>) -> Result<Self, Failure> {
        let from_s = words::not_negative("--from", from_s)?;
        let to_s = until_s.unwrap_or(f64::INFINITY);
        if to_s > from_s {
            return Ok(Self { from_s, to_s });
        }
        Err(Failure::usage(format!("--until: found {to_s}; expected more than --from")))
    }

    /// Whether a stamp is in it, if the recording begins at `first_ns`.
    pub fn holds(self, first_ns: i64, stamp_ns: i64) -> bool {
        let since_s = stamp_ns.saturating_sub(first_ns) as f64 / 1e9;
        since_s >= self.from_s && since_s < self.to_s
    }
}

/// `lacuna echo`.
pub fn echo(args: &EchoArgs) -> CommandResult {
    let part = Part::of(args.from, args.until)?;
    let mut left = args.limit.unwrap_or(u64::MAX);
    let mut printer = Printer::new(args.json);
    match (&args.what.recording, &args.what.run) {
        (Some(recording), _) => {
            let mut lines = Lines::open(recording, args.what.robot.as_ref(), &args.what.topics)?;
            let mut first_ns = None;
            while left > 0 {
                let Some(line) = lines.next_line()? else { break };
                if !part.holds(*first_ns.get_or_insert(line.stamp_ns), line.stamp_ns) {
                    continue;
                }
                left -= 1;
                if !printer.print(line)? {
                    return Ok(ExitCode::SUCCESS);
                }
            }
            printer.flush()?;
            if lines.was_cut() {
                eprintln!("note: the recording stops before its proper end (lacuna recover completes it)");
            }
        }
        (None, run) => {
            if args.from > 0.0 || args.until.is_some() {
                return Err(Failure::usage("--from, --until: a running graph has no such time; expected a recording"));
            }
            observe(run.as_deref().unwrap_or(""), &args.what.topics, None, &mut |topic, message, _| {
                if left == 0 {
                    return Ok(false);
                }
                left -= 1;
                // A line is seen when it happens.
                Ok(printer.print(of_message(topic, message))? && printer.flush()? && left > 0)
            })?;
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// Hears topic, message and how many samples were lost before it; says whether to go on.
pub type Heard<'a> = &'a mut dyn FnMut(&str, AnyMessage<'_>, u64) -> Result<bool, Failure>;

/// Looks at a running graph until it ends, `heard` has enough, or `limit` has passed.
pub fn observe(run: &str, topics: &[String], limit: Option<Duration>, heard: Heard<'_>) -> Result<(), Failure> {
    let (dir, status) = find(run)?;
    if status.state != State::Running {
        return Err(Failure::usage(format!("{}: is not running ({})", status.run, status.state.word())));
    }
    // Ended by the keyboard it still leaves its place on the bus in order.
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGTERM, signal_hook::consts::SIGINT] {
        signal_hook::flag::register(signal, Arc::clone(&stop))
            .map_err(|e| Failure::run(format!("cannot handle signals: {e}")))?;
    }
    let mut observer = Observer::attach(&RunDir::open(&dir), topics)?;
    let started = Instant::now();
    let mut asked = Instant::now();
    let mut enough = false;
    while limit.is_none_or(|limit| started.elapsed() < limit) {
        let ended = observer.drain(&mut |topic, message, missing| {
            if !enough {
                enough = !heard(topic, message, missing)?;
            }
            Ok(())
        })?;
        if ended || enough || stop.load(Ordering::Relaxed) {
            break;
        }
        if asked.elapsed() > ASK {
            asked = Instant::now();
            if !RunStatus::read(&dir).is_some_and(|s| s.state == State::Running) {
                break;
            }
        }
        std::thread::sleep(LOOK);
    }
    Ok(())
}

/// A run by its folder, or by its name.
fn find(run: &str) -> Result<(PathBuf, RunStatus), Failure> {
    let folder = Path::new(run);
    if run.contains('/') {
        let status = RunStatus::read(folder);
        return status.map(|status| (folder.to_path_buf(), status)).ok_or_else(|| {
            Failure::usage(format!("--run {run}: found no run in this folder; expected that of a run"))
        });
    }
    runs::find(&RunArgs::named(run))
}
