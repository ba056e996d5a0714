// What jobs and sessions found against a parameter set or a robot, in words. All pages take the words from here, so that none contradicts another.

import { el } from "./dom.js";
import { mm } from "./format.js";

/** Words for what was found, by the finding of a job: in a list, and within a sentence. */
const FINDINGS = {
  does_not_fit: ["does not fit", "does not fit"],
  set_far_off: ["misses by far", "misses by far"],
  no_better_than_nominal: ["no better than nominal", "no better than nominal"],
  worse_than_identified: ["worse than before", "worse than before"],
  check_changed: ["has changed", "has changed"],
  misses_session: ["misses the session", "misses the session"],
};

/** Findings by the code of a report's warning; the first that a report has counts. */
const OF_WARNING = [["session_does_not_fit", "does_not_fit"], ["no_fit", "does_not_fit"], ["joint_map_suspect", "does_not_fit"], ["set_far_off", "set_far_off"], ["check_changed", "check_changed"],
  ["no_better_than_nominal", "no_better_than_nominal"], ["misses_session", "misses_session"], ["worse_than_identified", "worse_than_identified"]];

/** What a report found against its parameter set or its file; undefined if nothing. */
const findingOf = (report) => OF_WARNING.find(([code]) => report.warnings.some((warning) => warning.code === code))?.[1];

/** The finding as lists have it: a quick check that misses by far says that the robot has changed, and a set that misses its own points does not fit them. */
const asListed = (finding, kind) => (finding !== "set_far_off" ? finding : { check: "check_changed", identify: "does_not_fit" }[kind] ?? finding);

/** The words for what a report found; undefined if nothing. */
export const foundAgainst = (report) => FINDINGS[asListed(findingOf(report), report.check ? "check" : undefined)]?.[1];

const badge = (finding) => FINDINGS[finding] && el("span.badge.bad", {}, FINDINGS[finding][0]);

/** The badge of a report of a job of this kind that found something; otherwise undefined. */
export const foundBadge = (report, kind) => badge(asListed(findingOf(report), kind));

/** The badge of a job that found something; otherwise undefined. */
export const findingBadge = (job) => badge(asListed(job.finding, job.kind));

/**
 * What the session found that asks somebody to look at the robot. Points that fit the robot and miss the set say that the robot has changed; points that do not
 * fit say so of the file. Neither is known of an older job.
 */
export function asksToLook(job, which = "active set") {
  const by = typeof job?.rms_mm === "number" ? ` by ${mm(job.rms_mm)} rms` : "";
  if (job?.finding === "set_far_off") return { isFarOff: true, short: "misses by far", sentence: `The robot has changed: the ${which} misses${by}` };
  if (job?.finding === "does_not_fit") return { isFarOff: false, short: "does not fit", sentence: `The file does not fit this robot${by && `: it misses${by}`}` };
  return { isFarOff: false, short: "to look at", sentence: "A session speaks against this robot" };
}

/** An error and that of the nominal robot beside it. */
export const figureOf = (after, before) => (typeof after === "number" ? [mm(after), typeof before === "number" && el("small.quiet", {}, `nominal ${mm(before)}`)] : "–");
