// The table of residuals: to sort, to filter and to download. Only the rows in sight are elements, so that 100,000 points stay usable.

import { el, fill } from "./dom.js";
import { count, error, fixed } from "./format.js";
import { saveText } from "./save.js";

/** Height of a row, px; the style sheet has the same. */
const ROW_PX = 30;
/** Rows beyond the edges that are kept as elements. */
const SPARE = 8;

/** The table. `name(index)` is the row of the file, `label(index)` its configuration or the point's name; `leave` says whether points can be left out: {excluded: Set, again(reason)} or null. */
export function residualTable(points, name, label, selected, leave) {
  const state = { key: "row", up: true, filter: "all", least: null, find: "", order: [], joints: null };
  const columns = () => [["row", "Row", (i) => name(i), (i) => i], ["configuration", "Configuration", label], ["target", "Target", (i) => points[i].target], ["subset", "Half", (i) => points[i].subset],
    ["before", "Before, mm", (i) => error(points[i].before_mm), (i) => points[i].before_mm], ["after", "After, mm", (i) => error(points[i].after_mm), (i) => points[i].after_mm],
    ...points.some((p) => p.corrected_mm !== undefined && p.corrected_mm !== p.after_mm) ? [["corrected", "Corrected, mm", (i) => error(points[i].corrected_mm), (i) => points[i].corrected_mm]] : [],
    ...["x", "y", "z"].map((axis, k) => [axis, `Δ${axis}, mm`, (i) => fixed(points[i].after_vector_mm?.[k], 3), (i) => points[i].after_vector_mm?.[k] ?? 0]),
    ["note", "Remark", (i) => [points[i].outlier && "outlier", leave?.excluded.has(i) && "left out"].filter(Boolean).join(", ")]];
  const head = el("tr", {});
  const body = el("tbody", {});
  const shown = el("p.note", { role: "status" });
  const box = el("div.scroll.residuals", { tabindex: 0, role: "region", "aria-label": "Residuals, row by row. Arrow keys select a row" },
    el("table", { "aria-label": "Residuals" }, el("thead", {}, head), body));
  const draw = () => {
    const had = body.contains(document.activeElement);
    rows(box, body, columns(), state, selected, leave);
    // whoever was at the selected row stays there
    if (had) (body.querySelector("tr.chosen button") ?? box).focus({ preventScroll: true });
  };
  const save = el("button", { type: "button", click: () => download(points, name, label, state) });
  /** Sorts and filters anew; another choice of rows begins at its top. */
  const sort = (isOther = true) => {
    const [, , text, number] = columns().find(([key]) => key === state.key);
    const of = number ?? text;
    state.order = points.map((_, i) => i).filter((i) => keeps(points[i], i, state, leave) && `${name(i)} ${label(i)}`.toLowerCase().includes(state.find));
    const compare = (a, b) => { const [x, y] = [of(a), of(b)]; return typeof x === "number" && typeof y === "number" ? x - y : String(x).localeCompare(String(y), "en", { numeric: true }); };
    state.order.sort((a, b) => (state.up ? 1 : -1) * compare(a, b) || a - b);
    fill(head, columns().map(([key, words]) => el(["th", kindOf(key)].filter(Boolean).join("."), { scope: "col", "aria-sort": key === state.key ? (state.up ? "ascending" : "descending") : "none" },
      el("button.sort", { type: "button", click: () => { Object.assign(state, { up: key === state.key ? !state.up : !["before", "after", "corrected"].includes(key), key }); sort(); head.querySelector("[aria-sort$=ending] button").focus(); } }, words, key === state.key ? (state.up ? " ↑" : " ↓") : ""))));
    const n = count(state.order.length);
    fill(shown, `${n} of ${count(points.length)} points`);
    fill(save, state.order.length === 1 ? "Download this row" : `Download these ${n} rows`);
    save.disabled = state.order.length === 0;
    if (isOther) box.scrollTop = 0;
    draw();
  };
  const controls = filters(state, sort, save);
  box.addEventListener("scroll", draw, { passive: true });
  box.addEventListener("keydown", (event) => {
    const by = { ArrowDown: 1, ArrowUp: -1, PageDown: 10, PageUp: -10 }[event.key];
    if (!by || state.order.length === 0) return;
    event.preventDefault();
    const here = state.order.indexOf(selected.index);
    selected.set(state.order[here < 0 ? 0 : Math.max(0, Math.min(state.order.length - 1, here + by))]);
  });
  selected.listen((index) => {
    const at = state.order.indexOf(index);
    if (at >= 0) {
      const top = at * ROW_PX;
      if (top < box.scrollTop) box.scrollTop = top;
      else if (top + 2 * ROW_PX > box.scrollTop + box.clientHeight) box.scrollTop = top + 3 * ROW_PX - box.clientHeight;
    }
    draw();
  });
  new ResizeObserver(draw).observe(box);
  const node = el("section.card", {}, el("h2", {}, "Residuals"), el("p.note", {}, "Measured minus predicted, in the measuring frame. Rows are counted from 0 without the header. A row that is selected here is selected in the figures, too."), controls, shown, box, leave?.node);
  sort();
  /** Shows only some rows, and goes to one of them. */
  const only = (filter, index) => {
    Object.assign(state, { filter, least: null, find: "" });
    for (const [id, value] of [["half", filter], ["least", ""], ["find", ""]]) node.querySelector(`#residual-${id}`).value = value;
    sort();
    selected.set(index);
    node.scrollIntoView({ block: "center" });
    (body.querySelector("tr.chosen button") ?? box).focus({ preventScroll: true });
  };
  return { node, redraw: () => sort(false), known: ({ joints }) => { state.joints = joints; sort(false); }, only,
    // what is taken along from a result has all of its points, whatever the table shows
    download: () => download(points, name, label, { order: points.map((_, i) => i), joints: state.joints }) };
}

