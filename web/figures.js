// The figures of one calibration.

import { axes, figure, legend, polyline, range, ticks } from "./charts.js";
import { svg } from "./dom.js";
import { mm, number, SMALLEST_MM } from "./format.js";

/** Names of the two robots of a calibration. */
export const IDENTIFIED = { before: "before", after: "after", remains: "after calibration", legend: [["before", "before: nominal robot"], ["after", "after: identified robot"]],
  note: "The verify points were not fitted: their bars tell how good the robot is now." };
/** Names of the two robots of a verification. */
export const VERIFIED = { before: "with the nominal robot", after: "with these parameters", remains: "with these parameters", legend: [["before", "nominal robot"], ["after", "these parameters"]],
  note: "This job fitted no link to them." };
/** More bars than this cannot be told apart: neighbours share one, which shows the largest of them. */
const MAX_BARS = 240;
/** More arrows than this hide each other, and ten times as many would stop the page. */
const MAX_ARROWS = 2000;
/** Ratio of the largest to the smallest error from which on the axis is logarithmic. */
const LOG_FROM_RATIO = 40;

const largest = (values) => values.reduce((a, b) => Math.max(a, b), 0);
const spansMuch = (points) => {
  const all = points.flatMap((p) => [p.before_mm, p.after_mm]).filter((v) => v > 0);
  return all.length > 0 && largest(all) / all.reduce((a, b) => Math.min(a, b), Infinity) > LOG_FROM_RATIO && median(points.map((p) => p.after_mm)) * LOG_FROM_RATIO < largest(all);
};
function median(values) {
  const sorted = [...values].sort((a, b) => a - b);
  return sorted[Math.floor(sorted.length / 2)] ?? 0;
}

/** Convergence of the cost. */
export function convergence(curve, note) {
  const { iteration, best_cost_mm2: cost } = curve;
  const caption = note ?? `The cost F, the sum of the squared position errors on the identify points, from ${number(cost[0])} to ${number(cost.at(-1))} mm² in ${iteration.at(-1)} iterations.`;
  return figure("Convergence", caption, 250, (width, height) => {
    const frame = axes(width, height, { min: 0, max: Math.max(1, curve.limit ?? iteration.at(-1)), label: "iteration" }, { ...range(cost, { log: true }), label: "F, mm²" });
    return [frame.nodes, polyline("line.after-line", iteration.map((i, n) => [frame.x(i), frame.y(cost[n])]))];
  });
}

/** One bar per point, verify half first. */
export function perPoint(points, names) {
  const log = spansMuch(points);
  const halves = ["verify", "identify"].map((name) => [name, points.filter((p) => p.subset === name)]).filter(([, half]) => half.length > 0);
  const share = Math.ceil(points.length / MAX_BARS);
  const groups = halves.map(([name, half]) => [name, half.length, grouped(half, share)]);
  const all = groups.flatMap(([, , half]) => half.flatMap((g) => [g.before, g.after]));
  const y = log ? visible(all) : range(all, { zero: true });
  const floor = log ? `, on a logarithmic axis that begins at ${number(y.min)} mm` : "";
  const caption = `Position error of each measured point, mm${floor}. ${share > 1 ? `Each bar is the largest of ${share} neighbouring points. ` : ""}${names.note}`;
  return figure("Error per point", caption, 260, (width, height) => bars(width, height, groups, { ...y, label: "mm" }, names), legend(names.legend));
}

/** A logarithmic range that does not go below what can be measured. */
const visible = (values) => range(values.map(seen), { log: true });
const seen = (value) => Math.max(value, SMALLEST_MM);

function grouped(half, share) {
  const groups = [];
  for (let i = 0; i < half.length; i += share) {
    const some = half.slice(i, i + share);
    groups.push({ before: largest(some.map((p) => p.before_mm)), after: largest(some.map((p) => p.after_mm)), names: some });
  }
  return groups;
}

