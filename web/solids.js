// The solids of an arm: tubes along its links and drums around its joints.

import { apply, axisX, axisZ, origin } from "./kinematics.js";
import { along, dot, minus } from "./scene.js";

/** Faces around a tube. */
const SIDES = 18;
/** Radius of the base's tube, and of the last link's, as shares of the reach. */
const [THICK, THIN] = [0.042, 0.02];
/** A drum is wider than the tubes beside it. */
const DRUM = 1.32;

const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (a) => { const length = Math.hypot(...a) || 1; return a.map((v) => v / length); };

/** A tube between two points, with flat ends; the radii may differ. */
export function tube(pen, from, to, [r1, r2], colour) {
  const axis = minus(to, from);
  if (Math.hypot(...axis) < 1e-9) return;
  const w = unit(axis);
  const u = unit(cross(w, Math.abs(w[2]) < 0.9 ? [0, 0, 1] : [1, 0, 0]));
  const v = cross(w, u);
  const out = Array.from({ length: SIDES }, (_, i) => {
    const angle = (2 * Math.PI * i) / SIDES;
    return u.map((c, k) => c * Math.cos(angle) + v[k] * Math.sin(angle));
  });
  const [near, far] = [out.map((n) => along(from, n, r1)), out.map((n) => along(to, n, r2))];
  // long tubes are cut, so that each part is sorted by its own depth
  const parts = Math.max(1, Math.min(6, Math.round(Math.hypot(...axis) / (4 * Math.max(r1, r2)))));
  const at = (i, part) => along(near[i], minus(far[i], near[i]), part / parts);
  for (let i = 0; i < SIDES; i += 1) {
    const j = (i + 1) % SIDES;
    const normal = unit(along(out[i], out[j], 1));
    for (let part = 0; part < parts; part += 1) pen.face([at(i, part), at(j, part), at(j, part + 1), at(i, part + 1)], normal, colour);
  }
  pen.face([...near].reverse(), w.map((c) => -c), colour);
  pen.face(far, w, colour);
}

/** The arm in a posture, from its frames (base first, flange last). `targets` are points in the flange frame. */
export function arm(pen, frames, robot, reach, colours, targets = []) {
  const n = robot.links.length;
  const radius = (i) => reach * (THICK + (THIN - THICK) * (i / Math.max(1, n)));
  foot(pen, reach, colours.joint);
  robot.links.forEach((link, i) => {
    const [before, here] = [frames[i], frames[i + 1]];
    const start = origin(before);
    const elbow = along(start, axisX(before), link.a_mm);
    const [thick, thin] = [radius(i), radius(i + 1)];
    if (Math.abs(link.a_mm) > 1e-6) tube(pen, start, elbow, [thick * 0.9, thick * 0.9], colours.link);
    tube(pen, elbow, origin(here), [thick, thin], colours.link);
    const axis = axisZ(here);
    // the first drum stands on the foot, the last one is the flange
    const half = thick * (i === n - 1 ? 0.35 : 1.15);
    const middle = i === 0 ? along(elbow, axis, half) : i === n - 1 ? along(origin(here), axis, -half) : elbow;
    tube(pen, along(middle, axis, -half), along(middle, axis, half), [thick * DRUM, thick * DRUM], colours.joint);
  });
  const flange = frames.at(-1);
  for (const target of targets) {
    const at = apply(flange, target);
    if (Math.hypot(...target) > reach * 1e-4) pen.line(origin(flange), at, colours.tool, 2.5);
    pen.dot(at, colours.tool, 4, { nearer: radius(n) * 2 });
  }
}

function foot(pen, reach, colour) {
  tube(pen, [0, 0, -reach * 0.012], [0, 0, reach * 0.012], [reach * 0.085, reach * 0.08], colour);
}

/** A grid on the floor through the base, and the base's axes. */
export function ground(pen, extent, colours) {
  const step = roundStep(extent / 4);
  const n = Math.ceil(extent / step);
  for (let i = -n; i <= n; i += 1) {
    for (const [a, b] of [[[i * step, -n * step, 0], [i * step, n * step, 0]], [[-n * step, i * step, 0], [n * step, i * step, 0]]]) {
      // drawn first: everything stands on the floor, seen from above
      pen.line(a, b, colours.grid, i === 0 ? 1.4 : 1, { behind: pen.axes.away[2] < 0 ? 1e9 : 0 });
    }
  }
  const length = step * 0.75;
  for (const [k, name, colour] of [[0, "x", colours.x], [1, "y", colours.y], [2, "z", colours.z]]) {
    const tip = [0, 1, 2].map((i) => (i === k ? length : 0));
    if (Math.abs(dot(pen.axes.away, tip)) > 0.97 * length) continue;
    pen.arrow([0, 0, 0], tip, colour, 2);
    pen.text(tip, name, colour);
  }
  return step;
}

function roundStep(raw) {
  const base = 10 ** Math.floor(Math.log10(raw || 1));
  return base * [5, 2, 1].find((m) => m * base <= raw);
}
