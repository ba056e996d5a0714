// The arm with what was measured: positions, error arrows and the posture of the point that is selected.

import { el, fill } from "./dom.js";
import { capital, count, fixed, mm, SMALLEST_MM } from "./format.js";
import { apply, axisX, framesOf, origin, poseOf, randomNumbers, reachOf, restOf, turn } from "./kinematics.js";
import { VIEWS, view } from "./scene.js";
import { arm, ground } from "./solids.js";

/** More arrows than this hide each other: an even sample is drawn, and the few points with the largest errors. */
const MAX_DRAWN = 2000;
const WORST_DRAWN = 20;
/** The longest arrow, as a share of the scene. */
const LONGEST = 0.13;
/** The scale ends at this quantile of the errors, or at so many times their median where a few are far off; what is above it has its last colour. */
const [WITHIN, MEDIANS] = [0.98, 5];
const LEVELS = ["--level-1", "--level-2", "--level-3", "--level-4", "--level-5"];
const GRAVITY = { floor: [0, 0, -1], wall: [1, 0, 0], ceiling: [0, 0, 1] };

/** Value below which a share of them is. */
export function quantile(values, share) {
  const sorted = Float64Array.from(values.filter(Number.isFinite)).sort();
  return sorted.length === 0 ? 0 : sorted[Math.min(sorted.length - 1, Math.floor(share * sorted.length))];
}

/** The points of a report in the robot's base frame. `toBase(i)` brings a point there from the measuring frame; null where that is not known. */
export function pointsOfReport(report, toBase) {
  return report.per_point.map((p, i) => {
    const back = toBase(i);
    return { position: back && p.position_mm ? apply(back, p.position_mm) : null,
      vectors: Object.fromEntries(["before", "after", "corrected"].map((stage) => [stage, back && p[`${stage}_vector_mm`] ? turn(back, p[`${stage}_vector_mm`]) : null])),
      errors: { before: p.before_mm, after: p.after_mm, corrected: p.corrected_mm ?? null }, target: p.target };
  });
}

/** From the base frame to a frame whose z points up, as the robot is mounted. */
function upright({ mounting }) {
  const g = GRAVITY[mounting] ?? mounting?.gravity_in_base ?? GRAVITY.floor;
  const z = g.map((v) => -v);
  const hint = Math.abs(z[0]) < 0.9 ? [1, 0, 0] : [0, 0, -1];
  const side = hint.map((v, i) => v - z[i] * (hint[0] * z[0] + hint[1] * z[1] + hint[2] * z[2]));
  const length = Math.hypot(...side);
  const x = side.map((v) => v / length);
  const y = [z[1] * x[2] - z[2] * x[1], z[2] * x[0] - z[0] * x[2], z[0] * x[1] - z[1] * x[0]];
  return [...x, 0, ...y, 0, ...z, 0];
}

/**
 * The picture. `points` have a position in the base frame, and where they were compared vectors and errors by stage. `stages` are
 * [name, words]; `shows` is what appears of a point that is picked; `said` begins the sentence about the arrows, null where there are none; `targets` are points of the flange frame; `postures(i)` are the joint values of a point, or null where they are not known.
 */
