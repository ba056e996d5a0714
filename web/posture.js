// Is this the arm in the cell? A posture as the pendant shows it, beside the arm of these links: the difference in millimetres and degrees, and which joints
// it says nothing of.

import { armFigure } from "./arm.js";
import { el, fill } from "./dom.js";
import { fixed } from "./format.js";
import { framesOf, origin, restOf } from "./kinematics.js";
import { apart, ofMatrix, quaternion, ROTATIONS } from "./rotations.js";
import { selection } from "./selection.js";

/** Robots of one type differ at the flange by at most this share of its distance from the base, as in the service. A joint that moves the flange by less is not compared. */
const MAX_APART = 0.02;
/** A pendant rounds its joint values, degrees. */
const ROUNDED_DEG = 0.01;
/** Nominal and real arm differ by some millimetres and tenths of a degree; what differs by more is another arm, mm and degrees. */
const [SAME_MM, SAME_DEG] = [5, 0.5];

const size = (v) => Math.hypot(...v);
const between = (a, b) => size(a.map((v, k) => v - b[k]));

/** The form's parts; `flange` is what the pendant is compared with. Nothing is stored. */
export function postureCheck(robot, { title, level = "h3" }) {
  const q = restOf(robot);
  const drawn = armFigure({ title, level, caption: "Type the joint values that the pendant shows, and where it says that the flange is: tool 0, base 0. Move every joint away from 0, the last one too.", robot, points: [], selected: selection(0), postures: () => q, rest: () => q });
  const [flange, verdict] = [el("p", { role: "status" }), el("div", { "aria-live": "polite" })];
  const joints = robot.links.map((_, i) => el("input", { type: "number", step: "any", value: q[i], "aria-label": `Joint ${i + 1}, degrees`, input: () => say() }));
  const place = ["x", "y", "z"].map((axis) => el("input", { type: "number", step: "any", "aria-label": `${axis} on the pendant, mm`, placeholder: axis, input: () => say() }));
  const kind = el("select", { "aria-label": "How the pendant writes the orientation", change: () => { drawAngles(); say(); } }, ROTATIONS.map(([value, words]) => el("option", { value }, value === "none" ? "no orientation" : words)));
  const angles = el("span.controls", {});
  const angleInputs = () => [...angles.querySelectorAll("input")];
  const drawAngles = () => fill(angles, ROTATIONS.find(([value]) => value === kind.value)[2].map((name) => el("input", { type: "number", step: "any", "aria-label": `${name} on the pendant`, placeholder: name, input: () => say() })));
  const typed = (inputs) => (inputs.length > 0 && inputs.every((input) => input.value !== "") ? inputs.map((input) => Number(input.value)) : null);
  const say = () => {
    const outside = joints.map((input, i) => outsideOf(robot.links[i], input.value, i)).filter(Boolean);
    joints.forEach((input, i) => { input.setAttribute("aria-invalid", String(outside.some(({ joint }) => joint === i))); });
    if (outside.length > 0) {
      // the arm stays where it can be
      fill(flange);
      fill(verdict, el("div.problem", { role: "alert" }, outside.map(({ said }) => el("p", {}, said)), el("p", {}, "Look at the sign and at the zero of the joint. Nothing is compared meanwhile.")));
      return;
    }
    joints.forEach((input, i) => { q[i] = Number(input.value); });
    const t = framesOf(robot, q).at(-1);
    drawn.redraw();
    fill(flange, "Flange in the base frame: ", el("strong", {}, origin(t).map((v) => fixed(v, 2)).join(", ")), " mm");
    fill(verdict, compared(robot, q, t, typed(place), kind.value === "none" ? null : typed(angleInputs()) && quaternion(kind.value, typed(angleInputs()))));
  };
  say();
  return el("div.posture", {}, drawn.node, el("div.controls", {}, joints.map((input, i) => el("label.joint", {}, `J${i + 1}, °`, input))), flange,
    el("fieldset", {}, el("legend", {}, "What the pendant shows, mm"), el("div.controls", {}, place, kind, angles)), verdict);
}

/** A joint value that the arm cannot have. */
function outsideOf({ joint_limits_deg: limits }, text, i) {
  if (text === "" || !Number.isFinite(Number(text))) return { joint: i, said: `Joint ${i + 1} has no value.` };
  const [low, high] = limits ?? [-Infinity, Infinity];
  const value = Number(text);
  return (value < low - ROUNDED_DEG || value > high + ROUNDED_DEG) && { joint: i, said: `Joint ${i + 1}: ${fixed(value, 2)}° is outside of its limits, ${fixed(low, 2)}° to ${fixed(high, 2)}°.` };
}

/** How far the pendant is from the arm, and what that does not show. */
function compared(robot, q, t, position, orientation) {
  if (!position) return el("p.note", {}, "Type x, y and z of the pendant, and its angles where it shows them: the difference stands here.");
  const off = between(position, origin(t));
  const turned = orientation && apart(ofMatrix([[t[0], t[1], t[2]], [t[4], t[5], t[6]], [t[8], t[9], t[10]]]), orientation);
  const hasAngle = typeof turned === "number";
  const isSame = off <= SAME_MM && (!hasAngle || turned <= SAME_DEG);
  const unchecked = hasAngle ? [] : uncheckedJoints(robot, q, origin(t));
  const figures = `${off.toFixed(2)} mm${hasAngle ? ` and ${turned.toFixed(3)}°` : ""} apart`;
  const [joints, them] = unchecked.length === 1 ? [`Joint ${unchecked[0]} was`, "it"] : [`Joints ${unchecked.slice(0, -1).join(", ")} and ${unchecked.at(-1)} were`, "them"];
  return el(isSame ? "div.done" : "div.warning", {}, el("p", {}, el("strong", {}, `Pendant and arm are ${figures}. `), isSame ? "It may be this arm: compare a second posture, with other signs." : "It is another arm, a tool or base is active, or a joint is counted otherwise. Compare one joint after the other."),
    unchecked.length > 0 && el("p", {}, `${joints} not compared: half a turn of ${them} hardly moves this point. Type the pendant's orientation, too.`));
}

/** The joints, from 1, of which half a turn hardly moves the flange. */
function uncheckedJoints(robot, q, at) {
  const moved = (i) => between(origin(framesOf(robot, q.map((v, k) => (k === i ? v + 180 : v))).at(-1)), at);
  return q.map((_, i) => i).filter((i) => moved(i) < MAX_APART * size(at)).map((i) => i + 1);
}

/** The check on the page of a stored robot, folded. */
export function postureCard(robot) {
  const place = el("div", {});
  const open = (event) => { if (event.target.open && place.childNodes.length === 0) fill(place, postureCheck(robot, { title: `Is this your ${robot.name}?` })); };
  return el("section.card", {}, el("details", { id: "posture", toggle: open }, el("summary", {}, "Compare a posture with the pendant"), place));
}
