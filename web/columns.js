// Asks what the columns of a file mean, with its first rows, and remembers it for the robot.

import { list, post, put } from "./api.js";
import { el, fill, problem } from "./dom.js";
import { capital, plain } from "./format.js";
import { rotationsOf } from "./sessions.js";

/** Refusals that a mapping of columns can mend. */
const ASKED = ["missing_unit", "two_readings", "no_header", "unknown_column", "missing_column", "wrong_joint_count", "duplicate_column", "mixed_units", "join_unclear", "duplicate_name", "not_a_time", "unknown_sheet"];

/** Names under which the dashboard keeps a robot's mappings: of one table, and of two files. */
const [REMEMBERED, REMEMBERED_PAIR] = ["dashboard", "dashboard-pair"];
const remembered = (kept, isPair) => kept.find((mapping) => mapping.name === (isPair ? REMEMBERED_PAIR : REMEMBERED))?.columns;

/** Whether a refusal is about columns. */
export const isAboutColumns = ({ errors }) => (errors ?? []).some((issue) => ASKED.includes(issue.code));

/** What was said of the columns of this robot's files before; undefined if nothing was, or of another kind of upload. */
export async function saidBefore(robot, isPair) {
  const kept = await list(`/v1/robots/${robot.id}/columns`, 200).catch(() => []);
  return remembered(kept, isPair);
}

/** Columns that every file may have. */
const OTHERS = ["configuration", "target", "target_name", "subset", "std_mm", "station", "session", "sequence", "measured_at", "temperature_c"];
const KEYS = [["name", "point's name"], ["number", "point's number"], ["time_s", "time, s"], ["time_ms", "time, ms"], ["group", "group of points"], ["collection", "collection of groups"]];

/** End of a meaning whose unit nobody has stated yet. */
const OPEN = "_?";
/** A unit in a column's name. */
const STATED = /deg|rad|gon|°|[mcuµ]m\b|\b(m|in|inch)\b/i;

/** What a column of this file may be: [value, text]. */
function meanings(part, nJoints) {
  const joints = Array.from({ length: nJoints }, (_, j) => j + 1).flatMap((j) => [[`q${j}_deg`, `joint ${j}, degrees`], [`q${j}_rad`, `joint ${j}, radians`], [`q${j}_gon`, `joint ${j}, gons`]]);
  const axes = ["x", "y", "z"].flatMap((axis) => ["mm", "m", "cm", "um", "in"].map((unit) => [`${axis}_${unit}`, `${axis}, ${unit}`]));
  const others = OTHERS.map((name) => [name, name]);
  const own = { robot: joints, instrument: [...axes, ...others], table: [...joints, ...axes, ...others] }[part];
  // a file that states no unit is not read before somebody says which
  const open = { robot: joints, instrument: axes, table: [...joints, ...axes] }[part].map(([value, text]) => [`${value.split("_")[0]}${OPEN}`, `${text.split(", ")[0]}, unit?`]).filter(([value], i, all) => all.findIndex(([other]) => other === value) === i);
  return [["", "(not read)"], ...open, ...own, ...(part === "table" ? KEYS.slice(0, 1) : KEYS)];
}

/** The mapping that a file is understood by so far: meaning → column number. */
function soFar(file, said) {
  const found = new Map(OTHERS.map((name) => [file.header.indexOf(name) + 1, name]).filter(([number]) => number > 0));
  for (const column of file.understood?.columns ?? []) found.set(column.number, column.unit ? `${column.means}_${column.unit}` : column.means);
  for (const [means, number] of Object.entries(file.proposed)) found.set(number, /^(q\d+|[xyz])_/.test(means) && found.get(number) !== means && !STATED.test(file.header[number - 1] ?? "") ? `${means.split("_")[0]}${OPEN}` : means);
  const own = file.part === "table" ? said : said?.[file.part];
  for (const [means, column] of Object.entries(own ?? {})) {
    const number = typeof column === "string" ? file.header.indexOf(column) + 1 : column;
    if (Number.isInteger(number) && number > 0) found.set(number, means);
  }
  return found;
}

/** Encodings of tables that have lines. */
const BY_LINES = ["utf-8", "windows-1252"];

