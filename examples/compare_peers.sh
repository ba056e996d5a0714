#!/usr/bin/env bash
# Times the yardstick (examples/throughput.rs) and two peers in turn on one core, and prints the ratios with their spread.
#
#   examples/compare_peers.sh PEERS_DIR [ROUNDS]      PYTHON: an interpreter with numba and scipy (python3); CORE: the core to pin to (1)
#
# PEERS_DIR holds peer_numba.py and peer_scipy.py, which print lines of JSON. A round is one run of each; a ratio is of medians of one
# round, so that what disturbs the machine for longer than a round disturbs both.
set -euo pipefail
peers=$(realpath "${1:?usage: compare_peers.sh PEERS_DIR [ROUNDS]}")
rounds=${2:-5}
python=${PYTHON:-python3}
cd "$(dirname "$0")/.."
cargo build --quiet --release --example throughput
ours=${CARGO_TARGET_DIR:-target}/release/examples/throughput
pin() { if command -v taskset >/dev/null; then taskset -c "${CORE:-1}" "$@"; else "$@"; fi; }
for _ in $(seq "$rounds"); do
  pin "$ours" data/paper/robot.json data/paper/first.csv | sed 's/^/OURS /'
  for peer in numba scipy; do pin "$python" "$peers/peer_$peer.py"; done
done | "$python" -c '
import json, statistics, sys

rounds = []
for line in sys.stdin:
    kind, _, text = line.partition(" ")
    if kind == "OURS":
        rounds.append({"ours": json.loads(text), "peers": {}})
    elif kind == "JSON":
        peer = json.loads(text)
        rounds[-1]["peers"][peer["peer"]] = peer

def fit_us(peer):
    # the looser tolerances where they reach the minimum, too
    return 1e6 * (peer["seconds"] if peer["final"] < 1e-15 else peer["tight_seconds"])

def line(name, pairs):
    ratios = sorted(theirs / ours for theirs, ours in pairs)
    middle = [statistics.median(column) for column in zip(*pairs)]
    print(f"{name}: {middle[0]:.1f} us to {middle[1]:.1f} us; ratio {statistics.median(ratios):.1f}, of {len(ratios)} rounds {ratios[0]:.1f} to {ratios[-1]:.1f}")

swarm = [(min(p["us_iter"] for name, p in r["peers"].items() if name.startswith("numba PSO")), r["ours"]["us_per_iteration"]) for r in rounds]
fit = [(fit_us(r["peers"]["scipy trf, analytic J"]), r["ours"]["us_least_squares"]) for r in rounds]
line("swarm iteration, the best numba PSO to ours", swarm)
line("least squares, scipy trf to ours", fit)
'
