// What jobs found: that a job has succeeded says only that it came to its end.

import { each, get } from "./api.js";
import { el, fill } from "./dom.js";

/** Most reports that are read for one list: each may be large. */
const MOST_READ = 50;

/** Badges of what a report found, by the code of its warning; the first that it has counts. */
const FOUND = [["session_does_not_fit", "does not fit"], ["no_fit", "does not fit"], ["joint_map_suspect", "does not fit"], ["set_far_off", "misses by far"], ["check_changed", "has changed"],
  ["no_better_than_nominal", "no better than nominal"], ["misses_session", "misses the session"], ["worse_than_identified", "worse than before"]];

/** The words for what a report found against its parameter set or its file; undefined where it found nothing. */
export const foundAgainst = (report) => FOUND.find(([code]) => report.warnings.some((warning) => warning.code === code))?.[1];

/** The badge of a job whose report found something; otherwise undefined. */
export function foundBadge(report) {
  const words = foundAgainst(report);
  return words && el("span.badge.bad", {}, words);
}

/** What is known of jobs that ended: it does not change any more. */
const known = new Map();

/** Puts the badge of what it found in the place of "succeeded", for verifications and checks in sight. */
export async function findings(jobs, place, signal) {
  const open = jobs.filter((job) => job.kind !== "identify" && job.status === "succeeded").slice(0, MOST_READ);
  await each(open, async ({ id }) => {
    // without its report a job stays "succeeded" until the list is drawn again
    if (!known.has(id)) await get(`/v1/jobs/${id}/report`, signal).then((report) => known.set(id, foundAgainst(report)), () => {});
    const cell = place.querySelector(`[data-state="${id}"]`);
    if (cell && known.get(id)) fill(cell, el("span.badge.bad", {}, known.get(id)));
  }, 2);
}
