// Are these my poses? The arm at the postures of an uploaded file, with the measured positions where they are in the robot's base frame.

import { blob } from "./api.js";
import { armFigure, jointFacts, pointFacts } from "./arm.js";
import { el } from "./dom.js";
import { fixed, mm } from "./format.js";
import { positionOf } from "./kinematics.js";
import { fromCsv, rowsOfSet } from "./rows.js";
import { selection } from "./selection.js";

/** A node that fills itself once the file was read again; empty where its joint values cannot be read here. */
export function posesOf(robot, set, signal) {
  const node = el("div", {});
  rowsOfSet(set, robot.links.length, signal).then(async ({ joints }) => {
    if (!joints || joints.length === 0) return;
    const measured = set.frame === "base" ? await positionsOf(set, signal) : null;
    node.append(figureOf(robot, set, joints, measured));
  }, () => { /* the upload stands without its picture */ });
  return node;
}

function figureOf(robot, set, joints, measured) {
  const flange = joints.map((q) => positionOf(robot, q));
  const shown = measured?.length === joints.length ? measured : null;
  const gap = (i) => shown && Math.hypot(...flange[i].map((v, k) => v - shown[i][k]));
  const points = joints.map((_, i) => ({ position: (shown ?? flange)[i], target: 0 }));
  const selected = selection(points.length);
  const describe = (i) => pointFacts(`Row ${i}`, [jointFacts(joints[i]), ["Flange, mm", flange[i].map((v) => fixed(v, 1)).join(", ")], shown && ["Measured, mm", shown[i].map((v) => fixed(v, 1)).join(", ")],
    shown && ["Distance", mm(gap(i))]]);
  const caption = shown ? "Dots: measured positions. Pick one: the arm takes the joint values of its row, and its flange should be near the dot, as far off as the reflector is."
    : "Dots: where the joint values of the file put the flange of the nominal robot. Pick one, and compare the arm with the robot in its cell.";
  const made = armFigure({ title: "Are these your poses?", caption, robot, points, selected, postures: (i) => joints[i], describe,
    actions: () => el("div.actions", {}, el("button", { type: "button", click: () => selected.step(-1) }, "Previous"), el("button", { type: "button", click: () => selected.step(1) }, "Next")) });
  selected.set(0);
  return made.node;
}

/** Measured positions of a set, mm; null where this page cannot read them. */
async function positionsOf(set, signal) {
  const file = await blob(`/v1/measurement-sets/${set.id}/points`, signal);
  const text = await file.text();
  if (file.type.startsWith("application/json")) return JSON.parse(text).points.map((p) => p.position_mm);
  return fromCsv(text, 0, set).positions;
}
