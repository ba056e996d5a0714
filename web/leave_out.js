// Points to leave out, and the calibration without them: the points are uploaded once more without them, under a name that says which and why, so
// that both sets are kept and nothing is hidden.

import { blob, get, post } from "./api.js";
import { rowsOf } from "./csv.js";
import { el, fill, problem, say } from "./dom.js";
import { pointsPath, rowsOfSet } from "./rows.js";
import { nPoints } from "./sessions.js";

/** The form, and which points are left out; null for points that were only scored. `sets` are the sessions of the job. For a key that may not, `locked` says why. */
export function leavingOut({ job, sets, points, robot, may, why, name, changed }) {
  if (job.kind !== "identify") return null;
  const scope = ["upload", "identify"].find((one) => !may(one));
  if (scope) return { excluded: new Set(), node: false, toggle: () => {}, may: () => false, locked: why(scope, "leave a point out") };
  const excluded = new Set();
  const out = el("div", {});
  const reason = el("input", { id: "exclude-reason", maxlength: 100, required: true });
  const list = el("p", {});
  const button = el("button.primary", { type: "submit" }, "Calibrate again without them");
  const node = el("form.leave", { hidden: true, submit: async (event) => {
    event.preventDefault();
    button.disabled = true;
    fill(out, el("p.quiet", {}, "Uploading the points without them …"));
    try {
      const { request } = await get(`/v1/jobs/${job.id}`);
      const ids = await withoutThem({ sets, points, robot, excluded, reason: reason.value });
      const { measurement_set_ids: several } = request;
      // what was kept aside stays aside, so that the figures of both results can be compared
      const verify = areSplit(points.slice(0, nPoints(sets))) ? { verify: { source: "subset" } } : {};
      const next = await post(`/v1/robots/${robot.id}/jobs`, { ...request, ...verify, ...several ? { measurement_set_ids: several.map((id) => ids.get(id) ?? id) } : { measurement_set_id: ids.get(sets[0].id) } });
      location.hash = `#/jobs/${next.id}`;
    } catch (refused) {
      fill(out, problem(refused));
      button.disabled = false;
    }
  } }, list, el("label", { for: "exclude-reason" }, "Why they are left out; it is kept in the name of the new set"), reason, out, el("div.actions", {}, button));
  const toggle = (i) => {
    if (!excluded.delete(i)) excluded.add(i);
    node.hidden = excluded.size === 0;
    fill(list, el("strong", {}, excluded.size === 1 ? "One point is" : `${excluded.size} points are`), ` to be left out: ${[...excluded].slice(0, 12).map(name).join(", ")}${excluded.size > 12 ? " …" : ""}.`);
    say(excluded.has(i) ? `${name(i)} will be left out` : `${name(i)} stays`);
    changed();
  };
  return { excluded, node, toggle, may: (i) => i < nPoints(sets) };
}

/** Whether some of the points were kept aside. */
const areSplit = (points) => points.some((p) => p.subset !== points[0].subset);

/** Uploads each session that has one of the points without it: the id of the new set by that of the old one. Where points were kept aside, all sessions state which. */
async function withoutThem({ sets, points, robot, excluded, reason }) {
  const ids = new Map();
  const keepsHalves = areSplit(points.slice(0, nPoints(sets)));
  let first = 0;
  for (const set of sets) {
    const own = points.slice(first, first + set.n_points);
    const from = first;
    const rows = [...excluded].filter((i) => i >= from && i < from + own.length).map((i) => i - from).sort((a, b) => a - b);
    first += own.length;
    const halves = keepsHalves ? own.map((p) => p.subset) : null;
    const lines = rows.length > 0 ? (await rowsOfSet(set)).lines : null;
    const named = rows.length > 0 ? nameWithout(set, rows, own, (row) => lines?.[row], reason) : `${set.name ?? set.id}, with its halves`.slice(-MAX_NAME);
    if (rows.length > 0 || (halves && sets.length > 1)) ids.set(set.id, (await uploadWithout(robot, set, rows, halves, named)).id);
  }
  return ids;
}

/** Longest name of a set. */
const MAX_NAME = 200;