function keeps(p, i, { filter, least }, leave) {
  if (filter === "outlier" && !p.outlier) return false;
  if (filter === "left" && !leave?.excluded.has(i)) return false;
  if (["identify", "verify"].includes(filter) && p.subset !== filter) return false;
  return least === null || p.after_mm >= least;
}

function filters(state, sort, save) {
  const which = el("select", { id: "residual-half", change: (event) => { state.filter = event.target.value; sort(); } },
    [["all", "all points"], ["identify", "identify half"], ["verify", "verify half"], ["outlier", "outliers"], ["left", "left out"]].map(([value, words]) => el("option", { value }, words)));
  const least = el("input", { id: "residual-least", type: "number", min: 0, step: "any", inputmode: "decimal", input: (event) => { state.least = event.target.value === "" ? null : Number(event.target.value); sort(); } });
  const find = el("input", { id: "residual-find", type: "search", input: () => { state.find = find.value.trim().toLowerCase(); sort(); } });
  return el("div.controls", {}, el("label.inline", { for: "residual-half" }, "Show"), which, el("label.inline", { for: "residual-find" }, "row or name"), find, el("label.inline", { for: "residual-least" }, "after at least, mm"), least, save);
}

/** Columns that a narrow page leaves out. */
const kindOf = (key) => (["x", "y", "z"].includes(key) ? "vector" : ["configuration", "target"].includes(key) ? "minor" : "");

/** Elements for the rows in sight; those that stay are kept. */
function rows(box, body, columns, { order }, selected, leave) {
  // a shorter list may be drawn before the browser has moved the box up
  const first = Math.max(0, Math.min(Math.floor(box.scrollTop / ROW_PX), order.length - 1) - SPARE);
  const last = Math.min(order.length, Math.ceil((box.scrollTop + (box.clientHeight || 400)) / ROW_PX) + SPARE);
  const spacer = (n) => n > 0 && el("tr.spacer", { "aria-hidden": "true" }, spaced(el("td", { colspan: columns.length }), n * ROW_PX));
  fill(body, spacer(first), order.slice(first, last).map((i, k) => {
    const chosen = i === selected.index;
    const kinds = [chosen && "chosen", leave?.excluded.has(i) && "left"].filter(Boolean);
    return el(["tr", ...kinds].join("."), { "aria-selected": chosen ? "true" : null, "aria-rowindex": first + k + 2, click: () => selected.set(i) }, columns.map(([key, , text]) => el(["td", ["row", "configuration", "subset", "note"].includes(key) ? "" : "n", kindOf(key)].filter(Boolean).join("."), {}, text(i), key === "row" && chosen && leave?.may(i) && leaveButton(i, leave))));
  }), spacer(order.length - last));
}

/** Leaves the selected point out, or takes it back. */
const leaveButton = (i, leave) => el("button.in-row", { type: "button", click: (event) => {
  event.stopPropagation();
  leave.toggle(i);
} }, leave.excluded.has(i) ? "Keep it" : "Leave out");

function spaced(cell, height) {
  cell.style.height = `${height}px`;
  return cell;
}

function download(points, name, label, { order, joints }) {
  const vectors = ["before", "after", "corrected"].filter((stage) => points[0]?.[`${stage}_mm`] !== undefined);
  const header = ["row", "configuration", "target", "subset", "outlier", ...joints ? joints[0].map((_, k) => `q${k + 1}_deg`) : [], "x_mm", "y_mm", "z_mm", ...vectors.flatMap((stage) => [`${stage}_mm`, ...["x", "y", "z"].map((axis) => `${stage}_d${axis}_mm`)])];
  const quoted = (cell) => (/[",\n\r]|^[=+@]/.test(String(cell)) ? `"${String(cell).replaceAll("\"", "\"\"")}"` : cell);
  const lines = order.map((i) => {
    const p = points[i];
    return [quoted(name(i)), quoted(label(i)), p.target, p.subset, p.outlier ? 1 : 0, ...joints ? joints[i] ?? joints[0].map(() => "") : [], ...p.position_mm ?? ["", "", ""], ...vectors.flatMap((stage) => [p[`${stage}_mm`], ...p[`${stage}_vector_mm`] ?? ["", "", ""]])].join(",");
  });
  saveText(`${header.join(",")}\n${lines.join("\n")}\n`, lines.length < points.length ? `residuals-${lines.length}-rows.csv` : "residuals.csv", "text/csv");
}
