// The points of a result: the arm, the errors and the residuals, with one selection.

import { armFigure, errorFacts, jointFacts, pointFacts, pointsOfReport, poseOf } from "./arm.js";
import { el, fill } from "./dom.js";
import { fixed } from "./format.js";
import { apply, framesOf, IDENTITY, inverse, placement, reachOf } from "./kinematics.js";
import { leavingOut } from "./leave_out.js";
import { pointsFigure } from "./points.js";
import { residualTable } from "./residuals.js";
import { rowsOfSet } from "./rows.js";
import { selection } from "./selection.js";
import { nPoints, placeOf } from "./sessions.js";

/** Figures and table of a report's points. `sets` are the sessions of the job; `parameterSet` is what was identified, or scored; `other` the set that was verified on, if it is another one. */
export function resultPoints({ report, job, sets, other, robot, parameterSet, names }, { signal, may, why }) {
  const points = report.per_point;
  const selected = selection(points.length);
  const rows = { joints: null, lines: null };
  const [[set], own] = [sets, nPoints(sets)];
  const setOf = (i) => placeOf(sets, i)?.set ?? other ?? set;
  const row = (i) => {
    const at = placeOf(sets, i);
    if (!at) return `row ${i - own} of the verify set`;
    return sets.length > 1 ? `row ${at.row} of session ${at.session + 1}` : `row ${at.row}`;
  };
  // the service numbers the points of files without a column of configurations
  const label = (i) => points[i].name ?? points[i].configuration;
  const name = (i) => (/^(row_)?\d+$/.test(label(i)) ? row(i) : `${row(i)} (${label(i)})`);
  const leave = leavingOut({ job, sets, points, robot, may, why, name, changed: () => { table.redraw(); cell?.refresh(); } });
  const stages = [["before", names.before], ["after", names.after, names.remains], ...points.some((p) => p.corrected_mm !== undefined && p.corrected_mm !== p.after_mm) ? [["corrected", "with corrections"]] : []];
  const describe = (i) => {
    const p = points[i];
    return pointFacts(`${name(i).replace("row", "Row")}${sets.length > 1 ? "," : " of"} ${setOf(i).name ?? "the set"}`, [[points[i].name ? "Name" : "Configuration", label(i)], rows.lines?.[i] && [`Line in the ${setOf(i).joined ? "instrument's " : ""}file`, rows.lines[i]], ["Target", p.target], ["Half", `${p.subset}${p.outlier ? ", outlier" : ""}`], ...errorFacts(p, stages),
      p.position_mm && ["Measured, mm", p.position_mm.map((v) => fixed(v, 2)).join(", ")], jointFacts(rows.joints?.[i])]);
  };
  const actions = (i) => [leave?.locked, el("div.actions", {}, el("button", { type: "button", click: () => selected.step(-1) }, "Previous"), el("button", { type: "button", click: () => selected.step(1) }, "Next"),
    leave?.may(i) && el("button", { type: "button", click: () => leave.toggle(i) }, leave.excluded.has(i) ? "Keep it" : "Leave it out …"), leave?.excluded.size > 0 && el("button.primary", { type: "button", click: () => { leave.node.scrollIntoView({ block: "center" }); leave.node.querySelector("input").focus({ preventScroll: true }); } }, `Calibrate without ${leave.excluded.size === 1 ? "it" : `these ${leave.excluded.size}`} …`), el("button.plain", { type: "button", click: () => selected.set(null) }, "Close"))];
  const figure = pointsFigure(points, names, selected, name);
  const table = residualTable(points, row, label, selected, leave);
  // the base that was found is that of the last session; points of another one, or that were only scored, have a base that the report does not state
  const isFound = (i) => set.frame === "base" || (job.kind === "identify" && (i < own ? placeOf(sets, i).session === sets.length - 1 : other?.frame === "base"));
  const base = parameterSet ? inverse(poseOf(parameterSet.t_instrument_base)) : IDENTITY;
  const known = pointsOfReport(report, (i) => (isFound(i) ? base : null));
  const caption = el("span", {}, captionOf(set, robot, points.every((_, i) => isFound(i)) ? "found" : "waiting"));
  const cell = points.some((p) => p.position_mm) && armFigure({ title: "The arm and what was measured", caption, robot, points: known, stages,
    targets: targetsOf(parameterSet), selected, postures: (i) => rows.joints?.[i] ?? null, describe, actions });
  const place = () => {
    const waiting = points.map((_, i) => i).filter((i) => !isFound(i));
    if (waiting.length === 0) return;
    const links = parameterSet ? { ...robot, links: parameterSet.links } : robot;
    const session = (i) => placeOf(sets, i)?.session;
    const found = new Map([...new Set(waiting.map(session))].map((one) => {
      const group = waiting.filter((i) => session(i) === one && rows.joints?.[i] && points[i].position_mm && points[i].after_vector_mm);
      return [one, group.length > 3 && placedBy(group, points, rows.joints, links, targetsOf(parameterSet))];
    }));
    const poseAt = (i) => (isFound(i) ? base : found.get(session(i)) || null);
    const areAll = waiting.every((i) => poseAt(i));
    fill(caption, captionOf(set, robot, !areAll ? "unknown" : sets.length > 1 ? "several" : "placed"));
    if (areAll) cell?.place?.(pointsOfReport(report, poseAt));
  };
  const read = (one) => rowsOfSet(one, signal).catch(() => ({}));
  Promise.all([...sets, ...points.length > own && other ? [other] : []].map(read)).then((files) => {
    if (signal.aborted) return;
    // what one file lacks, is left out of all
    const joined = (key) => (files.every((file, k) => file[key] || k >= sets.length) ? files.flatMap((file) => file[key] ?? []) : null);
    const all = Object.fromEntries(["joints", "lines", "times", "sequence"].map((key) => [key, joined(key)]));
    // a place in the measuring order counts within its own session
    if (sets.length > 1) all.sequence = null;
    Object.assign(rows, all);
    figure.known(all);
    table.known(all);
    cell?.refresh?.();
    place();
  });
  /** Shows the points that a warning calls outliers. */
  const outliers = points.map((p, i) => i).filter((i) => points[i].outlier);
  const lookAt = () => table.only("outlier", outliers[0]);
  return { cell: cell ? cell.node : [], errors: figure.node, table: table.node, download: table.download, name, outliers: { rows: outliers, name, lookAt } };
}