const meaningOf = ({ means, unit }) => (unit ? `${means}_${unit}` : means);

/** A mapping that reads a file as it was understood, or with its columns changed by `change`. */
export function mappingOf(understood, change = (column) => column) {
  if (!understood || understood.encoding === "robot program") return {};
  const isTable = BY_LINES.includes(understood.encoding);
  return { ...Object.fromEntries(understood.columns.map((column) => [meaningOf(change(column)), column.number])), ...understood.ignored.length > 0 ? { ignore: understood.ignored } : {},
    ...isTable ? { separator: understood.separator, decimal: understood.decimal } : { sheet: understood.sheet }, ...understood.header_row === null ? { header_row: false } : {} };
}

/** A mapping with what was chosen of a file, or of each of two files. */
export function withChoices(columns, choices) {
  const merged = { ...columns, ...choices };
  for (const part of ["robot", "instrument"]) if (choices[part] && columns[part]) merged[part] = { ...columns[part], ...choices[part] };
  return merged;
}

/** What of a mapping holds for later files, too: clocks differ from session to session, and not every table has a column of names. */
function lasting({ name, join, ...columns }) {
  const { clock_offset_s: _, ...rest } = join ?? {};
  return { ...columns, ...Object.keys(rest).length > 0 ? { join: rest } : {} };
}

/** Shows the files with a choice above each column; `read` is called with the mapping that was chosen. Rejects if the files cannot be shown. */
export async function askColumns(robot, { body, type, stated: choices = {} }, decimal, out, read) {
  const stated = new URLSearchParams({ ...Object.keys(choices).length > 0 ? { columns: JSON.stringify(choices) } : {}, ...decimal ? { decimal } : {} });
  const preview = await post(`/v1/robots/${robot.id}/measurement-sets/preview?${stated}`, body, type);
  const kept = await list(`/v1/robots/${robot.id}/columns`, 200).catch(() => []);
  const files = preview.files.filter((file) => file.understood);
  if (files.length === 0) return false;
  const asked = files.map((file) => fileTable(file, robot.links.length, soFar(file, remembered(kept, files.length > 1))));
  const keep = el("input", { type: "checkbox", id: "columns-keep", checked: true });
  const wrong = el("div", { role: "alert" });
  const by = files.length > 1 && el("select", { id: "columns-join" }, ["", "name", "number", "time", "order"].map((value) => el("option", { value }, value || "as the columns say")));
  // even times leave open how far the clocks are apart
  const clock = by && el("input", { id: "columns-clock", type: "number", step: "any" });
  const clockField = by && el("div", {}, el("label", { for: "columns-clock" }, "Robot's clock minus the instrument's, s, where it is known"), clock);
  const showClock = () => { clockField.hidden = by.value !== "time" && !preview.errors.some(({ detail }) => detail.includes("clock_offset_s")); };
  // one point under several groups: nominal beside measured positions
  const groups = el("input", { id: "columns-groups" });
  const groupField = el("div", {}, el("label", { for: "columns-groups" }, "Group of points that is read (several: with commas between them)"), groups);
  groupField.hidden = !preview.errors.some(({ detail }) => detail.includes('{"groups"'));
  if (by) {
    by.addEventListener("change", showClock);
    showClock();
  }
  const submit = async (event) => {
    event.preventDefault();
    const open = asked.flatMap(({ selects }) => selects).find((select) => select.value.endsWith(OPEN));
    if (open) {
      fill(wrong, el("p.problem", {}, `${open.getAttribute("aria-label")}: choose its unit.`));
      open.focus();
      return;
    }
    const wanted = groups.value.split(",").map((name) => name.trim()).filter(Boolean);
    const columns = withChoices({ ...wanted.length > 0 ? { groups: wanted } : {}, ...mapping(asked, by && { ...by.value ? { by: by.value } : {}, ...!clockField.hidden && clock.value !== "" ? { clock_offset_s: Number(clock.value) } : {} }) }, choices);
    try {
      if (keep.checked) await put(`/v1/robots/${robot.id}/columns/${files.length > 1 ? REMEMBERED_PAIR : REMEMBERED}`, lasting(columns));
      read(columns);
    } catch (error) {
      fill(wrong, problem(error));
    }
  };
  fill(out, el("form.columns", { submit },
    el("h3", {}, "Say once what the columns are"),
    el("p.note", {}, "Nothing was stored yet. Choose a meaning above each column; what is proposed may be wrong."),
    preview.errors.length > 0 && el("ul", {}, remarks(preview.errors).map((text) => el("li", {}, text))),
    asked.map(({ node }) => node),
    by && el("div", {}, el("label", { for: "columns-join" }, "Rows of the two files belong together by"), by),
    clockField,
    groupField,
    el("label.choice", {}, keep, "Remember this for the robot"),
    wrong,
    el("button.primary", { type: "submit" }, "Read it so")));
  return true;
}

