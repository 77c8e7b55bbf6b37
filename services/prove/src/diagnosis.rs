//! The diagnosis as a process of its own: it is given a robot file and recordings, and nothing else.

use crate::error::{Error, io};
use crate::said::Said;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// How to run it.
#[derive(Debug, Clone)]
pub struct Diagnosis {
    /// The `lacuna` executable.
    pub program: PathBuf,
    /// It counts as failed after this.
    pub limit: Duration,
}

/// What became of one.
#[derive(Debug, Clone)]
pub struct Answered {
    /// Findings, or one line why there are none.
    pub said: Result<Said, String>,
    /// Wall time [s].
    pub seconds: f64,
}

/// How often it is looked after.
const LOOK: Duration = Duration::from_millis(10);

impl Diagnosis {
    /// Runs `lacuna diagnose` in `folder` on `recordings` there; findings, model and report go to `out` (made if
    /// absent), what it prints to `out/log.txt`. The process inherits neither environment nor standard input.
    ///
    /// # Errors
    /// If the process cannot be started or `out` not be written. A diagnosis that fails is no error here: it is an
    /// answer without findings.
    pub fn run(&self, folder: &Path, robot: &str, recordings: &[String], out: &Path) -> Result<Answered, Error> {
        std::fs::create_dir_all(out).map_err(io("made", out))?;
        let out = out.canonicalize().map_err(io("found", out))?;
        let log_path = out.join("log.txt");
        let log = File::create(&log_path).map_err(io("written", &log_path))?;
        let both = log.try_clone().map_err(io("written", &log_path))?;
        let clock = Instant::now();
        let mut child = Command::new(&self.program)
            .args(["diagnose", "--robot", robot, "--out"])
            .arg(&out)
            .args(recordings)
            .current_dir(folder)
            .env_clear()
            .stdin(Stdio::null())
            .stdout(log)
            .stderr(both)
            .spawn()
            .map_err(io("started", &self.program))?;
        let status = loop {
            match child.try_wait().map_err(io("waited for", &self.program))? {
                Some(status) => break Some(status),
                None if clock.elapsed() > self.limit => {
                    // It may have ended by itself in between: then there is nothing to end.
                    let _ = child.kill();
                    let _ = child.wait();
                    break None;
                }
                None => std::thread::sleep(LOOK),
            }
        };
        let seconds = clock.elapsed().as_secs_f64();
        let said = match status {
            None => Err(format!("not done after {:.0} s", self.limit.as_secs_f64())),
            Some(s) if s.success() => Said::read(&out.join("findings.json")).map_err(|e| e.to_string()),
            Some(_) => Err(last_line(&log_path)),
        };
        Ok(Answered { said, seconds })
    }
}

fn last_line(log: &Path) -> String {
    let text = std::fs::read_to_string(log).unwrap_or_default();
    text.lines().rev().find(|l| !l.trim().is_empty()).unwrap_or("ended without a word").to_owned()
}
