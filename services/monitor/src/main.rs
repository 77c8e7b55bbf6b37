//! The monitor process.

use std::process::ExitCode;

fn main() -> ExitCode {
    lacuna_stage::run_stage::<lacuna_monitor::Monitor>()
}
