// All robots and their states.

import { each, get, list } from "./api.js";
import { el, fill, problem, table } from "./dom.js";
import { age, capital, error, EVIDENCE, gateTitle, mm, signed, when } from "./format.js";
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
/** The first of them are reasons why a robot needs somebody. */
const REASONS = URGENCY.indexOf("due") + 1;
const isUrgent = (robot) => !["nothing", "calibrate"].includes(robot.need);
const isRunning = (job) => job !== undefined && ["queued", "running"].includes(job.status);
const measured = (robot) => robot.active ?? robot.newest;

/** Whether the newest session does not fit; the list of robots does not have its error. */
const isMisfit = (robot) => robot.need === "check_robot" && robot.need_job_id !== undefined && robot.session?.job_id !== robot.need_job_id;

/** The error that is known of a robot: of the newest session, else at its identification; null where nothing verified it. `checks` are the sessions that do not fit, by robot. */
function errorOf(robot, { checks: known }) {
  const set = measured(robot);
  if (!set) return undefined;
  const check = isMisfit(robot) && known.get(robot.robot_id);
  if (typeof check?.rms_mm === "number") return { mm: check.rms_mm, said: `session of ${when(check.measured_at ?? check.created_at)}, does not fit` };
  const doubt = isMisfit(robot) ? "; a newer session does not fit" : "";
  if (robot.session?.rms_mm !== undefined && robot.session.rms_mm !== null) return { mm: robot.session.rms_mm, said: `session of ${when(robot.session.measured_at ?? robot.session.created_at)}${doubt}` };
  const [words] = EVIDENCE[set.evidence] ?? [];
  return set.evidence === "none" || set.after_rms_mm === null || set.after_rms_mm === undefined ? null : { mm: set.after_rms_mm, said: `at identification, ${words ?? "as stored"}; nominal ${error(set.before_rms_mm)}${doubt}` };
}

/** Ways to sort: the key, the words, and the value of a robot. */
const SORTS = [
  ["need", "what needs you first", (r) => URGENCY.indexOf(r.need)],
  ["name", "name", (r) => r.name.toLowerCase()],
  ["error", "error, largest first", (r, state) => -(errorOf(r, state)?.mm ?? -1)],
  ["released", "release, oldest first", (r) => r.active?.released_at ?? "9"],
  ["job", "last job, newest first", (r) => -Date.parse(r.last_job?.created_at ?? 0)],
];

const robotsOf = (query, signal) => list(`/v1/overview${query}`, MAX_ROBOTS, signal);

/** One robot as the list has it; undefined if it is not there any more. */
export async function overviewOf(robot, signal) {
  const found = await robotsOf(`?archived=all&search=${encodeURIComponent(robot.name)}`, signal);
  return found.find(({ robot_id: id }) => id === robot.id);
}

