#!/usr/bin/env bash
# Installs lacuna and its stages with cargo:  packaging/install.sh [ARGUMENTS OF cargo install …], as --root DIR
set -euo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
for service in lacuna source smoother torque friction payload monitor recorder live link; do
    cargo install --locked --path "$root/services/$service" "$@"
done
