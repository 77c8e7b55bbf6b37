//! What the offline commands show while they work, on standard error and only if that is a terminal.

use indicatif::{ProgressBar, ProgressStyle};
use std::io::Write;
use std::time::Duration;

/// A progress bar with the step that is being done.
#[derive(Debug)]
pub struct Progress {
    bar: ProgressBar,
}

/// The bar shows tenths of a per cent.
const STEPS: u64 = 1000;
const TICK: Duration = Duration::from_millis(120);

impl Progress {
    /// A bar for work whose share done is known.
    pub fn bar() -> Self {
        Self::with(ProgressBar::new(STEPS), "{spinner} {bar:30} {percent:>3} %  {msg} ({elapsed})")
    }

    /// A spinner for work whose share done is not known.
    pub fn spinner() -> Self {
        Self::with(ProgressBar::new_spinner(), "{spinner} {msg} ({elapsed})")
    }

    fn with(bar: ProgressBar, template: &str) -> Self {
        if let Ok(style) = ProgressStyle::with_template(template) {
            bar.set_style(style);
        }
        bar.enable_steady_tick(TICK);
        Self { bar }
    }

    /// Says what is being done.
    pub fn step(&self, words: &str) {
        self.bar.set_message(words.to_owned());
    }

    /// Says what is being done and the share done, 0 to 1.
    pub fn at(&self, share: f64, words: &str) {
        // A cast from f64 saturates; NaN is 0.
        self.bar.set_position((share.clamp(0.0, 1.0) * STEPS as f64) as u64);
        self.step(words);
    }

    /// Prints a line that stays: on standard output, or on standard error if that is kept for a result.
    pub fn say(&self, line: &str, on_standard_error: bool) {
        self.bar.suspend(|| {
            // Whoever reads it may have gone away; the work goes on.
            let _ = if on_standard_error {
                writeln!(std::io::stderr(), "{line}")
            } else {
                writeln!(std::io::stdout(), "{line}")
            };
        });
    }
}

/// However a command ends, the terminal is left clean for its result or its one line of error.
impl Drop for Progress {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}