export function armFigure({ title, level = "h3", caption, robot, points, stages = [], targets = [], selected, postures = () => null, rest = () => restOf(robot), boxes = [], said, shows = "its row, its joints and its residual", describe, actions }) {
  const reach = reachOf(robot);
  const up = upright(robot);
  const lift = (some) => some.map((p) => (p.position ? apply(up, p.position) : null));
  let placed = lift(points);
  // the errors of the headline, which are those without corrections
  const state = { stage: (stages.find(([name]) => name === "after") ?? stages.at(-1))?.[0] ?? null, own: hidesAfter(points, stages), drawn: [], factor: 1, top: 1 };
  const panel = el("div.picked", { "aria-live": "polite" });
  const key = el("p.legend", {});
  const lead = el("span", {});
  const shown = el("div.actions", {});
  let isPosed = postures(0) !== null;
  const scene = view({
    label: `${title}. Arrow keys turn it, plus and minus zoom, N and P go to the next and the previous point, Home shows all.`,
    draw: (pen) => drawScene(pen, { robot, reach, up, points, placed, state, targets, selected, postures, rest, boxes }),
    ends: () => endsOf(placed, robot, up, reach, boxes, postures, rest()), points: () => state.drawn, picked: (i) => selected.set(i), step: (by) => selected.step(by),
  });
  frame(scene.eye, endsOf(placed, robot, up, reach, boxes, postures, rest()), reach);
  const rescale = () => {
    Object.assign(state, scaleOf(points, placed, stages, state, scene.eye.size));
    fill(key, legendOf(state));
    fill(lead, arrowsSaid(state, points.length, stages, said));
    // for whoever cannot look at a canvas, such as a test
    scene.canvas.setAttribute("data-drawn", state.drawn.filter(Boolean).length);
    scene.redraw();
  };
  const refresh = () => {
    // the joints of the points may come later than the points
    if (!isPosed && points.length > 0 && postures(0) !== null) {
      isPosed = true;
      scene.fit();
    }
    // the picture has the whole width while there is nothing to say beside it
    cell.classList.toggle("whole", selected.index === null);
    // whoever pressed a button of the panel goes on from there
    const pressed = [...panel.querySelectorAll("button")].indexOf(document.activeElement);
    fill(panel, selected.index === null ? hint(points.length, shows) : [describe(selected.index), actions?.(selected.index)]);
    if (pressed >= 0) (panel.querySelectorAll("button")[pressed] ?? scene.canvas).focus({ preventScroll: true });
    scene.redraw();
  };
  selected.listen(refresh);
  const button = (text, label, click) => el("button", { type: "button", click, "aria-label": label, title: label }, text);
  fill(shown, VIEWS.map(([name, [more, word]]) => el("button", { type: "button", "aria-label": `${more}${word}`, click: () => scene.look(name) }, el("span.wide", {}, more), el("span", {}, word))),
    el("span.together", {}, button("+", "Zoom in", () => scene.zoom(1.3)), button("\u2212", "Zoom out", () => scene.zoom(1 / 1.3))));
  const cell = el("div.cell", {}, el("div.stage", {}, scene.canvas, key), panel);
  /** Draws the points at other places, once these are known. */
  const place = (some) => {
    points = some;
    placed = lift(points);
    frame(scene.eye, endsOf(placed, robot, up, reach, boxes, postures, rest()), reach);
    rescale();
    scene.fit();
  };
  const node = el("figure.arm", {}, el("figcaption", {}, el(level, {}, title), el("p.note", {}, caption, " ", lead), stageChoice(stages, state, rescale)),
    cell, shown);
  rescale();
  refresh();
  return { node, refresh, place, redraw: scene.redraw, scene };
}

/** Errors this many times smaller than the first ones are dots on the scale of those. */
const DOTS_FROM = 8;

/** Whether the errors after would be seen as dots on the scale of those before. */
function hidesAfter(points, stages) {
  if (stages.length < 2 || !stages.some(([name]) => name === "after")) return false;
  const size = (stage) => quantile(points.map((p) => p.errors?.[stage]), 0.5);
  return size(stages[0][0]) > DOTS_FROM * size("after");
}

let choices = 0;

/** Which errors the arrows show, and to which scale. */
function stageChoice(stages, state, changed) {
  if (stages.length < 2) return false;
  choices += 1;
  const radios = stages.map(([name, words]) => el("label.choice", {}, el("input", { type: "radio", name: `stage-${choices}`, value: name, checked: name === state.stage, change: () => { state.stage = name; changed(); } }), words));
  const own = stages.length > 1 && el("label.choice", {}, el("input", { type: "checkbox", checked: !state.own, change: (event) => { state.own = !event.target.checked; changed(); } }), "same scale for all");
  return el("fieldset.toggles", {}, el("legend", {}, "Errors"), radios, own);
}

const hint = (n, shows) => [el("p.note", {}, n > 0 ? `Click, tap or press N to pick a point: ${shows} appear here, and the arm takes its posture.` : "Drag to turn the arm."),
  el("p.note.by-mouse", {}, "Drag or arrow keys: turn. Shift and drag: move. + and \u2212, or the wheel once the picture has the focus: zoom."), el("p.note.by-touch", {}, "One finger: turn. Two fingers: zoom and move.")];

/** Postures whose joints are within the first picture. */
const FRAMED = 40;

/** Points that are all looked at to frame them. */
const FEW_ENDS = 300;

