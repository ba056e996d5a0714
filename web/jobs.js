// Jobs over all robots, newest first.

import { get, list } from "./api.js";
import { drawMore, el, fill, problem, table, withFocus } from "./dom.js";
import { method, plain, ran, span, when } from "./format.js";
import { isRunning, whileRunning } from "./polling.js";
import { statusBadge } from "./robot.js";
import { setsOfJob } from "./sessions.js";
import { figureOf, findingBadge } from "./verdicts.js";

/** Jobs that are shown at first, and with each click. */
const PAGE = 50;
/** Robots whose names are known here. */
const MAX_ROBOTS = 5000;
const CHOICES = [["", "all jobs"], ["queued", "queued"], ["running", "running"], ["failed", "failed"], ["succeeded", "succeeded"], ["cancelled", "cancelled"]];
const KINDS = [["", "calibrations, verifications and checks"], ["identify", "calibrations"], ["verify", "verifications"], ["check", "quick checks"]];

/** The page. The service filters and counts. */
export async function jobsPage({ main, signal, query, keep }) {
  document.title = "kincal: jobs";
  const robots = await list("/v1/overview?archived=all", MAX_ROBOTS, signal);
  const names = new Map(robots.map((r) => [r.robot_id, r.name]));
  const known = (name, values) => (values.includes(query.get(name)) ? query.get(name) : "");
  const state = { status: known("status", CHOICES.map(([value]) => value)), kind: known("kind", KINDS.map(([value]) => value)), robot: known("robot", [...names.keys()]), jobs: [], cursor: null, asked: 0 };
  const [rows, more] = [el("div.jobs", {}), el("div.actions", {})];
  const asked = (more = {}) => new URLSearchParams(Object.entries({ limit: PAGE, status: state.status, kind: state.kind, robot_id: state.robot, ...more }).filter(([, value]) => value));
  const draw = () => {
    fill(rows, jobTable(state.jobs, names, state.status || state.kind || state.robot ? "No such job. Choose all jobs to see the others." : "There is no job yet."));
    fill(more, state.jobs.length > 0 && el("span.note", { role: "status" }, `${state.jobs.length} of ${state.total} jobs`), state.cursor && el("button", { type: "button", click: () => drawMore(rows, () => load(true)) }, "Show more"));
  };
  /** Follows the jobs that run, until none of them does; new ones come first. */
  const follow = async () => {
    if (state.follows || !state.jobs.some(isRunning)) return;
    state.follows = true;
    await whileRunning(() => state.jobs.some(isRunning), refresh, signal);
    state.follows = false;
  };
  const refresh = async () => {
    const turn = state.asked;
    const page = await get(`/v1/jobs?${asked()}`, signal);
    const fresh = new Set(page.items.map(({ id }) => id));
    const rest = await Promise.all(state.jobs.slice(PAGE).filter(({ id }) => !fresh.has(id)).map((job) => (isRunning(job) ? get(`/v1/jobs/${job.id}`, signal) : job)));
    // a filter may have changed meanwhile
    if (turn !== state.asked) return;
    const before = shownOf(state.jobs);
    Object.assign(state, { jobs: [...page.items, ...rest], total: page.total });
    if (shownOf(state.jobs) !== before) withFocus(more.parentElement, draw);
  };
  const load = async (isMore) => {
    const turn = (state.asked += 1);
    keep({ status: state.status, kind: state.kind, robot: state.robot });
    try {
      const page = await get(`/v1/jobs?${asked({ cursor: isMore ? state.cursor : "" })}`, signal);
      // a later choice is on its way
      if (turn !== state.asked) return;
      Object.assign(state, { jobs: isMore ? [...state.jobs, ...page.items] : page.items, cursor: page.next_cursor, total: page.total });
      draw();
      follow();
    } catch (error) {
      if (error.name === "AbortError") return;
      if (!isMore && rows.childNodes.length === 0) throw error;
      fill(more, problem(error));
    }
  };
  const pick = (id, label, key, options) => el("span.pair", {}, el("label.inline", { for: id }, label), el("select", { id, change: (event) => { state[key] = event.target.value; load(false); } }, options.map(([value, words]) => el("option", { value, selected: value === state[key] }, words))));
  const byName = robots.map((r) => [r.robot_id, r.name]).sort(([, a], [, b]) => a.localeCompare(b, "en", { numeric: true }));
  await load(false);
  fill(main, el("div.head", {}, el("h1", {}, "Jobs")), el("section.card", {}, el("div.controls", {}, pick("job-status", "Show", "status", CHOICES), pick("job-kind", "of", "kind", KINDS), byName.length > 1 && pick("job-robot", "Robot", "robot", [["", "all robots"], ...byName])), rows, more));
}

/** What the table shows of jobs: progress does not stand there. */
const shownOf = (jobs) => JSON.stringify(jobs.map((job) => ({ ...job, progress: null })));

const jobTable = (jobs, names, empty) => table("Calibrations and verifications of all robots, newest first. Error: rms on points that were not fitted.", [
  ["Begun", (job) => el("a", { href: `#/jobs/${job.id}` }, when(job.created_at))], ["Robot", (job) => el("a", { href: `#/robots/${job.robot_id}` }, names.get(job.robot_id) ?? "another robot"), "name"],
  ["State", (job) => [findingBadge(job) ?? statusBadge(job.status), job.error?.detail && el("small.quiet", {}, plain(job.error.detail))], "name"],
  ["What", (job) => (job.kind === "verify" ? "verification" : job.kind === "check" ? "quick check" : job.method ? method(job.method) : "calibration")],
  ["Measurement set", setsOfJob, "name"],
  ["Error", (job) => figureOf(job.rms_mm, job.nominal_rms_mm), "n"],
  ["Took", (job) => (ran(job) === null ? "–" : span(ran(job))), "n"],
], jobs, empty);
