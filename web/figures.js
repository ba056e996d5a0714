// The figures of one calibration.

import { answering, axes, figure, legend, polyline, range, ticks } from "./charts.js";
import { svg } from "./dom.js";
import { count, error, mm, number, SMALLEST_MM } from "./format.js";
import { spansMuch } from "./points.js";

/** Names of the two robots of a calibration. */
export const IDENTIFIED = { before: "before", after: "after", remains: "after calibration", legend: [["before", "before: nominal robot"], ["after", "after: identified robot"]],
  note: "The verify points were not fitted: their errors tell how good the robot is now." };
/** The same of a partial recalibration, which begins with an earlier parameter set. */
export const RECALIBRATED = { ...IDENTIFIED, legend: [["before", "before: held parameter set"], ["after", "after: identified robot"]] };
/** Names of the two robots of a verification. */
export const VERIFIED = { before: "with the nominal robot", after: "with these parameters", remains: "with these parameters", legend: [["before", "nominal robot"], ["after", "these parameters"]],
  note: "This job fitted no link to them." };
const largest = (values) => values.reduce((a, b) => Math.max(a, b), 0);
function median(values) {
  const sorted = [...values].sort((a, b) => a - b);
  return sorted[Math.floor(sorted.length / 2)] ?? 0;
}

/** Convergence of the cost. */
export function convergence(curve, note) {
  const { iteration, best_cost_mm2: cost } = curve;
  const caption = note ?? `The cost F, the sum of the squared position errors on the identify points, on a logarithmic axis, from ${number(cost[0])} to ${number(cost.at(-1))} mm² in ${iteration.at(-1)} iterations.`;
  let told = [];
  const chart = figure("Convergence", caption, 250, (width, height) => {
    const frame = axes(width, height, { min: 0, max: Math.max(1, curve.limit ?? iteration.at(-1)), label: "iteration" }, { ...range(cost, { log: true }), label: "F, mm²" });
    told = iteration.map((i, n) => [frame.x(i), `Iteration ${i}: F ${number(cost[n])} mm²`]);
    return [frame.nodes, polyline("line.after-line", iteration.map((i, n) => [frame.x(i), frame.y(cost[n])]))];
  });
  return answering(chart, () => told);
}

/** A logarithmic range that does not go below what can be measured. */
const visible = (values) => range(values.map(seen), { log: true });
const seen = (value) => Math.max(value, SMALLEST_MM);

/** Histogram of the errors. */
export function histogram(points, names) {
  const log = spansMuch(points);
  const [before, after] = [points.map((p) => p.before_mm), points.map((p) => p.after_mm)];
  const caption = `Number of points by size of their error, all ${count(points.length)} points${log ? " on a logarithmic axis" : ""}. Half of them are below ${mm(median(before))} ${names.before} and ${mm(median(after))} ${names.after}.`;
  let told = [];
  const chart = figure("Distribution of the errors", caption, 250, (width, height) => {
    const x = { ...(log ? visible([...before, ...after]) : range([...before, ...after], { zero: true })), label: "position error, mm" };
    const n = 24;
    const bin = binner(x, n);
    const counts = [before, after].map((values) => values.reduce((all, v) => { all[bin(v)] += 1; return all; }, new Array(n).fill(0)));
    const top = largest(counts.flat());
    const frame = axes(width, height, x, { min: 0, max: top * 1.06, label: "points", ticks: ticks({ min: 0, max: top }, 4).filter(Number.isInteger) });
    const step = (frame.right - frame.left) / n;
    const edge = (i) => (log ? x.min * (x.max / x.min) ** (i / n) : x.min + ((x.max - x.min) * i) / n);
    told = counts[0].map((_, i) => [frame.left + (i + 0.5) * step, `${error(Math.max(0, edge(i)))} to ${mm(edge(i + 1))}: ${counts[0][i]} ${counts[0][i] === 1 ? "point" : "points"} ${names.before}, ${counts[1][i]} ${names.after}`]);
    const columns = (kind, values) => values.map((count, i) => count > 0 && svg(`rect.${kind}`, { x: frame.left + i * step + 0.5, y: frame.y(count), width: step - 1, height: frame.bottom - frame.y(count) }));
    return [frame.nodes, columns("before", counts[0]), columns("after", counts[1])];
  }, legend(names.legend));
  return answering(chart, () => told);
}

function binner({ min, max, log }, n) {
  const f = log ? (v) => Math.log10(Math.max(v, min)) : (v) => v;
  const [a, b] = [f(min), f(max)];
  return (v) => Math.max(0, Math.min(n - 1, Math.floor(((f(v) - a) / (b - a)) * n)));
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
