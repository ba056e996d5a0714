#!/usr/bin/env bash
# A first calibration and a follow-up by curl, as a cell PC would do it: bash, curl, and a running server.
#
#   kincal serve --no-auth          in one terminal
#   examples/curl.sh                in another
#
# KINCAL_SERVER (as for the command line; else KINCAL_URL) says where the server is, KINCAL_KEY holds the key if it wants one.
set -euo pipefail
cd "$(dirname "$0")/.."

url=${KINCAL_SERVER:-${KINCAL_URL:-http://127.0.0.1:8080}}
url=${url%/}
options=(--silent --show-error --fail-with-body)
if [ -n "${KINCAL_KEY:-}" ]; then options+=(--header "Authorization: Bearer $KINCAL_KEY"); fi

say() { printf '\n-- %s\n' "$*" >&2; }
get() { curl "${options[@]}" "$url$1"; }
post() { curl "${options[@]}" --header "Content-Type: $2" --data-binary "$3" "${@:4}" "$url$1"; }
# What creates carries a key of its own: if the answer is lost, the same request may be sent again without a second effect.
create() { post "$@" --header "Idempotency-Key: $RANDOM-$RANDOM-$RANDOM-$RANDOM"; }
# The first value of a field with this name; enough for the few that are needed here.
field() { grep -oE "\"$1\": ?\"[^\"]*\"" | head -n 1 | cut -d '"' -f 4; }

wait_until_over() {
    local job status
    while :; do
        job=$(get "/v1/jobs/$1?wait_s=30")
        status=$(field status <<<"$job")
        case "$status" in
            queued | running) grep -oE '"progress": ?\{[^}]*\}' <<<"$job" >&2 || true ;;
            succeeded) break ;;
            *) printf 'the job %s:\n%s\n' "$status" "$job" >&2; return 1 ;;
        esac
    done
    echo "$job"
}

calibrate() { # ROBOT_ID CSV METHOD
    local set_id job_id job
    say "upload $2"
    set_id=$(create "/v1/robots/$1/measurement-sets?frame=base&name=$(basename "$2" .csv)" text/csv "@$2" | field id)
    echo "measurement set $set_id" >&2

    say "identify from it with $3"
    job_id=$(create "/v1/robots/$1/jobs" application/json "{\"measurement_set_id\": \"$set_id\", \"method\": \"$3\"}" | field id)
    echo "job $job_id" >&2
    job=$(wait_until_over "$job_id")

    say "errors before and after, mm"
    get "/v1/jobs/$job_id/report" | grep -oE '"(identify|verify)": ?\{"[^{]*\{[^}]*\}[^}]*\{[^}]*\}' >&2 || true
    field parameter_set_id <<<"$job"
}

say "register the robot"
robot_id=$(create /v1/robots application/json @data/paper/robot.json | field id)
echo "robot $robot_id" >&2

first=$(calibrate "$robot_id" data/paper/first.csv pso)
say "the identified parameters"
get "/v1/parameter-sets/$first"
echo

# The network that the first job trained moves the second one's swarm before it starts.
second=$(calibrate "$robot_id" data/paper/followup_drifted.csv bpnn_pso)
say "where the target would be with all joints at 10 degrees"
post "/v1/parameter-sets/$second/predict" application/json '{"q_deg": [[10, 10, 10, 10, 10, 10]], "target": 0}'
echo
