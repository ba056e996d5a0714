// All robots and their states.

import { each, get, list } from "./api.js";
import { el, fill, problem, table } from "./dom.js";
import { age, capital, error, EVIDENCE, mm, when } from "./format.js";
import { newRobot } from "./new_robot.js";

/** Robots that are shown at first, and how many more each click shows. */
const [FIRST, MORE] = [20, 100];
/** Most robots that are listed. */
const MAX_ROBOTS = 5000;

/** Needs in the order of their urgency: the words of the badge, its kind, the words of the filter. */
const NEEDS = {
  check_robot: ["check this robot", "bad", "Check the robot"],
  drifted: ["drifted", "bad", "Drifted"],
  job_failed: ["job failed", "bad", "Job failed"],
  review: ["result to review", "wait", "To review"],
  due: ["due", "wait", "Due"],
  calibrate: ["not calibrated", "", "Not calibrated"],
  nothing: ["released", "good", "In order"],
};
const URGENCY = Object.keys(NEEDS);
const isUrgent = (robot) => !["nothing", "calibrate"].includes(robot.need);
const isRunning = (job) => job !== undefined && ["queued", "running"].includes(job.status);
const measured = (robot) => robot.active ?? robot.newest;

/** The error that is known of a robot: of the newest session that the active set was scored on, else at its identification; null where nothing verified it. */
function errorOf(robot) {
  const set = measured(robot);
  if (!set) return undefined;
  const doubt = robot.need === "check_robot" ? "; a newer session does not fit" : "";
  if (robot.session?.rms_mm !== undefined && robot.session.rms_mm !== null) return { mm: robot.session.rms_mm, said: `session of ${when(robot.session.created_at)}${doubt}` };
  const [words] = EVIDENCE[set.evidence] ?? [];
  return set.evidence === "none" || set.after_rms_mm === null || set.after_rms_mm === undefined ? null : { mm: set.after_rms_mm, said: `at identification, ${words ?? "as stored"}; nominal ${error(set.before_rms_mm)}${doubt}` };
}

/** Ways to sort: the key, the words, and the value of a robot. */
const SORTS = [
  ["need", "what needs you first", (r) => URGENCY.indexOf(r.need)],
  ["name", "name", (r) => r.name.toLowerCase()],
  ["error", "error, largest first", (r) => -(errorOf(r)?.mm ?? -1)],
  ["released", "release, oldest first", (r) => r.active?.released_at ?? "9"],
  ["job", "last job, newest first", (r) => -Date.parse(r.last_job?.created_at ?? 0)],
];

/** The front page. */
export async function robotsPage({ main, signal, may, why, query, keep }) {
  document.title = "kincal: robots";
  const [inUse, { total: nArchived }] = await Promise.all([list("/v1/overview", MAX_ROBOTS, signal), get("/v1/overview?archived=true&limit=1", signal)]);
  const known = (name, values, usual) => (values.includes(query.get(name)) ? query.get(name) : usual);
  const state = { search: query.get("find") ?? "", filter: known("show", ["urgent", "running", ...URGENCY], "all"), sort: known("sort", SORTS.map(([key]) => key), "need"), shown: FIRST, drifts: new Map() };
  const isOfArchive = query.get("show") === "archived" && nArchived > 0;
  let robots = isOfArchive ? await list("/v1/overview?archived=true", MAX_ROBOTS, signal) : inUse;
  const count = el("p.quiet", {});
  const [rows, chips, more] = [el("div", {}), el("div.chips", { role: "group", "aria-label": "Show" }), el("div.actions", {})];
  const draw = () => {
    const words = state.search.toLowerCase().split(/\s+/).filter(Boolean);
    const found = robots.filter((r) => words.every((word) => `${r.name} ${r.serial_number ?? ""}`.toLowerCase().includes(word)));
    fill(chips, robots === inUse && filters(found, state, draw), nArchived > 0 && el("button.chip", { type: "button", "aria-pressed": String(robots !== inUse), click: swap }, "Archived", el("b", {}, nArchived)));
    const kept = sorted(found.filter((r) => passes(r, state.filter)), state.sort);
    keep({ find: state.search, show: robots === inUse ? state.filter !== "all" && state.filter : "archived", sort: state.sort !== "need" && state.sort });
    fill(count, counted(kept, robots));
    const page = kept.slice(0, state.shown);
    fill(rows, robotTable(page, state, robots.length > 0 ? noneOf(state) : nArchived > 0 ? "Every robot is archived." : "There is no robot yet."));
    fill(more, kept.length > 0 && el("span.note", { role: "status" }, `${page.length} of ${kept.length}${kept.length < robots.length ? ` that match, of ${robots.length} robots` : kept.length === 1 ? " robot" : " robots"}${robots === inUse ? "" : ", archived"}`),
      kept.length > page.length && el("button", { type: "button", click: () => { state.shown += MORE; draw(); } }, "Show more"));
    drifts(page, state, signal, rows);
  };
  // archived robots are fetched once somebody asks for them
  const swap = async () => {
    try {
      robots = robots === inUse ? await list("/v1/overview?archived=true", MAX_ROBOTS, signal) : inUse;
      Object.assign(state, { filter: "all", shown: FIRST });
      draw();
      chips.lastElementChild?.focus();
    } catch (error) {
      if (error.name !== "AbortError") fill(rows, problem(error));
    }
  };
  const search = el("input", { id: "robot-search", type: "search", placeholder: "name or serial number", autocomplete: "off", value: state.search, input: () => { Object.assign(state, { search: search.value, shown: FIRST }); draw(); } });
  const sort = el("select", { id: "robot-sort", change: () => { state.sort = sort.value; draw(); } }, SORTS.map(([key, words]) => el("option", { value: key, selected: key === state.sort }, words)));
  const tools = inUse.length + nArchived > 1 && el("div.controls", {}, el("label.inline", { for: "robot-search" }, "Find"), search, el("label.inline", { for: "robot-sort" }, "Sort by"), sort);
  draw();
  fill(main, el("div.head", {}, el("div", {}, el("h1", {}, "Robots"), inUse.length + nArchived > 0 && count)),
    inUse.length + nArchived === 0 ? welcome() : el("section.card", {}, tools, inUse.length + nArchived > 1 && chips, rows, more), may("upload") ? newRobot() : why("upload", "add robots"));
}

