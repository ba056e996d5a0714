// The error of every point as a figure that answers: bars in the order of the rows or of the measurement, or dots against a joint or the time; with values by
// pointer, touch and keyboard, zoom by dragging, and one selection with arrows and table.

import { axes, figure, legend, oneInstant, range, ticks, timeAxis } from "./charts.js";
import { quantile } from "./arm.js";
import { el, fill, svg } from "./dom.js";
import { mm, SMALLEST_MM } from "./format.js";

/** More bars than this cannot be told apart: neighbours share one, which shows the largest of them. */
const MAX_BARS = 240;
/** More dots than this hide each other. */
const MAX_DOTS = 1500;
/** Ratio of the largest to the median error from which on the axis is logarithmic. */
const LOG_FROM_RATIO = 40;
/** The scale of "after" ends here, as a multiple of the largest error after; the bars of "before" are cut. */
const ABOVE_AFTER = 1.15;

const largest = (values) => values.reduce((a, b) => Math.max(a, b), 0);

/** Whether errors before and after need a logarithmic axis. */
export function spansMuch(points) {
  const top = largest(points.map((p) => Math.max(p.before_mm, p.after_mm)));
  const low = points.reduce((least, p) => Math.min(least, p.before_mm || Infinity, p.after_mm || Infinity), Infinity);
  return top > LOG_FROM_RATIO * low && quantile(points.map((p) => p.after_mm), 0.5) * LOG_FROM_RATIO < top;
}

/** The figure; `name(index)` names a point. `known(rows)` tells it joints and times once they were read. */
export function pointsFigure(points, names, selected, name) {
  const state = { against: "order", span: null, toAfter: false, log: spansMuch(points), marks: [], joints: null, times: null, sequence: null, name };
  const value = el("p.value", { "aria-live": "polite" });
  const choice = el("select", { id: "error-against", change: (event) => { Object.assign(state, { against: event.target.value, span: null }); changed(); } });
  const toAfter = el("button", { type: "button", "aria-pressed": "false", click: () => { state.toAfter = !state.toAfter; toAfter.setAttribute("aria-pressed", state.toAfter); changed(); } }, "Scale to after");
  const whole = el("button", { type: "button", hidden: true, click: () => { state.span = null; changed(); } }, "Show all points");
  const closer = (by) => () => { state.span = zoomed(state, points, selected.index, by); changed(); };
  const controls = el("div.controls", {}, el("label.inline", { for: "error-against" }, "Against"), choice, toAfter,
    el("span.together", {}, el("button", { type: "button", "aria-label": "Zoom in on the points", click: closer(0.5) }, "+"), el("button", { type: "button", "aria-label": "Zoom out of the points", click: closer(2) }, "\u2212")), whole);
  const options = () => fill(choice, [["order", "order of the rows"], ...state.sequence ? [["sequence", "order of the measurement"]] : [], ...state.joints ? state.joints[0].map((_, i) => [`q${i}`, `joint ${i + 1}`]) : [], ...state.times ? [["time", "time"]] : []]
    .map(([v, words]) => el("option", { value: v, selected: v === state.against }, words)));
  const note = el("span", {});
  const node = figure("Error per point", note, 280, (width, height) => plot(width, height, points, names, state, selected.index), legend(names.legend), controls);
  node.classList.add("answers");
  const changed = () => {
    whole.hidden = state.span === null;
    fill(note, captionOf(points, names, state));
    node.redraw();
  };
  const say = (index) => fill(value, index === null ? "Point, drag or use the arrow keys for values; a click selects the point everywhere." : sentenceOf(points[index], name(index), names));
  node.append(value);
  answer(node, state, selected, say, (span) => { state.span = span; changed(); });
  selected.listen((index) => { say(index); node.redraw(); });
  options();
  say(null);
  fill(note, captionOf(points, names, state));
  return { node, known: ({ joints, times, sequence }) => { Object.assign(state, { joints, times, sequence }); options(); say(selected.index); } };
}

const sentenceOf = (p, name, names) => [el("strong", {}, name), `: ${mm(p.before_mm)} ${names.before}, ${mm(p.after_mm)} ${names.after}${p.corrected_mm !== undefined && p.corrected_mm !== p.after_mm ? `, ${mm(p.corrected_mm)} with corrections` : ""} (${p.subset})`];

function captionOf(points, names, { against, toAfter, log, span }) {
  const share = Math.ceil((span ? span[1] - span[0] : points.length) / MAX_BARS);
  const parts = ["Position error of each measured point, mm"];
  if (log && !toAfter) parts[0] += ", on a logarithmic axis";
  if (isOrder(against) && share > 1) parts.push(`Each bar is the largest of ${share} neighbouring points`);
  if (isOrder(against) && points.some((p) => p.subset !== points[0].subset)) parts.push("Verify points have a mark below their bar");
  if (toAfter) parts.push("Marks that reach the upper edge go on beyond it");
  return `${parts.join(". ")}. ${names.note}`;
}

