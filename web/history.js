// A robot's past: each parameter set with the report of its job.

import { each, get, list } from "./api.js";
import { axes, figure, legend, range, ticks } from "./charts.js";
import { el, svg } from "./dom.js";
import { mm, parameter, signed, SMALLEST_MM, when } from "./format.js";

/** Most parameter sets that are drawn. The active one is always drawn. */
const MAX_SETS = 30;
/** Most parameter sets that are listed. */
const MAX_LISTED = 200;

/** State of a robot: its sets, newest first, the active one, the last job, and the error. */
export async function state(robot, signal) {
  const [sets, jobs] = await Promise.all([
    list(`/v1/robots/${robot.id}/parameter-sets`, MAX_LISTED, signal),
    get(`/v1/robots/${robot.id}/jobs?limit=1`, signal),
  ]);
  const active = sets.find((set) => set.status === "released") ?? (sets.length < MAX_LISTED ? null : await olderActive(robot, sets, signal));
  const newest = sets.find((set) => set.status !== "withdrawn") ?? null;
  const measured = active ?? newest;
  const report = measured && (await get(`/v1/jobs/${measured.job_id}/report`, signal));
  const since = active && newest && newest.id !== active.id && newest.created_at > active.created_at ? newest : null;
  return { sets, active, newest, lastJob: jobs.items[0] ?? null, report, since, drift: since && (await drift(active, since, signal)) };
}

/** The active set if it is older than all listed sets; it is added after them. */
async function olderActive(robot, sets, signal) {
  try {
    const active = await get(`/v1/robots/${robot.id}/parameter-sets/active`, signal);
    sets.push(active);
    return active;
  } catch (error) {
    if (error.code === "no_active_parameter_set") return null;
    throw error;
  }
}

/** Distance of the tool between the newer set and the active one, computed by the service; null if it cannot be computed. */
function drift(active, since, signal) {
  return get(`/v1/parameter-sets/${since.id}/compare?with=${active.id}`, signal).catch((error) => {
    if (error.name === "AbortError" || error.status === 401) throw error;
    return null;
  });
}

/** The sets that are drawn, oldest first, with their reports. */
export async function past({ sets, active }, signal) {
  const shown = sets.filter((set, i) => i < MAX_SETS || set.id === active?.id).reverse();
  const reports = await each(shown, (set) => get(`/v1/jobs/${set.job_id}/report`, signal));
  return shown.map((set, i) => ({ set, report: reports[i] }));
}

/** Errors on the verify points or, if there are none, on the fitted points. */
export const best = (report) => report.verify ?? report.identify;

/** Error over time: nominal robot and each set on its own points. */
export function errorHistory(entries) {
  const caption = "Position error (rms) of each calibration on its own verify points, before and after. A filled square was released, a hollow one was not.";
  return figure("Error over time", caption, 260, (width, height) => {
    const values = entries.flatMap(({ report }) => [best(report).before.rms_mm, Math.max(SMALLEST_MM, best(report).after.rms_mm)]);
    const log = Math.max(...values) > 40 * Math.min(...values);
    const frame = axes(width, height, places(entries), { ...range(values, log ? { log } : { zero: true }), label: "rms, mm" });
    const marks = entries.map(({ set, report }, i) => {
      const { before, after } = best(report);
      const x = frame.x(i);
      return svg("g", {}, svg("line.before-line", { x1: x, x2: x, y1: frame.y(before.rms_mm), y2: frame.y(after.rms_mm) }),
        svg("circle.before", { cx: x, cy: frame.y(before.rms_mm), r: 4 }),
        square(x, frame.y(after.rms_mm), set.status),
        svg("title", {}, `${when(set.created_at)}: ${mm(before.rms_mm)} before, ${mm(after.rms_mm)} after, ${set.status}`));
    });
    return [frame.nodes, marks];
  }, legend([["before", "before: nominal robot"], ["after", "after: identified robot"]]));
}

function square(x, y, status) {
  const released = status === "released" || status === "superseded";
  return svg(`rect.${released ? "released" : "candidate"}`, { x: x - 4, y: y - 4, width: 8, height: 8 });
}

