// A robot's past: each parameter set with the report of its job.

import { each, get, list } from "./api.js";
import { answering, axes, figure, legend, oneInstant, range, ticks, timeAxis } from "./charts.js";
import { el, svg } from "./dom.js";
import { mm, parameter, signed, SMALLEST_MM, when } from "./format.js";
import { foundAgainst } from "./verdicts.js";

/** Most parameter sets that are drawn. The active one is always drawn. */
const MAX_SETS = 30;
/** Most parameter sets that are listed. */
const MAX_LISTED = 200;
/** Most verifications, and most checks, that are drawn. */
const MAX_SESSIONS = 30;

/** State of a robot: its sets, newest first, the active one, the last job, the error, and the sessions that scored sets. */
export async function state(robot, signal) {
  const [sets, jobs, sessions] = await Promise.all([
    list(`/v1/robots/${robot.id}/parameter-sets`, MAX_LISTED, signal),
    get(`/v1/robots/${robot.id}/jobs?limit=1`, signal),
    sessionsOf(robot, signal),
  ]);
  const active = sets.find((set) => set.status === "released") ?? (sets.length < MAX_LISTED ? null : await olderActive(robot, sets, signal));
  // what came from an archived job asks for nothing, as in the list of robots
  const newest = sets.find((set) => set.status !== "withdrawn" && !set.job_archived_at) ?? null;
  const measured = active ?? newest;
  const report = measured && (await get(`/v1/jobs/${measured.job_id}/report`, signal));
  const since = active && newest && newest.id !== active.id && newest.created_at > active.created_at ? newest : null;
  const scored = sessions.filter(({ job }) => measured && job.parameter_set_from === measured.id);
  return { sets, active, newest, lastJob: jobs.items[0] ?? null, report, since, sessions, lastSession: scored.find(({ report: of }) => counts(of)) ?? null, doubt: scored.length > 0 && !counts(scored[0].report) ? scored[0] : null, drift: since && (await drift(active, since, signal)) };
}

/** Verifications and checks of parameter sets with their reports, newest first. */
async function sessionsOf(robot, signal) {
  const kinds = await Promise.all(["verify", "check"].map((kind) => list(`/v1/robots/${robot.id}/jobs?kind=${kind}&status=succeeded`, MAX_SESSIONS, signal)));
  const jobs = kinds.flat().filter((job) => job.parameter_set_from).sort((a, b) => Date.parse(b.created_at) - Date.parse(a.created_at)).slice(0, MAX_SESSIONS);
  const reports = await each(jobs, (job) => get(`/v1/jobs/${job.id}/report`, signal));
  return jobs.map((job, i) => ({ job, report: reports[i] }));
}

/** Whether a session says how large the error of a set is: a file that does not fit the robot says nothing, as in the list of robots. */
const counts = (report) => best(report).n_points > 0 && !report.warnings.some(({ code }) => code === "session_does_not_fit");

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

/** Time on the axis of a job or a set, with its report: when it was measured or, where the upload did not say it, computed. */
const timeOf = (thing, report) => Date.parse(report.measured_at ?? thing.created_at);
/** Which time the axis has. */
function timeWords(reports) {
  const n = reports.filter(({ report }) => report.measured_at).length;
  if (n === reports.length) return "Time: when it was measured.";
  return n > 0 ? "Time: when it was measured; where the upload did not say it, when it was computed." : "Time: when it was computed; no upload says when it was measured.";
}

/** Errors on the verify points or, if there are none, on the fitted points. */
export const best = (report) => report.verify ?? report.identify;

/** A set whose error is this many times the median of the others is outside of the scale. */
const ABSURD = 20;

/** The entries that the scale shows: without withdrawn sets, and without those that are absurd beside the others. */
function scaled(entries) {
  const kept = entries.filter(({ set }) => set.status !== "withdrawn");
  const errors = kept.map(({ report }) => best(report).after.rms_mm).sort((a, b) => a - b);
  const limit = ABSURD * Math.max(SMALLEST_MM, errors[Math.floor(errors.length / 2)] ?? 0, ...kept.filter(({ set }) => set.status === "released").map(({ report }) => best(report).after.rms_mm));
  const shown = kept.filter(({ report }) => best(report).after.rms_mm <= limit);
  return shown.length > 0 ? shown : entries;
}

