// Charts in SVG: scales, axes and frames. What is drawn in them is in figures.js.

import { el, fill, svg } from "./dom.js";
import { number, powerOfTen, when } from "./format.js";

/** A figure with a heading and a sentence that says what it shows; `draw(width)` gives its SVG children for that width. */
export function figure(title, caption, height, draw, ...extras) {
  const words = () => `${title}. ${caption instanceof Node ? caption.textContent : caption}`;
  const image = svg("svg", { role: "img", "aria-label": words(), height });
  const redraw = () => {
    // a caption that is a node changes with what is drawn
    image.setAttribute("aria-label", words());
    const width = Math.floor(image.parentNode?.clientWidth ?? 0);
    if (width < 50) return;
    image.setAttribute("viewBox", `0 0 ${width} ${height}`);
    image.setAttribute("width", width);
    fill(image, draw(width, height));
  };
  const box = el("div.plot", {}, image);
  let drawnFor = 0;
  new ResizeObserver(() => {
    if (box.clientWidth === drawnFor) return;
    drawnFor = box.clientWidth;
    redraw();
  }).observe(box);
  const node = el("figure", {}, el("figcaption", {}, el("h3", {}, title), ...extras, el("p.note", {}, caption)), box);
  node.redraw = redraw;
  return node;
}

/** Makes a figure answer: `marks()` are [x, words] of what was drawn last; the nearest is told by pointer, touch and arrow keys. */
export function answering(node, marks, idle = "Point, tap or use the arrow keys for values.") {
  const image = node.querySelector(".plot svg");
  const value = el("p.value", { "aria-live": "polite" }, idle);
  let at = -1;
  const tell = (index) => {
    at = index;
    fill(value, marks()[index]?.[1] ?? idle);
  };
  const near = (event) => {
    const x = event.clientX - image.getBoundingClientRect().left;
    tell(marks().reduce((best, [place], i, all) => (best < 0 || Math.abs(place - x) < Math.abs(all[best][0] - x) ? i : best), -1));
  };
  node.classList.add("answers");
  for (const [name, text] of [["tabindex", 0], ["role", "application"], ["aria-roledescription", "chart"]]) image.setAttribute(name, text);
  image.addEventListener("pointermove", near);
  image.addEventListener("pointerdown", near);
  image.addEventListener("keydown", (event) => {
    const by = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (by === undefined || marks().length === 0) return;
    event.preventDefault();
    tell(Math.max(0, Math.min(marks().length - 1, at < 0 ? (by > 0 ? 0 : marks().length - 1) : at + by)));
  });
  node.append(value);
  return node;
}

/** Which mark means what. */
export function legend(entries) {
  return el("p.legend", {}, entries.map(([kind, text]) => el("span", {}, svg("svg.key", { width: 14, height: 12, "aria-hidden": "true" }, svg(`rect.${kind}`, { x: 1, y: 1, width: 12, height: 10 })), text)));
}

/** From values to pixels, linear or logarithmic. */
export function scale({ min, max, log = false }, from, to) {
  const f = log ? (v) => Math.log10(Math.max(v, min)) : (v) => v;
  const [a, b] = [f(min), f(max)];
  const size = b - a || 1;
  return (value) => from + ((f(value) - a) / size) * (to - from);
}

/** Round values that cover the range. */
export function ticks({ min, max, log = false }, count) {
  if (log) return logTicks(min, max, count);
  const raw = (max - min || 1) / Math.max(1, count);
  const base = 10 ** Math.floor(Math.log10(raw));
  const step = base * [1, 2, 5, 10].find((m) => m * base >= raw * 0.8);
  const first = Math.ceil(min / step - 1e-9);
  const found = [];
  for (let i = first; i * step <= max + step * 1e-9; i += 1) found.push(Number((i * step).toPrecision(12)));
  return found;
}

function logTicks(min, max, count) {
  const [low, high] = [Math.ceil(Math.log10(min) - 1e-9), Math.floor(Math.log10(max) + 1e-9)];
  const every = Math.max(1, Math.ceil((high - low + 1) / Math.max(1, count)));
  const found = [];
  for (let e = low; e <= high; e += 1) if ((high - e) % every === 0) found.push(10 ** e);
  if (found.length >= 2) return found;
  const steps = [];
  for (let e = low - 1; e <= high + 1; e += 1) for (const m of [1, 2, 5]) steps.push(m * 10 ** e);
  return steps.filter((v) => v >= min * 0.999 && v <= max * 1.001);
}