function bars(width, height, groups, y, names) {
  const count = groups.reduce((n, [, , half]) => n + half.length, 0);
  const gap = groups.length > 1 ? 1.5 : 0;
  const frame = axes(width, height, { min: 0, max: count + gap, ticks: [] }, y);
  const step = frame.x(1) - frame.x(0);
  const nodes = [frame.nodes];
  let at = 0;
  for (const [name, n, half] of groups) {
    nodes.push(svg("text.axislabel", { x: (frame.x(at) + frame.x(at + half.length)) / 2, y: frame.bottom + 20, "text-anchor": "middle" }, `${name} (${n} points)`));
    if (at > 0) nodes.push(svg("line.divider", { x1: frame.x(at - gap / 2), x2: frame.x(at - gap / 2), y1: frame.top, y2: frame.bottom + 22 }));
    for (const group of half) {
      const x = frame.x(at);
      const [b, a] = [group.before, group.after].map((v) => frame.y(y.log ? seen(v) : v));
      const bar = Math.max(1, step * 0.84);
      nodes.push(svg("g", {}, svg("rect.before", { x, y: b, width: bar, height: Math.max(0, frame.bottom - b) }),
        svg("rect.after", { x: x + bar * 0.25, y: a, width: Math.max(0.8, bar * 0.5), height: Math.max(0, frame.bottom - a) }),
        svg("title", {}, `configuration ${group.names.map((p) => p.configuration).join(", ")}: ${mm(group.before)} ${names.before}, ${mm(group.after)} ${names.after}`)));
      at += 1;
    }
    at += gap;
  }
  return nodes;
}

/** Histogram of the errors. */
export function histogram(points, names) {
  const log = spansMuch(points);
  const [before, after] = [points.map((p) => p.before_mm), points.map((p) => p.after_mm)];
  const caption = `Number of points by size of their error, all ${points.length} points${log ? "; each step to the right is ten times as much" : ""}. Half of them are below ${mm(median(before))} ${names.before} and ${mm(median(after))} ${names.after}.`;
  return figure("Distribution of the errors", caption, 250, (width, height) => {
    const x = { ...(log ? visible([...before, ...after]) : range([...before, ...after], { zero: true })), label: "position error, mm" };
    const n = 24;
    const bin = binner(x, n);
    const counts = [before, after].map((values) => values.reduce((all, v) => { all[bin(v)] += 1; return all; }, new Array(n).fill(0)));
    const top = largest(counts.flat());
    const frame = axes(width, height, x, { min: 0, max: top * 1.06, label: "points", ticks: ticks({ min: 0, max: top }, 4).filter(Number.isInteger) });
    const step = (frame.right - frame.left) / n;
    const columns = (kind, values) => values.map((count, i) => count > 0 && svg(`rect.${kind}`, { x: frame.left + i * step + 0.5, y: frame.y(count), width: step - 1, height: frame.bottom - frame.y(count) }));
    return [frame.nodes, columns("before", counts[0]), columns("after", counts[1])];
  }, legend(names.legend));
}

function binner({ min, max, log }, n) {
  const f = log ? (v) => Math.log10(Math.max(v, min)) : (v) => v;
  const [a, b] = [f(min), f(max)];
  return (v) => Math.max(0, Math.min(n - 1, Math.floor(((f(v) - a) / (b - a)) * n)));
}

const VIEWS = [["Seen from above", 0, 1, "x", "y"], ["Seen from the side", 0, 2, "x", "z"]];

/** The error vectors where they were measured, in two projections; nothing for reports that have no vectors. */
export function arrows(points, names) {
  const known = points.filter((p) => p.position_mm && p.before_vector_mm && p.after_vector_mm);
  if (known.length === 0) return [];
  const share = Math.ceil(known.length / MAX_ARROWS);
  const placed = farthest(known, share);
  const thinned = share > 1 ? `Of every ${share} neighbouring points only the one with the largest error ${names.remains} is drawn: ${placed.length.toLocaleString("en-GB")} of ${known.length.toLocaleString("en-GB")}. ` : "";
  const extent = largest([0, 1, 2].map((k) => spread(placed.map((p) => p.position_mm[k]))));
  const factor = magnification(extent, largest(placed.map((p) => p.before_mm)));
  return VIEWS.map(([title, i, j, xName, yName]) => {
    const caption = `Each arrow goes from where the robot was believed to be to where it was measured, drawn ${factor.toLocaleString("en-GB")} times as long. ${thinned}${xName} and ${yName} in the measuring frame, mm.`;
    return figure(title, caption, 420, (width, height) => projection(width, height, placed, [i, j], { x: xName, y: yName, ...names }, factor), legend(names.legend));
  });
}