const isWithoutUnit = (issue) => issue.code === "missing_unit" && issue.column;

/** Which of two files an issue is about, as the end of a phrase; empty for the only file. */
const ofFile = (issue) => ({ "/robot": " of the robot's file", "/instrument": " of the instrument's file" }[issue.pointer] ?? "");

/** What is to be said of the columns; what many of a file lack is said once. */
function remarks(issues) {
  const without = issues.filter(isWithoutUnit);
  const some = [...new Set(without.map(ofFile))].map((file) => {
    const names = [...new Set(without.filter((issue) => ofFile(issue) === file).map((issue) => issue.column))];
    return names.length > 1 ? `${names.slice(0, -1).join(", ")} and ${names.at(-1)}${file} have no unit: choose it in the list above one of them, and the others follow` : `${names[0]}${file} has no unit: choose it in the list above its column`;
  });
  return [...some, ...new Set(issues.filter((issue) => !isWithoutUnit(issue)).map((issue) => capital(plain(issue.detail))))];
}

/** The choices as a mapping. A file with a header is mapped by names, so that a column more in the next file does no harm. */
function mapping(asked, join) {
  const columns = {};
  for (const { file, selects } of asked) {
    const own = file.part === "table" ? columns : (columns[file.part] = {});
    const hasNames = file.understood.header_row !== null;
    if (!hasNames) own.header_row = false;
    selects.forEach((select, at) => {
      const name = file.header[at];
      const isUnique = hasNames && name && file.header.filter((other) => other.trim().toLowerCase() === name.trim().toLowerCase()).length === 1;
      const column = isUnique ? name : at + 1;
      if (select.value) own[select.value] = column;
      else own.ignore = [...own.ignore ?? [], column];
    });
  }
  if (join && Object.keys(join).length > 0) columns.join = join;
  return columns;
}

function fileTable(file, nJoints, found) {
  const width = Math.max(file.header.length, ...file.rows.map((row) => row.length));
  const options = meanings(file.part, nJoints);
  const above = file.above?.length > 1 && file.above.some((cell) => cell !== "") ? file.above : null;
  const groupOf = (at) => above?.slice(0, at + 1).findLast((cell) => cell !== "");
  const selects = Array.from({ length: width }, (_, at) => {
    const select = el("select", { "aria-label": `Column ${at + 1}, ${[groupOf(at), file.header[at] || "without a name"].filter(Boolean).join(", ")}` }, options.map(([value, text]) => el("option", { value }, text)));
    const means = found.get(at + 1) ?? "";
    select.value = options.some(([value]) => value === means) ? means : "";
    return select;
  });
  // joints have one unit, and so have axes
  selects.forEach((select) => select.addEventListener("change", () => {
    const [, kind, , unit] = /^(q|[xyz])(\d*)_(\w+)$/.exec(select.value) ?? [];
    const isAlike = (other) => other.value.endsWith(OPEN) && (kind === "q") === other.value.startsWith("q");
    if (kind) selects.filter(isAlike).forEach((other) => { other.value = other.value.replace(OPEN, `_${unit}`); });
  }));
  const title = { table: "The file", robot: "The robot's file", instrument: "The instrument's file" }[file.part];
  const cells = (row) => Array.from({ length: width }, (_, at) => el("td", {}, row[at] ?? ""));
  const node = el("div", {}, el("p.caption", {}, `${title}: ${inWords(file.understood, false)}`),
    el("div.scroll", { tabindex: 0, role: "region", "aria-label": title },
      el("table", { "aria-label": title },
        el("thead", {}, el("tr", {}, selects.map((select) => el("th", {}, select))), above && el("tr", {}, selects.map((_, at) => el("th", { scope: "col" }, above[at] ?? ""))), el("tr", {}, Array.from({ length: width }, (_, at) => el("th", { scope: "col" }, file.header[at] || `column ${at + 1}`)))),
        el("tbody", {}, file.rows.map((row) => el("tr", {}, cells(row)))))));
  return { file, selects, node };
}