/** A range that holds all values, with round ends. */
export function range(values, { zero = false, log = false, pad = 0.04 } = {}) {
  const finite = values.filter((v) => Number.isFinite(v) && (!log || v > 0));
  if (finite.length === 0) return log ? { min: 0.1, max: 1, log } : { min: 0, max: 1, log };
  let [min, max] = [finite.reduce((a, b) => Math.min(a, b)), finite.reduce((a, b) => Math.max(a, b))];
  if (log) return { min: min / 1.3, max: Math.max(max * 1.3, min * 4), log };
  if (zero) min = Math.min(0, min);
  if (zero) max = Math.max(0, max);
  const space = (max - min || Math.abs(max) || 1) * pad;
  return { min: zero && min === 0 ? 0 : min - space, max: max + space, log };
}

const label = (value, log) => (log && (value < 0.01 || value >= 1e4) ? powerOfTen(Math.round(Math.log10(value))) : number(value, 3).replace(/(\.\d*?)0+$/, "$1").replace(/\.$/, ""));

const [SECOND, DAY] = [1000, 86_400_000];
/** Steps of a time axis. */
const STEPS = [1, 2, 5, 10, 30, 60, 120, 300, 600, 1800, 3600, 7200, 21_600, 43_200].map((s) => s * SECOND).concat([1, 2, 7, 14, 30, 91, 182, 365, 730, 1826].map((d) => d * DAY));

/** A time axis for one instant alone: its only mark says date and time. */
export function oneInstant(at) {
  return { min: at - SECOND, max: at + SECOND, ticks: [at], format: (v) => when(v) };
}

const isMidnight = (v) => { const t = new Date(v); return t.getHours() + t.getMinutes() + t.getSeconds() === 0; };

/** A real time axis between two instants, ms, with marks at whole steps of local time. Where the marks tell hours, that of a midnight tells the date. */
export function timeAxis(min, max) {
  const step = STEPS.find((s) => (max - min) / s <= 5) ?? STEPS.at(-1);
  const shift = new Date(min).getTimezoneOffset() * 60 * SECOND;
  const marks = [];
  for (let at = Math.ceil((min - shift) / step) * step + shift; at <= max; at += step) marks.push(at);
  const date = { day: "numeric", month: "short" };
  const how = step < 60 * SECOND ? { hour: "2-digit", minute: "2-digit", second: "2-digit" } : step < DAY ? { hour: "2-digit", minute: "2-digit" } : step < 60 * DAY ? date : { month: "short", year: "numeric" };
  // where the marks tell the hour only, the first day is said beside the axis
  const label = step < DAY ? `from ${new Date(min).toLocaleDateString("en-GB", { ...date, year: "numeric" })}` : undefined;
  return { min, max, ticks: marks, label, format: (v) => new Date(v).toLocaleString("en-GB", step < DAY && isMidnight(v) ? date : how) };
}

/** Both axes with grid lines; gives the pixel functions and the nodes. */
export function axes(width, height, x, y) {
  const margin = { left: 58, right: 14, top: y.label ? 26 : 10, bottom: 38 };
  const [left, right, top, bottom] = [margin.left, width - margin.right, margin.top, height - margin.bottom];
  const [px, py] = [scale(x, left, right), scale(y, bottom, top)];
  const nodes = [];
  for (const v of y.ticks ?? ticks(y, Math.max(2, Math.floor((bottom - top) / 45)))) {
    nodes.push(svg("line.grid", { x1: left, x2: right, y1: py(v), y2: py(v) }));
    nodes.push(svg("text.tick", { x: left - 7, y: py(v) + 4, "text-anchor": "end" }, (y.format ?? ((t) => label(t, y.log)))(v)));
  }
  for (const v of x.ticks ?? ticks(x, Math.max(2, Math.floor((right - left) / 90)))) {
    nodes.push(svg("line.tickmark", { x1: px(v), x2: px(v), y1: bottom, y2: bottom + 4 }));
    nodes.push(svg("text.tick", { x: px(v), y: bottom + 17, "text-anchor": px(v) > right - 12 ? "end" : "middle" }, (x.format ?? ((t) => label(t, x.log)))(v)));
  }
  nodes.push(svg("line.axis", { x1: left, x2: right, y1: bottom, y2: bottom }));
  if (x.label) nodes.push(svg("text.axislabel", { x: right, y: height - 5, "text-anchor": "end" }, x.label));
  if (y.label) nodes.push(svg("text.axislabel", { x: 2, y: 13 }, y.label));
  return { x: px, y: py, left, right, top, bottom, nodes };
}

/** Points joined by straight lines. */
export function polyline(kind, points) {
  return svg(`path.${kind}`, { d: points.map(([x, y], i) => `${i === 0 ? "M" : "L"}${x.toFixed(1)} ${y.toFixed(1)}`).join("") });
}
