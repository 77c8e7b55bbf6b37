#!/usr/bin/env bash
# Builds Lacuna and runs the demo: the paper's experiment on a simulated robot, through the real process graph.
#   launch/demo.sh [ARGUMENTS OF lacuna demo …]
set -euo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
cargo build --release --manifest-path "$root/Cargo.toml" --workspace --bins
exec "${CARGO_TARGET_DIR:-$root/target}/release/lacuna" demo --launch "$root/launch" "$@"