/** Error over time: nominal robot and each set on its own points, and the sessions that scored a set later. */
export function errorHistory(entries, sessions, nameOf) {
  const shown = scaled(entries);
  const beyond = entries.length - shown.length;
  const scored = (those) => those.filter(({ report }) => best(report).n_points > 0).map(({ job, report }) => ({ at: timeOf(job, report), rms: best(report).after.rms_mm, isAgainst: foundAgainst(report) !== undefined, words: verifiedWords(job, report, entries, nameOf) }));
  const later = scored(sessions.filter(({ report }) => counts(report)));
  const misfits = scored(sessions.filter(({ report }) => !counts(report)));
  const onAxis = [...entries.map(({ set, report }) => timeOf(set, report)), ...[...later, ...misfits].map(({ at }) => at)];
  const caption = `Position error (rms) of each calibration on its own verify points, before and after. A filled square was released, a hollow one was not.${later.length > 0 ? ` A round mark is a later session that a set was scored on${later.some(({ isAgainst }) => isAgainst) ? "; a red one speaks against the set" : ""}.` : ""}${beyond > 0 ? ` Withdrawn sets and those far beyond the others (${beyond}) do not stretch the scale; they stand at its edge.` : ""}${misfits.length > 0 ? " A triangle is a session that does not fit the robot; beyond the scale it stands at its upper edge." : ""} ${timeWords([...entries, ...sessions])}`;
  let told = [];
  const values = [...shown.flatMap(({ report }) => [best(report).before.rms_mm, Math.max(SMALLEST_MM, best(report).after.rms_mm)]), ...later.map(({ rms }) => Math.max(SMALLEST_MM, rms))];
  const log = Math.max(...values) > 40 * Math.min(...values);
  const chart = figure("Error over time", `${caption}${log ? " The axis of the error is logarithmic." : ""}`, 260, (width, height) => {
    const frame = axes(width, height, times(onAxis), { ...range(values, log ? { log } : { zero: true }), label: "rms, mm" });
    const within = (v) => Math.max(frame.top, Math.min(frame.bottom, frame.y(Math.max(v, SMALLEST_MM))));
    told = [...entries.map(({ set, report }) => [frame.x(timeOf(set, report)), [el("strong", {}, when(timeOf(set, report))), `: ${errorWords(set, report, nameOf)}`]]), ...[...later, ...misfits].map(({ at, words }) => [frame.x(at), [el("strong", {}, when(at)), `: ${words}`]])].sort(([a], [b]) => a - b);
    const marks = entries.map(({ set, report }) => {
      const { before, after } = best(report);
      const x = frame.x(timeOf(set, report));
      const isBeyond = !shown.some((entry) => entry.set.id === set.id);
      return svg(isBeyond ? "g.beyond" : "g", {}, svg("line.before-line", { x1: x, x2: x, y1: within(before.rms_mm), y2: within(after.rms_mm) }),
        svg("circle.before", { cx: x, cy: within(before.rms_mm), r: 4 }),
        square(x, within(after.rms_mm), set.status),
        svg("title", {}, `${when(timeOf(set, report))}: ${errorWords(set, report, nameOf)}`));
    });
    return [frame.nodes, marks, misfits.map(({ at, rms, words }) => svg("g", {}, triangle(frame.x(at), within(rms)), svg("title", {}, `${when(at)}: ${words}`))), later.map(({ at, rms, isAgainst, words }) => svg("g", {}, svg(isAgainst ? "circle.misfit" : "circle.scored", { cx: frame.x(at), cy: within(rms), r: 4.5 }), svg("title", {}, `${when(at)}: ${words}`)))];
  }, legend([["before", "before: nominal robot"], ["after", "after: identified robot"], ...later.length > 0 ? [["scored", "on a later session"]] : [], ...misfits.length > 0 ? [["misfit", "session that does not fit"]] : []]));
  return answering(chart, () => told);
}

const errorWords = (set, report, nameOf) => `${nameOf(set)}: ${mm(best(report).before.rms_mm)} before, ${mm(best(report).after.rms_mm)} after${report.verify ? "" : ", on the points of the fit itself"}`;

/** What a session found, for the figure. */
function verifiedWords(job, report, entries, nameOf) {
  const scored = entries.find(({ set }) => set.id === job.parameter_set_from);
  return `${mm(best(report).after.rms_mm)} on a ${counts(report) ? "later session" : "session that does not fit the robot"}, with ${scored ? `the set of ${nameOf(scored.set)}` : "an older set"}`;
}

function square(x, y, status) {
  const released = status === "released" || status === "superseded";
  return svg(`rect.${released ? "released" : "candidate"}`, { x: x - 4, y: y - 4, width: 8, height: 8 });
}

const triangle = (x, y) => svg("path.misfit", { d: `M${x - 6} ${y + 5}L${x + 6} ${y + 5}L${x} ${y - 6}Z` });