/** What has to be in the first picture: points, boxes, and the arm at rest and in the postures of points. */
function endsOf(placed, robot, up, reach, boxes, postures, rest) {
  const every = Math.max(1, Math.ceil(placed.length / FRAMED));
  const known = placed.map((_, i) => (i % every === 0 ? postures(i) : null)).filter(Boolean);
  const corners = boxes.flatMap((b) => Array.from({ length: 8 }, (_, i) => [0, 1, 2].map((k) => (i & (1 << k) ? b.max_mm[k] : b.min_mm[k]))));
  const ends = [[0, 0, 0], ...outermost(placed.filter(Boolean)), ...corners.map((p) => apply(up, p)), ...[rest, ...known].flatMap((q) => framesOf(robot, q)).map((t) => apply(up, origin(t)))];
  // without points the arm may be moved by hand
  if (placed.length === 0) ends.push([-0.55 * reach, -0.55 * reach, 0], [0.55 * reach, 0.55 * reach, 0.85 * reach]);
  return ends;
}

/** Of many points those that lie outermost in one of 26 directions. */
function outermost(points) {
  if (points.length <= FEW_ENDS) return points;
  const steps = [-1, 0, 1];
  const directions = steps.flatMap((x) => steps.flatMap((y) => steps.map((z) => [x, y, z])));
  const along = (p, d) => p[0] * d[0] + p[1] * d[1] + p[2] * d[2];
  return directions.map((d) => points.reduce((best, p) => (along(p, d) > along(best, d) ? p : best)));
}

function frame(eye, ends, reach) {
  const [low, high] = [0, 1, 2].map((k) => [Infinity, -Infinity].map((start, side) => ends.reduce((best, p) => (side === 0 ? Math.min(best, p[k]) : Math.max(best, p[k])), start)))
    .reduce(([a, b], [l, h]) => [[...a, l], [...b, h]], [[], []]);
  eye.centre = low.map((v, k) => (v + high[k]) / 2);
  eye.size = 1.04 * Math.max(reach * 0.6, Math.hypot(...low.map((v, k) => high[k] - v)) * 0.76);
}

/** What is drawn, and how long and of which colour its arrows are. */
function scaleOf(points, placed, stages, state, size) {
  const share = Math.max(1, Math.ceil(points.length / MAX_DRAWN));
  const drawn = share === 1 ? placed : thinned(points, placed, share, state.stage);
  const first = state.own ? state.stage : stages[0]?.[0];
  const errors = state.stage ? points.map((p) => p.errors?.[first]) : [];
  const longest = Math.max(Math.min(quantile(errors, WITHIN), MEDIANS * quantile(errors, 0.5) || Infinity), SMALLEST_MM);
  const raw = (LONGEST * size) / longest;
  const base = 10 ** Math.floor(Math.log10(raw));
  return { drawn, share, top: longest, factor: Math.max(1, base * ([5, 2, 1].find((m) => m * base <= raw) ?? 1)) };
}

/** One point of each group of neighbours, whatever its error, and the points with the largest errors. */
export function thinned(points, placed, share, stage) {
  const drawn = new Array(points.length).fill(null);
  // a place by chance in each group: poses may repeat in step with the groups
  const random = randomNumbers();
  for (let from = 0; from < points.length; from += share) {
    const i = from + Math.floor(random() * Math.min(share, points.length - from));
    drawn[i] = placed[i];
  }
  const error = (i) => points[i].errors?.[stage] ?? 0;
  for (const i of points.map((_, k) => k).sort((a, b) => error(b) - error(a)).slice(0, WORST_DRAWN)) drawn[i] = placed[i];
  return drawn;
}

const level = (error, top) => Math.max(0, Math.min(LEVELS.length - 1, Math.floor((error / top) * LEVELS.length)));

function legendOf({ stage, top }) {
  if (!stage) return false;
  const decimals = Math.max(0, Math.min(5, 1 - Math.floor(Math.log10(top / LEVELS.length))));
  return LEVELS.map((_, i) => el("span", {}, el(`span.swatch.level-${i + 1}`, {}), i < LEVELS.length - 1 ? `to ${((top * (i + 1)) / LEVELS.length).toFixed(decimals)} mm` : `above ${((top * i) / LEVELS.length).toFixed(decimals)} mm`));
}