/** The front page. */
export async function robotsPage({ main, signal, may, why, query, keep }) {
  document.title = "kincal: robots";
  const [inUse, { total: nArchived }] = await Promise.all([robotsOf("", signal), get("/v1/overview?archived=true&limit=1", signal)]);
  const known = (name, values, usual) => (values.includes(query.get(name)) ? query.get(name) : usual);
  const state = { search: query.get("find") ?? "", filter: known("show", ["urgent", "refused", "running", ...URGENCY], "all"), sort: known("sort", SORTS.map(([key]) => key), "need"), shown: FIRST, drifts: new Map(), checks: new Map() };
  const isOfArchive = query.get("show") === "archived" && nArchived > 0;
  let robots = isOfArchive ? await robotsOf("?archived=true", signal) : inUse;
  const count = el("p.quiet", {});
  const [rows, chips, more] = [el("div.robots", {}), el("div.chips", { role: "group", "aria-label": "Show" }), el("div.actions", {})];
  const draw = () => {
    const words = state.search.toLowerCase().split(/\s+/).filter(Boolean);
    const found = robots.filter((r) => words.every((word) => `${r.name} ${r.serial_number ?? ""}`.toLowerCase().includes(word)));
    fill(chips, robots === inUse && filters(found, state, draw), nArchived > 0 && el("button.chip", { type: "button", "aria-pressed": String(robots !== inUse), click: swap }, "Archived", el("b", {}, nArchived)));
    const kept = sorted(found.filter((r) => passes(r, state.filter)), state);
    keep({ find: state.search, show: robots === inUse ? state.filter !== "all" && state.filter : "archived", sort: state.sort !== "need" && state.sort });
    fill(count, counted(kept, robots));
    const page = kept.slice(0, state.shown);
    fill(rows, robotTable(page, state, robots.length > 0 ? noneOf(state) : nArchived > 0 ? "Every robot is archived." : "There is no robot yet."));
    fill(more, kept.length > 0 && el("span.note", { role: "status" }, `${page.length} of ${kept.length}${kept.length < robots.length ? ` that match, of ${robots.length} robots` : kept.length === 1 ? " robot" : " robots"}${robots === inUse ? "" : ", archived"}`),
      kept.length > page.length && el("button", { type: "button", click: () => { state.shown += MORE; draw(); } }, "Show more"));
    drifts(page, state, signal, rows);
    // the order by errors needs those of all sessions that do not fit
    checks(state.sort === "error" ? kept : page, state, signal, rows).then((isNews) => isNews && state.sort === "error" && draw());
  };
  // archived robots are fetched once somebody asks for them
  const swap = async () => {
    try {
      robots = robots === inUse ? await robotsOf("?archived=true", signal) : inUse;
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
  fill(main, el("div.head.brief", {}, el("div", {}, el("h1", {}, "Robots"), inUse.length + nArchived > 0 && count)),
    inUse.length + nArchived === 0 ? welcome() : el("section.card.finder", {}, tools, inUse.length + nArchived > 1 && chips, rows, more), may("upload") ? newRobot() : why("upload", "add robots"));
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

/** Whether stored facts refuse the release of the newest result. */
const isRefused = (robot) => Boolean(refusalOf(robot));

const passes = (robot, filter) => filter === "all" || (filter === "refused" ? isRefused(robot) : (filter === "urgent" ? isUrgent(robot) : filter === "running" ? isRunning(robot.last_job) : robot.need === filter));

function sorted(robots, state) {
  const value = SORTS.find(([known]) => known === state.sort)[2];
  const of = (robot) => value(robot, state);
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
  const needs = URGENCY.map((need) => chip(need, NEEDS[need][2], NEEDS[need][1]));
  return [chip("all", "All"), chip("urgent", "Needs you"), ...needs.slice(0, REASONS), chip("refused", "Release refused", "bad"), chip("running", "Calibrating"), ...needs.slice(REASONS)];
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

/** Misfit of the sessions that do not fit, where the overview does not have it; whether any of them was not known before. */
async function checks(page, state, signal, rows) {
  const open = page.filter((r) => r.need === "check_robot" && r.need_job_id && !state.checks.has(r.robot_id));
  for (const robot of open) state.checks.set(robot.robot_id, null);
  await each(open, async (robot) => {
    const job = await get(`/v1/jobs/${robot.need_job_id}`, signal).catch(() => ({}));
    const set = job.measurement_set_id && await get(`/v1/measurement-sets/${job.measurement_set_id}`, signal).catch(() => undefined);
    state.checks.set(robot.robot_id, { ...job, measured_at: set?.record?.measured_at });
    const place = rows.querySelector(`[data-reason="${robot.robot_id}"]`);
    if (place) fill(place, reasonOf(robot, state));
    const error = rows.querySelector(`[data-error="${robot.robot_id}"]`);
    if (error) fill(error, errorCell(robot, state));
  }, 2);
  return open.length > 0;
}

/** Why a robot is as it is, in one sentence. */
function reasonOf(robot, { checks: known }) {
  const check = robot.need === "check_robot" && known.get(robot.robot_id);
  return typeof check?.rms_mm !== "number" ? capital(robot.reason) : `The session of ${when(check.measured_at ?? check.created_at)} misses by ${mm(check.rms_mm)} rms; no release until one fits`;
}

const isNewer = ({ active, newest }) => active !== undefined && newest !== undefined && newest.id !== active.id && newest.created_at > active.created_at;

/** How far the newer set is from the active one; without a newer one, by how much the error of the active set has grown. */
function driftCell(robot, { drifts: known }) {
  const { active, session } = robot;
  if (!isNewer(robot)) return active && session && active.evidence !== "none" && typeof session.rms_mm === "number" && typeof active.after_rms_mm === "number"
    ? [`${signed(session.rms_mm - active.after_rms_mm, 3)}\u202fmm`, el("small.quiet", {}, `error was ${error(active.after_rms_mm)}`)] : "–";
  const found = known.get(robot.robot_id);
  if (found === null || !known.has(robot.robot_id)) return "…";
  return found === undefined ? "–" : [mm(found.mean_mm), el("small.quiet", {}, `at most ${error(found.max_mm)}`)];
}

/** State of a robot, as badges; with a link to the job that shows it. */
export function standing(robot) {
  const [words, kind] = NEEDS[robot.need] ?? [robot.need, "wait"];
  const text = robot.need === "review" && robot.active ? `newer ${words}` : words;
  const runs = isRunning(robot.last_job);
  const badge = (said, color, id) => el([id ? "a" : "span", "badge", color].filter(Boolean).join("."), { href: id && `#/jobs/${id}` }, said);
  return [runs && badge("calibrating", "wait", robot.last_job.id), runs && " ", !(runs && robot.need === "calibrate") && badge(text, kind, isUrgent(robot) && robot.need_job_id)];
}

/** The first stored fact that refuses a release of the newest result; nothing where none is known or no result waits. */
function refusalOf({ need, newest, active }) {
  const isOlder = active !== undefined && newest !== undefined && newest.created_at < active.created_at;
  return newest?.status !== "candidate" || need === "check_robot" || isOlder ? undefined : newest.refused_by;
}

function releaseOf(robot) {
  const refused = isRefused(robot) && gateTitle({ gate: refusalOf(robot), passed: false });
  return Boolean(refused) && el("small.quiet", {}, el("strong", {}, "Release refused"), `: ${refused.replace(/^./, (c) => c.toLowerCase())}`);
}

function badges(robot, state) {
  const reason = reasonOf(robot, state);
  const isLinked = robot.need_job_id && isUrgent(robot);
  return [standing(robot), reason && !(isRunning(robot.last_job) && !isLinked) && el(isLinked ? "small" : "small.quiet", {}, el(isLinked ? "a" : "span", { href: isLinked && `#/jobs/${robot.need_job_id}`, "data-reason": robot.robot_id }, reason)), releaseOf(robot)];
}

function errorCell(robot, state) {
  const found = errorOf(robot, state);
  if (found === undefined) return "–";
  return found === null ? ["not verified", el("small.quiet", {}, "no point was held out that counts")] : [mm(found.mm), el("small.quiet", {}, found.said)];
}

/** How the newest job ended, and what it found. */
const ended = ({ need, need_job_id: id, last_job: job }) => (job.id !== id ? job.status : need === "check_robot" ? "does not fit" : need === "drifted" ? "speaks against the set" : job.status);

function robotTable(robots, state, empty) {
  const columns = [
    ["Robot", (r) => [el("a", { href: `#/robots/${r.robot_id}` }, r.name), r.serial_number && el("small.quiet", {}, r.serial_number)], "name"],
    ["State", (r) => badges(r, state), "name"],
    ["Active set", ({ active }) => (active ? el("span", { title: when(active.released_at) }, age(active.released_at)) : "none")],
    ["Error, rms", (r) => (measured(r) ? el("span", { "data-error": r.robot_id }, errorCell(r, state)) : "–"), "n"],
    ["Drift", (r) => el("span", { "data-drift": r.robot_id }, driftCell(r, state)), "n"],
    ["Last job", (r) => (r.last_job ? [el("a", { href: `#/jobs/${r.last_job.id}` }, ended(r)), el("small.quiet", {}, age(r.last_job.finished_at ?? r.last_job.created_at))] : "–")],
  ];
  const caption = "Error: of the newest session, else of the active or the newest set on points that were not fitted; below it where these points come from. Drift: how far a newer result puts the tool from the active one, on average over the workspace; without a newer result, how much the error has grown since the active set was identified. Release: by what is stored; the page of a result asks all gates.";
  return table(caption, columns, robots, empty);
}

/** Longest remark that stands in its card; a longer one is folded, so that the cards stay alike. */
const MAX_REMARK = 150;

/** Facts as large numbers: [name, value, remark]. */
export function facts(entries) {
  const small = (remark) => (typeof remark === "string" && remark.length > MAX_REMARK ? el("details", {}, el("summary", {}, "Why"), el("small", {}, remark)) : el("small", {}, remark));
  return el("dl.facts", {}, entries.filter(Boolean).map(([name, value, remark]) => el("div.fact", {}, el("dt", {}, name), el("dd", {}, value, remark && small(remark)))));
}
