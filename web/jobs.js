// Jobs over all robots, newest first.

import { get, list } from "./api.js";
import { el, fill, table } from "./dom.js";
import { method, ran, span, when } from "./format.js";
import { statusBadge } from "./robot.js";

/** Jobs that are listed. */
const MAX_JOBS = 200;
/** Robots whose newest jobs stand in where the server lists no jobs over all robots. */
const MAX_ROBOTS = 5000;

/** The page. */
export async function jobsPage({ main, signal }) {
  document.title = "kincal: jobs";
  const robots = await list("/v1/overview", MAX_ROBOTS, signal);
  const names = new Map(robots.map((r) => [r.robot_id, r.name]));
  const [jobs, caption] = await all(robots, signal);
  const state = { status: "" };
  const rows = el("div", {});
  const draw = () => fill(rows, table(caption, [
    ["Begun", (job) => el("a", { href: `#/jobs/${job.id}` }, when(job.created_at))], ["Robot", (job) => el("a", { href: `#/robots/${job.robot_id}` }, names.get(job.robot_id) ?? job.robot_id), "name"],
    ["State", (job) => statusBadge(job.status)], ["What", (job) => (job.kind === "verify" ? "verification" : job.kind === "check" ? "check" : job.method ? method(job.method) : "calibration")],
    ["Took", (job) => (ran(job) === null ? "–" : span(ran(job))), "n"], ["Remark", (job) => job.error?.detail ?? "", "name"],
  ], jobs.filter((job) => state.status === "" || job.status === state.status), "No such job."));
  const status = el("select", { id: "job-status", change: () => { state.status = status.value; draw(); } }, [["", "all"], ...["running", "queued", "failed", "succeeded", "cancelled"].map((s) => [s, s])].map(([value, words]) => el("option", { value }, words)));
  draw();
  fill(main, el("div.head", {}, el("h1", {}, "Jobs")), el("section.card", {}, el("div.controls", {}, el("label.inline", { for: "job-status" }, "Show"), status), rows));
}

async function all(robots, signal) {
  const contract = await get("/openapi.json", signal);
  if (contract.paths?.["/v1/jobs"]?.get) return [await list("/v1/jobs", MAX_JOBS, signal), `The last ${MAX_JOBS} jobs of all robots.`];
  const last = robots.filter((r) => r.last_job).map((r) => ({ ...r.last_job, robot_id: r.robot_id, started_at: null }));
  return [last.sort((a, b) => b.created_at.localeCompare(a.created_at)).slice(0, MAX_JOBS), "The newest job of each robot."];
}
