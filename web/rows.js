// The joint values and times of an uploaded file, row by row, for figures. The service keeps files as they came; what this page cannot read in
// one, it leaves out.

import { blob } from "./api.js";
import { rowsOf } from "./csv.js";

const DEG = 180 / Math.PI;
/** A larger file is not read again for its figures. */
const MAX_BYTES = 64 * 2 ** 20;

/** `{joints: [[…]…] or null, times: [ms or null…] or null}` of a set; `n` is the number of the robot's joints. */
export async function rowsOfSet(set, n, signal) {
  const file = await blob(`/v1/measurement-sets/${set.id}/points`, signal);
  if (file.size > MAX_BYTES) return { joints: null, times: null };
  const text = await file.text();
  return file.type.startsWith("application/json") ? fromJson(text) : fromCsv(text, n, set);
}

function fromJson(text) {
  const { points } = JSON.parse(text);
  const times = points.map((p) => (p.measured_at ? Date.parse(p.measured_at) : null));
  return { joints: points.every((p) => p.q_deg) ? points.map((p) => p.q_deg) : null, times: times.some(Number.isFinite) ? times : null };
}

/** Rows of a table; quotes are rare, and looking for them in every cell of a large file takes its time. */
function cellsOf(text, separator) {
  if (text.includes("\"")) return rowsOf(text, separator).map((row) => row.cells);
  return text.replace(/^\uFEFF/, "").split(/\r\n|\n|\r/).filter((line) => line !== "").map((line) => line.split(separator));
}

export function fromCsv(text, n, set = {}) {
  const header = text.split(/\r\n|\n|\r/, 1)[0];
  const separator = header.includes("\t") ? "\t" : header.includes(";") ? ";" : ",";
  const [names = [], ...rows] = cellsOf(text, separator);
  const columns = set.columns ?? {};
  const place = (name) => names.findIndex((cell) => cell.trim().toLowerCase() === (typeof columns[name] === "string" ? columns[name].toLowerCase() : name));
  const value = (cell) => Number(separator === "," ? cell : cell?.replace(",", "."));
  const joint = (i) => {
    for (const [unit, factor] of [["deg", 1], ["mm", 1], ["rad", DEG]]) {
      const at = place(`q${i + 1}_${unit}`);
      if (at >= 0) return { at, factor };
    }
    return null;
  };
  const joints = Array.from({ length: n }, (_, i) => joint(i));
  const time = place("measured_at");
  const known = joints.length > 0 && joints.every(Boolean) && rows.length > 0;
  const axes = ["x", "y", "z"].map((axis) => (place(`${axis}_mm`) >= 0 ? { at: place(`${axis}_mm`), factor: 1 } : { at: place(`${axis}_m`), factor: 1000 }));
  const positions = axes.every(({ at }) => at >= 0) ? rows.map((cells) => axes.map(({ at, factor }) => value(cells[at]) * factor)) : null;
  const times = time < 0 ? null : rows.map((cells) => Date.parse(cells[time]));
  return { positions, joints: known ? rows.map((cells) => joints.map(({ at, factor }) => value(cells[at]) * factor)) : null, times: times?.some(Number.isFinite) ? times : null };
}