/** What an empty page leads to. */
const welcome = () => el("section.card", {}, el("h2", {}, "There is no robot yet"), el("p", {}, "A calibration measures where an arm really is, and finds the true lengths and angles of its links. This is the way to it:"),
  el("ol.path", {}, [["Add the robot", "From the library or its file, below. Compare the arm on the page with the one in the cell."], ["Measure and upload", "30 or more poses with a tracker. The page plans them, and checks your file before it stores anything."], ["Calibrate, verify, release", "See what the arm gains, check it on a second session, release it, and correct your programs."]]
    .map(([name, said], i) => el(i === 0 ? "li.now" : "li", {}, el("strong", {}, name), el("span", {}, said)))));

/** How many robots are shown, and how many of them need somebody. */
function counted(shown, robots) {
  const urgent = shown.filter(isUrgent).length;
  const all = shown.length < robots.length ? `${shown.length} of ${robots.length} robots` : robots.length === 1 ? "One robot" : `${robots.length} robots`;
  if (shown.length === 0) return `${all}.`;
  return urgent === 0 ? `${all}; none needs you.` : `${all}; ${shown.length === 1 ? "it needs" : urgent === 1 ? "one needs" : `${urgent} need`} you.`;
}

/** Why the list is empty. */
const noneOf = ({ search, filter }) => `No robot matches${search.trim() ? ` "${search.trim()}"` : ""}${filter === "all" ? "" : " with this filter: choose All to see the others"}.`;

const passes = (robot, filter) => filter === "all" || (filter === "urgent" ? isUrgent(robot) : filter === "running" ? isRunning(robot.last_job) : robot.need === filter);

function sorted(robots, key) {
  const of = SORTS.find(([known]) => known === key)[2];
  return [...robots].sort((a, b) => (of(a) < of(b) ? -1 : of(a) > of(b) ? 1 : a.name.localeCompare(b.name, "en", { numeric: true })));
}

/** How many robots need what; each is a filter. */
function filters(found, state, draw) {
  const chip = (key, words, kind) => {
    const n = found.filter((r) => passes(r, key)).length;
    if (n === 0 && key !== state.filter && key !== "all") return false;
    const press = () => { Object.assign(state, { filter: state.filter === key ? "all" : key, shown: FIRST }); draw(); document.querySelector(".chips [aria-pressed=true]")?.focus(); };
    return el(kind ? `button.chip.${kind}` : "button.chip", { type: "button", "aria-pressed": String(state.filter === key), click: press }, words, el("b", {}, n));
  };
  return [chip("all", "All"), chip("urgent", "Needs you"), ...URGENCY.map((need) => chip(need, NEEDS[need][2], NEEDS[need][1])), chip("running", "Calibrating")];
}

