// All robots and their states.

import { each, get, post } from "./api.js";
import { el, fill, problem, say, table } from "./dom.js";
import { age, error, mm, when } from "./format.js";
import { best, state } from "./history.js";

const PAGE = 20;

/** The front page. */
export async function robotsPage({ main, signal, may }) {
  document.title = "kincal: robots";
  const rows = el("div", {});
  const more = el("div.actions", {});
  const shown = [];
  let busy = false;
  const next = async (cursor) => {
    const page = await get(`/v1/robots?limit=${PAGE}${cursor ? `&cursor=${encodeURIComponent(cursor)}` : ""}`, signal);
    const states = await each(page.items, (robot) => state(robot, signal), 3);
    shown.push(...page.items.map((robot, i) => ({ robot, ...states[i] })));
    fill(rows, robotTable(shown));
    fill(more, page.next_cursor && el("button", { type: "button", click: () => showMore(page.next_cursor) }, "Show more"));
  };
  // a second click meanwhile would list the same robots twice
  const showMore = async (cursor) => {
    if (busy) return;
    busy = true;
    try {
      await next(cursor);
    } catch (error) {
      if (error.name !== "AbortError") say(`No more robots could be listed: ${error.detail ?? error.message}`);
    } finally {
      busy = false;
    }
  };
  await next(null);
  fill(main, el("div.head", {}, el("div", {}, el("h1", {}, "Robots"))), el("section.card", {}, rows, more), may("upload") && newRobot());
}

/** State of a robot, as a badge. */
export function standing({ robot, active, since, newest, lastJob }) {
  if (robot.state === "check_robot") return el("span.badge.bad", {}, "check this robot");
  if (lastJob && ["queued", "running"].includes(lastJob.status)) return el("span.badge.wait", {}, "calibrating");
  if (since) return el("span.badge.wait", {}, "newer result to review");
  if (active) return el("span.badge.good", {}, "released");
  if (newest) return el("span.badge.wait", {}, "result to review");
  return el("span.badge", {}, "not calibrated");
}

function robotTable(states) {
  const columns = [
    ["Robot", ({ robot }) => [el("a", { href: `#/robots/${robot.id}` }, robot.name), robot.serial_number && el("small.quiet", {}, robot.serial_number)], "name"],
    ["State", (row) => standing(row)],
    ["Active set", ({ active }) => (active ? el("span", { title: when(active.released_at) }, age(active.released_at)) : "none")],
    ["Error, rms", ({ report }) => (report ? [mm(best(report).after.rms_mm), el("small.quiet", {}, `nominal ${error(best(report).before.rms_mm)}`)] : "–"), "n"],
    ["Drift", ({ drift }) => (drift ? [mm(drift.mean_mm), el("small.quiet", {}, `at most ${error(drift.max_mm)}`)] : "–"), "n"],
    ["Last job", ({ lastJob }) => (lastJob ? [el("a", { href: `#/jobs/${lastJob.id}` }, lastJob.status), el("small.quiet", {}, age(lastJob.finished_at ?? lastJob.created_at))] : "–")],
  ];
  const caption = "Error: of the active set, else of the newest, on points that were not fitted; below it that of the nominal robot. Drift: how far the newest result puts the tool from the active one, on average over the workspace.";
  return table(caption, columns, states, "There is no robot yet. Add one below, or with POST /v1/robots.");
}

function newRobot() {
  const out = el("div", {});
  const file = el("input", { id: "robot-file", type: "file", accept: ".json,application/json", required: true });
  const submit = async (event) => {
    event.preventDefault();
    if (file.files.length === 0) return;
    try {
      const robot = await post("/v1/robots", await file.files[0].text());
      location.hash = `#/robots/${robot.id}`;
    } catch (error) {
      fill(out, problem(error));
    }
  };
  return el("section.card", {}, el("h2", {}, "Add a robot"),
    el("form", { submit }, el("label", { for: "robot-file" }, "Robot file (JSON with the name and the nominal links)"),
      el("div.fields", {}, file, el("div", {}, el("button", { type: "submit" }, "Add robot"))), out));
}

/** Facts as large numbers: [name, value, remark]. */
export function facts(entries) {
  return el("dl.facts", {}, entries.filter(Boolean).map(([name, value, remark]) => el("div.fact", {}, el("dt", {}, name), el("dd", {}, value, remark && el("small", {}, remark)))));
}
