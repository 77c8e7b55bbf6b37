//! `lacuna top`: a terminal view of a running graph.
//!
//! It reads the status file that the supervisor keeps from the processes' own progress lines. Nothing attaches to the
//! bus, so watching cannot slow the graph.

use crate::runs::{self, NodeStatus, RunArgs, RunStatus, State};
use crate::{CommandResult, words};
use clap::Args;
use crossterm::event::{self, Event, KeyCode, KeyModifiers};
use crossterm::terminal::{self, Clear, ClearType};
use crossterm::{cursor, execute, queue};
use lacuna_interfaces::flag;
use lacuna_stage::{Failure, HopLatency};
use serde::Serialize;
use std::fmt::Write as _;
use std::io::{IsTerminal, Write};
use std::path::Path;
use std::process::ExitCode;
use std::time::Duration;

const REDRAW: Duration = Duration::from_millis(500);

#[derive(Args)]
pub struct TopArgs {
    #[command(flatten)]
    run: RunArgs,
    /// Print once and leave.
    #[arg(long)]
    once: bool,
    /// Machine-readable, one object a line.
    #[arg(long)]
    json: bool,
}

/// Flags a viewer is told of, the alarming ones first.
const FLAGS: [(u32, &str); 7] = [
    (flag::MISMATCH, "MISMATCH"),
    (flag::UNREACHABLE, "UNREACHABLE"),
    (flag::GAP, "gap"),
    (flag::REPAIRED, "repaired"),
    (flag::DRIVE_OFF, "drive off"),
    (flag::PAYLOAD_STEP, "payload step"),
    (flag::STATE_RESET, "reset"),
];

/// What `--json` prints.
#[derive(Serialize)]
struct Look {
    schema: &'static str,
    #[serde(flatten)]
    run: RunStatus,
    /// Flags of the last five seconds or so by node, in words.
    flags: Vec<(String, Vec<&'static str>)>,
}

/// `lacuna top`.
pub fn top(args: &TopArgs) -> CommandResult {
    let (dir, status) = runs::find(&args.run)?;
    if args.json {
        return json(args, &dir, status);
    }
    if args.once {
        words::say(&page(&status))?;
        return Ok(ExitCode::SUCCESS);
    }
    if !std::io::stdout().is_terminal() {
        return Err(Failure::usage("top: standard output is not a terminal; expected one, or --once, or --json"));
    }
    let screen = Screen::open().map_err(|e| Failure::run(format!("top: cannot use the terminal: {e}")))?;
    let last = watch(&dir, status).map_err(|e| Failure::run(format!("top: cannot use the terminal: {e}")));
    drop(screen);
    words::say(&page(&last?))?;
    Ok(ExitCode::SUCCESS)
}

fn json(args: &TopArgs, dir: &Path, mut status: RunStatus) -> CommandResult {
    loop {
        let flags = status.nodes.iter().map(|n| (n.name.clone(), flag_words(n.flags))).collect();
        let over = args.once || !running(&status);
        let text = serde_json::to_string(&Look { schema: "lacuna.top/1", run: status, flags })
            .map_err(|e| Failure::run(e.to_string()))?;
        words::say(&(text + "\n"))?;
        if over {
            return Ok(ExitCode::SUCCESS);
        }
        std::thread::sleep(REDRAW);
        status = again(dir)?;
    }
}

fn running(status: &RunStatus) -> bool {
    matches!(status.state, State::Starting | State::Running)
}

fn again(dir: &Path) -> Result<RunStatus, Failure> {
    RunStatus::read(dir).ok_or_else(|| Failure::run(format!("{}: the run's status is gone", dir.display())))
}

/// The terminal while it shows the page; put right again when dropped.
struct Screen;

impl Screen {
    fn open() -> std::io::Result<Self> {
        terminal::enable_raw_mode()?;
        let screen = Self;
        execute!(std::io::stdout(), terminal::EnterAlternateScreen, cursor::Hide)?;
        Ok(screen)
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        let _ = execute!(std::io::stdout(), cursor::Show, terminal::LeaveAlternateScreen);
        let _ = terminal::disable_raw_mode();
    }
}

/// Redraws until a key says to leave or the run ends; returns what was shown last.
fn watch(dir: &Path, mut status: RunStatus) -> std::io::Result<RunStatus> {
    loop {
        draw(&page(&status))?;
        if !running(&status) {
            return Ok(status);
        }
        if event::poll(REDRAW)?
            && let Event::Key(key) = event::read()?
        {
            let interrupt = key.code == KeyCode::Char('c') && key.modifiers.contains(KeyModifiers::CONTROL);
            if interrupt || matches!(key.code, KeyCode::Char('q') | KeyCode::Esc) {
                return Ok(status);
            }
        }
        match RunStatus::read(dir) {
            Some(new) => status = new,
            None => return Ok(status),
        }
    }
}

fn draw(page: &str) -> std::io::Result<()> {
    let (width, height) = terminal::size()?;
    let mut out = std::io::stdout().lock();
    queue!(out, cursor::MoveTo(0, 0))?;
    for line in page.lines().chain(["", "q to leave"]).take(usize::from(height).max(1)) {
        let line: String = line.chars().take(usize::from(width)).collect();
        write!(out, "{line}")?;
        queue!(out, Clear(ClearType::UntilNewLine), cursor::MoveToNextLine(1))?;
    }
    queue!(out, Clear(ClearType::FromCursorDown))?;
    out.flush()
}

fn flag_words(flags: u32) -> Vec<&'static str> {
    FLAGS.iter().filter(|(bit, _)| flags & bit != 0).map(|(_, word)| *word).collect()
}