/** The drift of robots with a newer result, as the service computes it: for those in sight only, because each is some work. */
async function drifts(page, state, signal, rows) {
  const open = page.filter((r) => isNewer(r) && !state.drifts.has(r.robot_id));
  for (const robot of open) state.drifts.set(robot.robot_id, null);
  await each(open, async (robot) => {
    const found = await get(`/v1/parameter-sets/${robot.newest.id}/compare?with=${robot.active.id}`, signal).catch(() => undefined);
    state.drifts.set(robot.robot_id, found);
    const cell = rows.querySelector(`[data-drift="${robot.robot_id}"]`);
    if (cell) fill(cell, driftCell(robot, state));
  }, 2);
}

const isNewer = ({ active, newest }) => active !== undefined && newest !== undefined && newest.id !== active.id && newest.created_at > active.created_at;

function driftCell(robot, { drifts: known }) {
  if (!isNewer(robot)) return "–";
  const found = known.get(robot.robot_id);
  if (found === null || !known.has(robot.robot_id)) return "…";
  return found === undefined ? "–" : [mm(found.mean_mm), el("small.quiet", {}, `at most ${error(found.max_mm)}`)];
}

/** State of a robot, as a badge. */
export function standing({ robot, active, since, newest, lastJob }) {
  if (robot.state === "check_robot") return el("span.badge.bad", {}, "check this robot");
  if (lastJob && ["queued", "running"].includes(lastJob.status)) return el("a.badge.wait", { href: `#/jobs/${lastJob.id}` }, "calibrating");
  if (since) return el("a.badge.wait", { href: `#/jobs/${since.job_id}` }, "newer result to review");
  if (active) return el("span.badge.good", {}, "released");
  if (newest) return el("a.badge.wait", { href: `#/jobs/${newest.job_id}` }, "result to review");
  return el("span.badge", {}, "not calibrated");
}

function badges(robot) {
  const [words, kind] = NEEDS[robot.need] ?? [robot.need, "wait"];
  const text = robot.need === "review" && robot.active ? `newer ${words}` : words;
  const runs = isRunning(robot.last_job);
  const badge = el(kind ? `span.badge.${kind}` : "span.badge", {}, text);
  return [runs && el("span.badge.wait", {}, "calibrating"), runs && " ", !(runs && robot.need === "calibrate") && badge,
    robot.need_job_id && isUrgent(robot) ? el("small", {}, el("a", { href: `#/jobs/${robot.need_job_id}` }, capital(robot.reason))) : robot.reason && !runs && el("small.quiet", {}, capital(robot.reason))];
}

function errorCell(robot) {
  const found = errorOf(robot);
  if (found === undefined) return "–";
  return found === null ? ["not verified", el("small.quiet", {}, "no point was held out that counts")] : [mm(found.mm), el("small.quiet", {}, found.said)];
}

function robotTable(robots, state, empty) {
  const columns = [
    ["Robot", (r) => [el("a", { href: `#/robots/${r.robot_id}` }, r.name), r.serial_number && el("small.quiet", {}, r.serial_number)], "name"],
    ["State", badges, "name"],
    ["Active set", ({ active }) => (active ? el("span", { title: when(active.released_at) }, age(active.released_at)) : "none")],
    ["Error, rms", errorCell, "n"],
    ["Drift", (r) => el("span", { "data-drift": r.robot_id }, driftCell(r, state)), "n"],
    ["Last job", ({ last_job: job, need, need_job_id: doubted }) => (job ? [el("a", { href: `#/jobs/${job.id}` }, need === "check_robot" && job.id === doubted ? "does not fit" : job.status), el("small.quiet", {}, age(job.finished_at ?? job.created_at))] : "–")],
  ];
  const caption = "Error: of the active set, else of the newest, on points that were not fitted; below it where these points come from. Drift: how far the newest result puts the tool from the active one, on average over the workspace.";
  return table(caption, columns, robots, empty);
}

/** Longest remark that stands in its card; a longer one is folded, so that the cards stay alike. */
const MAX_REMARK = 150;

/** Facts as large numbers: [name, value, remark]. */
export function facts(entries) {
  const small = (remark) => (typeof remark === "string" && remark.length > MAX_REMARK ? el("details", {}, el("summary", {}, "Why"), el("small", {}, remark)) : el("small", {}, remark));
  return el("dl.facts", {}, entries.filter(Boolean).map(([name, value, remark]) => el("div.fact", {}, el("dt", {}, name), el("dd", {}, value, remark && small(remark)))));
}