/** The point with the largest error after the calibration of each group of neighbours, so that no outlier is hidden. */
function farthest(points, share) {
  const found = [];
  for (let i = 0; i < points.length; i += share) found.push(points.slice(i, i + share).reduce((a, b) => (b.after_mm > a.after_mm ? b : a)));
  return found;
}

const spread = (values) => values.reduce((a, b) => Math.max(a, b)) - values.reduce((a, b) => Math.min(a, b));

/** A round factor that makes the longest arrow about a seventh of the picture. */
function magnification(extent, longest) {
  const raw = (0.14 * extent) / (longest || 1);
  const base = 10 ** Math.floor(Math.log10(raw || 1));
  return Math.max(1, base * [5, 3, 2, 1].find((m) => m * base <= raw));
}

function projection(width, height, points, [i, j], names, factor) {
  const ends = (k) => points.flatMap((p) => [p.position_mm[k], p.position_mm[k] - factor * p.before_vector_mm[k]]);
  let [x, y] = [range(ends(i), { pad: 0.03 }), range(ends(j), { pad: 0.03 })];
  // one scale for both directions
  const [w, h] = [width - 72, height - 48];
  const perPixel = Math.max((x.max - x.min) / w, (y.max - y.min) / h);
  x = { ...around(x, perPixel * w), label: `${names.x}, mm` };
  y = { ...around(y, perPixel * h), label: `${names.y}, mm` };
  const frame = axes(width, height, x, y);
  const nodes = [frame.nodes];
  if (y.min < 0 && y.max > 0) nodes.push(svg("line.zero", { x1: frame.left, x2: frame.right, y1: frame.y(0), y2: frame.y(0) }));
  if (x.min < 0 && x.max > 0 && y.min < 0 && y.max > 0) nodes.push(svg("circle.origin", { cx: frame.x(0), cy: frame.y(0), r: 5 }), svg("text.axislabel", { x: frame.x(0) + 9, y: frame.y(0) + 4 }, "origin"));
  for (const kind of ["before", "after"]) {
    for (const p of points) {
      const vector = p[`${kind}_vector_mm`];
      const tip = [frame.x(p.position_mm[i]), frame.y(p.position_mm[j])];
      const tail = [frame.x(p.position_mm[i] - factor * vector[i]), frame.y(p.position_mm[j] - factor * vector[j])];
      nodes.push(arrow(kind, tail, tip, `configuration ${p.configuration}: ${mm(p[`${kind}_mm`])} ${names[kind]}`));
    }
  }
  return nodes;
}

const around = ({ min, max }, size) => ({ min: (min + max - size) / 2, max: (min + max + size) / 2 });

/** A line with a head; a dot where the arrow is too short to have one. */
function arrow(kind, [x1, y1], [x2, y2], text) {
  const [dx, dy] = [x2 - x1, y2 - y1];
  const length = Math.hypot(dx, dy);
  const title = svg("title", {}, text);
  if (length < 2) return svg(`circle.${kind}-dot`, { cx: x2, cy: y2, r: 1.8 }, title);
  const head = Math.min(6, length * 0.45);
  const [ux, uy] = [(dx / length) * head, (dy / length) * head];
  const d = `M${x1.toFixed(1)} ${y1.toFixed(1)}L${x2.toFixed(1)} ${y2.toFixed(1)}m${(-ux - uy * 0.55).toFixed(1)} ${(-uy + ux * 0.55).toFixed(1)}L${x2.toFixed(1)} ${y2.toFixed(1)}l${(-ux + uy * 0.55).toFixed(1)} ${(-uy - ux * 0.55).toFixed(1)}`;
  return svg(`path.${kind}-line`, { d }, title);
}

/** A change with twice its standard uncertainty on a small scale of its own unit. */
export function interval(row, scaleTo) {
  const [width, middle] = [200, 100];
  const at = (v) => middle + Math.max(-1, Math.min(1, v / scaleTo)) * (middle - 5);
  const std = row.std_uncertainty;
  return svg("svg.interval", { width, height: 16, viewBox: `0 0 ${width} 16`, "aria-hidden": "true" },
    svg("line.zero", { x1: middle, x2: middle, y1: 1, y2: 15 }),
    std !== null && std !== undefined && svg("line.whisker", { x1: at(row.delta - 2 * std), x2: at(row.delta + 2 * std), y1: 8, y2: 8 }),
    svg(row.identifiable ? "circle.mark" : "circle.unseen", { cx: at(row.delta), cy: 8, r: 3.2 }));
}
