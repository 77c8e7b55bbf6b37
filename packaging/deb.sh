#!/usr/bin/env bash
# Builds the Debian package with cargo-deb:  packaging/deb.sh [--no-build] [FOLDER]
# The package lies in FOLDER, target/debian if none is given. --no-build: the executables are there already.
set -euo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
target=${CARGO_TARGET_DIR:-$root/target}
build=yes
if [ "${1:-}" = --no-build ]; then
    build=no
    shift
fi
out=${1:-$target/debian}
stages=(source smoother torque friction payload monitor recorder live link)
if [ "$build" = yes ]; then
    packages=(-p lacuna -p lacuna-benches)
    for stage in "${stages[@]}"; do packages+=(-p "lacuna-$stage"); done
    cargo build --release --manifest-path "$root/Cargo.toml" "${packages[@]}" --bins
fi
lacuna=$target/release/lacuna
made=$target/release/packaging
rm -rf "$made"
mkdir -p "$made" "$out"
"$lacuna" man "$made/man"
gzip -9n "$made"/man/*.1
for shell in bash zsh fish; do "$lacuna" completions "$shell" > "$made/lacuna.$shell"; done
"$lacuna" messages --python --out "$made/lacuna_messages.py"
cd "$root"
exec cargo deb --no-build --package lacuna --output "$out"
