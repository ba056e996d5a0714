// A small 3-D view on a canvas: camera, solids in painter's order, and turning, zooming and picking by pointer, touch and keyboard. No WebGL:
// industrial PCs often have none, and an arm with some thousand points needs none.

import { el } from "./dom.js";

/** Eye angle over the height of the picture, rad. */
const FIELD = 0.6;
/** Angle of one press of an arrow key, rad. */
const STEP = Math.PI / 24;
const ZOOM = 1.15;
/** The view never looks from exactly above or below, where left and right would flip. */
const STEEPEST = Math.PI / 2 - 1e-4;
/** Zoom relative to the whole scene. */
const [NEAREST, FARTHEST] = [0.02, 6];
/** What is framed stays this far from the edges, as a share of the smaller side: joints are drawn thicker than their axes. */
const MARGIN = 0.1;
/** Steps of the search for the zoom that frames everything. */
const FIT_STEPS = 24;
/** A pointer that moved less than this did not drag, px. */
const STILL_PX = 4;
/** Distances at which a point is hit, px: a mouse, a finger. */
const [HIT_PX, TOUCH_PX] = [14, 28];

/** [name, words, which a narrow page leaves out in part, azimuth, elevation]. */
export const VIEWS = [["perspective", ["In ", "perspective"], -0.75, 0.38], ["above", ["Seen from ", "above"], -Math.PI / 2, STEEPEST], ["side", ["Seen from the ", "side"], -Math.PI / 2, 0], ["front", ["Seen from the ", "front"], 0, 0]];

/**
 * A view. `draw(pen)` draws the scene whenever it is needed; `ends()` are the places that have to be in the picture until somebody moves it;
 * `points()` are those that can be picked: [x, y, z] each, or null;
 * `picked(index)` is told which. `step(by)` goes to the next point. `label` names the picture for screen readers.
 */
export function view({ label, draw, ends, points, picked, step }) {
  const canvas = el("canvas.scene", { tabindex: 0, role: "application", "aria-label": label, "aria-roledescription": "3-D view" });
  const eye = { centre: [0, 0, 0], size: 1000, azimuth: VIEWS[0][2], elevation: VIEWS[0][3], zoom: 1, pan: [0, 0] };
  let [waiting, isMoved] = [false, false];
  const redraw = () => {
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(() => {
      waiting = false;
      paint(canvas, eye, draw);
    });
  };
  const fit = () => {
    if (!isMoved) fitted(canvas, eye, ends());
    redraw();
  };
  const look = (name) => {
    const [, , azimuth, elevation] = VIEWS.find(([known]) => known === name);
    Object.assign(eye, { azimuth, elevation });
    isMoved = false;
    fit();
  };
  const zoom = (by) => {
    isMoved = true;
    eye.zoom = Math.min(FARTHEST, Math.max(NEAREST, eye.zoom / by));
    redraw();
  };
  const move = { turn: (right, up) => { isMoved = true; eye.azimuth -= right; eye.elevation = Math.max(-STEEPEST, Math.min(STEEPEST, eye.elevation + up)); redraw(); },
    pan: (x, y) => { isMoved = true; eye.pan = [eye.pan[0] + x, eye.pan[1] + y]; redraw(); }, zoom };
  const hit = (event, reach) => {
    const box = canvas.getBoundingClientRect();
    const found = nearest(projector(canvas, eye), points(), [event.clientX - box.left, event.clientY - box.top], reach);
    if (found !== null) picked(found);
    return found;
  };
  byPointer(canvas, move, hit);
  byKeyboard(canvas, move, { look, step, clear: () => picked(null) });
  new ResizeObserver(fit).observe(canvas);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
  return { canvas, eye, redraw, fit, look, zoom, place: (point) => projector(canvas, eye)(point) };
}

function byPointer(canvas, move, hit) {
  const down = new Map();
  let dragged = false;
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    if (down.size === 0) dragged = false;
    down.set(event.pointerId, { x: event.clientX, y: event.clientY, from: [event.clientX, event.clientY] });
  });
  canvas.addEventListener("pointermove", (event) => {
    const last = down.get(event.pointerId);
    if (!last) return;
    const [dx, dy] = [event.clientX - last.x, event.clientY - last.y];
    if (Math.hypot(event.clientX - last.from[0], event.clientY - last.from[1]) > STILL_PX) dragged = true;
    if (down.size === 2) pinch([...down.entries()].find(([id]) => id !== event.pointerId)[1], last, event, move);
    else if (dragged && (event.shiftKey || event.buttons === 2)) move.pan(dx, dy);
    else if (dragged) move.turn(dx * 0.008, dy * 0.008);
    Object.assign(last, { x: event.clientX, y: event.clientY });
  });
  const up = (event) => {
    if (!down.delete(event.pointerId) || dragged || event.type === "pointercancel") return;
    hit(event, event.pointerType === "touch" ? TOUCH_PX : HIT_PX);
  };
  canvas.addEventListener("pointerup", up);
  canvas.addEventListener("pointercancel", up);
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  // The wheel scrolls the page until the view was clicked or reached by Tab.
  canvas.addEventListener("wheel", (event) => {
    if (document.activeElement !== canvas && !event.ctrlKey) return;
    event.preventDefault();
    move.zoom(ZOOM ** (-event.deltaY / 100));
  }, { passive: false });
}