/** The measuring frame in the robot's base frame, from the points: measured minus residual is where the arm of these links is, seen from the instrument. */
function placedBy(group, points, joints, robot, targets) {
  const seen = group.map((i) => points[i].position_mm.map((v, k) => v - points[i].after_vector_mm[k]));
  const here = group.map((i) => apply(framesOf(robot, joints[i]).at(-1), targets[points[i].target] ?? targets[0] ?? [0, 0, 0]));
  return placement(seen, here);
}

/** How the points came into the robot's base frame, in words. */
const PLACED = {
  found: "Positions are brought into the robot's base frame by the base that was found.",
  placed: "Positions are brought into the robot's base frame by the place of the instrument in this session.",
  several: "Positions are brought into the robot's base frame by the place of the instrument in each session.",
  waiting: "Positions are brought into the robot's base frame once the file is read.",
  unknown: "The joint values of this file cannot be read here, so its points cannot be shown beside the arm.",
};

const captionOf = (set, robot, how) => `${Math.round(reachOf(robot)).toLocaleString("en-GB")} mm from joint to joint; grey: the nominal arm. ${set.frame === "base" ? "Positions are in the robot's base frame." : PLACED[how]}`;

/** The measured reflectors in the flange frame, by their number. */
function targetsOf(parameterSet) {
  const found = [];
  for (const { target, position_mm: position } of parameterSet?.targets ?? []) found[target] = position;
  return found;
}
