//! Benchmarks, each with its baseline in the same run: absolute times depend on the machine and its mood, ratios
//! much less. `lacuna bench` prints them; nothing here is a test.

pub mod balance;
pub mod chain;
pub mod conditions;
pub mod faults;
pub mod latency;
pub mod load;
pub mod memory;
pub mod motion;
pub mod soak;
pub mod stages;
pub mod stress;
pub mod throughput;

use lacuna_interfaces::BadInput;
use std::path::{Path, PathBuf};

/// Why a benchmark could not be run.
pub type BenchError = Box<dyn std::error::Error>;

/// Executable beside this one.
fn beside(name: &str) -> Result<PathBuf, BenchError> {
    let path = std::env::current_exe()?.parent().ok_or("no folder")?.join(name);
    if path.is_file() {
        Ok(path)
    } else {
        Err(format!("{}: not built; build the whole workspace first", path.display()).into())
    }
}

/// A file of the launch folder.
fn launch_file(path: &Path) -> Result<String, BenchError> {
    std::fs::read_to_string(path).map_err(|e| {
        let what = format!("cannot be read: {e}; expected a launch file (--launch names their folder)");
        BadInput::new(what).in_file(path).into()
    })
}

/// Median; 0 for none.
fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    match values.len() {
        0 => 0.0,
        n if n % 2 == 1 => values[n / 2],
        n => 0.5 * (values[n / 2 - 1] + values[n / 2]),
    }
}
