// Points to leave out, and the calibration without them: their file is uploaded once more without their rows, under a name that says which and why, so
// that both files are kept and nothing is hidden.

import { blob, get, post } from "./api.js";
import { BY_LINES, isPlain, mappingOf } from "./columns.js";
import { el, fill, problem, say } from "./dom.js";
import { pointsPath, rowsOfSet } from "./rows.js";
import { nPoints, placeOf } from "./sessions.js";

/** The form, and which points are left out; null for a key that may not, and for points that were only scored. `sets` are the sessions of the job. */
export function leavingOut({ job, sets, points, robot, may, name, changed }) {
  if (job.kind !== "identify" || !may("identify") || !may("upload")) return null;
  const excluded = new Set();
  const out = el("div", {});
  const reason = el("input", { id: "exclude-reason", maxlength: 100, required: true });
  const list = el("p", {});
  const button = el("button.primary", { type: "submit" }, "Calibrate again without them");
  const node = el("form.leave", { hidden: true, submit: async (event) => {
    event.preventDefault();
    button.disabled = true;
    fill(out, el("p.quiet", {}, "Uploading the file without them …"));
    try {
      const { request } = await get(`/v1/jobs/${job.id}`);
      const ids = await withoutThem({ sets, points, robot, excluded, reason: reason.value });
      const { measurement_set_ids: several } = request;
      const next = await post(`/v1/robots/${robot.id}/jobs`, { ...request, ...several ? { measurement_set_ids: several.map((id) => ids.get(id) ?? id) } : { measurement_set_id: ids.get(sets[0].id) } });
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
  const setOf = (i) => placeOf(sets, i)?.set;
  return { excluded, node, toggle, may: (i) => i < nPoints(sets) && !byHand(setOf(i)), byHand: (i) => i < nPoints(sets) && byHand(setOf(i)) };
}

/** Uploads each session that has one of the points without it: the id of the new set by that of the old one. */
async function withoutThem({ sets, points, robot, excluded, reason }) {
  const ids = new Map();
  let first = 0;
  for (const set of sets) {
    const own = points.slice(first, first + set.n_points);
    const from = first;
    const rows = [...excluded].filter((i) => i >= from && i < from + own.length).map((i) => i - from).sort((a, b) => a - b);
    first += own.length;
    if (rows.length > 0) ids.set(set.id, (await uploadWithout(robot, set, rows, nameWithout(set, rows, own, reason))).id);
  }
  return ids;
}

/** What to do where a row cannot be taken out of the file of a set here; false where it can. Of two files the joined points are uploaded. */
function byHand({ joined, understood }) {
  const isReadable = joined || !understood || BY_LINES.includes(understood.encoding);
  return !isReadable && "To leave it out, delete its row from the file, say why in the file's name, and upload it on the robot's page.";
}

/** Longest name of a set. */
const MAX_NAME = 200;

/** The name of a set without some rows: which, how many of the points to verify were among them, and why. The reason stays whole, the rows may not. `points` are those of the set. */
function nameWithout(set, rows, points, reason) {
  const own = points.filter((p) => p.subset === "verify").length;
  const left = rows.filter((i) => points[i].subset === "verify").length;
  const half = left > 0 ? ` (${left} of ${own} verify points)` : "";
  const before = set.name ?? set.id;
  const named = (which) => `${before} without ${which}${half}: ${reason}`;
  const whole = named(`${rows.length === 1 ? "row" : "rows"} ${rows.join(", ")}`);
  if (whole.length <= MAX_NAME) return whole;
  const short = named(`${rows.length} points`);
  return short.length <= MAX_NAME ? short : `… ${short.slice(short.length - MAX_NAME + 2)}`;
}

/** How many points of a set were left out by hand, as its name says: {points, verify, of}; null if none were. */
export function leftOut(set) {
  const all = [...(set?.name ?? "").matchAll(/ without (?:rows? ([\d, ]+\d|\d)|(\d+) points)(?: \((\d+) of (\d+) verify points\))?:/g)];
  if (all.length === 0) return null;
  const sum = (values) => values.reduce((a, b) => a + b, 0);
  const marked = all.filter(([, , , verify]) => verify !== undefined);
  return { points: sum(all.map(([, rows, n]) => (rows ? rows.split(",").length : Number(n)))), verify: sum(marked.map(([, , , verify]) => Number(verify))), of: marked.length > 0 ? Number(marked[0][4]) : null };
}

/** The state of an upload beside its points, so that the shorter file is taken like the whole one. */
function statedOf({ frame, instrument, reference, record, serial_number: serial, rotation, inverse_poses: inverse }) {
  const { levelled, ...noise } = instrument ?? {};
  const { measured_at_of_points: isOfPoints, measured_at: at, ...texts } = record ?? {};
  const all = { frame, ...noise, instrument_levelled: levelled, reference: reference?.name, ...texts, measured_at: isOfPoints ? undefined : at, serial_number: serial, rotation, inverse_poses: inverse };
  return Object.fromEntries(Object.entries(all).filter(([, value]) => value !== undefined && value !== null && value !== false));
}

/** What goes beside a JSON body: its own instrument stands in it. */
function besides(whole, stated) {
  const { range_std_mm: length, range_std_mm_per_m: perMetre, angle_std_deg: angle, instrument_levelled: levelled, ...rest } = stated;
  return whole.instrument ? rest : stated;
}

async function uploadWithout(robot, set, rows, name) {
  const send = (body, type, columns, stated = statedOf(set)) => post(`/v1/robots/${robot.id}/measurement-sets?${new URLSearchParams({ ...stated, ...columns ? { columns: JSON.stringify(columns) } : {}, name })}`, body, type);
  if (set.joined) {
    const lines = (await (await blob(pointsPath(set))).text()).trimEnd().split("\n");
    // its poses have quaternions, which need no convention
    const { rotation: _, ...stated } = statedOf(set);
    return send(lines.filter((_line, at) => at === 0 || !rows.includes(at - 1)).join("\n"), "text/csv", undefined, stated);
  }
  const file = await blob(`/v1/measurement-sets/${set.id}/points`);
  if (file.type.startsWith("application/json")) {
    const whole = JSON.parse(await file.text());
    return send(JSON.stringify({ ...whole, name, points: whole.points.filter((_, i) => !rows.includes(i)) }), "application/json", undefined, besides(whole, statedOf(set)));
  }
  const { lines } = await rowsOfSet(set);
  const bytes = new Uint8Array(await file.arrayBuffer());
  return send(bytesOf(withoutLines(binaryOf(bytes), rows, lines)), "text/csv", isPlain(set.understood) ? undefined : mappingOf(set.understood));
}

/** Bytes as a text with a character for each, so that what stays of them stays as it is. */
function binaryOf(bytes) {
  let text = "";
  for (let at = 0; at < bytes.length; at += CHUNK) text += String.fromCharCode(...bytes.subarray(at, at + CHUNK));
  return text;
}

/** Bytes that are turned into characters at once. */
const CHUNK = 0x8000;

const bytesOf = (binary) => Uint8Array.from(binary, (char) => char.charCodeAt(0));

/** A table without some points, which stand on these lines; every other line stays as it is. */
function withoutLines(text, left, lines) {
  if (!lines) throw { title: "This file cannot be shortened here", detail: "Its rows are read in another way than this page reads them. Take the rows out of the file yourself, and upload it." };
  const all = text.split(/\r\n|\n|\r/);
  const gone = new Set();
  for (const i of left) {
    // a cell in quotes may go on over several lines
    const end = text.includes("\"") ? lines[i + 1] ?? all.length + 1 : lines[i] + 1;
    for (let line = lines[i]; line < end; line += 1) gone.add(line);
  }
  return `${all.filter((_, i) => !gone.has(i + 1)).join("\n").replace(/\n+$/, "")}\n`;
}