/** Two fingers: their distance zooms, their middle moves the view. */
function pinch(other, last, now, move) {
  const length = (p) => Math.hypot(p[0] - other.x, p[1] - other.y) || 1;
  move.zoom(length([now.clientX, now.clientY]) / length([last.x, last.y]));
  move.pan((now.clientX - last.x) / 2, (now.clientY - last.y) / 2);
}

function byKeyboard(canvas, move, { look, step, clear }) {
  const arrows = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
  const keys = { "+": () => move.zoom(ZOOM), "=": () => move.zoom(ZOOM), "-": () => move.zoom(1 / ZOOM), Home: () => look("perspective"), n: () => step(1), p: () => step(-1), PageDown: () => step(1), PageUp: () => step(-1), Escape: clear };
  canvas.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.altKey || event.metaKey) return;
    const arrow = arrows[event.key];
    if (arrow && event.shiftKey) move.pan(30 * arrow[0], -30 * arrow[1]);
    else if (arrow) move.turn(-STEP * arrow[0], STEP * arrow[1]);
    else if (keys[event.key]) keys[event.key]();
    else return;
    event.preventDefault();
  });
}

/** Index of the point nearest to a place on the canvas within reach; of several at the same place the foremost. */
function nearest(project, points, [x, y], reach) {
  let [best, found] = [reach, null];
  points.forEach((point, i) => {
    const at = point && project(point);
    if (!at) return;
    const away = Math.hypot(at[0] - x, at[1] - y) + at[2] * 1e-6;
    if (away < best) [best, found] = [away, i];
  });
  return found;
}

/** Camera axes: to the right, up and away. */
function axesOf({ azimuth, elevation }) {
  const [ca, sa, ce, se] = [Math.cos(azimuth), Math.sin(azimuth), Math.cos(elevation), Math.sin(elevation)];
  return { right: [-sa, ca, 0], up: [-se * ca, -se * sa, ce], away: [-ce * ca, -ce * sa, -se] };
}
export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const minus = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
export const along = (a, b, t) => [a[0] + t * b[0], a[1] + t * b[1], a[2] + t * b[2]];

/** From a point, mm, to [x, y, depth, px per mm] on the canvas; null behind the eye. */
function projector(canvas, eye) {
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  const { right, up, away } = axesOf(eye);
  const distance = (0.5 * eye.size * eye.zoom) / Math.tan(FIELD / 2);
  const focal = (0.5 * Math.min(height, width * 1.15)) / Math.tan(FIELD / 2);
  return (point) => {
    const from = minus(point, eye.centre);
    const depth = distance + dot(from, away);
    if (depth < 1e-3 * distance) return null;
    const scale = focal / depth;
    return [width / 2 + eye.pan[0] + scale * dot(from, right), height / 2 + eye.pan[1] - scale * dot(from, up), depth, scale];
  };
}

/** Sets zoom and place of the picture so that these places fill it and none is cut. */
function fitted(canvas, eye, ends) {
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  const margin = MARGIN * Math.min(width, height);
  if (margin < 1 || ends.length === 0) return;
  const boundsAt = (zoom) => {
    Object.assign(eye, { zoom, pan: [0, 0] });
    const at = ends.map(projector(canvas, eye));
    if (at.includes(null)) return null;
    return [0, 1].map((k) => [at.reduce((low, p) => Math.min(low, p[k]), Infinity), at.reduce((high, p) => Math.max(high, p[k]), -Infinity)]);
  };
  const holds = (bounds) => bounds !== null && [width, height].every((size, k) => bounds[k][1] - bounds[k][0] <= size - 2 * margin);
  let [near, far] = [NEAREST, FARTHEST];
  for (let i = 0; i < FIT_STEPS; i += 1) {
    const middle = Math.sqrt(near * far);
    if (holds(boundsAt(middle))) far = middle;
    else near = middle;
  }
  const bounds = boundsAt(far);
  if (bounds) eye.pan = [width, height].map((size, k) => size / 2 - (bounds[k][0] + bounds[k][1]) / 2);
}

function paint(canvas, eye, draw) {
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  if (width < 20 || height < 20) return;
  const ratio = Math.min(3, window.devicePixelRatio || 1);
  if (canvas.width !== Math.round(width * ratio)) canvas.width = Math.round(width * ratio);
  if (canvas.height !== Math.round(height * ratio)) canvas.height = Math.round(height * ratio);
  const g = canvas.getContext("2d");
  g.setTransform(ratio, 0, 0, ratio, 0, 0);
  g.clearRect(0, 0, width, height);
  const pen = new Pen(g, projector(canvas, eye), axesOf(eye), getComputedStyle(canvas), { width, height });
  draw(pen);
  pen.finish();
}

