#!/usr/bin/env python3
"""Plants faults in a copy of the tree and runs the tests that have to catch them.

    tests/planted_faults.py --check             every fault finds its place in the tree as it is: a second, part of .ci/run
    tests/planted_faults.py                     all faults, half an hour on two cores: this runs by night
    tests/planted_faults.py fence "no scope"    those whose name contains one of these texts

A build takes minutes, so all faults are built at once. In the copy, a function with a fault has both bodies, and the variable KINCAL_PLANTED says
which one runs. First the tests run without a fault and have to pass. Then each fault is switched on alone, and its tests have to fail: a fault
that no test catches fails this script. The few faults that cannot be switched, such as those in a macro, take a build each. KINCAL_PLANT_DIR keeps
the copy and its target directory for the next run; a copy of target/ there saves building the dependencies.

A fault is a text to find and a text to put in its place. It is looked for in the sources of both packages (or in the folder that the fault names), and has to be
found exactly once. Spaces, line breaks and trailing commas do not count, so it survives rustfmt and moves between files.
"""

import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
LONGEST_BUILD_S = 3600
LONGEST_RUN_S = 900


@dataclass
class Fault:
    name: str
    # the test binary, and the filter of the tests that must fail
    test: str
    filter: str
    # (find, replace), all of them planted together
    edits: list
    folder: str = ""


