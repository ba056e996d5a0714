#!/usr/bin/env bash
# Plants one fault at a time in a copy of the tree and runs the test that has to catch it. First the same tests run without a fault, and have to
# pass. A fault that no test catches fails this script.
# By hand, not in CI: each fault is a build. `tests/planted_faults.sh [part of a name]`; KINCAL_PLANT_DIR keeps the copy and its target directory.
set -euo pipefail
cd "$(dirname "$0")/.."

# name | file | sed expression | test binary | filter of the tests that must fail
faults() {
    grep -vE '^\s*(#|$)' <<'TABLE'
acknowledged before the commit        | src/store/writer.rs         | s/match verdict.await \{/match Ok::<_, oneshot::error::RecvError>(Ok::<(), Arc<sqlx::Error>>(drop(verdict))) {/ | store | nobody_is_answered
a group that nobody ends              | src/store/writer.rs         | s/writer\.end\(\&mut \*turn\.await\)\.await/drop(turn.await)/ | store | who_gives_up_waiting
SQLite's connections sync less        | src/store/sqlite.rs         | s/handle\.execute_batch\(settings\)/handle.execute_batch(\&settings.replace("full", "normal"))/ | faults | power
a rollback takes the writer before    | src/store/writer.rs         | s/step_over_what_is_kept\(&mut state\)\?;// | store | takes_neither
computed before the claim is certain  | src/jobs/worker.rs          | s/tx\.commit\(\)\.await\?;/drop(tx.commit().await);/ | jobs | nothing_is_computed
a broken beam decides a release       | src/calibration/judged.rs   | s/let n_set_aside = if points/let n_set_aside = if points.is_empty() \&\& points/ | follow_ups | one_wild_point
a failed writer keeps its writes      | src/store/writer.rs         | s/const UNDO: \&\[\&str\] = \&\["rollback to member"\]/const UNDO: \&[\&str] = \&["select 1"]/ | store | takes_no_other
no UNIQUE on the job's parameter set  | migrations/sqlite/0001_initial.sql | /create table parameter_set/,/\);/ s/job_id              text   not null unique/job_id              text   not null/ | store | a_job_has_at_most_one
no UNIQUE on the released set         | migrations/sqlite/0001_initial.sql | s/create unique index parameter_set_one_released/create index parameter_set_one_released/ | store | the_schema_itself_refuses_a_second
a release in spite of a failed gate   | migrations/sqlite/0002_trust.sql | s/or new.release_checks_json like '%"passed":false%'// | store | in_spite_of_a_failed_gate
a withdrawn set comes back            | migrations/sqlite/0002_trust.sql | s/old.status = 'withdrawn' and new.status <> 'withdrawn'/1 = 0/ | store | keeps_the_life
a policy that only code keeps         | migrations/sqlite/0004_release.sql | s/p.independent_session_required = 1 and/p.independent_session_required = 2 and/ | store | keeps_the_robots_policy
the chain forgets the hash before     | src/store/audit.rs          | s/json!\(\[before, seq/json!(["", seq/ | store | an_entry_forged
the chain leaves out who did it       | src/store/audit.rs          | s/seq, at_ms, actor, event, subject, detail_json\]\)/seq, at_ms, "", event, subject, detail_json])/ | store | an_edit_a_deletion
the key is claimed outside its effect | src/store/idempotency.rs    | s/    on conflict do nothing"/    on conflict (key_holder, method, path, idempotency_key) do update set status = null"/ | store | idempotency::
synchronous = NORMAL                  | src/store/open.rs           | s/pragma synchronous = full/pragma synchronous = normal/ | store | durable_settings
bytes are not compared                | src/store/verify/content.rs | s/kept.is_empty\(\) \|\| kept == now/true || kept == now/; s/require\(then == now/require(true || then == now/ | store | each_fault_is_told
documents are not compared            | src/store/verify/content.rs | s/\(REPORTS, "job_succeeded", "report_sha256"\)/(REPORTS, "job_succeeded", "no_such_field")/ | store | each_fault_is_told
fields of rows are not compared       | src/store/verify/rules.rs   | s/Some\(then\) => then == now,/Some(_) => true,/ | store | each_fault_is_told
who did it is not compared            | src/store/verify/rules.rs   | s/ \|\| \*now == \*then.actor,/ || true,/ | store | databases_from_before
a report that may be edited           | migrations/sqlite/0007_documents_last.sql | s/^when old.status in \([^)]*\)$/when 1 = 0/ | store | keeps_results_and_frames
no fencing token                      | src/store/leases.rs         | s/ where id = \$1 and owner = \$2 and attempt = \$3 and status = 'running'/ where id = $1 and $2 = $2 and $3 = $3 and status = 'running'/ | jobs | queue::
attempts without end                  | src/store/leases.rs         | s/"\(attempt >= \$1 or deaths >= \$3\)"/"($1 < 0 or $3 < 0)"/ | jobs | is_tried_as_often
a job without end                     | src/jobs/worker.rs          | s/tokio::time::sleep\(longest\)/tokio::time::sleep(longest.max(Duration::from_secs(3600)))/ | jobs | without_an_end
cancelled: over with its thread only  | src/jobs/worker.rs          | s/sleep\(CANCELLED_WITHIN\)/sleep(CANCELLED_WITHIN * 1000)/ | jobs | a_cancelled_job_is_over_soon
cancelled: two threads of one worker  | src/jobs/worker.rs          | s/wait_for\(context, &job_id, deaf\)\.await;/drop(deaf);/ | jobs | a_cancelled_job_is_over_soon
cancelled: a worker waits for ever    | src/jobs/worker.rs          | s/tokio::time::sleep\(left\)/tokio::time::sleep(left * 1000)/ | jobs | a_cancelled_computation_without
a cancellation that comes too late    | src/store/leases.rs         | s/status = case when cancel_requested_at_ms is null then 'succeeded' else 'cancelled' end/status = 'succeeded'/ | jobs | a_waiting_job_is_cancelled
calibrate takes any file              | src/cli/calibrate.rs        | s/look\(&robot, &set, &arguments\.set\)\?;// | service | calibrate_refuses
jitter makes equations                | src/calibration/check.rs    | s/configurations\.first_row_like\(&o\.q_rad, row\)/configurations.first_row_like(\&[row as f64], row)/ | identification | poses_repeated
targets that no pose has looked at    | src/calibration/check.rs    | s/\.max\(n_targets\);/;/ | identification | with_nothing_to_identify
a gate that fails open                | src/wire/release.rs         | s/s.after_rms_mm.partial_cmp\(&s.before_rms_mm\) != Some\(std::cmp::Ordering::Less\)/s.after_rms_mm.is_infinite()/; s/facts.no_better_than_nominal.is_some\(\)/facts.policy.tolerance_mm == Some(-1.0)/ | api | no_better_than_nominal
only the newest sessions are asked     | src/store/sessions.rs       | s/order by created_at_ms desc, id desc limit 1"/order by created_at_ms desc, id desc limit 0"/ | api | no_better_than_nominal
the same points count as a session    | src/jobs/execution.rs       | s/n_shared_points\(identified_from, points\) as f64/0.0/ | api | the_same_points_uploaded_again
no look at the active set             | src/wire/release.rs         | s/passed \&= \*own <= active \+ SAME_MM/passed \&= *own <= active + 1000.0/ | api | worse_than_the_active_one
no scope check                        | src/http/auth.rs            | s/if caller.has\(\*scope\) => Ok/if caller.has(*scope) || true => Ok/ | api | each_route_takes_its_scope
other robots' things are seen         | src/http/access.rs          | s/if caller.may_see\(robot_id\) \{ Ok/if true || caller.may_see(robot_id) { Ok/ | api | every_role_on_every_route
what is refused unread is not heard   | src/http/lingering.rs       | s/Poll::Pending => return silence.as_mut\(\).poll\(context\).map\(Ok\)/Poll::Pending => return Poll::Ready(Ok(()))/ | load | still_hears
no last call of who is connected      | src/http/accept.rs          | s/Duration = Duration::from_millis\(100\)/Duration = Duration::from_millis(0)/ | api | who_was_connected
no last call before the end           | src/http/accept.rs          | s/Duration = Duration::from_millis\(100\)/Duration = Duration::from_millis(0)/; s/in 0\.\.MAX_LAST/in 0..0/ | api | who_is_connected
a key is logged                       | src/http/auth.rs            | s/let key = value.to_str\(\).ok\(\).and_then/tracing::debug!(?value, "a key"); let key = value.to_str().ok().and_then/ | api | no_key_and_no_body
no finite check                       | src/measurement/csv.rs      | s/if !value.is_finite\(\)/if value.is_nan() \&\& false/ | bad_input | every_bad_file
a lower bound without what is not linear | src/kinematics/batch/lower_bound.rs | s/\+ \(error\[part\] \+ rounding\)/+ rounding/ | kinematics | never_above_the_cost
a lower bound without its rounding    | src/kinematics/batch/lower_bound.rs | s/\+ \(error\[part\] \+ rounding\)/+ error[part]/ | kinematics | never_above_the_cost
no alignment check                    | src/calibration/alignment/mod.rs | s/pub const FITS_MM: f64 = 20.0/pub const FITS_MM: f64 = 1e12/ | bad_input | wrong_as_a_whole
releases what was uploaded alone      | src/wire/release.rs         | s/other \|\| !facts.policy.second_person_required/other || facts.policy.second_person_required/ | dangerous_uploads | no_dangerous_upload
TABLE
}

if [ -n "${KINCAL_PLANT_DIR:-}" ]; then copy=$KINCAL_PLANT_DIR; else copy=$(mktemp -d); trap 'rm -rf "$copy"' EXIT; fi
mkdir -p "$copy/tree"
# The copy keeps its times, so that a second run builds only what changed; what an interrupted run left planted is not among it.
git ls-files -z | rsync --archive --checksum --delete-missing-args --from0 --files-from=- ./ "$copy/tree/"
export CARGO_TARGET_DIR=$copy/target RUST_BACKTRACE=0
# Without optimisation of this crate a build takes a third of the time; the crates below it stay as they are.
cargo=(cargo --config 'profile.dev.package.kincal.opt-level=0')
trim() { sed -E 's/^\s+|\s+$//g' <<<"$1"; }
build() { (cd "$copy/tree" && timeout 3600 "${cargo[@]}" test --locked --test "$1" --no-run) >"$copy/log" 2>&1; }
run() { (cd "$copy/tree" && timeout 600 "${cargo[@]}" test --locked --test "$1" -- "${@:2}") >"$copy/log" 2>&1; }
failed() { grep -E '^test .* \.\.\. FAILED' "$copy/log" | sed -E 's/^test (.*) \.\.\. FAILED/\1/' | paste -sd' '; }

names=() files=() expressions=() binaries=() filters=()
while IFS= read -r line; do
    # A pipe inside a sed expression is written as || or with a backslash; the columns are separated by " | ".
    IFS=$'\x1f' read -r name file expression binary filter <<<"${line// | /$'\x1f'}"
    name=$(trim "$name")
    case "$name" in *"${1:-}"*) ;; *) continue ;; esac
    names+=("$name") files+=("$(trim "$file")") expressions+=("$(trim "$expression")") binaries+=("$(trim "$binary")") filters+=("$(trim "$filter")")
done < <(faults)

# In a copy that is used again the last build had a fault in it.
(cd "$copy/tree" && touch "${files[@]}")
caught=0 missed=0 controlled=""
miss() { printf '%-12s %-40s %s\n' "$1" "$2" "$3"; missed=$((missed + 1)); }
for i in "${!names[@]}"; do
    name=${names[$i]} file=${files[$i]} binary=${binaries[$i]} filter=${filters[$i]}
    if [ "$controlled" != "$binary" ]; then
        controlled=$binary mine=()
        for j in "${!names[@]}"; do [ "${binaries[$j]}" = "$binary" ] && mine+=("${filters[$j]}"); done
        if ! build "$binary" || ! run "$binary" "${mine[@]}"; then
            echo "without a fault, $binary fails: $(failed)"; tail -20 "$copy/log"
            exit 1
        fi
    fi
    cp "$copy/tree/$file" "$copy/original"
    sed -E -i "${expressions[$i]}" "$copy/tree/$file"
    if cmp --silent "$copy/original" "$copy/tree/$file"; then
        miss "NOT PLANTED" "$name" "the expression changes nothing in $file"
    elif ! build "$binary"; then
        miss "NO BUILD" "$name" "$(grep -E '^error' -A5 "$copy/log" | head -20)"
    elif run "$binary" "$filter"; then
        miss "MISSED" "$name" "$binary $filter passed"
    else
        printf '%-12s %-40s by %s\n' caught "$name" "$binary: $(failed)"
        caught=$((caught + 1))
    fi
    # A new time, so that the build sees that the fault is gone.
    cp "$copy/original" "$copy/tree/$file"
done
printf '%d caught, %d not\n' "$caught" "$missed"
[ "$missed" = 0 ]
