// Are these my poses? The arm at the postures of an uploaded file, with the measured positions where they are in the robot's base frame.

import { armFigure, jointFacts, pointFacts } from "./arm.js";
import { el } from "./dom.js";
import { fixed, mm } from "./format.js";
import { positionOf } from "./kinematics.js";
import { rowsOfSet } from "./rows.js";
import { selection } from "./selection.js";

/** A node that fills itself once the points were read again. */
export function posesOf(robot, set, signal) {
  const node = el("div", {});
  rowsOfSet(set, signal).then(({ joints, positions, names }) => {
    if (joints && joints.length > 0) node.append(figureOf(robot, joints, set.frame === "base" ? positions : null, names));
  }, () => { /* the upload stands without its picture */ });
  return node;
}

function figureOf(robot, joints, measured, names) {
  const flange = joints.map((q) => positionOf(robot, q));
  const shown = measured?.length === joints.length ? measured : null;
  const gap = (i) => shown && Math.hypot(...flange[i].map((v, k) => v - shown[i][k]));
  const points = joints.map((_, i) => ({ position: (shown ?? flange)[i], target: 0 }));
  const selected = selection(points.length);
  const describe = (i) => pointFacts(names?.[i] ? `Row ${i} (${names[i]})` : `Row ${i}`, [jointFacts(joints[i]), ["Flange, mm", flange[i].map((v) => fixed(v, 1)).join(", ")], shown && ["Measured, mm", shown[i].map((v) => fixed(v, 1)).join(", ")],
    shown && ["Distance", mm(gap(i))]]);
  const caption = shown ? "Dots: measured positions. Pick one: the arm takes the joint values of its row, and its flange should be near the dot, as far off as the reflector is."
    : "Dots: where the joint values of the file put the flange of the nominal robot. Pick one, and compare the arm with the robot in its cell.";
  const made = armFigure({ title: "Are these your poses?", caption, robot, points, selected, postures: (i) => joints[i], describe,
    actions: () => el("div.actions", {}, el("button", { type: "button", click: () => selected.step(-1) }, "Previous"), el("button", { type: "button", click: () => selected.step(1) }, "Next")) });
  selected.set(0);
  return made.node;
}