FAULTS = [
    # Noise that differs from direction to direction
    Fault("noise by direction counts by its root mean square", "core", "gains_what_weighted_least_squares_of_scipy_gains", [
        ("request.preset == Preset::Default && is_least_squares && set.has_uneven_noise()", "false && is_least_squares && set.has_uneven_noise()")],
        "core/src/calibration"),
    Fault("a stated noise is all there is", "core", "a_noise_that_is_stated_far_too_small_costs_nothing", [
        (".map(|noise| noise.whitening(beside_mm) * to_measuring.rotation.matrix());", ".map(|noise| noise.whitening(0.0 * beside_mm) * to_measuring.rotation.matrix());")],
        "core/src/calibration"),
    Fault("a beam does not turn with its station", "core", "the_noise_of_every_station_is_that_of_its_own_beam", [
        ("o.whitening = uneven.map(|w| w * motion.rotation.matrix().transpose());", "o.whitening = uneven.map(|w| w * 1.0);"),
        ("whitening.map(|w| w * motion_of(row).rotation.matrix().transpose());", "whitening.map(|w| w * 1.0);")], "core/src/calibration"),
    Fault("a stored set forgets its instrument", "service", "stated_beside_a_file_or_in_a_body_and_shown_and_used", [
        ("reading.instrument = Some(stated.instrument);", "reading.instrument = Some(stated.instrument).filter(|_| false);")], "src/wire"),
    Fault("a tracker stands at the robot's base", "service", "bad_noise_is_refused_with_its_place_and_a_hint", [
        ("if frame == Frame::Base {\n            let named", "if false && frame == Frame::Base {\n            let named")], "src/wire"),
    # Tables
    Fault("a number with two readings is taken", "core", "one_number_with_two_readings", [
        ("if is_grouped && thousands.parse()", "if false && is_grouped && thousands.parse()")], "core/src/measurement"),
    Fault("another table's target is a reflector", "core", "a_column_with_another_value_in_each_row", [
        ("if !is_only_label(means) && (is_own || is_exact(means)) => {", "if true || !is_only_label(means) && (is_own || is_exact(means)) => {")],
        "core/src/measurement"),
    Fault("a quote swallows rows", "core", "a_quote_that_closes_nothing", [
        ("true if parts.iter().all(|n| *n < PARTS_OF_A_ROW) => {", "true if true || parts.iter().all(|n| *n < PARTS_OF_A_ROW) => {")], "core/src/measurement"),
    Fault("a mean without a name is a measurement", "core", "rows_of_statistics_are_no", [
        ("(is_told && n_spread >= 3 && n_of_position >= 2)", "(is_told && n_spread >= 300 && n_of_position >= 2)")], "core/src/measurement"),
    Fault("a target that was mounted anew is shared", "core", "a_target_of_one_name_that_was_mounted_anew", [
        ("shared_targets_agree(request, &estimates, alarm)?;", "shared_targets_agree(request, &estimates, 0.0 * alarm)?;")], "core/src/calibration"),
    Fault("a base that moved is shared", "core", "sessions_in_the_base_frame_are_refused_if_the_base_moved", [
        ("bases_agree(request, &estimates, alarm)?;", "")], "core/src/calibration"),
    Fault("a base points into the floor", "core", "the_base_of_a_description_is_upright", [
        ("axes[0].direction.z < ROUNDING - 1.0", "axes[0].direction.z < ROUNDING - 2.0")], "core/src/exchange"),
    Fault("clocks with two differences are taken", "core", "what_cannot_be_joined_says", [
        ("if !ties.are_contradictory {", "if true || !ties.are_contradictory {")], "core/src/measurement"),
    Fault("groups of an instrument are pooled", "core", "nominal_and_measured_positions_are_never_pooled", [
        (".filter(|(_, groups)| groups.len() > 1)", ".filter(|(_, groups)| groups.len() > 100)")], "core/src/measurement"),
    Fault("slow ends of a motion are standstills", "core", "of_two_logs_only_rows_are_paired_in_which_both_stand", [
        ("const MAX_DRIFT: f64 = 0.25;", "const MAX_DRIFT: f64 = 25.0;"), ("const CLEAR_MOTION: f64 = 5.0;", "const CLEAR_MOTION: f64 = 0.0;")],
        "core/src/measurement"),
    Fault("an external axis that moves is not told", "core", "external_axes_that_move_are_refused", [
        ("const STANDSTILL: f64 = 0.05;\n\n/// Whether a column", "const STANDSTILL: f64 = 1e12;\n\n/// Whether a column")], "core/src/measurement"),
    Fault("the verdict forgets the uncertainty", "browser", "a_withdrawn_set_says_so_at_the_top", [
        ("Within::InGuardBand => (\n            \"NOT WITHIN\",", "Within::InGuardBand => (\n            \"WITHIN\",")], "src/report_page"),
    # Rotations, noise and scale
    Fault("rotations may turn the base, too", "service", "rotations_that_do_not_belong_to_the_positions", [
        ("(found.rms_mm <= NEAR_FIT_PER_REACH * reach_mm && is_known)", "(found.rms_mm < 0.0 * COMES_NEAR * reach_mm && is_known)")], "core/src/calibration"),
    Fault("a turned pose is like the others", "service", "turned_poses_are_named", [
        ("(*angle_rad > limit_rad).then_some(TurnedPose {", "(*angle_rad > 4.0 + limit_rad).then_some(TurnedPose {")], "core/src/calibration"),
    Fault("any rotation fits", "service", "a_set_whose_rotations_do_not_fit", [
        ("let by_rotation = || missed(&|point| Some(point.rotation_rad?[1]), no_fit_rad);", "let by_rotation = || missed(&|point| Some(0.0 * point.rotation_rad?[1]), no_fit_rad);")], "core/src/calibration"),
    Fault("any stated noise is right", "core", "a_stated_noise_far_above", [
        ("let is_overstated = self.ratio * MIN_TIMES_SCATTER * MIN_TIMES_SCATTER < redundant as f64;", "let is_overstated = self.ratio * MIN_TIMES_SCATTER * MIN_TIMES_SCATTER < 0.0 * redundant as f64;")], "core/src/calibration"),
    Fault("an instrument that is off is released", "service", "a_reference_states_the_scale", [
        ("let passes = reference.at_reach_std_mm <= MAX_SCALE_PER_ERROR * found_mm;", "let passes = reference.at_reach_std_mm >= 0.0 * found_mm;")], "src/release"),
    Fault("a work frame of any station", "service", "a_work_frame_is_measured_from_the_station", [
        ("if stated == Some(*of_parameters) || stated.is_none() && all.len() == 1 {", "if stated == Some(*of_parameters) || true {")], "src/operations"),
    Fault("withdrawn sets are exported", "service", "a_withdrawn_set_does_not_return_with_other_options", [
        ("if row.status == ParameterSetStatus::Withdrawn {\n        let reason = row.withdraw_reason.as_deref().unwrap_or_default();\n        let detail = format!(\n            \"the parameter set was withdrawn ({reason}), and", "if row.status == ParameterSetStatus::Withdrawn && false {\n        let reason = row.withdraw_reason.as_deref().unwrap_or_default();\n        let detail = format!(\n            \"the parameter set was withdrawn ({reason}), and")], "src/http"),
    Fault("a plan runs into the fixture", "core", "the_arm_keeps_out_of_boxes", [
        ("!self.keep_out_mm.iter().any(|b| meets(&from, p, b))", "!self.keep_out_mm.iter().any(|b| meets(p, p, b))")], "core/src/planning"),
    # What a partial recalibration holds
    Fault("the upload of a held set is another session", "service", "the_upload_of_a_held_set_is_no_other_session", [
        ("parse_uploads(input.sets.iter().chain(&input.sources), request)?", "parse_uploads(&input.sets, request)?")], "src/jobs"),
    Fault("who uploaded what is held is a second person", "service", "who_uploaded_what_a_set_holds_is_no_second_person", [
        ("if upload.is_held {", "if upload.is_held && false {")], "src/jobs"),
    Fault("what is held was not insisted on", "service", "the_schema_itself_looks_at_the_uploads_that_a_set_rests_on", [
        ("m.insisted_on is not null or (s.is_held = 1 and", "(s.is_held = 1 and")], "migrations/sqlite"),
    # Sessions that show less than they seem to
    Fault("an instrument's frame shows the base", "service", "says_nothing_of_the_base_of_a_set_from_the_base_frame", [
        ("} else if request.scored_frame == Some(Frame::Base) {", "} else if false {"),
        ("identified_in == Frame::Base && session_in == Frame::Instrument", "false && identified_in != session_in")]),
    Fault("a verify set hides the base", "service", "says_nothing_of_the_base_of_a_set_from_the_base_frame", [
        ("(request.set.frame == Frame::Base && layout.is_placed_anew).then(|| Warning {", "(request.set.frame == Frame::Base && false).then(|| Warning {")],
        "core/src/calibration"),
    Fault("a constant on joint 1 is a new session", "core", "a_constant_on_the_first_or_the_last_joint", [
        ("(!is_none).then_some(offset)", "(!is_none).then_some(offset).filter(|_| false)")], "core/src/calibration"),
    Fault("nobody is told to measure other poses", "service", "told_to_be_other_poses_next_time", [
        ("session.verification.evidence == Evidence::SameUpload;", "session.verification.evidence == Evidence::SameUpload && false;")], "src/release"),
    Fault("close poses can serve to verify", "service", "what_an_upload_says_of_a_small_set", [
        ("nominal.as_ref().map(|model| (model, &points[..])),\n    ) {", "nominal.as_ref().map(|model| (model, &points[..])),\n    ).filter(|_| false) {")],
        "core/src/calibration"),
    Fault("one pose lies too close together", "service", "one_pose_that_was_read_thirty_times", [
        ("flange_spread_mm(&model.links, observations) > SAME_POSE * reach_mm {", "flange_spread_mm(&model.links, observations) >= 0.0 {")], "core/src/calibration"),
    Fault("an insisted file is advised a joint map", "service", "the_advice_is_that_of_its_refusal", [
        (".map(|told| advised(told, request.refused_as.as_deref()));", ".map(|told| advised(told, None));")], "core/src/calibration"),
    Fault("what fits nothing has not changed", "core", "of_points_that_fit_no_robot", [
        ("if request.previous.is_some() && !is_no_fit {", "if request.previous.is_some() && (!is_no_fit || true) {")], "core/src/calibration"),
    Fault("nine times worse is as good", "service", "a_session_several_times_worse", [
        ("(times >= REPORTED_ERROR_RATIO).then_some(times)", "(times >= 10.0 * REPORTED_ERROR_RATIO).then_some(times)")], "core/src/calibration"),
    Fault("a work frame of another set-up is used", "core", "a_work_frame_from_another_set_up_is_refused", [
        ("if is_measuring && !is_own && from.provenance", "if false && !is_own && from.provenance")], "src/operations"),
    Fault("a drawing in inches is kept", "service", "a_work_frame_whose_points_do_not_fit_is_refused", [
        ('fitting_work_frame(body, "/points")?;', "work_frame(body)?;")], "src/operations"),
    Fault("the wrist may flip", "core", "the_posture_is_the_nearest_one", [
        ("if nearest.status == Status::Ok", "if false && nearest.status == Status::Ok")], "core/src/compensation"),
    Fault("poses of a measured work frame are in the base frame", "core", "cartesian_targets_in_a_measured_work_frame", [
        ("t_base_answer: t_base_work,", "t_base_answer: if is_measuring { identity } else { t_base_work },")], "src/operations"),
    Fault("the work frame is exact", "core", "a_frame_from_points_is_as_uncertain", [
        ("noise_std_mm: shown_mm.max(std_mm),", "noise_std_mm: 0.5 * shown_mm.max(std_mm),")], "core/src/compensation"),
    Fault("the base is not in the tool's error", "core", "the_uncertainty_of_a_tool_is_that_of_predictions", [
        ("let anchor = anchor_in(base, &model, &nominal.links, has_tool);",
         "let _ = base; let anchor = anchor_in(Base::Robot, &model, &nominal.links, has_tool);")], "core/src/compensation"),
    Fault("no final fit, no question", "service", "a_narrow_cloud_is_refused_without_a_final_fit", [
        ("let is_open = facts.report.tool_uncertainty_absent_because.is_some();", "let is_open = false;")], "src/release"),
    Fault("one of two visits of a pose is a session", "core", "a_copy_of_one_of_several_visits", [
        ("of_earlier[index].extend(rows);", "let _ = (index, rows);")]),
    Fault("coarse numbers are a copy", "core", "sessions_with_coarse_numbers", [
        ("rounding_mm(self.set) <= STEPS_PER_COPIED * copied_mm", "true")]),
    Fault("sessions that differ say nothing", "service", "a_later_session_that_differs", [
        ("[SESSIONS_DIFFER, FIT_DIVERGED]", "[FIT_DIVERGED, FIT_DIVERGED]")]),
    Fault("text behind a port", "service", "hosts::", [
        ("if is_host_and_port(&authority)", "if !authority.as_str().contains('@')")]),
    Fault("a later session of another set does not count", "service", "only_after_it_was_scored_on_later_sessions", [
        ("let only_warns = facts.is_rollback && !session.has_changed;", "let only_warns = true;")], "src/release"),
    Fault("a rollback across a collision", "service", "a_rollback_to_a_set_from_before_a_collision", [
        ("let only_warns = facts.is_rollback && !session.has_changed;", "let only_warns = facts.is_rollback;")], "src/release"),
    Fault("no wrist turns two joints together", "core", "a_last_joint_that_turns_with_the_one_before", [
        ("for reading in COUPLED {", "for reading in COUPLED.into_iter().take(0) {")], "core/src/calibration"),
    # Several sessions as one job
    Fault("two robots are fitted together", "core", "two_robots_of_one_model_are_never_fitted_together", [
        ("if tested.probability < alarm {", "if false && tested.probability < alarm {")], "core/src/calibration"),
    Fault("only the first session is compared", "core", "a_joint_that_moved_between_the_sessions_is_named", [
        ("pooled(&estimates, alarm).map_err", "pooled(&estimates[..2], alarm).map_err")],
        "core/src/calibration"),
    Fault("corrections are judged within sessions", "core", "corrections_are_judged_on_sessions_that_were_not_fitted", [
        ("point.session = Some(name.clone());", "point.session = None;")], "core/src/measurement"),
    Fault("a posture is fitted in one session and scored in another", "core", "a_posture_of_both_sessions_never_stands_on_both_sides", [
        ("with_shared_configurations(MeasurementSet { frame,", "std::convert::identity(MeasurementSet { frame,")], "core/src/measurement"),
    Fault("all sessions are as noisy", "core", "a_coarse_session_does_not_spoil_a_fine_one", [
        ("session_noise_mm: pool.noise_mm.clone(),", "session_noise_mm: vec![],")], "core/src/calibration"),
    Fault("a session that was fitted is an independent one", "service", "no_session_that_was_fitted_counts_as_an_independent_one", [
        ("parse_uploads(input.sets.iter().chain(&input.sources), request)?", "parse_uploads(input.sets.iter().take(1).chain(&input.sources), request)?")], "src/jobs"),
    Fault("a further session is no later session", "service", "an_earlier_set_has_to_be_scored_on_each_session", [
        ("from own join verification v on v.robot_id = own.robot_id join job_upload u on u.job_id = v.job_id",
         "from own join verification v on v.robot_id = own.robot_id join (select id as job_id, measurement_set_id from job) u on u.job_id = v.job_id")],
        "src/store"),
    Fault("an old upload is new when it is identified again", "service", "an_old_upload_that_is_identified_again", [
        ("(v.uploaded > own.uploaded or (v.uploaded = own.uploaded and v.seq > own.seq))", "(v.seq > own.seq)")], "src/store"),
    Fault("a withdrawn set comes back by its upload", "service", "the_same_upload_identified_again", [
        ("has_same_values(own, other)", "false"), ("(is_of_same_points && is_same_tool())", "(false && is_same_tool())")], "src/release"),
    Fault("a reflector that was mounted again hides the noise", "core", "with_its_reflector_mounted_again", [
        ("pair.difference_mm -= Vector3::new(explained[0]", "pair.difference_mm -= 0.0 * Vector3::new(explained[0]")], "core/src/calibration"),
    Fault("a withdrawn set comes back with another loss", "service", "with_other_options", [
        ("(is_of_same_points && is_same_tool())", "(false && is_same_tool())")], "src/release"),
    Fault("a withdrawn set comes back by the sessions that it passed", "service", "with_other_options", [
        ("&& counts(session)", "")], "src/release"),
    Fault("old sessions verify what is uploaded late", "service", "an_old_file_that_is_uploaded_late", [
        ("changes.filter(|seq| self.own > *seq).max().unwrap_or(0)", "changes.filter(|_| false).max().unwrap_or(0)")], "src/release"),
    Fault("a reference is not in the budget", "service", "states_the_scale_of_the_instrument", [
        ("mean_mm: libm::hypot(tool.mean_mm, self.std_mm), max_mm: libm::hypot(tool.max_mm, self.std_mm)", "mean_mm: tool.mean_mm, max_mm: tool.max_mm")], "core/src/calibration"),
    Fault("an instrument that is off is right", "service", "states_the_scale_of_the_instrument", [
        ("self.error.abs() > COVERAGE * self.std", "self.error.abs() > 100.0 * COVERAGE * self.std")], "core/src/calibration"),
    Fault("a withdrawn set comes back with another seed", "service", "with_another_seed", [
        ("(a - b).abs() <= TOLERANCE", "a == b"), ("(is_of_same_points && is_same_tool())", "(false && is_same_tool())")]),
    Fault("a set is compared on its own points", "service", "on_points_that_neither_was_fitted_to", [
        ("if session.is_independent() && is_new", "if session.verification.evidence != crate::wire::report_shape::Evidence::None && is_new")], "src/release"),
    Fault("a set is compared on the active set's points", "service", "points_that_the_active_set_was_fitted_to", [
        ("if repeats(&parsed.request.robot, &parsed.active_points, &set) {", "if false && repeats(&parsed.request.robot, &parsed.active_points, &set) {")],
        "src/jobs"),
    Fault("what shows little condemns", "service", "a_session_that_shows_little_condemns_no_set", [
        ("find(|session| session.is_evidence && !session.verification.is_better)", "find(|session| !session.verification.is_better)"),
        ("told.code != NO_BETTER || shows_little.is_none()", "true")]),
    # The store
    Fault("no UNIQUE on the job's parameter set", "service", "a_job_has_at_most_one", [
        ("""create table parameter_set (
                id text not null primary key, robot_id text not null references robot (id), job_id text not null unique references job (id)""",
         """create table parameter_set (
                id text not null primary key, robot_id text not null references robot (id), job_id text not null references job (id)""")],
        "migrations/sqlite"),
    Fault("an outlier is in the delivered fit", "core", "rows_that_do_not_belong_and_segments", [
        ("for row in without_weight.chain(unfitted) {", "for row in without_weight.chain(unfitted).take(0) {")], "core/src/calibration"),
    Fault("outliers are searched once", "core", "gross_rows_swapped_labels_and_a_slip_cost_nothing", [
        ("const MAX_SEARCHES: usize = 4;", "const MAX_SEARCHES: usize = 1;")], "core/src/calibration"),
    Fault("a knocked tool is one target", "core", "reflectors_that_were_knocked_at_once", [
        ("2 => self.changes_of_targets::<6>(places, tried),", "2 => {}")], "core/src/identification"),
    Fault("a wrong base frame is believed", "core", "a_base_frame_that_was_set_up_wrongly", [
        ("(variable.width, variable.prior) = (width, Prior::OfKind(kind));",
         "let _ = kind; (variable.width, variable.prior) = (width, Prior::Stated { mean: 0.0, std: 1.0 });")], "core/src/identification"),
    Fault("the last joint's zero is known", "core", "the_zero_of_the_last_joint_counts", [
        ("libm::hypot(self.by_positions_rad, self.last_joint_zero_rad)", "self.by_positions_rad")], "core/src/calibration"),
    Fault("what was held has not changed", "core", "a_partial_recalibration_of_the_wrong_joint", [
        ("match (others_changed, of_held, report.uncertainty.clone()) {", "match (others_changed.filter(|_| false), of_held, report.uncertainty.clone()) {")],
        "core/src/calibration"),
    Fault("the active set has seen the points", "service", "calibrates_and_fetches_what_was_released", [
        ("own.any(|upload| repeats(", "own.any(|upload| false && repeats(")], "src/jobs"),
    Fault("the delivered fit is far from the verified", "service", "each_dangerous_upload_carries", [
        ("moved_mm <= MAX_MOVED_PER_ERROR * verified_mm + SAME_MM", "moved_mm >= 0.0")], "src/release"),
    Fault("no UNIQUE on the released set", "service", "the_schema_itself_refuses_a_second", [
        ("create unique index parameter_set_one_released", "create index parameter_set_one_released")], "migrations/sqlite"),
    Fault("a release in spite of a failed gate", "service", "in_spite_of_a_failed_gate", [
        ("or coalesce(new.release_n_failed, 1) <> 0", "")], "migrations/sqlite"),
    Fault("a change that a check found is explained by scoring it again", "service", "a_check_says_whether_the_released_set_holds", [
        ("where c.kind = 'check' and w.robot_id = $1", "where c.kind = 'none' and w.robot_id = $1")], "src/store"),
    Fault("old points say that a set holds", "service", "a_check_says_whether_the_released_set_holds", [
        ("is_measured_anew: another && !age.is_repeat,", "is_measured_anew: true,")], "src/jobs"),
    Fault("labels are configurations", "core", "fewer_than_five_configurations_are_refused", [
        ("let other = *number_at.entry(first).or_insert(number);", "let other = *number_at.entry(row).or_insert(number);")], "core/src/measurement"),
    Fault("a zero that is not seen holds", "core", "a_zero_that_these_poses_alone_do_not_show", [
        ("found.change.is_none() && limit_mm", "false && found.change.is_none() && limit_mm")], "core/src/calibration"),
    Fault("the newest document by the clock", "service", "mappings_of_columns_keep_their_order", [
        ("and kind = $2 and name = $3 order by version desc limit 1", "and kind = $2 and name = $3 order by id desc limit 1")], "src/store"),
    Fault("a rollback by the clock", "service", "follows_what_a_release_superseded", [
        ("""order by case when id = (select a.supersedes_id from parameter_set a where a.robot_id = $1 and a.status = 'released') then 0 else 1 end,
            release_seq desc""", "order by released_at_ms desc")], "src/store"),
    Fault("a set of before a collision is released", "service", "keeps_what_speaks_against", [
        ("or (r.check_seq > r.checked_seq and not exists", "or (1 = 0 and not exists")], "migrations/sqlite/0022_age_and_references.sql"),
    Fault("a set that is far off is released", "service", "keeps_what_speaks_against", [
        ("v.fit = 'set_far_off' and v.seq > r.checked_seq", "v.fit = 'set_far_off' and v.seq > r.checked_seq + 1000")], "migrations/sqlite/0022_age_and_references.sql"),
    Fault("old points count as measured since", "service", "keeps_what_speaks_against", [
        ("is_repeat: found.is_repeat || found.misfit_seq != misfit_seq", "is_repeat: found.is_repeat || found.misfit_seq != found.misfit_seq")], "src/release"),
    Fault("facts are not in the chain", "service", "each_fault_is_told", [
        ("tx.audit(AuditEvent::VerificationKept, job_id, row.audit_entry());", "")], "src/store"),
    Fault("a withdrawn set comes back", "service", "keeps_the_life", [
        ("old.status = 'withdrawn' and new.status <> 'withdrawn'", "1 = 0")], "migrations/sqlite"),
    Fault("a policy that only code keeps", "service", "keeps_the_robots_policy", [
        ("p.independent_session_required = 1 and", "p.independent_session_required = 2 and")], "migrations/sqlite/0010_far_off.sql"),
    Fault("a report that may be edited", "service", "keeps_results_and_frames", [
        ("""update of report_json, convergence_json, result_sha256 on job
            when old.status in ('succeeded', 'failed', 'cancelled')""",
         """update of report_json, convergence_json, result_sha256 on job
            when 1 = 0""")], "migrations/sqlite/0007_documents_last.sql"),
    Fault("the chain forgets the hash before", "service", "an_entry_forged", [
        ("json!([before, seq, at_ms,", 'json!(["", seq, at_ms,')]),
    Fault("the chain leaves out who did it", "service", "an_edit_a_deletion", [
        ("seq, at_ms, actor, event, subject, detail_json]).to_string()", 'seq, at_ms, "", event, subject, detail_json]).to_string()')]),
    Fault("the key is claimed outside its effect", "service", "idempotency::", [
        ("""(select now_ms from clock)) on conflict do nothing";""",
         """(select now_ms from clock))
            on conflict (key_holder, method, path, idempotency_key) do update set status = null";""")]),
    Fault("synchronous = NORMAL", "service", "durable_settings", [
        ("pragma synchronous = full", "pragma synchronous = normal")]),
    Fault("bytes are not compared", "service", "each_fault_is_told", [
        ("kept.is_empty() || kept == now", "true || kept == now"),
        ("require(then == now,", "require(true || then == now,")]),
    Fault("documents are not compared", "service", "each_fault_is_told", [
        ('(REPORTS, AuditEvent::JobSucceeded, "report_sha256")', '(REPORTS, AuditEvent::JobSucceeded, "no_such_field")')]),
    Fault("summaries are not compared", "service", "each_fault_is_told", [
        ("(Ok(expected), Ok(found)) if expected == found)", "(Ok(_), Ok(_)))")]),
    Fault("fields of rows are not compared", "service", "each_fault_is_told", [
        ("Some(then) => then == now,", "Some(_) => true,")]),
    Fault("who did it is not compared", "service", "databases_from_before", [
        ("|| *now == *then.actor }", "|| true }")]),
    # Jobs and nodes
    Fault("computed before the claim is certain", "service", "nothing_is_computed", [
        ("tx.commit().await?; tracing::info!(", "drop(tx.commit().await); tracing::info!(")]),
    Fault("no fencing token", "service", "queue::", [
        ("where id = $1 and owner = $2 and attempt = $3 and status = 'running'",
         "where id = $1 and $2 = $2 and $3 = $3 and status = 'running'")]),
    Fault("attempts without end", "service", "is_tried_as_often", [
        ('concat!(counted_attempts!(), " >= $1")', 'concat!(counted_attempts!(), " >= $1 + 1000")'),
        ('concat!(counted_attempts!(), " < $1 and', 'concat!(counted_attempts!(), " < $1 + 1000 and')]),
    Fault("deaths without end", "service", "not_for_ever", [
        ('died_now!(), " > $1"', 'died_now!(), " > $1 + 1000"'), ('died_now!(), " <= $2"', 'died_now!(), " <= $2 + 1000"')]),
    Fault("a death counts as an attempt", "service", "uses_up_no_attempt", [
        ('"(attempt - deaths - "', '"(attempt - 0 * "')]),
    Fault("a suspect beside others", "faults", "run_alone_one_after_the_other", [
        ("Arc::clone(&self.jobs).write_owned().await", "RwLock::default().pipe_write().await"),
        ("impl RunAlone {", """trait PipeWrite { async fn pipe_write(self) -> OwnedRwLockWriteGuard<()>; }
            impl PipeWrite for RwLock<()> { async fn pipe_write(self) -> OwnedRwLockWriteGuard<()> { Arc::new(self).write_owned().await } }
            impl RunAlone {""")]),
    Fault("suspects starve", "faults", "has_its_turn", [
        ("since.elapsed() >= self.suspect_wait", "since.elapsed() >= self.suspect_wait * 10_000")]),
    Fault("a frozen node keeps its lock", "faults", "a_frozen_node", [
        ("set idle_in_transaction_session_timeout = '5s'", "set idle_in_transaction_session_timeout = 0")]),
    Fault("/readyz does not look for stuck writers", "faults", "readyz_tells", [
        ("stuck.filter(|stuck| stuck.duration >= STUCK).map(", "stuck.filter(|stuck| stuck.duration >= STUCK_TOO_LONG).map(")]),
    Fault("a job without end", "service", "a_computation_without_an_end", [
        ("tokio::time::sleep(time_left)", "tokio::time::sleep(time_left.max(Duration::from_secs(3600)))")]),
    Fault("a cancelled job without end", "faults", "a_cancelled_computation_without_an_end", [
        ("tokio::time::sleep(left)", "tokio::time::sleep(left.max(Duration::from_secs(3600)))")]),
    Fault("cancelled: over with its thread only", "faults", "a_cancelled_job_is_over_soon", [
        ("sleep(CANCEL_TIMEOUT)", "sleep(CANCEL_TIMEOUT * 1000)")]),
    Fault("cancelled: two threads of one worker", "faults", "a_cancelled_job_is_over_soon", [
        ("computation.wait(context, &job_id).await;", "drop(computation);")]),
    Fault("cancelled: a worker waits for ever", "faults", "a_cancelled_computation_without", [
        ("tokio::time::sleep(left)", "tokio::time::sleep(left * 1000)")]),
    Fault("a cancellation that comes too late", "service", "a_waiting_job_is_cancelled", [
        ("status = case when cancel_requested_at_ms is null then 'succeeded' else 'cancelled' end", "status = 'succeeded'")]),
    # Release
    Fault("a broken beam decides a release", "core", "one_outlier", [
        ("match points.len() >= MIN_POINTS && n_outliers", "match points.is_empty() && points.len() >= MIN_POINTS && n_outliers")]),
    Fault("the uncertainty of a figure is not counted", "service", "the_tolerance_counts_the_uncertainty", [
        ("if figure + expanded <= tolerance", "if figure <= tolerance || expanded.is_nan()")], "src/release"),
    Fault("the schema does not count it", "service", "the_schema_itself_counts_the_uncertainty", [
        ("or v.after_rms_mm + v.after_expanded_mm > p.tolerance_mm", "")], "migrations/sqlite/0022_age_and_references.sql"),
    Fault("the schema lets few points condemn", "service", "a_set_once_shown_to_be_no_better", [
        ("and v.evidence <> 'none' and not (v.fit", "and not (v.fit")], "migrations/sqlite/0022_age_and_references.sql"),
    Fault("the schema lets a worse session support", "service", "keeps_what_speaks_against", [
        ("(v.fit = 'fits' and v.is_better = 1 and v.is_worse = 0 and", "(v.fit = 'fits' and v.is_better = 1 and")], "migrations/sqlite/0022_age_and_references.sql"),
    Fault("few points need a stated uncertainty", "service", "a_session_of_few_points", [
        ("false => DecisionRule::SimpleAcceptance", "false => rule")], "src/release"),
    Fault("the schema asks few points for an uncertainty", "service", "a_session_of_few_points", [
        ("and (v.kind = 'identification' or v.evidence <> 'none')", "")], "migrations/sqlite/0022_age_and_references.sql"),
    Fault("a copy is as young as its upload", "service", "a_copy_of_an_old_upload", [
        ("first.map_or(own.uploaded_seq, |i| others[i].upload.uploaded_seq)", "first.map_or(own.uploaded_seq, |_| own.uploaded_seq)")], "src/jobs"),
    Fault("the age of a copy is not asked for", "service", "a_copy_of_an_old_upload", [
        ("case when v.measured_seq > 0 and v.measured_seq <", "case when v.measured_seq < 0 and v.measured_seq <")], "src/store"),
    Fault("a check that finds a change lets releases through", "service", "a_check_says_whether", [
        ("else if has_warning(report, CHECK_CHANGED) { // The check found a change.", "else if false { // The check found a change.")], "src/release"),
    Fault("a check counts what the placement takes up", "core", "what_the_placement_takes_up", [
        ("m - &taken * taken.tr_mul(m)", "m - &taken * taken.tr_mul(m) * 0.0")], "core/src/identification"),
    Fault("the delivered fit may hold an impossible reflector", "core", "a_reflector_farther_away_than_the_arm", [
        ("fit = fit.or_else(|| impossible_reflector(delivered_model, &request.robot.links));", "")], "core/src/calibration"),
    Fault("a check takes the points of a pose as independent", "core", "points_of_one_configuration", [
        ("if configuration == other {", "if false && configuration == other {")], "core/src/identification"),
    Fault("a gate that fails open", "service", "no_better_than_nominal", [
        ("session.is_evidence && !session.verification.is_better", "session.is_evidence && session.seq == -1")]),
    Fault("a placement that hides a joint is evidence", "core", "whose_last_joint_hardly_moves", [
        ("let is_hidden = left_mm > MIN_LEFT_SHARE * whole_mm && share < SHOWN;", "let is_hidden = left_mm > MIN_LEFT_SHARE * whole_mm && share < 0.0;")]),
    Fault("a change during a session is a few outliers", "core", "changes_during_a_session", [
        ("run.n_configurations >= MIN_OF_RUN", "run.n_configurations >= 1000")]),
    Fault("a copy at another scale is a session", "core", "another_scale_makes", [
        ("effects.set_column(6, &(row.here_mm / size_mm));", "effects.set_column(6, &(0.0 * row.here_mm));")]),
    Fault("one of two joint maps is offered", "core", "two_explanations_of_a_symmetric_arm", [
        ("joint_map: other.is_none().then_some(map),", "joint_map: Some(map),")]),
    Fault("a tool from a drawing is exact", "core", "a_tool_from_a_drawing", [
        ("let off_axis_mm = libm::hypot(flange_mm.x, flange_mm.y);", "return 0.0; #[allow(unreachable_code)] let off_axis_mm = libm::hypot(flange_mm.x, flange_mm.y);")]),
    Fault("a copy with noise is a session", "core", "a_second_visit", [
        ("pair.reading_rad <= SAME_READING_RAD", "pair.reading_rad < 0.0"), ("slope >= FOLLOWS && slope", "true || slope")]),
    Fault("a set of before a collision passes its gates", "service", "from_before_a_collision", [
        ("if facts.identification_seq > *seq && !facts.identification.is_repeat", "if *seq > 0")], "src/release"),
    Fault("a later session outweighs one that missed", "service", "missed_by_far_stays", [
        ("Fit::SetFarOff => false,", "Fit::SetFarOff => facts.sessions.iter().any(|later| later.supports_since(session.seq)),")], "src/release"),
    Fault("a blank is a reason", "service", "nothing_to_read", [
        ("!text.is_empty() && !text.chars().any(is_readable)", "text.trim().is_empty() && !text.is_empty()")], "src/wire"),
    Fault("what does not fit is evidence", "service", "session_that_does_not_fit", [
        ("const MAX_ERROR_RATIO: f64 = 10.0", "const MAX_ERROR_RATIO: f64 = 1e9"),
        ("set_mm.min(typical(0)) > farthest_mm", "set_mm.min(typical(0)) > 1e9 * farthest_mm")], "core/src/calibration/validation/session_fit.rs"),
    Fault("a robot that has changed is evidence", "service", "a_base_that_is_off_in_the_base_frame", [
        ("const MAX_ERROR_RATIO: f64 = 10.0", "const MAX_ERROR_RATIO: f64 = 1e9")], "core/src/calibration/validation/session_fit.rs"),
    Fault("the same points count as a session", "service", "the_same_points_uploaded_again", [
        ("rows.len() as f64 > MAX_REPEATED", "0.0 > MAX_REPEATED")]),
    Fault("no look at the active set", "service", "worse_than_the_active_one", [
        ("passed &= rms.is_as_good();", "passed &= own < active + 1000.0;")]),
    Fault("releases what was uploaded alone", "service", "no_dangerous_upload", [
        ("other || !facts.stored.policy.second_person_required", "other || facts.stored.policy.second_person_required")]),
    # HTTP
    Fault("sign-out leaves the session", "service", "sign_out_and_revocation_end_the_session", [
        ("delete from browser_session where token_sha256 = $1", "delete from browser_session where token_sha256 = $1 and 1 = 0")]),
    Fault("the session of a revoked key goes on", "service", "a_session_ends_by_sign_out", [
        ("\n        and k.revoked_at_ms is null", "")]),
    Fault("pages of other sites may release", "service", "without_keys", [
        ("if app.no_auth {", "if false {")], "src/http/host.rs"),
    Fault("hyper's own answers forget TLS", "service", "answers_without_a_route_carry_hsts", [
        ("problem.headers_mut().extend(common.clone());", "")], "src/http"),
    Fault("remedies of HTTP in a terminal", "service", "remedies_in_a_terminal", [
        ('Some(command) => format!("{text} ({command})"),', "Some(_) => text,")], "src/cli"),
    Fault("an old data directory stays open", "faults", "of_an_older_version", [
        ("set_permissions(data_dir, Permissions::from_mode(PRIVATE_DIR))", "set_permissions(data_dir, Permissions::from_mode(mode & 0o7777))")], "src/store"),
    Fault("a description is parsed uncounted", "load", "a_urdf_of_too_much", [
        ("xml_limits::check(text)?;", "")]),
    Fault("a data directory for everybody", "faults", "owners_alone", [
        (".mode(PRIVATE_DIR)", "")]),
    Fault("no scope check", "service", "each_route_takes_its_scope", [
        ("if caller.has(scope) => Ok", "if caller.has(scope) || true => Ok")]),
    Fault("other robots' things are seen", "service", "every_role_on_every_route", [
        ("if caller.may_see(robot_id) { Ok", "if true || caller.may_see(robot_id) { Ok")]),
    Fault("what is refused unread is not heard", "load", "still_sending", [
        ("const TOTAL_TIMEOUT: Duration = Duration::from_secs(10)", "const TOTAL_TIMEOUT: Duration = Duration::ZERO")]),
    Fault("no last call of who is connected", "faults", "open_connections_are_answered", [
        ("const SHUTDOWN_GRACE: Duration = Duration::from_millis(100)", "const SHUTDOWN_GRACE: Duration = Duration::from_millis(0)")]),
    Fault("no last call before the end", "faults", "who_is_connected", [
        ("const SHUTDOWN_GRACE: Duration = Duration::from_millis(100)", "const SHUTDOWN_GRACE: Duration = Duration::from_millis(0)"),
        ("for _ in 0..MAX_ACCEPTED_AT_SHUTDOWN { let Ok(Ok((stream, peer)))", "for _ in 0..0 { let Ok(Ok((stream, peer)))"),
        ("for _ in 0..MAX_ACCEPTED_AT_SHUTDOWN { let Ok((stream, peer))", "for _ in 0..0 { let Ok((stream, peer))")]),
    Fault("a key is logged", "service", "no_key_and_no_body", [
        ("let key = value.to_str().ok().and_then", 'tracing::debug!(?value, "a key"); let key = value.to_str().ok().and_then')]),
    # What is uploaded and asked
    Fault("the controller's own position is measured", "service", "positions_that_the_controller_computed", [
        ("is_computed.then(|| Warning::new(POSITIONS_COMPUTED, detail))", "(false && is_computed).then(|| Warning::new(POSITIONS_COMPUTED, detail))")],
        "core/src/calibration"),
    Fault("a lost target is measured", "core", "rows_of_an_instrument_that_lost_its_target", [
        ("(rows.len() > 1).then_some(Warning { code: \"position_repeated\"", "(false && rows.len() > 1).then_some(Warning { code: \"position_repeated\"")],
        "core/src/calibration"),
    Fault("calibrate takes any file", "service", "calibrate_refuses", [
        ("match alignment::align(robot, &set) {", "match Alignment::Fits {")]),
    Fault("jitter makes equations", "core", "poses_repeated", [
        ("configurations.first_row_like(&o.q_rad, row)", "configurations.first_row_like(&[row as f64], row)")]),
    Fault("targets that no pose has looked at", "core", "with_nothing_to_identify", [
        ("let n_poses = (parameters.len() + MORE_POSES).max(n_targets);", "let n_poses = parameters.len() + MORE_POSES;")]),
    Fault("no finite check", "service", "every_bad_file", [
        ("if !value.is_finite() { let detail = format!(\"{cell:?} is not a finite", "if value.is_nan() && false { let detail = format!(\"{cell:?} is not a finite")]),
    Fault("a short row may lack any cell", "core", "a_short_row_whose_remark_is_a_number", [
        ("if n_cells < ends.n_named {", "if n_cells < ends.n_read {")], "core/src/measurement"),
    Fault("rows that a filter hides are measurements", "core", "hidden_rows_of_a_workbook", [
        ("refuse_marked_rows(&sheet)?;", "")], "src/wire"),
    Fault("a table counts twice", "core", "a_table_that_stands_twice", [
        ("found = repeats::repeats(points);", "")], "core/src/measurement"),
    Fault("thousands are columns", "core", "numbers_that_are_split", [
        ("found.extend(self.split.take());", "")], "core/src/measurement"),
    Fault("pulses are degrees", "core", "pulses_of_motors", [
        ("found = not_measured::pulses(points);", "")], "core/src/measurement"),
    Fault("means of each pose are measurements", "core", "statistics_of_each_pose_are_no_measurements", [
        ("(n_hits > 1 && is_rare && evidence <= FALSE_ALARM)", "(n_hits > 1 && is_rare && evidence < f64::MIN)")], "core/src/measurement"),
    Fault("rows that were put aside are measurements", "core", "rows_that_somebody_put_aside", [
        ("self.issues.extend(self.flags.refused(table));", "")], "core/src/measurement"),
    Fault("positions under Nominal are measured", "core", "columns_under_a_group_that_was_not_measured", [
        ("let known = without_groups_not_measured(self.table, known);", "")], "core/src/measurement"),
    Fault("shared targets count twice", "core", "what_cannot_be_fitted_together", [
        ("let n_targets = request.set.n_targets(); if n_targets > MAX_TARGETS", "let n_targets: usize = sessions.iter().map(MeasurementSet::n_targets).sum(); if n_targets > MAX_TARGETS")],
        "core/src/calibration"),
    Fault("joints are counted as the file says", "service", "a_controllers_joint_convention", [
        ("all.extend(self.convention(self.frame));", "")]),
    Fault("no alignment check", "service", "wrong_as_a_whole", [
        ("pub const FITS: f64 = 0.01", "pub const FITS: f64 = 1e9")]),
    # The core
    Fault("a robot of Universal Robots points backwards", "service", "a_universal_robot_from_its", [
        ("rpy_rad: [0.0, 0.0, if self == Self::Base { 0.0 } else { PI }]", "rpy_rad: [0.0, 0.0, 0.0 * PI]")], "core/src/exchange"),
    Fault("compensate forgets where the base is", "service", "a_wrong_mastering_of_the_first_joint", [
        ("Some(Base::Measured) | None => Ok(Base::Measured)",
         "Some(Base::Measured) => Ok(Base::Measured), None => Ok(Base::Robot)")], "src/operations"),
    Fault("a flange turned as nobody knows", "service", "poses_are_refused_if_the_flange", [
        ("MAX_FLANGE_ROTATION_STD_RAD: f64 = 0.5 *", "MAX_FLANGE_ROTATION_STD_RAD: f64 = 500.0 *")], "core/src/calibration"),
    Fault("an orientation that nobody knows is released", "service", "poses_are_refused_if_the_flange", [
        ("if links_std_deg > most_deg {", "if links_std_deg > 1e9 {")], "src/release"),
    Fault("a joint that counts the other way is no misfit", "service", "an_identified_robot_that_is_wrong", [
        ("delta_rad.abs() > UNMASTERED_RAD &&", "delta_rad.abs() > 100.0 &&")], "core/src/calibration"),
    Fault("a robot that does not fit corrects targets", "service", "an_identified_robot_that_is_wrong", [
        ("= wrong_robot(provenance)", "= wrong_robot(provenance).filter(|_| false)")], "src/operations"),
    Fault("a misfit is compared with", "service", "a_job_whose_points_do_not_fit", [
        ("UNUSABLE_FIT: Fit = Fit::SetFarOff", "UNUSABLE_FIT: Fit = Fit::DoesNotFit")], "src/release"),
    Fault("five points cannot serve as they are told", "service", "a_small_set_can_serve", [
        ("let n_placed = n_placed_where(refit, set);", "let n_placed = n_placed_where(refit && false, set);")], "core/src/calibration"),
    Fault("corrections without a veto", "core", "have_a_veto", [
        ("if (corrected_mm <= links_mm && corrected_rad <= links_rad) || errors_mm.is_empty()", "if corrected_mm <= links_mm + 1e9 || errors_mm.is_empty()")]),
    Fault("joints that follow others are not looked for", "core", "a_joint_that_follows_another_one", [
        ("const CHANCE_OF_FOLLOWING: f64 = 1e-6;", "const CHANCE_OF_FOLLOWING: f64 = 0.0;")], "core/src/identification"),
    Fault("uncertainty of what did not converge", "core", "did_not_converge", [
        ("const AT_MINIMUM_STDS: f64 = 1.0", "const AT_MINIMUM_STDS: f64 = 1e12")]),
    Fault("a lower bound without what is not linear", "core", "never_above_the_cost", [
        ("+ (error[part] + rounding)", "+ rounding")]),
    Fault("a lower bound without its rounding", "core", "never_above_the_cost", [
        ("+ (error[part] + rounding)", "+ error[part]")]),
]


