// What sessions and jobs found against a parameter set: one rule for the list of robots, the robot's page and the list of jobs.

import { each, get } from "./api.js";
import { el, fill } from "./dom.js";
import { error, mm } from "./format.js";

/** Most reports that are read for one list: each may be large. */
const MOST_READ = 50;

/** Badges of what a report found, by the code of its warning; the first that it has counts. */
const FOUND = [["session_does_not_fit", "does not fit"], ["no_fit", "does not fit"], ["joint_map_suspect", "does not fit"], ["set_far_off", "misses by far"], ["check_changed", "has changed"],
  ["no_better_than_nominal", "no better than nominal"], ["misses_session", "misses the session"], ["worse_than_identified", "worse than before"]];

const codeOf = (report) => FOUND.find(([code]) => report.warnings.some((warning) => warning.code === code))?.[0] ?? null;

/** The words for what a report found against its parameter set or its file; undefined where it found nothing. */
export const foundAgainst = (report) => FOUND.find(([code]) => code === codeOf(report))?.[1];

/** Ratio of the errors from which on a set is worse than when it was identified, as in the service (session_fit.rs). */
const WORSE = 3;
/** Smaller errors at the identification count as this, mm: neither robots nor trackers repeat a pose better. */
const FINEST_MM = 0.02;

/** A robot of the overview, with the need `drifted` where its newest session speaks against its active set. `report` is that session's, where it is known. */
export function judged(robot, report) {
  const { active, session } = robot;
  if (!active || !session || ["check_robot", "drifted"].includes(robot.need)) return robot;
  const finding = report ? codeOf(report) : session.finding;
  const then = active.evidence === "none" ? null : active.after_rms_mm;
  const isAgainst = finding === undefined ? typeof then === "number" && session.rms_mm >= WORSE * Math.max(then, FINEST_MM) : finding !== null;
  if (!isAgainst) return robot;
  const words = FOUND.find(([code]) => code === finding)?.[1] ?? "worse than before";
  return { ...robot, need: "drifted", need_job_id: session.job_id, reason: `${words}: the newest session has ${mm(session.rms_mm)} rms${typeof then === "number" ? `; it was ${mm(then)} when the set was identified` : ""}` };
}

/** Badges of the sessions that speak against an active set, by their job. */
export const sessionsAgainst = (robots) => new Map(robots.filter(({ need }) => need === "drifted").map(({ need_job_id: id, reason }) => [id, /tolerance/.test(reason) ? "over the tolerance" : "worse than before"]));

/** The badge of a job whose report found something, or of whose robot it is known `otherwise`; undefined if there is nothing. */
export function foundBadge(report, otherwise) {
  const words = (report && foundAgainst(report)) ?? otherwise;
  return words && el("span.badge.bad", {}, words);
}

/** What is known of jobs that ended: it does not change any more. */
const known = new Map();

/** Puts what verifications and checks in sight found in the place of "succeeded", and their figures beside it. */
export async function findings(jobs, place, against, signal) {
  const open = jobs.filter((job) => job.kind !== "identify" && job.status === "succeeded").slice(0, MOST_READ);
  await each(open, async (job) => {
    // without its report a job stays "succeeded" until the list is drawn again
    if (!known.has(job.id)) await get(`/v1/jobs/${job.id}/report`, signal).then(({ warnings, verify, identify }) => known.set(job.id, { warnings, half: verify ?? identify }), () => {});
    const found = known.get(job.id);
    const badge = foundBadge(found, against.get(job.id));
    const [state, figure] = ["state", "figure"].map((name) => place.querySelector(`[data-${name}="${job.id}"]`));
    if (state && badge) fill(state, badge);
    if (figure && found?.half?.n_points > 0) fill(figure, figureOf(found.half.after.rms_mm, found.half.before.rms_mm));
  }, 2);
}

/** An error and that of the nominal robot beside it. */
export const figureOf = (after, before) => (typeof after === "number" ? [mm(after), typeof before === "number" && el("small.quiet", {}, `nominal ${error(before)}`)] : "–");