/** One place per set; dates as labels where they fit. */
function places(entries) {
  const n = entries.length;
  const every = Math.max(1, Math.ceil(n / 6));
  const at = entries.map((_, i) => i).filter((i) => (n - 1 - i) % every === 0);
  return { min: -0.5, max: n - 0.5, ticks: at, format: (i) => dayOf(entries, i) };
}

function dayOf(entries, i) {
  const date = new Date(entries[i].set.created_at);
  const sameDay = entries.every(({ set }) => new Date(set.created_at).toDateString() === date.toDateString());
  const how = sameDay ? { hour: "2-digit", minute: "2-digit", second: "2-digit" } : { day: "numeric", month: "short" };
  return date.toLocaleString("en-GB", how);
}

/** One parameter over time with twice its standard uncertainty, and the choice of it. */
export function parameterHistory(entries) {
  const names = [...new Set(entries.flatMap(({ report }) => report.parameters.filter((p) => p.identifiable).map((p) => p.name)))];
  if (names.length === 0) return el("p.empty", {}, "No parameter was identified alone.");
  names.sort((a, b) => jump(entries, b) - jump(entries, a));
  let chosen = names[0];
  const choice = el("select", { id: "history-parameter", change: (event) => { chosen = event.target.value; chart.redraw(); } },
    names.map((name) => el("option", { value: name }, `${parameter(name)}  (${name})`)));
  const caption = "Those that moved most come first. Identified minus nominal value, with twice its standard uncertainty where one is stated. Hollow: the data of that set could not see it alone.";
  const chart = figure("Parameter over time", caption, 260, (width, height) => drawParameter(width, height, entries, chosen),
    el("p", {}, el("label", { for: "history-parameter" }, "Parameter"), choice));
  return chart;
}

/** Largest step of a parameter from one set to the next, in units of the two uncertainties, where they are stated; base and targets come after the links. */
function jump(entries, name) {
  const rows = entries.map(({ report }) => report.parameters.find((p) => p.name === name && p.identifiable)).filter(Boolean);
  const std = (now, then) => (now.std_uncertainty === null || then.std_uncertainty === null ? Infinity : Math.hypot(now.std_uncertainty, then.std_uncertainty) || 1e-9);
  const steps = rows.slice(1).map((now, i) => Math.abs(now.delta - rows[i].delta) / std(now, rows[i]));
  return rows.some((p) => p.link) ? 1 + Math.max(0, ...steps) : 0;
}

function drawParameter(width, height, entries, name) {
  const rows = entries.map(({ report }) => report.parameters.find((p) => p.name === name) ?? null);
  const known = rows.filter(Boolean);
  const unit = known[0]?.unit === "deg" ? "°" : "mm";
  const ends = known.flatMap((p) => [p.delta - 2 * (p.std_uncertainty ?? 0), p.delta + 2 * (p.std_uncertainty ?? 0)]);
  const y = range(ends, { zero: true, pad: 0.1 });
  const decimals = decimalsOf(ticks(y, 4));
  const frame = axes(width, height, places(entries), { ...y, label: `change, ${unit}`, format: (v) => signed(v, decimals) });
  const marks = rows.map((p, i) => p && svg("g", {},
    p.std_uncertainty && svg("line.whisker", { x1: frame.x(i), x2: frame.x(i), y1: frame.y(p.delta - 2 * p.std_uncertainty), y2: frame.y(p.delta + 2 * p.std_uncertainty) }),
    svg(p.identifiable ? "circle.mark" : "circle.unseen", { cx: frame.x(i), cy: frame.y(p.delta), r: 4.5 }),
    svg("title", {}, `${when(entries[i].set.created_at)}: ${signed(p.delta, 5)} ${unit}${p.std_uncertainty ? ` ± ${p.std_uncertainty.toPrecision(2)}` : ""}`)));
  return [frame.nodes, svg("line.axis", { x1: frame.left, x2: frame.right, y1: frame.y(0), y2: frame.y(0) }), marks.filter(Boolean)];
}

function decimalsOf(values) {
  const step = values.length > 1 ? Math.abs(values[1] - values[0]) : 1;
  return Math.max(0, Math.min(6, -Math.floor(Math.log10(step))));
}