/** Separators of columns in words. */
export const SEPARATORS = { ",": "commas", ";": "semicolons", "|": "bars", tab: "tabs", spaces: "spaces" };

/** How a table was understood, in a sentence. */
export function inWords(understood, isSure = true) {
  const separator = SEPARATORS[understood.separator];
  const header = understood.header_row === null ? "no header" : `header in line ${understood.header_row}`;
  return `${understood.encoding}, columns separated by ${separator}, ${isSure ? `decimal ${understood.decimal}, ` : ""}${header}, ${understood.skipped_rows} other lines`;
}

/** What was understood of a stored set, folded; nothing for a file as the documentation describes it. */
export function understoodDetails(set) {
  const parts = set.joined ? [["Robot's file", set.joined.robot], ["Instrument's file", set.joined.instrument]] : set.understood ? [["File", set.understood]] : [];
  if (parts.length === 0) return [];
  const unit = (column) => (column.unit ? `${column.means} in ${column.unit}` : column.means);
  const rows = parts.map(([title, understood]) => el("div", {}, el("p", {}, el("strong", {}, title), `: ${inWords(understood)}.`),
    el("p.note", {}, understood.columns.map((column) => `${column.column} is ${unit(column)}`).join("; "), "."),
    understood.ignored.length > 0 && el("p.note", {}, `Not read: ${understood.ignored.join(", ")}.`),
    understood.other_groups && el("p.note", {}, `Only these groups of points are read: ${understood.groups.join(", ")}; ${understood.other_groups} rows of other groups are not.`),
    understood.unread && el("p.note", {}, `${understood.unread.n} points of the program are not read: ${understood.unread.points.map((point) => `line ${point.line} ${point.name} (${point.reason})`).join("; ")}.`)));
  const turned = rotationsOf(set);
  return el("details", {}, el("summary", {}, "How the file was read"), rows, turned.length > 0 && el("p", {}, capital(`${turned.join("; ")}.`)), set.joined && joinWords(set.joined.join));
}

/** What is no part of the points' names. */
function leftOutWords({ robot, instrument, repetitions }) {
  const begins = [["robot's", robot], ["instrument's", instrument]].filter(([, begin]) => begin).map(([file, begin]) => `“${begin}”, with which all names of the ${file} file begin, is no part of them`);
  return [...begins, ...repetitions ? ["the last number of the instrument's names counts the repetitions of a point"] : []].join("; ");
}

function joinWords(join) {
  const clock = join.clock_offset_s === undefined ? "" : ` The robot's clock minus the instrument's is ${join.clock_offset_s.toFixed(3)} s; pairs may be ${join.tolerance_s.toFixed(3)} s apart.`;
  const midnight = join.over_midnight ? " Times of day that fall back are those of the next day." : "";
  const rest = [["robot's", join.leftover_robot], ["instrument's", join.leftover_instrument]].filter(([, rows]) => rows.n > 0)
    .map(([file, rows]) => el("p.note", {}, `${rows.n === 1 ? `One row of the ${file} file has` : `${rows.n} rows of the ${file} file have`} no partner: ${rows.rows.map((row) => row.label || `line ${row.line}`).join(", ")}.`));
  return [el("p", {}, `${join.n_joined === 1 ? "One pair" : `${join.n_joined} pairs`} of rows, joined by ${join.by}${join.left_out ? ` (${leftOutWords(join.left_out)})` : join.loose_names ? " (names agree without signs, spaces and leading zeros, or by their numbers alone)" : ""}.${clock}${midnight}`), rest];
}