/** Whether each point has a bar, in some order, and not a dot at its value. */
const isOrder = (against) => against === "order" || against === "sequence";

/** The points in the order of the bars. */
function ordered(points, { against, sequence }) {
  const rows = points.map((_, i) => i);
  return against === "sequence" ? rows.sort((a, b) => (sequence[a] ?? Infinity) - (sequence[b] ?? Infinity) || a - b) : rows;
}

function plot(width, height, points, names, state, chosen) {
  state.scales ??= {};
  const y = (state.scales[state.toAfter] ??= scaleOf(points, state));
  return isOrder(state.against) ? bars(width, height, points, y, state, chosen) : dots(width, height, points, y, state, chosen, names);
}

/** The scale of the errors; it does not depend on what is selected. */
function scaleOf(points, state) {
  const most = largest(points.map((p) => p.after_mm));
  return state.toAfter ? { min: 0, max: Math.max(most * ABOVE_AFTER, SMALLEST_MM), label: "mm" }
    : { ...(state.log ? range(points.flatMap((p) => [seen(p.before_mm), seen(p.after_mm)]), { log: true }) : range(points.flatMap((p) => [p.before_mm, p.after_mm]), { zero: true })), label: "mm" };
}

const seen = (value) => Math.max(value, SMALLEST_MM);

function bars(width, height, points, y, state, chosen) {
  const flat = ordered(points, state);
  const [from, to] = state.span ?? [0, flat.length];
  const share = Math.max(1, Math.ceil((to - from) / MAX_BARS));
  // rows of the verify set count from 0 again
  const labelOf = (at) => (state.against === "order" ? /\d+/.exec(state.name(at))[0] : at);
  // a row's number stands below the middle of its bar
  const scale = { min: from, max: to };
  const places = ticks({ min: from, max: to - 1 }, Math.max(2, Math.floor(width / 90))).filter((v) => Number.isInteger(v) && v < to);
  const frame = axes(width, height, { ...scale, ticks: places.map((v) => v + share * 0.42), format: (v) => labelOf(Math.round(v - share * 0.42)), label: state.against === "sequence" ? "place in the measurement, from 0" : "row, from 0" }, y);
  const nodes = [frame.nodes];
  const isMixed = points.some((p) => p.subset !== points[0].subset);
  state.marks = [];
  const step = frame.x(from + share) - frame.x(from);
  for (let at = from; at < to; at += share) {
    const group = flat.slice(at, Math.min(to, at + share));
    const [b, a] = ["before_mm", "after_mm"].map((key) => largest(group.map((i) => points[i][key])));
    const worst = group.includes(chosen) ? chosen : group.reduce((x, i) => (points[i].after_mm > points[x].after_mm ? i : x));
    nodes.push(bar(frame, at, step, b, a, y, group.includes(chosen)));
    // a verify point has a mark below its bar
    if (isMixed && group.some((i) => points[i].subset === "verify")) nodes.push(svg("rect.released", { x: frame.x(at) + step * 0.2, y: frame.bottom + 2, width: Math.max(1, step * 0.45), height: 2 }));
    state.marks.push({ x: frame.x(at) + step * 0.42, index: worst, at });
  }
  state.frame = frame;
  return nodes;
}

function bar(frame, at, step, before, after, y, chosen) {
  const place = (v) => Math.max(frame.top, frame.y(y.log ? seen(v) : v));
  const [x, wide, b, a] = [frame.x(at), Math.max(1, step * 0.84), place(before), place(after)];
  return svg("g", {}, chosen && svg("rect.chosen", { x: x - 2, y: frame.top, width: wide + 4, height: frame.bottom - frame.top }),
    svg("rect.before", { x, y: b, width: wide, height: Math.max(0, frame.bottom - b) }),
    svg("rect.after", { x: x + wide * 0.25, y: a, width: Math.max(0.8, wide * 0.5), height: Math.max(0, frame.bottom - a) }));
}

