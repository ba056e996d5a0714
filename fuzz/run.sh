#!/usr/bin/env bash
# fuzz/run.sh TARGET SECONDS [options of libFuzzer]
# Runs a target with the stable toolchain: coverage without a sanitizer, which would need a nightly one. The code has no `unsafe` of its own.
# With cargo-fuzz and a nightly toolchain, `cargo +nightly fuzz run TARGET` does the same with AddressSanitizer.
set -euo pipefail
cd "$(dirname "$0")"
target=$1 seconds=$2
shift 2
host=$(rustc -vV | sed -n 's/^host: //p')
export RUSTFLAGS="--cfg fuzzing -Cpasses=sancov-module -Cllvm-args=-sanitizer-coverage-level=4 -Cllvm-args=-sanitizer-coverage-inline-8bit-counters \
-Cllvm-args=-sanitizer-coverage-pc-table -Cllvm-args=-sanitizer-coverage-trace-compares"
# With a target of its own, build scripts and macros are left alone.
cargo build --release --locked --target "$host" --bin "$target"
mkdir -p "corpus/$target" "artifacts/$target"
exec "${CARGO_TARGET_DIR:-target}/$host/release/$target" "corpus/$target" "seeds/$target" -max_total_time="$seconds" -timeout=10 -rss_limit_mb=1024 -max_len=65536 \
    -artifact_prefix="artifacts/$target/" -print_final_stats=1 "$@"