def squeezed(text):
    """The text without spaces and trailing commas, and where each of its characters stands."""
    kept = [at for at, character in enumerate(text) if not character.isspace()]
    kept = [at for at, after in zip(kept, kept[1:] + [None]) if not (text[at] == "," and after is not None and text[after] in ")]}")]
    return "".join(text[at] for at in kept), kept


class Tree:
    """The sources in which faults are planted."""

    def __init__(self, root):
        self.root = Path(root)
        self.files = {}
        for folder, suffix in (("core/src", ".rs"), ("src", ".rs"), ("migrations", ".sql")):
            for path in sorted((self.root / folder).rglob("*" + suffix)):
                text = path.read_text(encoding="utf-8")
                self.files[path.relative_to(self.root).as_posix()] = (text, *squeezed(text))

    def places(self, find, folder):
        """(file, begin, end) of each place where the text stands."""
        needle, _ = squeezed(find)
        found = []
        for name, (_, text, kept) in self.files.items():
            if name == folder or name.startswith(folder and folder + "/"):
                found += [(name, kept[m.start()], kept[m.start() + len(needle) - 1] + 1) for m in re.finditer(re.escape(needle), text)]
        return found

    def troubles(self, fault):
        """Why the fault cannot be planted."""
        counted = [(find, len(self.places(find, fault.folder))) for find, _ in fault.edits]
        return [f"{fault.name}: found {n} times in {fault.folder or 'the sources'}, not once: {find.strip()}" for find, n in counted if n != 1]

    def edits(self, fault):
        """(file, begin, end, replacement) of each edit."""
        return [(*self.places(find, fault.folder)[0], replace) for find, replace in fault.edits]


