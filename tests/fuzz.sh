#!/usr/bin/env bash
# Coverage-guided fuzzing of every parser with libFuzzer:  tests/fuzz.sh [SECONDS PER TARGET] [TARGET …]
# Targets: fuzz_csv fuzz_mcap fuzz_robot fuzz_model fuzz_graph fuzz_urdf fuzz_capture fuzz_eni (services/recording/tests/fuzz.rs).
# Needs a C++ compiler. What it learns is kept under target/fuzz/; an input that fails is printed and kept there.
set -uo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
cd "$root" || exit 1
seconds=${1:-60}
shift || true
[ $# -gt 0 ] || set -- fuzz_csv fuzz_mcap fuzz_robot fuzz_model fuzz_graph fuzz_urdf fuzz_capture fuzz_eni
target=${CARGO_TARGET_DIR:-$root/target}/fuzz
export CARGO_TARGET_DIR=$target CARGO_INCREMENTAL=0
# What `cargo bolero` sets for libFuzzer without a sanitizer; it works with the stable compiler.
export RUSTFLAGS="--cfg fuzzing --cfg fuzzing_libfuzzer -Cpasses=sancov-module -Cllvm-args=-sanitizer-coverage-level=4 \
-Cllvm-args=-sanitizer-coverage-inline-8bit-counters -Cllvm-args=-sanitizer-coverage-pc-table \
-Cllvm-args=-sanitizer-coverage-trace-compares -Clink-dead-code -Ccodegen-units=1 -Cdebug-assertions -Coverflow-checks"
host=$(rustc -vV | sed -n 's/^host: //p')
exe=$(cargo test --release --target "$host" -p lacuna-recording --test fuzz --no-run --message-format=json |
    sed -n 's/.*"executable":"\([^"]*\)".*/\1/p' | tail -1)
[ -x "$exe" ] || { echo "fuzz.sh: the fuzz targets could not be built" >&2; exit 1; }
failed=0
for name in "$@"; do
    mkdir -p "$target/corpus/$name" "$target/crashes/$name"
    echo "== $name, $seconds s"
    BOLERO_TEST_NAME=$name BOLERO_LIBTEST_HARNESS=1 \
        BOLERO_LIBFUZZER_ARGS="$target/corpus/$name -max_total_time=$seconds -max_len=4096 -rss_limit_mb=2048 \
-artifact_prefix=$target/crashes/$name/ -print_final_stats=1" \
        "$exe" "$name" --exact --nocapture --quiet --test-threads 1 2>&1 | grep -E "cov:|stat::|panicked|ERROR|SUMMARY|Failure|assert" | tail -12
    [ "${PIPESTATUS[0]}" -eq 0 ] || failed=1
done
exit $failed