function dots(width, height, points, y, state, chosen, names) {
  const of = state.against === "time" ? (i) => state.times[i] : (i) => state.joints[i]?.[Number(state.against.slice(1))];
  const all = points.map((_, i) => i).filter((i) => Number.isFinite(of(i)));
  const isOne = state.against === "time" && all.every((i) => of(i) === of(all[0]));
  if (all.length === 0) return [svg("text.axislabel", { x: 20, y: 40 }, "The file has no such column.")];
  const full = isOne ? oneInstant(of(all[0])) : range(all.map(of));
  const x = state.span ? { min: state.span[0], max: state.span[1] } : { min: full.min, max: full.max };
  const within = all.filter((i) => of(i) >= x.min && of(i) <= x.max);
  const share = Math.max(1, Math.ceil(within.length / MAX_DOTS));
  const shown = share === 1 ? within : worstOf(within.sort((i, k) => of(i) - of(k)), share, points, chosen);
  const scale = isOne ? full : state.against === "time" ? timeAxis(x.min, x.max) : { ...x, label: `joint ${Number(state.against.slice(1)) + 1}, °` };
  const frame = axes(width, height, scale, y);
  const place = (v) => Math.max(frame.top, frame.y(y.log ? seen(v) : v));
  state.frame = frame;
  state.marks = shown.map((i) => ({ x: frame.x(of(i)), y: place(points[i].after_mm), index: i, at: of(i) }));
  const r = shown.length > 400 ? 2 : 3.2;
  const marker = chosen !== null && Number.isFinite(of(chosen)) && of(chosen) >= x.min && of(chosen) <= x.max && svg("rect.chosen", { x: frame.x(of(chosen)) - 4, y: frame.top, width: 8, height: frame.bottom - frame.top });
  return [frame.nodes, marker, shown.map((i) => svg("circle.before", { cx: frame.x(of(i)), cy: place(points[i].before_mm), r })), shown.map((i) => svg("circle.after", { cx: frame.x(of(i)), cy: place(points[i].after_mm), r })),
    share > 1 && svg("text.axislabel", { x: frame.right, y: 13, "text-anchor": "end" }, `the worst of every ${share} points, ${names.after}`)];
}

/** Of each group of successive points the one with the largest error, and the selected point. */
function worstOf(indices, share, points, chosen) {
  const groups = Array.from({ length: Math.ceil(indices.length / share) }, (_, n) => indices.slice(n * share, (n + 1) * share));
  const worst = groups.map((group) => group.reduce((x, i) => (points[i].after_mm > points[x].after_mm ? i : x)));
  return indices.includes(chosen) && !worst.includes(chosen) ? [...worst, chosen] : worst;
}

/** Half or twice the range on the axis, around the selected point. */
function zoomed(state, points, chosen, by) {
  const marks = state.marks;
  if (marks.length === 0 || !state.frame) return state.span;
  const whole = isOrder(state.against) ? [0, points.length] : null;
  const span = state.span ?? whole ?? [Math.min(...marks.map((m) => m.at)), Math.max(...marks.map((m) => m.at))];
  const here = marks.find((m) => m.index === chosen)?.at ?? (span[0] + span[1]) / 2;
  const half = ((span[1] - span[0]) * by) / 2;
  if (!whole) return by > 1 && half * 2 > 360 ? null : [here - half, here + half];
  const least = Math.max(2, Math.round(half));
  const next = [Math.max(0, Math.floor(here - least)), Math.min(points.length, Math.ceil(here + least))];
  return next[0] === 0 && next[1] === points.length ? null : next;
}

/** Pointer, touch and keyboard on the plot. */
function answer(node, state, selected, say, zoom) {
  const image = node.querySelector(".plot svg");
  image.setAttribute("tabindex", "0");
  image.setAttribute("role", "application");
  image.setAttribute("aria-roledescription", "chart");
  const at = (event) => event.clientX - image.getBoundingClientRect().left;
  const near = (event) => {
    const [x, y] = [at(event), event.clientY - image.getBoundingClientRect().top];
    return state.marks.reduce((best, m) => { const away = Math.abs(m.x - x) + (m.y === undefined ? 0 : 0.7 * Math.abs(m.y - y)); return away < best[0] ? [away, m] : best; }, [Infinity, null])[1];
  };
  let from = null;
  image.addEventListener("pointerdown", (event) => { from = at(event); if (event.pointerType === "mouse") image.setPointerCapture(event.pointerId); });
  image.addEventListener("pointermove", (event) => { const mark = near(event); if (mark) say(mark.index); });
  image.addEventListener("pointerleave", () => say(selected.index));
  image.addEventListener("pointerup", (event) => {
    const to = at(event);
    if (from !== null && Math.abs(to - from) > 12 && event.pointerType === "mouse") {
      const within = state.marks.filter((m) => m.x >= Math.min(from, to) && m.x <= Math.max(from, to)).map((m) => m.at);
      const wide = isOrder(state.against) ? 1 : 0;
      if (within.length > 1) zoom([Math.min(...within), Math.max(...within) + wide]);
    } else if (from !== null) {
      const mark = near(event);
      if (mark) selected.set(mark.index);
    }
    from = null;
  });
  image.addEventListener("pointercancel", () => { from = null; });
  image.addEventListener("keydown", (event) => {
    const by = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (event.key === "Escape") selected.set(null);
    if (by === undefined || state.marks.length === 0) return;
    event.preventDefault();
    const marks = [...state.marks].sort((a, b) => a.x - b.x);
    const here = marks.findIndex((m) => m.index === selected.index);
    selected.set(marks[here < 0 ? (by > 0 ? 0 : marks.length - 1) : Math.max(0, Math.min(marks.length - 1, here + by))].index);
  });
}