/** A point as the file has it: its name, and its line in the file that was uploaded first. Rows of a shortened file are other points. */
function pointOf({ name, configuration }, line, isShortened) {
  const own = (name ?? (/^(row_)?\d+$/.test(configuration) ? "" : configuration)).replace(/[:;()]/g, " ").trim();
  if (!line) return own ? `point ${own}` : null;
  return `${own ? `${own}, ` : ""}line ${line}${isShortened ? " of the shortened file" : ""}`;
}

/** The name of a set without some rows: which points, how many of the points to verify were among them, and why. The reason stays whole, the points may not. `points` are those of the set. */
function nameWithout(set, rows, points, lineOf, reason) {
  const own = points.filter((p) => p.subset === "verify").length;
  const left = rows.filter((i) => points[i].subset === "verify").length;
  const half = left > 0 ? ` (${left} of ${own} verify points)` : "";
  const before = set.name ?? set.id;
  const named = (which) => `${before} without ${which}${half}: ${reason}`;
  const all = rows.map((i) => pointOf(points[i], lineOf(i), leftOut(set) !== null));
  const whole = named(all.every(Boolean) ? all.join("; ") : `${rows.length === 1 ? "row" : "rows"} ${rows.join(", ")}`);
  if (whole.length <= MAX_NAME) return whole;
  const short = named(`${rows.length} points`);
  return short.length <= MAX_NAME ? short : `… ${short.slice(short.length - MAX_NAME + 2)}`;
}

/** Points as the name of a set lists them. */
const ONE_POINT = String.raw`(?:[^:;()]*?\bline \d+(?: of the shortened file)?|point [^:;()]+)`;
const LEFT_OUT = new RegExp(String.raw` without (?:rows? ([\d, ]+\d|\d)|(\d+) points|(${ONE_POINT}(?:; ${ONE_POINT})*))(?: \((\d+) of (\d+) verify points\))?:`, "g");

/** How many points of a set were left out by hand, as its name says: {points, verify, of}; null if none were. */
export function leftOut(set) {
  const all = [...(set?.name ?? "").matchAll(LEFT_OUT)];
  if (all.length === 0) return null;
  const sum = (values) => values.reduce((a, b) => a + b, 0);
  const marked = all.filter(([, , , , verify]) => verify !== undefined);
  const size = (rows, n, points) => (rows ? rows.split(",").length : points ? points.split(";").length : Number(n));
  return { points: sum(all.map(([, rows, n, points]) => size(rows, n, points))), verify: sum(marked.map(([, , , , verify]) => Number(verify))), of: marked.length > 0 ? Number(marked[0][5]) : null };
}

/** The state of an upload beside its points, so that the shorter file is taken like the whole one. */
function statedOf({ frame, instrument, reference, record, serial_number: serial, rotation, inverse_poses: inverse }) {
  const { levelled, ...noise } = instrument ?? {};
  const { measured_at_of_points: isOfPoints, measured_at: at, ...texts } = record ?? {};
  const all = { frame, ...noise, instrument_levelled: levelled, reference: reference?.name, ...texts, measured_at: isOfPoints ? undefined : at, serial_number: serial, rotation, inverse_poses: inverse };
  return Object.fromEntries(Object.entries(all).filter(([, value]) => value !== undefined && value !== null && value !== false));
}

/** Uploads the points of a set as the service reads them, without some rows, whatever file they came in; `halves` are those of its points where the new set has to state them, else null. */
async function uploadWithout(robot, set, rows, halves, name) {
  const table = await (await blob(pointsPath(set))).text();
  // its poses have quaternions, which need no convention
  const { rotation: _, ...stated } = statedOf(set);
  return post(`/v1/robots/${robot.id}/measurement-sets?${new URLSearchParams({ ...stated, name })}`, tableOf(table, rows, halves), "text/csv");
}

/** The points as the service reads them, without some rows. */
function tableOf(text, rows, halves) {
  const [header, ...all] = rowsOf(text, ",").map(({ cells }) => cells);
  const at = header.indexOf("subset");
  const lines = [at < 0 && halves ? [...header, "subset"] : header, ...all.map((cells, i) => (!halves ? cells : at < 0 ? [...cells, halves[i]] : cells.with(at, halves[i]))).filter((_, i) => !rows.includes(i))];
  const quoted = (cell) => (/[",\r\n]/.test(cell) ? `"${cell.replaceAll("\"", "\"\"")}"` : cell);
  return `${lines.map((cells) => cells.map(quoted).join(",")).join("\n")}\n`;
}