function arrowsSaid({ stage, factor, share, drawn }, n, stages, said = "Each arrow goes from where the robot was believed to be to where it was measured,") {
  if (!stage || said === null) return "";
  const some = share > 1 ? ` Drawn are an even sample, one of every ${share} points, and the ${WORST_DRAWN} points with the largest errors ${stages.find(([name]) => name === stage).at(-1)}: ${count(drawn.filter(Boolean).length)} of ${count(n)}.` : "";
  return `${said} ${factor.toLocaleString("en-GB")} times as long.${some}`;
}

const rgb = (text) => text.split(/[ ,]+/).map(Number);

function drawScene(pen, { robot, reach, up, points, placed, state, targets, selected, postures, rest, boxes }) {
  const colours = { grid: pen.colour("--grid-3d"), link: rgb(pen.colour("--arm-link")), joint: rgb(pen.colour("--arm-joint")), tool: pen.colour("--accent"),
    x: pen.colour("--axis-x"), y: pen.colour("--axis-y"), z: pen.colour("--axis-z") };
  ground(pen, reach, colours);
  boxes.forEach((box) => cuboid(pen, box, up, pen.colour(box.colour ?? "--bad")));
  const chosen = selected.index;
  const q = (chosen === null ? null : postures(chosen)) ?? rest();
  const tools = targets.length > 0 ? [targets[points[chosen]?.target ?? 0] ?? targets[0]] : [];
  const lifted = framesOf(robot, q).map((t) => liftedPose(up, t));
  arm(pen, lifted, robot, reach, colours, tools);
  drawPoints(pen, { up, points, placed, state, chosen });
}

const liftedPose = (up, t) => {
  const [x, y, z, p] = [axisX(t), [t[1], t[5], t[9]], [t[2], t[6], t[10]], origin(t)].map((v) => turn(up, v));
  return [x[0], y[0], z[0], p[0], x[1], y[1], z[1], p[1], x[2], y[2], z[2], p[2]];
};

/** In front of everything else: the picked point is never hidden. */
const NEAREST = 1e9;

function drawPoints(pen, { up, points, placed, state, chosen }) {
  const colours = LEVELS.map((name) => pen.colour(name));
  const plain = pen.colour("--accent");
  const small = state.drawn.length > 800 ? 1.3 : 2.2;
  const one = (at, i, strong) => {
    const vector = state.stage && points[i].vectors?.[state.stage];
    const colour = state.stage ? colours[level(points[i].errors[state.stage] ?? 0, state.top)] : plain;
    if (vector) {
      const v = turn(up, vector);
      pen.arrow(at.map((c, k) => c - state.factor * v[k]), at, colour, strong ? 3 : 1.6, strong ? NEAREST : 0);
    }
    pen.dot(at, colour, vector ? small * 0.8 : small + 0.6, { nearer: strong ? NEAREST : 0 });
  };
  state.drawn.forEach((at, i) => at && i !== chosen && one(at, i, false));
  if (chosen === null || !placed[chosen]) return;
  one(placed[chosen], chosen, true);
  pen.dot(placed[chosen], null, 9, { ring: pen.colour("--ink"), nearer: NEAREST });
}

function cuboid(pen, { min_mm: a, max_mm: b }, up, colour) {
  const corner = (i) => apply(up, [0, 1, 2].map((k) => (i & (1 << k) ? b[k] : a[k])));
  for (let i = 0; i < 8; i += 1) for (let k = 0; k < 3; k += 1) if (!(i & (1 << k))) pen.line(corner(i), corner(i | (1 << k)), colour, 1.4, { dash: [5, 4] });
}

/** A point's facts: [name, value] pairs. */
export function pointFacts(title, entries) {
  return [el("p.which", {}, title), el("dl.pairs", {}, entries.filter(Boolean).map(([name, value]) => [el("dt", {}, name), el("dd", {}, value)]))];
}

/** Errors of a point of a report in words, for its panel. */
export function errorFacts(point, stages) {
  return stages.map(([name, words]) => point[`${name}_mm`] !== undefined && [capital(words), [el("strong", {}, mm(point[`${name}_mm`])), point[`${name}_vector_mm`] && el("small.quiet", {}, ` (${point[`${name}_vector_mm`].map((v) => fixed(v, 3)).join(", ")})`)]]);
}

export const jointFacts = (q) => q && ["Joints, °", q.map((v) => fixed(v, 2)).join(", ")];

export { poseOf };