/** The distance between two marks is the time between them. */
function times(all) {
  if (new Set(all).size === 1) return oneInstant(all[0]);
  const [from, to] = [Math.min(...all), Math.max(...all)];
  const pad = Math.max(1000, (to - from) * 0.05);
  return timeAxis(from - pad, to + pad);
}

/** One parameter over time with twice its standard uncertainty, and the choice of it. */
export function parameterHistory(entries, nameOf) {
  const names = [...new Set(entries.flatMap(({ report }) => report.parameters.filter((p) => p.identifiable).map((p) => p.name)))];
  if (names.length === 0) return el("p.empty", {}, "No parameter was identified alone.");
  names.sort((a, b) => jump(entries, b) - jump(entries, a));
  let chosen = names[0];
  const told = [];
  const choice = el("select", { id: "history-parameter", change: (event) => { chosen = event.target.value; chart.redraw(); } },
    names.map((name) => el("option", { value: name }, parameter(name))));
  const isMoved = entries.length > 1 && jump(entries, names[0]) > 1;
  const caption = `${isMoved ? "Those that moved most come first. " : ""}Identified minus nominal value, with twice its standard uncertainty where one is stated. Hollow: the data of that set could not see it alone. ${timeWords(entries)}`;
  const chart = figure("Parameter over time", caption, 260, (width, height) => drawParameter(width, height, entries, chosen, told, nameOf),
    el("p", {}, el("label", { for: "history-parameter" }, "Parameter"), choice));
  return answering(chart, () => told);
}

/** Largest step of a parameter from one set to the next, in units of the two uncertainties, where they are stated; base and targets come after the links. */
function jump(entries, name) {
  const rows = entries.map(({ report }) => report.parameters.find((p) => p.name === name && p.identifiable)).filter(Boolean);
  const std = (now, then) => (now.std_uncertainty === null || then.std_uncertainty === null ? Infinity : Math.hypot(now.std_uncertainty, then.std_uncertainty) || 1e-9);
  const steps = rows.slice(1).map((now, i) => Math.abs(now.delta - rows[i].delta) / std(now, rows[i]));
  return rows.some((p) => p.link) ? 1 + Math.max(0, ...steps) : 0;
}

function drawParameter(width, height, entries, name, told, nameOf) {
  const rows = entries.map(({ report }) => report.parameters.find((p) => p.name === name) ?? null);
  const known = rows.filter(Boolean);
  const unit = known[0]?.unit === "deg" ? "°" : "mm";
  const usual = entries.map(({ set }, i) => (set.status === "withdrawn" ? null : rows[i])).filter(Boolean);
  const ends = (usual.length > 0 ? usual : known).flatMap((p) => [p.delta - 2 * (p.std_uncertainty ?? 0), p.delta + 2 * (p.std_uncertainty ?? 0)]);
  const y = range(ends, { zero: true, pad: 0.1 });
  const at = (i) => timeOf(entries[i].set, entries[i].report);
  const decimals = decimalsOf(ticks(y, 4));
  const frame = axes(width, height, times(entries.map(({ set, report }) => timeOf(set, report))), { ...y, label: `change, ${unit}`, format: (v) => signed(v, decimals) });
  const within = (v) => Math.max(frame.top, Math.min(frame.bottom, frame.y(v)));
  told.splice(0, Infinity, ...rows.map((p, i) => p && [frame.x(at(i)), [el("strong", {}, when(at(i))), `: ${nameOf(entries[i].set)}: ${signed(p.delta, 5)} ${unit}${p.std_uncertainty ? ` ± ${p.std_uncertainty.toPrecision(2)} (one standard deviation)` : ""}`]]).filter(Boolean).sort(([a], [b]) => a - b));
  const marks = rows.map((p, i) => p && svg("g", {},
    p.std_uncertainty && svg("line.whisker", { x1: frame.x(at(i)), x2: frame.x(at(i)), y1: within(p.delta - 2 * p.std_uncertainty), y2: within(p.delta + 2 * p.std_uncertainty) }),
    svg(p.identifiable ? "circle.mark" : "circle.unseen", { cx: frame.x(at(i)), cy: within(p.delta), r: 4.5 }),
    svg("title", {}, `${when(at(i))}: ${signed(p.delta, 5)} ${unit}${p.std_uncertainty ? ` ± ${p.std_uncertainty.toPrecision(2)}` : ""}`)));
  return [frame.nodes, svg("line.axis", { x1: frame.left, x2: frame.right, y1: frame.y(0), y2: frame.y(0) }), marks.filter(Boolean)];
}

function decimalsOf(values) {
  const step = values.length > 1 ? Math.abs(values[1] - values[0]) : 1;
  return Math.max(0, Math.min(6, -Math.floor(Math.log10(step))));
}
