// The points of a result: the arm, the errors and the residuals, with one selection.

import { armFigure, errorFacts, jointFacts, pointFacts, pointsOfReport, poseOf } from "./arm.js";
import { el } from "./dom.js";
import { fixed } from "./format.js";
import { reachOf } from "./kinematics.js";
import { pointsFigure } from "./points.js";
import { leavingOut, residualTable } from "./residuals.js";
import { rowsOfSet } from "./rows.js";
import { selection } from "./selection.js";

/** Figures and table of a report's points. */
export function resultPoints({ report, job, set, robot, parameterSet, names }, { signal, may }) {
  const points = report.per_point;
  const selected = selection(points.length);
  const name = (i) => (i < set.n_points ? `row ${i}` : `row ${i - set.n_points} of the verify set`);
  const rows = { joints: null };
  const leave = leavingOut({ job, set, points, robot, may, name, changed: () => { table.redraw(); cell?.refresh(); } });
  const stages = [["before", names.before], ["after", names.after, names.remains], ...points.some((p) => p.corrected_mm !== undefined && p.corrected_mm !== p.after_mm) ? [["corrected", "with corrections"]] : []];
  const describe = (i) => {
    const p = points[i];
    return pointFacts(`${name(i).replace("row", "Row")} of ${set.name ?? "the set"}`, [["Configuration", p.configuration], ["Target", p.target], ["Half", `${p.subset}${p.outlier ? ", outlier" : ""}`], ...errorFacts(p, stages),
      p.position_mm && ["Measured, mm", p.position_mm.map((v) => fixed(v, 2)).join(", ")], jointFacts(rows.joints?.[i])]);
  };
  const actions = (i) => el("div.actions", {}, el("button", { type: "button", click: () => selected.step(-1) }, "Previous"), el("button", { type: "button", click: () => selected.step(1) }, "Next"),
    leave?.may(i) && el("button", { type: "button", click: () => leave.toggle(i) }, leave.excluded.has(i) ? "Keep it" : "Leave it out …"), leave?.excluded.size > 0 && el("button.primary", { type: "button", click: () => { leave.node.scrollIntoView({ block: "center" }); leave.node.querySelector("input").focus({ preventScroll: true }); } }, `Calibrate without ${leave.excluded.size === 1 ? "it" : `these ${leave.excluded.size}`} …`), el("button.plain", { type: "button", click: () => selected.set(null) }, "Close"));
  const figure = pointsFigure(points, names, selected, name);
  const table = residualTable(points, name, selected, leave);
  const cell = points.some((p) => p.position_mm) && armFigure({ title: "The arm and what was measured", caption: captionOf(set, robot, parameterSet), robot, points: pointsOfReport(report, baseOf(parameterSet, report)), stages,
    targets: targetsOf(parameterSet), selected, postures: (i) => rows.joints?.[i] ?? null, describe, actions });
  rowsOfSet(set, robot.links.length, signal).then((read) => {
    if (signal.aborted || (read.joints && read.joints.length < set.n_points)) return;
    rows.joints = read.joints;
    figure.known(read);
    table.known(read);
    cell?.refresh?.();
  }, () => { /* the figures stand without joints */ });
  return { cell: cell ? cell.node : [], errors: figure.node, table: table.node, download: table.download };
}

const captionOf = (set, robot, parameterSet) => `${Math.round(reachOf(robot)).toLocaleString("en-GB")} mm from joint to joint; grey: the nominal arm. ${set.frame === "base" ? "Positions are in the robot's base frame." : parameterSet ? "Positions are brought into the robot's base frame by the base that was found." : "Positions stand as the instrument measured them."}`;

const baseOf = (parameterSet) => parameterSet && poseOf(parameterSet.t_instrument_base);

/** The measured reflectors in the flange frame, by their number. */
function targetsOf(parameterSet) {
  const found = [];
  for (const { target, position_mm: position } of parameterSet?.targets ?? []) found[target] = position;
  return found;
}
