// The joint values, positions, times and names of an uploaded file, row by row, for figures. The service keeps files as they came, and says how it
// understood them; what this page cannot read in one, it leaves out.

import { blob } from "./api.js";
import { rowsOf } from "./csv.js";

const DEG = 180 / Math.PI;
/** A larger file is not read again for its figures. */
const MAX_BYTES = 64 * 2 ** 20;
const NOTHING = { joints: null, positions: null, times: null, names: null, lines: null, sequence: null };
/** What separates columns, by its name. */
const MARKS = { tab: "\t", spaces: / +/ };
/** Degrees or millimetres of a unit. */
const UNITS = { deg: 1, rad: DEG, mm: 1, m: 1000, cm: 10, um: 0.001, in: 25.4 };

/** `{joints, positions, times, names, lines, sequence}` of a set, each null or one entry for each point; `n` is the number of the robot's joints. */
export async function rowsOfSet(set, n, signal) {
  const file = await blob(`/v1/measurement-sets/${set.id}/points`, signal);
  if (file.size > MAX_BYTES) return NOTHING;
  const text = await file.text();
  if (file.type.startsWith("application/json")) return fromJson(text);
  const found = set.joined ? fromTwo(text, n, set.joined) : fromTable(text, n, set.understood);
  // a row too many or too few would put every posture in a wrong place
  return found && found.length === set.n_points ? columnsOf(found) : NOTHING;
}

function fromJson(text) {
  const { points } = JSON.parse(text);
  const times = points.map((p) => (p.measured_at ? Date.parse(p.measured_at) : null));
  return { ...NOTHING, joints: points.every((p) => p.q_deg) ? points.map((p) => p.q_deg) : null, positions: points.every((p) => p.position_mm) ? points.map((p) => p.position_mm) : null, times: times.some(Number.isFinite) ? times : null, sequence: points.every((p) => Number.isFinite(p.sequence)) ? points.map((p) => p.sequence) : null };
}

function columnsOf(rows) {
  const all = (key) => (rows.every((row) => row[key]) ? rows.map((row) => row[key]) : null);
  const numbers = (key, some) => (rows[some]((row) => Number.isFinite(row[key])) ? rows.map((row) => row[key]) : null);
  return { joints: all("q"), positions: all("p"), times: numbers("time", "some"), names: all("key"), lines: all("line"), sequence: numbers("sequence", "every") };
}

/** Cells of each row with its line; quotes are rare, and looking for them in every cell of a large file takes its time. */
function linesOf(text, mark) {
  if (text.includes("\"") && typeof mark === "string") return rowsOf(text, mark);
  return text.replace(/^\uFEFF/, "").split(/\r\n|\n|\r/).map((line, i) => ({ line: i + 1, cells: mark instanceof RegExp ? line.trim().split(mark) : line.split(mark) }));
}

/** Rows that have joint values, positions or both, as the service understood the table; null where it cannot be read here. */
function fromTable(text, n, understood) {
  if (!understood || !["utf-8", "windows-1252"].includes(understood.encoding)) return null;
  const columns = new Map(understood.columns.map((column) => [column.means, { at: column.number - 1, factor: UNITS[column.unit] ?? 1 }]));
  const some = (names) => { const found = names.map((name) => columns.get(name)); return found.every(Boolean) ? found : null; };
  const [joints, axes, time] = [some(Array.from({ length: n }, (_, i) => `q${i + 1}`)), some(["x", "y", "z"]), columns.get("measured_at")];
  const sequence = columns.get("sequence");
  const key = columns.get("name") ?? columns.get("number");
  const number = (cell) => (cell === undefined || cell.trim() === "" ? NaN : Number(understood.decimal === "comma" ? cell.replace(",", ".") : cell));
  const values = (places, cells) => { const found = places.map(({ at, factor }) => number(cells[at]) * factor); return found.every(Number.isFinite) ? found : null; };
  const rows = [];
  for (const { line, cells } of linesOf(text, MARKS[understood.separator] ?? understood.separator)) {
    if (line <= (understood.header_row ?? 0)) continue;
    const [q, p] = [joints && values(joints, cells), axes && values(axes, cells)];
    if ((joints && !q) || (axes && !p)) continue;
    rows.push({ line, q, p, time: time ? Date.parse(cells[time.at]) : NaN, sequence: sequence ? number(cells[sequence.at]) : NaN, key: key && cells[key.at]?.trim() });
  }
  return rows;
}

/** The text of an upload, a character for each byte, so that what stays of it stays as it is: `{table}`, or of two files `{robot, instrument}`. */
export function partsOf(bytes, { joined }) {
  let text = "";
  for (let at = 0; at < bytes.length; at += CHUNK) text += String.fromCharCode(...bytes.subarray(at, at + CHUNK));
  return joined ? { robot: partOf(text, "robot"), instrument: partOf(text, "instrument") } : { table: text };
}

/** Bytes that are turned into characters at once. */
const CHUNK = 0x8000;

/** A part of a form; empty if it has none of this name. */
function partOf(text, name) {
  const boundary = text.slice(0, text.search(/\r?\n/));
  return text.split(boundary).find((some) => some.includes(`name="${name}"`))?.replace(/^\r?\n[^]*?\r?\n\r?\n/, "").replace(/\r?\n$/, "") ?? "";
}

/** The lines on which the points of an upload stand, by the part; null where this page reads it otherwise than the service. */
export function linesOfPoints(parts, n, set) {
  const lines = (part, understood) => fromTable(decoded(parts[part], understood), n, understood)?.map((row) => row.line);
  const whole = (some) => Object.values(some).every((one) => one?.length === set.n_points) && some;
  if (!set.joined) return whole({ table: lines("table", set.understood) }) || null;
  const { robot, instrument, join } = set.joined;
  if (join.by === "order") return whole({ robot: lines("robot", robot), instrument: lines("instrument", instrument) }) || null;
  // rows without a partner are no points
  const { n: left, rows } = join.leftover_instrument;
  const without = new Set(rows.map(({ line }) => line));
  return (without.size === left && whole({ instrument: lines("instrument", instrument)?.filter((line) => !without.has(line)) })) || null;
}

/** A part in characters of its own encoding. */
const decoded = (binary, understood) => new TextDecoder(understood?.encoding === "windows-1252" ? "windows-1252" : "utf-8").decode(Uint8Array.from(binary, (char) => char.charCodeAt(0)));

/** Two files that were joined: the positions in their order, each with the joint values of its row of the robot's file. */
function fromTwo(text, n, { robot, instrument, join }) {
  const [postures, points] = [fromTable(partOf(text, "robot"), n, robot), fromTable(partOf(text, "instrument"), n, instrument)];
  if (!postures || !points) return null;
  if (join.by === "order") return points.map((point, i) => ({ ...point, q: postures[i]?.q }));
  // by time the service finds the offset of the clocks, which is not repeated here
  if (!["name", "number"].includes(join.by)) return null;
  const byKey = new Map(postures.map((row) => [row.key, row.q]));
  return points.filter((point) => byKey.has(point.key)).map((point) => ({ ...point, q: byKey.get(point.key) }));
}
