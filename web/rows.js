// The points of an upload as the service reads it, row by row, for figures. Files of any form come as one table.

import { blob } from "./api.js";
import { rowsOf } from "./csv.js";

/** A larger table is not read for figures. */
const MAX_BYTES = 64 * 2 ** 20;
const NOTHING = { joints: null, positions: null, times: null, names: null, lines: null, sequence: null };

/** Path of the points of a set as a CSV with the columns of the documentation. */
export const pointsPath = (set) => `/v1/measurement-sets/${set.id}/points?format=csv`;

/** `{joints, positions, times, names, lines, sequence}` of a set, each null or one entry for each point. */
export async function rowsOfSet(set, signal) {
  const table = await blob(pointsPath(set), signal);
  if (table.size > MAX_BYTES) return NOTHING;
  const [header, ...rows] = linesOf(await table.text());
  const column = (name) => { const at = header.indexOf(name); return at < 0 ? null : rows.map((cells) => cells[at]); };
  const numbers = (name) => column(name)?.map((cell) => (cell === "" ? null : Number(cell))) ?? null;
  const together = (names) => { const all = names.map(numbers); return all.every(Boolean) ? rows.map((_, i) => all.map((one) => one[i])) : null; };
  return { joints: together(header.filter((name) => /^q\d+_deg$/.test(name))), positions: together(["x_mm", "y_mm", "z_mm"]), times: column("measured_at")?.map((time) => Date.parse(time)) ?? null,
    names: column("name"), lines: numbers("line"), sequence: numbers("sequence") };
}

/** Cells of each row; quotes are rare, and looking for them in every cell of a large table takes its time. */
const linesOf = (text) => (text.includes("\"") ? rowsOf(text, ",").map(({ cells }) => cells) : text.trimEnd().split("\n").map((line) => line.split(",")));
