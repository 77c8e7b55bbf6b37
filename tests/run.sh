#!/usr/bin/env bash
# Runs all tests:  ./tests/run.sh          the tests every change must pass (about fifteen minutes cold, on two cores)
#                  ./tests/run.sh --all    also the long ones
# Independent readers, viewer and stage (Python: mcap, mcap-ros2-support, rosbags, websockets, iceoryx2, pandas, pyarrow,
# scipy; JavaScript: @mcap/core; with --all Rerun, and Ray) go into environments of their own under target/; where one
# cannot be made, the tests that need it say SKIPPED.
set -uo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
cd "$root" || exit 1
target=${CARGO_TARGET_DIR:-$root/target}
long=()
case "${1:-}" in
    "") ;;
    --all) long=(--include-ignored) ;;
    *) echo "usage: tests/run.sh [--all]" >&2; exit 2 ;;
esac

venv=$target/test-venv
packages="mcap==1.6.0 mcap-ros2-support==0.6.0 rosbags==0.11.9 numpy websockets==17.4 iceoryx2==0.10.0"
if [ "$(cat "$venv/ready" 2>/dev/null)" != "$packages" ]; then
    mkdir -p "$target"
    rm -rf "$venv"
    if python3 -m venv "$venv" && "$venv/bin/pip" install --quiet --disable-pip-version-check $packages; then
        echo "$packages" > "$venv/ready"
    else
        echo "note: no Python environment; tests with independent readers will be skipped" >&2
    fi
fi
# Pinocchio, a witness for dynamics, is large and not built for every machine: the tests run without it, too.
if [ -f "$venv/ready" ] && [ ! -f "$venv/ready-pin" ]; then
    if "$venv/bin/pip" install --quiet --disable-pip-version-check "pin==4.1.0"; then
        touch "$venv/ready-pin"
    else
        echo "note: no Pinocchio; the tests that hold torques against it will be skipped" >&2
    fi
fi
# Another solver for the physically consistent fit.
if [ -f "$venv/ready" ] && [ ! -f "$venv/ready-solver" ]; then
    if "$venv/bin/pip" install --quiet --disable-pip-version-check scipy clarabel==0.11.1; then
        touch "$venv/ready-solver"
    else
        echo "note: no clarabel; the test that holds the physically consistent fit against it will be skipped" >&2
    fi
fi
# Readers of exported tables, and what the notebook page uses.
if [ -f "$venv/ready" ] && [ ! -f "$venv/ready-tables" ]; then
    if "$venv/bin/pip" install --quiet --disable-pip-version-check pandas==3.1.1 pyarrow==26.0.1 scipy matplotlib; then
        touch "$venv/ready-tables"
    else
        echo "note: no pandas, pyarrow, scipy; the tests that read exported tables with them will be skipped" >&2
    fi
fi
# The MCAP reader of the web: needs node and npm.
node=$target/test-node
if [ ! -f "$node/ready" ]; then
    mkdir -p "$node"
    if command -v node > /dev/null && npm install --silent --no-audit --no-fund --prefix "$node" \
        @mcap/core@2.2.2 @mcap/support@1.1.0 @foxglove/rosmsg@5.0.5 @foxglove/rosmsg2-serialization@3.1.0; then
        touch "$node/ready"
    else
        echo "note: no node or no packages for it; the test with @mcap/core will be skipped" >&2
    fi
fi
# Rerun and Ray are large (1.2 GB installed): for --all only.
if [ ${#long[@]} -gt 0 ] && [ ! -f "$venv-long/ready" ]; then
    rm -rf "$venv-long"
    if python3 -m venv "$venv-long" && "$venv-long/bin/pip" install --quiet --disable-pip-version-check \
        rerun-sdk==0.41.0 ray==2.60.0 pandas==3.1.1 pyarrow==26.0.1; then
        touch "$venv-long/ready"
    else
        echo "note: no Rerun or no Ray; the tests with them will be skipped" >&2
    fi
fi
[ -f "$venv/ready" ] && export LACUNA_TEST_PYTHON=$venv/bin/python
[ -f "$venv/ready-tables" ] && export LACUNA_TEST_PYTHON_TABLES=$venv/bin/python
[ -f "$node/ready" ] && export LACUNA_TEST_NODE=$node
[ -f "$venv-long/ready" ] && export LACUNA_TEST_PYTHON_LONG=$venv-long/bin/python

# Tools of the long tests: the tunnel between machines (fifteen minutes of processor time, once) and cargo-deb.
if [ ${#long[@]} -gt 0 ]; then
    export LACUNA_TEST_TOOLS=$target/tools
    # Without link-time optimisation and at the first level they build in a third of the time and serve as well.
    export CARGO_PROFILE_RELEASE_LTO=off CARGO_PROFILE_RELEASE_OPT_LEVEL=1 CARGO_PROFILE_RELEASE_CODEGEN_UNITS=16
    for tool in "iox2-link-tunnel-zenoh iceoryx2-integrations-zenoh-link-tunnel-cli@0.10.0" "cargo-deb cargo-deb"; do
        read -r executable crate <<< "$tool"
        [ -x "$LACUNA_TEST_TOOLS/bin/$executable" ] && continue
        CARGO_TARGET_DIR=$target/tools/build cargo install --quiet --locked --root "$LACUNA_TEST_TOOLS" "$crate" ||
            echo "note: no $executable; the tests that need it will be skipped" >&2
    done
    rm -rf "$target/tools/build"
    unset CARGO_PROFILE_RELEASE_LTO CARGO_PROFILE_RELEASE_OPT_LEVEL CARGO_PROFILE_RELEASE_CODEGEN_UNITS
fi

cargo build --release --workspace --bins || exit 1
log=$(mktemp)
trap 'rm -f "$log"' EXIT
cargo test --release --workspace --no-fail-fast -- "${long[@]}" 2>&1 | tee "$log"
status=${PIPESTATUS[0]}
# cargo prints one result line per test executable; this is their sum.
awk '/^test result:/ { for (i = 1; i <= NF; i++) { if ($i ~ /^passed/) p += $(i-1); if ($i ~ /^failed/) f += $(i-1); if ($i ~ /^ignored/) s += $(i-1) } }
     END { printf "%d passed, %d failed, %d skipped\n", p, f, s }' "$log"
exit "$status"
