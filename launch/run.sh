#!/usr/bin/env bash
# Builds the workspace and starts a graph:  launch/run.sh GRAPH.toml [ARGUMENTS OF lacuna up …]
set -euo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
if [ $# -lt 1 ]; then
    echo "usage: launch/run.sh GRAPH.toml [--set key=value]… (lacuna up --help says more)" >&2
    exit 2
fi
cargo build --quiet --release --manifest-path "$root/Cargo.toml" --workspace --bins
exec "${CARGO_TARGET_DIR:-$root/target}/release/lacuna" up "$@"