def sources(test):
    """The source files of a test binary, but for those that it shares with others."""
    folder = ROOT / "tests" / test
    return folder.rglob("*.rs") if folder.is_dir() else [folder.with_suffix(".rs")]


def check():
    tree = Tree(ROOT)
    troubles = [trouble for fault in FAULTS for trouble in tree.troubles(fault)]
    names = [fault.name for fault in FAULTS]
    troubles += [f"{name}: there are two of this name" for name in sorted(set(names)) if names.count(name) > 1]
    binaries = {path.stem for path in (ROOT / "tests").glob("*.rs")} | {path.parent.name for path in (ROOT / "tests").glob("*/main.rs")}
    tests = {test: "".join(path.read_text(encoding="utf-8") for path in sources(test)) for test in binaries}
    for fault in FAULTS:
        name = fault.filter.removesuffix("::")
        if fault.test not in binaries or not re.search(rf"(fn|mod) \w*{re.escape(name)}", tests[fault.test]):
            troubles.append(f"{fault.name}: there is no test {fault.test} {fault.filter}")
    print("\n".join(troubles + [f"{len(FAULTS)} faults, {len(troubles)} troubles"]))
    return not troubles


class Runner:
    def __init__(self, directory):
        self.copy = Path(directory) / "tree"
        self.env = {**os.environ, "CARGO_TARGET_DIR": str(Path(directory) / "target"), "RUST_BACKTRACE": "0"}
        self.output = ""

    def refresh(self):
        """Copies what git knows and what differs, so that a second run builds only what changed."""
        known = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, stdout=subprocess.PIPE, check=True).stdout.decode().split("\0")
        for name in filter(None, known):
            source, target = ROOT / name, self.copy / name
            if not source.is_file():
                target.unlink(missing_ok=True)
            elif not target.is_file() or source.read_bytes() != target.read_bytes():
                target.parent.mkdir(parents=True, exist_ok=True)
                shutil.copy(source, target)
        for folder in ("core", "src", "tests", "migrations"):
            for path in (self.copy / folder).rglob("*"):
                if path.is_file() and path.relative_to(self.copy).as_posix() not in known:
                    path.unlink()

    def command(self, timeout_s, command, env=()):
        try:
            done = subprocess.run(command, cwd=self.copy, env={**self.env, **dict(env)}, timeout=timeout_s, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
        except subprocess.TimeoutExpired as late:
            self.output = (late.stdout or b"").decode(errors="replace") + f"\nnot over after {timeout_s} s"
            return False
        self.output = done.stdout.decode(errors="replace")
        return done.returncode == 0

    def build(self, test):
        """Builds a test binary; returns its path, or None. Only the tests are not optimised: calibrations run in the library."""
        profile = ["--profile", "test", "--message-format", "json-render-diagnostics"]
        command = ["cargo", "rustc", "--locked", *profile, "--test", test, "--", "-C", "opt-level=0", "-C", "debuginfo=0"]
        if not self.command(LONGEST_BUILD_S, command):
            return None
        for line in self.output.splitlines():
            if line.startswith("{") and (message := json.loads(line)).get("executable") and message["target"]["name"] == test:
                return message["executable"]
        return None

    def errors(self):
        return "\n".join(re.findall(r"^error.*(?:\n.*){0,4}", self.output, re.MULTILINE)[:4])

    def run(self, executable, filters, planted=""):
        return self.command(LONGEST_RUN_S, [executable, *filters], {SWITCH: planted})

    def failed(self):
        return " ".join(re.findall(r"^test (\S+) \.\.\. FAILED", self.output, re.MULTILINE)) or self.output.strip().splitlines()[-1]

    def ran_any(self):
        return any(int(n) > 0 for n in re.findall(r"^test result: \w+\. (\d+) passed", self.output, re.MULTILINE))

    def put(self, files):
        for name, text in files.items():
            (self.copy / name).write_text(text, encoding="utf-8")


# Which body of a function runs, in the library of the copy.
SWITCH = "KINCAL_PLANTED"
PLANTED = f"""
/// Whether this fault is planted.
pub fn planted(name: &str) -> bool {{
    static NAME: std::sync::LazyLock<String> = std::sync::LazyLock::new(|| std::env::var("{SWITCH}").unwrap_or_default());
    NAME.as_str() == name
}}
"""
SWITCHED = """
pub use kincal_core::planted;
/// A migration with the faults that are planted in it.
pub fn planted_sql(sql: &'static str) -> &'static str {
    let faults: &[(&str, &str, &str)] = &[
        %s
    ];
    let planted = faults.iter().filter(|(name, ..)| planted(name));
    let text = planted.fold(sql.to_owned(), |text, (_, find, replace)| text.replace(find, replace));
    Box::leak(text.into_boxed_str())
}
"""


def masked(text):
    """A Rust text in which comments and literals are blanks, so that braces can be counted."""
    patterns = r"""//[^\n]*|/\*.*?\*/|b?r(#*)".*?"\1|b?"(?:\\.|[^"\\])*"|b?'(?:\\.[^']*|[^'\\])'"""
    blank = lambda found: re.sub(r"[^\n]", " ", found.group())
    return re.sub(patterns, blank, text, flags=re.DOTALL)


def end_of(mask, begin):
    """Where the bracket at `begin` is closed."""
    depth = 0
    for at in range(begin, len(mask)):
        depth += (mask[at] in "{[(") - (mask[at] in "}])")
        if depth == 0:
            return at + 1
    return len(mask)


def functions(mask):
    """(begin, end) of the bodies of the outermost functions that can have two bodies."""
    found, after = [], 0
    for match in re.finditer(r"(const\s+)?((?:async|unsafe)\s+)*fn\s+\w+", mask):
        at = match.end()
        while at < len(mask) and mask[at] not in "{;":
            at = end_of(mask, at) if mask[at] in "([" else at + 1
        if match.start() < after or at >= len(mask) or mask[at] == ";":
            continue
        after = end_of(mask, at)
        if not match.group(1) and not re.search(r"->\s*impl\b", mask[match.end():at]):
            found.append((at, after))
    return found


def constants(mask):
    """(begin, end, name) of constants outside of functions."""
    bodies = functions(mask)
    for match in re.finditer(r"^ *(?:pub(?:\([^)]*\))?\s+)?const\s+(\w+)\s*:", mask, re.MULTILINE):
        at = match.end()
        while at < len(mask) and mask[at] != ";":
            at = end_of(mask, at) if mask[at] in "([{" else at + 1
        if not any(begin <= match.start() < end for begin, end in bodies):
            yield match.start(), at + 1, match.group(1)


class Switch:
    """The files of a copy in which every fault can be switched on."""

    def __init__(self, tree):
        self.tree = tree
        self.masks = {name: masked(text) for name, (text, *_) in tree.files.items() if name.endswith(".rs")}
        self.bodies = {name: functions(mask) for name, mask in self.masks.items()}
        # (file, begin, end) of a body -> {fault: its body}
        self.faulty = {}
        # (file, end of the item, name) of a constant -> {fault: its item}
        self.constants = {}
        self.sql = []

    def add(self, fault):
        """Whether the fault can be switched."""
        bodies, items, sql = {}, {}, []
        for name, begin, end, replace in self.tree.edits(fault):
            text = self.tree.files[name][0]
            if name.endswith(".sql"):
                sql.append((fault.name, text[begin:end], replace))
                continue
            body = next((body for body in self.bodies[name] if body[0] < begin and end < body[1]), None)
            item = next((item for item in constants(self.masks[name]) if item[0] <= begin and end <= item[1]), None)
            if body:
                bodies.setdefault((name, *body), []).append((begin, end, replace))
            elif item:
                items.setdefault((name, *item), []).append((begin, end, replace))
            else:
                return False
        for (name, begin, end), edits in bodies.items():
            self.faulty.setdefault((name, begin, end), {})[fault.name] = edited(self.tree.files[name][0], begin, end, edits)
        for (name, begin, end, constant), edits in items.items():
            self.constants.setdefault((name, end, constant), {})[fault.name] = edited(self.tree.files[name][0], begin, end, edits)
        self.sql += sql
        return True

    def files(self):
        """The files that differ from the tree."""
        # constants first: their names are replaced in all bodies
        switches, items = {}, {}
        for (name, end, constant), faults in self.constants.items():
            scope = [name] if sum(len(re.findall(rf"\bconst {constant}\b", mask)) for mask in self.masks.values()) > 1 else self.masks
            other = [f"{constant}_PLANTED_{n}" for n in range(len(faults))]
            public = lambda item, planted: "pub " + re.sub(rf"\b{constant}\b", planted, re.sub(r"^\s*pub(\([^)]*\))?\s+", "", item).lstrip(), count=1)
            items[name, end] = "".join(public(item, planted) + "\n" for planted, item in zip(other, faults.values()))
            used = constant
            for planted, fault in zip(other, faults):
                used = f"(if crate::planted({json.dumps(fault)}) {{ HOME::{planted} }} else {{ {used} }})"
            for file in scope:
                switches.setdefault(file, {})[constant] = used.replace("HOME::", "" if file == name else self.module(name) + "::")
        changed = {}
        for name, (text, *_) in self.tree.files.items():
            if not name.endswith(".rs"):
                continue
            pieces, at = [], 0
            places = [(begin, end, None) for begin, end in self.bodies[name]] + [(end, end, extra) for (file, end), extra in items.items() if file == name]
            for begin, end, extra in sorted(places, key=lambda place: place[:2]):
                if extra is not None:
                    pieces.append(text[at:begin] + "\n" + extra)
                    at = begin
                    continue
                right = self.with_constants(name, text[begin:end], switches)
                for fault, body in self.faulty.get((name, begin, end), {}).items():
                    faulty = self.with_constants(name, body, switches)
                    right = f"{{ if crate::planted({json.dumps(fault)}) {faulty} else {right} }}"
                pieces.append(text[at:begin] + right)
                at = end
            # constants of private modules are used from everywhere
            result = re.sub(r"^mod (\w+);", r"pub mod \1;", "".join(pieces) + text[at:], flags=re.MULTILINE)
            if name == "src/store/migration.rs":
                result = result.replace("sql.into_sql_str()", "crate::planted_sql(sql).into_sql_str()")
            if name == "core/src/lib.rs":
                result += PLANTED
            if name == "src/lib.rs":
                rust = ", ".join(f"({json.dumps(fault)}, {json.dumps(find, ensure_ascii=False)}, {json.dumps(replace, ensure_ascii=False)})" for fault, find, replace in self.sql)
                result += SWITCHED % rust
            if result != text:
                changed[name] = result
        return changed

    def module(self, name):
        return "crate::" + name.removeprefix("core/").removeprefix("src/").removesuffix(".rs").removesuffix("/mod").replace("/", "::")

    def with_constants(self, name, body, switches):
        for constant, used in switches.get(name, {}).items():
            mask = masked(body)
            places = [match.span() for match in re.finditer(rf"(?<![\w:]){constant}\b", mask)]
            for begin, end in reversed(places):
                body = body[:begin] + used + body[end:]
        return body


def edited(text, begin, end, edits):
    """A part of a text after edits."""
    part = text[begin:end]
    for at, until, replace in sorted(edits, reverse=True):
        part = part[: at - begin] + replace + part[until - begin :]
    return part


def plant(wanted, directory):
    faults = [fault for fault in FAULTS if not wanted or any(part in fault.name for part in wanted)]
    runner = Runner(directory)
    runner.refresh()
    tree = Tree(runner.copy)
    if troubles := [trouble for fault in faults for trouble in tree.troubles(fault)]:
        print("\n".join(troubles))
        return False
    switch = Switch(tree)
    switched = [fault for fault in faults if switch.add(fault)]
    files = switch.files()
    runner.put(files)
    missed = {}

    def tell(fault, verdict, detail):
        if verdict != "caught":
            missed[fault.name] = verdict
        print(f"{verdict:<9} {fault.name:<50} {detail}", flush=True)

    def judge(fault, executable, planted):
        passed = runner.run(executable, [fault.filter], planted)
        tell(fault, "MISSED" if passed else "caught", f"{fault.test} {fault.filter} passed" if passed else f"by {fault.test}: {runner.failed()}")

    for test in dict.fromkeys(fault.test for fault in switched):
        ours = [fault for fault in switched if fault.test == test]
        if not (executable := runner.build(test)):
            print(f"{test} cannot be built with switches:\n{runner.errors()}")
            return False
        if not (runner.run(executable, sorted({fault.filter for fault in ours})) and runner.ran_any()):
            print(f"without a fault, {test} fails: {runner.failed()}\n{runner.output[-3000:]}")
            return False
        for fault in ours:
            judge(fault, executable, fault.name)
    # a new time, so that the build sees that the switches are gone
    runner.put({name: tree.files[name][0] for name in files})
    for fault in (fault for fault in faults if fault not in switched):
        changed = {}
        for name, begin, end, replace in sorted(tree.edits(fault), reverse=True):
            text = changed.get(name, tree.files[name][0])
            changed[name] = text[:begin] + replace + text[end:]
        runner.put(changed)
        executable = runner.build(fault.test)
        if executable:
            judge(fault, executable, "")
        else:
            tell(fault, "NO BUILD", runner.errors())
        runner.put({name: tree.files[name][0] for name in changed})
    print(f"{len(faults) - len(missed)} caught, {len(missed)} not: {', '.join(missed) or 'none'}")
    return not missed and bool(faults)


def main(arguments):
    if arguments == ["--check"]:
        return check()
    if kept := os.environ.get("KINCAL_PLANT_DIR"):
        return plant(arguments, kept)
    with tempfile.TemporaryDirectory() as directory:
        return plant(arguments, directory)


if __name__ == "__main__":
    sys.exit(0 if main(sys.argv[1:]) else 1)
