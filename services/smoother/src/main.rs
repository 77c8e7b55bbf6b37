//! The smoother process.

use std::process::ExitCode;

fn main() -> ExitCode {
    lacuna_stage::run_stage::<lacuna_smoother::Smoother>()
}
