// The sessions that a job fitted together: which they are, what each of them has, and whether they are one robot in one state.

import { el, table } from "./dom.js";
import { leftOut } from "./leave_out.js";
import { list } from "./api.js";
import { chance, count, day, measuredAt, mm, number, when } from "./format.js";

/** The measurement sets of a job in the order of its rows. */
export const setIds = ({ request, measurement_set_id: one }) => request?.measurement_set_ids ?? [one];

/** The session that a row of the report is of, and its row there; undefined for a row of the verify set. `sets` are those of the job. */
export function placeOf(sets, row) {
  let first = 0;
  for (const [session, set] of sets.entries()) {
    if (row < first + set.n_points) return { session, set, row: row - first };
    first += set.n_points;
  }
  return undefined;
}

/** Number of points of all sets. */
export const nPoints = (sets) => sets.reduce((sum, set) => sum + set.n_points, 0);

/** Names and points of the sets, in words. */
export const setsInWords = (sets) => sets.map((set) => `${set.name ?? "a set without a name"} (${count(set.n_points)} points)`).join(", ");

/** How the rotations of a set of poses were read, a part of a sentence each. */
export const rotationsOf = ({ rotation, inverse_poses: isInverted }) => [rotation && `rotations read as ${rotation}`, isInverted && "poses inverted, as of a board that a camera on the arm sees"].filter(Boolean);

/** Jobs and sets of points among which the session of a parameter set is looked for. */
const MAX_NAMED = 200;

/** A function that names a parameter set by the session that it was identified from: "session4, measured 3 Sep 2026, candidate". */
export async function setNames({ id }, signal) {
  const [jobs, sets] = await Promise.all([list(`/v1/robots/${id}/jobs?kind=identify`, MAX_NAMED, signal), list(`/v1/robots/${id}/measurement-sets`, MAX_NAMED, signal)]);
  const jobOf = new Map(jobs.map((job) => [job.id, job]));
  const pointsOf = new Map(sets.map((set) => [set.id, set]));
  return (set) => {
    const job = jobOf.get(set.job_id);
    const points = pointsOf.get(job?.measurement_set_id);
    const at = points?.record?.measured_at;
    const more = job ? setIds(job).length - 1 : 0;
    const left = leftOut({ name: job?.measurement_set_name });
    // which points were left out and why stands on the page of the job
    const name = left ? `${job.measurement_set_name.split(" without ")[0]} without ${left.points === 1 ? "one point" : `${left.points} points`}` : job?.measurement_set_name;
    const session = name && `${name}${more > 0 ? ` and ${more} more` : ""}`;
    return [session, at ? `measured ${day(at)}` : `identified ${session ? day(set.created_at) : when(set.created_at)}`, set.status === "released" ? "active" : set.status].filter(Boolean).join(", ");
  };
}

/** The sets of a job in a list: the name of the first, and how many sessions more. */
export function setsOfJob(job) {
  const more = setIds(job).length - 1;
  return [job.measurement_set_name ?? "without a name", more > 0 && el("small.quiet", {}, `and ${more} ${more === 1 ? "session" : "sessions"} more, fitted together`)];
}

/** What each session has, and the test whether they are one robot; nothing for a job of one set. */
export function sessionsCard({ pooled }, sets) {
  if (!pooled) return [];
  const rows = pooled.sessions.map((found, i) => ({ ...found, set: sets[i], at: i + 1 }));
  const columns = [
    ["Session", (row) => [`${row.at}. ${row.set.name ?? "without a name"}`, el("small.quiet", {}, row.set.record?.measured_at ? measuredAt(row.set.record) : `uploaded ${when(row.set.created_at)}`)], "name"],
    ["Points", (row) => count(row.n_points), "n"], ["Rows of the report", (row) => `${row.first_row} to ${row.first_row + row.n_points - 1}`, "n"],
    ["Noise of a coordinate", (row) => (row.noise_std_mm === undefined ? "as the others" : mm(row.noise_std_mm)), "n"],
    ["Identify, rms", (row) => mm(row.identify_rms_mm), "n"], ["Verify, rms", (row) => mm(row.verify_rms_mm), "n"],
  ];
  const byChance = pooled.probability < 1e-4 ? "below 0.0001" : chance(pooled.probability);
  return el("section.card", {}, el("h2", {}, "Sessions that were fitted together"),
    el("p", {}, el("strong", {}, "They are one robot in one state, as far as these points tell. "), `Each session was first identified by itself. Two sessions of an unchanged robot differ as much as ${sets.length === 2 ? "these" : "the two that are least alike"} with probability ${byChance} (sum of squares ${number(pooled.chi_square)} of ${pooled.n_combinations} combinations of parameters that both see). A test of few or noisy points sees large changes only.`),
    pooled.shared_targets && el("p", {}, `Reflectors that were not mounted anew between sessions, and have one place on the tool: ${pooled.shared_targets.join(", ")}.`),
    table("Links are fitted to all sessions; each has its own base, reflectors and noise. Errors with the links alone.", columns, rows, ""));
}
