// What jobs and sessions found against a parameter set, as the service says it.

import { el } from "./dom.js";
import { error, mm } from "./format.js";

/** What a job found, in the list of jobs. */
const FINDINGS = { does_not_fit: "does not fit", set_far_off: "misses by far", no_better_than_nominal: "no better than nominal", worse_than_identified: "worse than before" };

/** What a report found, by the code of its warning; the first that it has counts. */
const FOUND = [["session_does_not_fit", "does not fit"], ["no_fit", "does not fit"], ["joint_map_suspect", "does not fit"], ["set_far_off", "misses by far"], ["check_changed", "has changed"],
  ["no_better_than_nominal", "no better than nominal"], ["misses_session", "misses the session"], ["worse_than_identified", "worse than before"]];

/** The words for what a report found against its parameter set or its file; undefined where it found nothing. */
export const foundAgainst = (report) => FOUND.find(([code]) => report.warnings.some((warning) => warning.code === code))?.[1];

const badge = (words) => words && el("span.badge.bad", {}, words);

/** The badge of a report that found something; otherwise undefined. */
export const foundBadge = (report) => badge(foundAgainst(report));

/** The badge of a job that found something against a set or its own points; otherwise undefined. An identified set that is far off does not fit its own points. */
export const findingBadge = (job) => badge(job.kind === "check" && job.finding === "set_far_off" ? "has changed" : FINDINGS[job.kind === "identify" && job.finding === "set_far_off" ? "does_not_fit" : job.finding]);

/** An error and that of the nominal robot beside it. */
export const figureOf = (after, before) => (typeof after === "number" ? [mm(after), typeof before === "number" && el("small.quiet", {}, `nominal ${error(before)}`)] : "–");
