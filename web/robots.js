// All robots and their states.

import { get, list } from "./api.js";
import { drawMore, el, fill, problem, table, withFocus } from "./dom.js";
import { age, capital, EVIDENCE, gateTitle, mm, signed, when } from "./format.js";
import { forget, hasDrifted, isNewer, learn, noFacts, refusals } from "./list_facts.js";
import { newRobot } from "./new_robot.js";
import { isRunning, whileRunning } from "./polling.js";
import { asksToLook } from "./verdicts.js";

/** Robots that are shown at first, and how many more each click shows. */
const [FIRST, MORE] = [20, 100];
/** Most robots that are listed. */
const MAX_ROBOTS = 5000;

/** Needs in the order of their urgency: the words of the badge, its kind, the words of the filter. */
const NEEDS = {
  check_robot: ["check this robot", "bad", "Check the robot"],
  drifted: ["drifted", "bad", "Drifted"],
  withdrawn: ["withdrawn", "bad", "Withdrawn"],
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
const measured = (robot) => robot.active ?? robot.newest;

/** Whether the list of robots does not have the error of the session that asks for a look at the robot. */
const isMisfit = (robot) => robot.need === "check_robot" && robot.need_job_id !== undefined && robot.session?.job_id !== robot.need_job_id;

/** The error that is known of a robot: of the newest session, else at its identification; null where nothing verified it. `checks` are the sessions that do not fit, by robot. */
function errorOf(robot, { checks: known }) {
  const set = measured(robot);
  if (!set) return undefined;
  const check = isMisfit(robot) && known.get(robot.robot_id);
  if (typeof check?.rms_mm === "number") return { mm: check.rms_mm, said: `session of ${when(check.measured_at ?? check.created_at)}, ${asksToLook(check).short}` };
  const doubt = isMisfit(robot) ? `; newer session: ${asksToLook(check).short}` : "";
  if (robot.session?.rms_mm !== undefined && robot.session.rms_mm !== null) return { mm: robot.session.rms_mm, said: `session of ${when(robot.session.measured_at ?? robot.session.created_at)}${doubt}` };
  const [words] = EVIDENCE[set.evidence] ?? [];
  return set.evidence === "none" || set.after_rms_mm === null || set.after_rms_mm === undefined ? null : { mm: set.after_rms_mm, said: `at identification, ${words ?? "as stored"}; nominal ${mm(set.before_rms_mm)}${doubt}` };
}

/** Ways to sort: the key, the words, and the value of a robot. */
const SORTS = [
  ["need", "what needs you first", (r, state) => severity(r, state)],
  ["name", "name", (r) => r.name.toLowerCase()],
  ["error", "error, largest first", (r, state) => -(errorOf(r, state)?.mm ?? -1)],
  ["released", "release, oldest first", (r) => r.active?.released_at ?? "9"],
  ["job", "last job, newest first", (r) => -Date.parse(r.last_job?.created_at ?? 0)],
];

/** From what is wrong in production to what needs nobody; of each fault first the robots with a set in force, then those without. A newer result than the active set, and one that a release refuses, before other results that wait. */
const FAULTS = ["check_robot", "drifted", "job_failed", "withdrawn"];
const RANKS = [...FAULTS, ...FAULTS.map((fault) => `${fault}, nothing in force`), "newer", "refused", "review", "due", "calibrate", "nothing"];
/** No figure counts as more, mm. */
const MOST_MM = 1e5;

/** How severe it is; among robots of one rank the larger figure comes first. */
function severity(robot, state) {
  const rank = hasDrifted(robot, state) && robot.need !== "check_robot" ? "drifted" : robot.need !== "review" ? robot.need : isNewer(robot) ? "newer" : isRefused(robot, state) ? "refused" : "review";
  const size = ["check_robot", "drifted", "newer", "refused"].includes(rank) ? Math.max(state.drifts.get(robot.robot_id)?.mean_mm ?? 0, errorOf(robot, state)?.mm ?? 0) : 0;
  // what a cell runs on comes before what no cell uses yet
  const place = RANKS.indexOf(rank) + (FAULTS.includes(rank) && !robot.active ? FAULTS.length : 0);
  return place * 10 * MOST_MM - Math.min(size, MOST_MM);
}

const robotsOf = (query, signal) => list(`/v1/overview${query}`, MAX_ROBOTS, signal);

/** One robot as the list has it; undefined if it is not there any more. */
export async function overviewOf(robot, signal) {
  const found = await robotsOf(`?archived=all&search=${encodeURIComponent(robot.name)}`, signal);
  return found.find(({ robot_id: id }) => id === robot.id);
}

/** The front page. */
export async function robotsPage({ main, signal, may, why, query, keep }) {
  document.title = "kincal: robots";
  let [inUse, { total: nArchived }] = await Promise.all([robotsOf("", signal), get("/v1/overview?archived=true&limit=1", signal)]);
  const known = (name, values, usual) => (values.includes(query.get(name)) ? query.get(name) : usual);
  const state = { search: query.get("find") ?? "", filter: known("show", ["urgent", "refused", "running", ...URGENCY], "all"), sort: known("sort", SORTS.map(([key]) => key), "need"), shown: FIRST, ...noFacts() };
  const isOfArchive = query.get("show") === "archived" && nArchived > 0;
  let robots = isOfArchive ? await robotsOf("?archived=true", signal) : inUse;
  const count = el("p.quiet", {});
  const [rows, chips, more] = [el("div.robots", {}), el("div.chips", { role: "group", "aria-label": "Show" }), el("div.actions", {})];
  const draw = () => {
    const found = matching(robots, state.search.toLowerCase().trim());
    fill(chips, robots === inUse && filters(found, state, draw), nArchived > 0 && el("button.chip", { type: "button", "aria-pressed": String(robots !== inUse), click: swap }, "Archived", el("b", {}, nArchived)));
    const kept = sorted(found.filter((r) => passes(r, state)), state);
    keep({ find: state.search, show: robots === inUse ? state.filter !== "all" && state.filter : "archived", sort: state.sort !== "need" && state.sort });
    fill(count, counted(kept, robots));
    const page = kept.slice(0, state.shown);
    fill(rows, robotTable(page, state, robots.length > 0 ? noneOf(state, found.length) : nArchived > 0 ? "Every robot is archived." : "There is no robot yet."));
    fill(more, kept.length > 0 && el("span.note", { role: "status" }, `${page.length} of ${kept.length}${kept.length < robots.length ? ` that match, of ${robots.length} robots` : kept.length === 1 ? " robot" : " robots"}${robots === inUse ? "" : ", archived"}`),
      kept.length > page.length && el("button", { type: "button", click: () => drawMore(rows, () => { state.shown += MORE; draw(); }) }, "Show more"));
    // what comes later may change the order and the counts; an archived robot asks for nothing
    if (robots === inUse) learn(robots, state, signal, (robot) => update(robot, state, rows)).then((isNews) => isNews && !signal.aborted && withFocus(rows.parentElement, draw));
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
  const refresh = async () => {
    const fresh = await robotsOf("", signal);
    forget(inUse, fresh, state);
    const isShown = robots === inUse;
    inUse = fresh;
    if (!isShown) return;
    robots = fresh;
    withFocus(rows.parentElement, draw);
  };
  // not awaited: the page is there already
  whileRunning(() => inUse.some((robot) => isRunning(robot.last_job)), refresh, signal);
}

/** What an empty page leads to. */
const welcome = () => el("section.card", {}, el("h2", {}, "There is no robot yet"), el("p", {}, "A calibration measures where an arm really is, and finds the true lengths and angles of its links. This is the way to it:"),
  el("ol.path", {}, [["Add the robot", "From the library or its file, below. Compare the arm on the page with the one in the cell."], ["Measure and upload", "30 or more poses with a tracker. The page plans them, and checks your file before it stores anything."], ["Calibrate, verify, release", "See what the arm gains, check it on a second session, release it, and correct your programs."]]
    .map(([name, said], i) => el(i === 0 ? "li.now" : "li", {}, el("strong", {}, name), el("span", {}, said)))));

/** The robots with these words in name or serial number: where any has the words as they stand, no others. */
function matching(robots, searched) {
  const has = (text) => (robot) => `${robot.name}\n${robot.serial_number ?? ""}`.toLowerCase().includes(text);
  const whole = robots.filter(has(searched));
  const words = searched.split(/\s+/);
  return whole.length > 0 ? whole : robots.filter((robot) => words.every((word) => has(word)(robot)));
}

/** How many robots are shown, and how many of them need somebody. */
function counted(shown, robots) {
  const urgent = shown.filter(isUrgent).length;
  const all = shown.length < robots.length ? `${shown.length} of ${robots.length} robots` : robots.length === 1 ? "One robot" : `${robots.length} robots`;
  if (shown.length === 0) return `${all}.`;
  return urgent === 0 ? `${all}; none needs you.` : `${all}; ${shown.length === 1 ? "it needs" : urgent === 1 ? "one needs" : `${urgent} need`} you.`;
}

/** Why the list is empty. */
const noneOf = ({ search, filter }, nFound) => `No robot matches${search.trim() ? ` "${search.trim()}"` : ""}${filter === "all" || nFound === 0 ? "" : " with this filter: choose All to see the others"}.`;

/** Whether a release of the newest result would be refused. */
const isRefused = (robot, state) => refusals(robot, state).length > 0;

/** What the filters that are no need let through. */
const FILTERS = { all: () => true, refused: isRefused, urgent: isUrgent, running: (robot) => isRunning(robot.last_job), drifted: hasDrifted };
const passes = (robot, state, filter = state.filter) => FILTERS[filter]?.(robot, state) ?? robot.need === filter;

function sorted(robots, state) {
  const value = SORTS.find(([known]) => known === state.sort)[2];
  const of = (robot) => value(robot, state);
  return [...robots].sort((a, b) => (of(a) < of(b) ? -1 : of(a) > of(b) ? 1 : a.name.localeCompare(b.name, "en", { numeric: true })));
}

/** How many robots need what; each is a filter. */
function filters(found, state, draw) {
  const chip = (key, words, kind) => {
    const n = found.filter((r) => passes(r, state, key)).length;
    if (n === 0 && key !== state.filter && key !== "all") return false;
    const press = () => { Object.assign(state, { filter: state.filter === key ? "all" : key, shown: FIRST }); draw(); document.querySelector(".chips [aria-pressed=true]")?.focus(); };
    return el(kind ? `button.chip.${kind}` : "button.chip", { type: "button", "aria-pressed": String(state.filter === key), click: press }, words, el("b", {}, n));
  };
  const needs = URGENCY.map((need) => chip(need, NEEDS[need][2], NEEDS[need][1]));
  return [chip("all", "All"), chip("urgent", "Needs you"), ...needs.slice(0, REASONS), chip("refused", "Release refused", "bad"), chip("running", "Calibrating"), ...needs.slice(REASONS)];
}

/** Shows what came of one robot in its row. */
function update(robot, state, rows) {
  const put = (name, content) => { const place = rows.querySelector(`[data-${name}="${robot.robot_id}"]`); if (place) fill(place, content(robot, state)); };
  put("drift", driftCell);
  put("reason", reasonOf);
  put("error", errorCell);
  put("ended", ended);
}

/** Why a robot is as it is, in one sentence. */
function reasonOf(robot, state) {
  const check = robot.need === "check_robot" && state.checks.get(robot.robot_id);
  const apart = robot.need !== "drifted" && hasDrifted(robot, state) && state.drifts.get(robot.robot_id)?.mean_mm;
  if (apart) return `A newer result puts the tool ${mm(apart)} from where the active set has it`;
  return robot.need !== "check_robot" ? capital(robot.reason) : `${asksToLook(check).sentence}; no release until a session fits`;
}

/** How far the newer set is from the active one; without a newer one, by how much the error of the active set has grown. */
function driftCell(robot, state) {
  const { active, session } = robot;
  const { drifts: known } = state;
  const now = isMisfit(robot) ? state.checks.get(robot.robot_id)?.rms_mm : session?.rms_mm;
  if (!isNewer(robot)) return active && active.evidence !== "none" && typeof now === "number" && typeof active.after_rms_mm === "number"
    ? [`${signed(now - active.after_rms_mm, 3)}\u202fmm`, el("small.quiet", {}, `error was ${mm(active.after_rms_mm)}`)] : "–";
  const found = known.get(robot.robot_id);
  if (found === null || !known.has(robot.robot_id)) return "…";
  return found === undefined ? "–" : [mm(found.mean_mm), el("small.quiet", {}, `at most ${mm(found.max_mm)}`)];
}

/** State of a robot, as badges; with a link to the job that shows it. */
export function standing(robot, state = noFacts()) {
  const [words, kind] = NEEDS[robot.need] ?? [robot.need, "wait"];
  const text = robot.need === "review" && robot.active ? `newer ${words}` : words;
  const runs = isRunning(robot.last_job);
  const badge = (said, color, id) => el([id ? "a" : "span", "badge", color].filter(Boolean).join("."), { href: id && `#/jobs/${id}` }, said);
  const drifted = robot.need !== "drifted" && hasDrifted(robot, state);
  return [drifted && [badge(...NEEDS.drifted.slice(0, 2), robot.newest.job_id), " "], runs && badge("calibrating", "wait", robot.last_job.id), runs && " ", !(runs && robot.need === "calibrate") && badge(text, kind, isUrgent(robot) && robot.need_job_id)];
}

function releaseOf(robot, state) {
  const [gate] = refusals(robot, state);
  return gate !== undefined && el("small.quiet", {}, el("strong", {}, "Release refused"), `: ${gateTitle({ gate, passed: false }).replace(/^./, (c) => c.toLowerCase())}`);
}

function badges(robot, state) {
  const reason = reasonOf(robot, state);
  const isLinked = robot.need_job_id && isUrgent(robot);
  return [standing(robot, state), reason && !(isRunning(robot.last_job) && !isLinked) && el(isLinked ? "small" : "small.quiet", {}, el(isLinked ? "a" : "span", { href: isLinked && `#/jobs/${robot.need_job_id}`, "data-reason": robot.robot_id }, reason)), releaseOf(robot, state)];
}

function errorCell(robot, state) {
  const found = errorOf(robot, state);
  if (found === undefined) return "–";
  return found === null ? ["not verified", el("small.quiet", {}, "no point was held out that counts")] : [mm(found.mm), el("small.quiet", {}, found.said)];
}

/** How the newest job ended, and what it found. */
const ended = ({ robot_id: robot, need, need_job_id: id, last_job: job }, { checks }) => (job.id !== id ? job.status : need === "check_robot" ? asksToLook(checks.get(robot)).short : need === "drifted" ? "speaks against the set" : job.status);

/** Whether the newest job identified what does not fit. */
const hasMisfit = ({ newest, last_job: job }) => newest?.job_id === job.id && newest.refused_by === "fits";

function robotTable(robots, state, empty) {
  const columns = [
    ["Robot", (r) => [el("a", { href: `#/robots/${r.robot_id}` }, r.name), r.serial_number && el("small.quiet", {}, r.serial_number)], "name"],
    ["State", (r) => badges(r, state), "name"],
    ["In force since", ({ active }) => (active ? el("span", { title: when(active.released_at) }, age(active.released_at)) : "–")],
    ["Error, rms", (r) => (measured(r) ? el("span", { "data-error": r.robot_id }, errorCell(r, state)) : "–"), "n"],
    ["Drift", (r) => (isNewer(r) || isMisfit(r) ? el("span", { "data-drift": r.robot_id }, driftCell(r, state)) : driftCell(r, state)), "n"],
    ["Last job", (r) => (r.last_job ? [el("a", { href: `#/jobs/${r.last_job.id}` }, hasMisfit(r) ? "does not fit" : el("span", { "data-ended": r.robot_id }, ended(r, state))), el("small.quiet", {}, age(r.last_job.finished_at ?? r.last_job.created_at))] : "–")],
  ];
  const caption = "Error: of the newest session, else of the active or the newest set on points that were not fitted; below it where these points come from. Drift: how far a newer result puts the tool from the active one, on average over the workspace; without a newer result, how much the error has grown since the active set was identified.";
  return table(caption, columns, robots, empty);
}

/** Longest remark that stands in its card; a longer one is folded, so that the cards stay alike. */
const MAX_REMARK = 150;

/** Facts as large numbers: [name, value, remark]. */
export function facts(entries) {
  const small = (remark) => (typeof remark === "string" && remark.length > MAX_REMARK ? el("details", {}, el("summary", {}, "Why"), el("small", {}, remark)) : el("small", {}, remark));
  return el("dl.facts", {}, entries.filter(Boolean).map(([name, value, remark]) => el("div.fact", {}, el("dt", {}, name), el("dd", {}, value, remark && small(remark)))));
}