/// The whole view as text.
fn page(status: &RunStatus) -> String {
    let age = runs::now_s().saturating_sub(status.started_s);
    let mut out = String::new();
    // Writing to a String cannot fail.
    let _ = writeln!(out, "{}  {}  {age} s  pid {}  {}", status.run, status.state.word(), status.pid, status.graph);
    if let Some(reason) = &status.reason {
        let _ = writeln!(out, "{reason}");
    }
    let _ = writeln!(
        out,
        "\n{:<12} {:<9} {:>9} {:>12} {:>8} {:>8} {:>9} {:>8} {:>9} {:>8} {:>8} {:>4}  flags",
        "node",
        "state",
        "rate/s",
        "samples",
        "in p50",
        "in p99",
        "in max",
        "age p50",
        "age p99",
        "dropped",
        "missing",
        "rst"
    );
    for node in &status.nodes {
        let _ = writeln!(out, "{}", line(node));
    }
    let _ = writeln!(
        out,
        "\nin: from the stage before to here; age: from the source to here, less the smoother's lag (µs, live graphs)"
    );
    for node in status.nodes.iter().filter(|n| n.restarts > 0 || n.state == State::Failed) {
        if let Some(fault) = &node.fault {
            let _ = writeln!(out, "{}: {fault}", node.name);
        }
    }
    out
}

fn line(node: &NodeStatus) -> String {
    let hop = |name: &str| node.latency.iter().find(|l| l.hop == name);
    let us = |l: Option<&HopLatency>, of: fn(&HopLatency) -> f64| l.map_or("-".to_owned(), |l| format!("{:.0}", of(l)));
    format!(
        "{:<12} {:<9} {:>9.0} {:>12} {:>8} {:>8} {:>9} {:>8} {:>9} {:>8} {:>8} {:>4}  {}",
        node.name,
        node.state.word(),
        node.rate_hz,
        node.samples,
        us(hop("in"), |l| l.p50_us),
        us(hop("in"), |l| l.p99_us),
        us(hop("in"), |l| l.max_us),
        us(hop("age"), |l| l.p50_us),
        us(hop("age"), |l| l.p99_us),
        node.dropped,
        node.missing,
        node.restarts,
        flag_words(node.flags).join(" ")
    )
    .trim_end()
    .to_owned()
}