/** Collects faces, lines and dots, and draws them from back to front. */
class Pen {
  constructor(g, project, axes, style, size) {
    Object.assign(this, { g, project, axes, style, size, things: [] });
    this.light = along(along([-axes.away[0], -axes.away[1], -axes.away[2]], axes.up, 0.9), axes.right, -0.55);
    const length = Math.hypot(...this.light);
    this.light = this.light.map((v) => v / length);
  }

  /** A colour of the style sheet, by the name of its property. */
  colour(name) {
    return this.style.getPropertyValue(name).trim();
  }

  /** A flat face with its outward normal; faces that look away are left out. */
  face(corners, normal, [r, g, b]) {
    const at = corners.map(this.project);
    if (at.includes(null)) return;
    let area = 0;
    at.forEach(([x, y], i) => { const [u, v] = at[(i + 1) % at.length]; area += x * v - u * y; });
    if (area > 0) return;
    const shade = 0.42 + 0.62 * Math.max(0, dot(normal, this.light));
    const fill = `rgb(${[r, g, b].map((c) => Math.min(255, Math.round(c * shade))).join(" ")})`;
    this.things.push({ depth: at.reduce((sum, p) => sum + p[2], 0) / at.length, at, fill });
  }

  /** A straight line; `width` in px. */
  line(from, to, stroke, width = 1, { dash, behind = 0 } = {}) {
    const [a, b] = [this.project(from), this.project(to)];
    if (a && b) this.things.push({ depth: (a[2] + b[2]) / 2 + behind, line: [a, b], stroke, width, dash });
  }

  /** An arrow with a head of constant size; one that is nearer is drawn over what is in front of it. */
  arrow(from, to, stroke, width = 1.6, nearer = 0) {
    const [a, b] = [this.project(from), this.project(to)];
    if (a && b) this.things.push({ depth: Math.min(a[2], b[2]) - nearer, arrow: [a, b], stroke, width });
  }

  /** A dot; radius in px. */
  dot(point, fill, radius, { ring, nearer = 0 } = {}) {
    const at = this.project(point);
    if (at) this.things.push({ depth: at[2] - nearer, dot: at, fill, radius, ring });
  }

  /** Text beside a point, over everything. */
  text(point, words, fill) {
    const at = this.project(point);
    if (at) this.things.push({ depth: -1, text: at, words, fill });
  }

  finish() {
    const { g } = this;
    this.things.sort((a, b) => b.depth - a.depth);
    g.lineCap = "round";
    g.lineJoin = "round";
    for (const thing of this.things) {
      if (thing.at) fillFace(g, thing);
      else if (thing.line) stroke(g, thing.line, thing);
      else if (thing.arrow) strokeArrow(g, thing);
      else if (thing.dot) fillDot(g, thing);
      else write(g, thing, this.colour("--card"));
    }
  }
}

function fillFace(g, { at, fill }) {
  g.beginPath();
  at.forEach(([x, y], i) => (i === 0 ? g.moveTo(x, y) : g.lineTo(x, y)));
  g.closePath();
  g.fillStyle = fill;
  g.fill();
  // closes the hairline between neighbouring faces
  g.strokeStyle = fill;
  g.lineWidth = 0.8;
  g.stroke();
}

function stroke(g, [a, b], { stroke: colour, width, dash }) {
  g.beginPath();
  g.setLineDash(dash ?? []);
  g.moveTo(a[0], a[1]);
  g.lineTo(b[0], b[1]);
  g.strokeStyle = colour;
  g.lineWidth = width;
  g.stroke();
  g.setLineDash([]);
}

function strokeArrow(g, { arrow: [a, b], stroke: colour, width }) {
  const [dx, dy] = [b[0] - a[0], b[1] - a[1]];
  const length = Math.hypot(dx, dy);
  if (length < 2.5) return fillDot(g, { dot: b, fill: colour, radius: 1.6 });
  stroke(g, [a, b], { stroke: colour, width });
  const head = Math.min(6.5, length * 0.5);
  const [ux, uy] = [(dx / length) * head, (dy / length) * head];
  g.beginPath();
  g.moveTo(b[0], b[1]);
  g.lineTo(b[0] - ux - uy * 0.5, b[1] - uy + ux * 0.5);
  g.lineTo(b[0] - ux + uy * 0.5, b[1] - uy - ux * 0.5);
  g.closePath();
  g.fillStyle = colour;
  g.fill();
}

function fillDot(g, { dot: [x, y], fill, radius, ring }) {
  g.beginPath();
  g.arc(x, y, radius, 0, 2 * Math.PI);
  if (fill) {
    g.fillStyle = fill;
    g.fill();
  }
  if (!ring) return;
  g.strokeStyle = ring;
  g.lineWidth = 2;
  g.stroke();
}

function write(g, { text: [x, y], words, fill }, halo) {
  g.font = "600 12px system-ui, \"DejaVu Sans\", sans-serif";
  g.lineWidth = 3.5;
  g.strokeStyle = halo;
  g.strokeText(words, x + 8, y + 4);
  g.fillStyle = fill;
  g.fillText(words, x + 8, y + 4);
}
