#!/usr/bin/env bash
# Fuzzes a running server by its own contract: no 5xx, and no answer that openapi.yaml does not document.
# Bounded by examples and time. Schemathesis goes into a venv under target/, nothing else is touched.
#   KINCAL_BIN          the binary to run (default: the release build, else a debug build made now)
#   SCHEMATHESIS_S      seconds of fuzzing (default 60)
set -euo pipefail
cd "$(dirname "$0")/.."

version=4.32.5
venv=target/schemathesis-venv
if ! "$venv/bin/schemathesis" --version 2>/dev/null | grep -qF "$version"; then
    python3 -m venv "$venv"
    "$venv/bin/pip" install --quiet --disable-pip-version-check "schemathesis==$version"
fi

binary=${KINCAL_BIN:-target/release/kincal}
if [ ! -x "$binary" ]; then
    cargo build --locked
    binary=target/debug/kincal
fi

work=$(mktemp -d)
"$binary" serve --listen 127.0.0.1:0 --data-dir "$work/data" --workers 1 --no-auth >"$work/out" 2>"$work/log" &
server=$!
trap 'kill "$server" 2>/dev/null; wait "$server" 2>/dev/null || true; rm -rf "$work"' EXIT
for _ in $(seq 100); do
    grep -q listening "$work/out" && break
    kill -0 "$server" || { cat "$work/log"; exit 1; }
    sleep 0.1
done
url=$(sed -n 's/^kincal listening on //p' "$work/out")

# Something real to ask for: a robot with a set, frames, a finished job, its network and a released parameter set.
post() { curl -sSf -X POST "$url$1" -H "Content-Type: $2" --data-binary "$3"; }
field() { python3 -c 'import json, sys; print(json.load(sys.stdin)[sys.argv[1]])' "$1"; }
robot=$(post /v1/robots application/json @data/paper/robot.json | field id)
set=$(post "/v1/robots/$robot/measurement-sets?frame=base" text/csv @data/paper/first.csv | field id)
frames=$(post "/v1/robots/$robot/frames" text/csv @data/paper/sweeps_instrument.csv | field id)
job=$(post "/v1/robots/$robot/jobs" application/json "{\"measurement_set_id\": \"$set\", \"method\": \"pso\"}" | field id)
done_job() { curl -sSf "$url/v1/jobs/$job?wait_s=30"; }
for _ in $(seq 10); do
    done_job | grep -qE '"status": ?"(succeeded|failed|cancelled)"' && break
done
done_job | grep -q '"status": \?"succeeded"' || { echo "the first job did not succeed:"; done_job; exit 1; }
parameter_set=$(done_job | field parameter_set_id)
network=$(done_job | field network_id)
post "/v1/parameter-sets/$parameter_set/release" application/json '{"reason": "for the fuzzer"}' >/dev/null

config="$work/schemathesis.toml"
id_of() { printf '[[operations]]\ninclude-path-regex = "^/v1/%s/"\nparameters = { "path.id" = "%s"%s }\n' "$1" "$2" "${3:-}" >>"$config"; }
printf 'max-stream-events = 5\n[parameters]\n"path.robot_id" = "%s"\n' "$robot" >"$config"
id_of jobs "$job"
id_of measurement-sets "$set"
id_of frames "$frames"
id_of networks "$network"
# Not withdraw: the set should stay released.
id_of parameter-sets "$parameter_set"

# A fixed seed and no example database make a run repeatable.
fuzz() {
    HYPOTHESIS_STORAGE_DIRECTORY="$work/hypothesis" "$venv/bin/schemathesis" "${@:2}" run openapi.yaml --url "$url" \
        --max-examples 25 --max-time $((${SCHEMATHESIS_S:-60} / 2)) --seed 1 --request-timeout 40 --no-color --continue-on-failure \
        --warnings off --phases "$1" \
        --checks not_a_server_error,status_code_conformance,content_type_conformance,response_headers_conformance,response_schema_conformance,unsupported_method
}
status=0
echo "== with ids that exist"
fuzz coverage,fuzzing --config-file "$config" || status=$?
echo "== with ids of its own making, and chains of requests"
fuzz coverage,fuzzing,stateful || status=$?
if grep -qE '"level":"ERROR"|panicked' "$work/log"; then
    echo "the server logged errors:"
    grep -E '"level":"ERROR"|panicked' "$work/log" | head
    status=1
fi
exit "$status"
