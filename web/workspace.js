// The uncertainty of the tool over the workspace, as dots about the arm.

import { post } from "./api.js";
import { armFigure, jointFacts, pointFacts } from "./arm.js";
import { el, fill, problem } from "./dom.js";
import { fixed, mm } from "./format.js";
import { framesOf, origin, positionOf, randomNumbers } from "./kinematics.js";
import { standsOnFloor } from "./plan.js";
import { selection } from "./selection.js";

const N_CONFIGURATIONS = 600;
/** Range of a joint without limits, degrees. */
const WITHOUT_LIMITS = [-90, 90];

/** A card with a button that shows it. Nothing is asked of the service before. */
export function workspaceCard(robot, parameterSet) {
  const out = el("div", { "aria-live": "polite" });
  const show = async () => {
    button.disabled = true;
    fill(out, el("p.quiet", {}, "Asking for the uncertainty …"));
    try {
      const configurations = randomConfigurations(robot, targetOf(parameterSet));
      if (configurations.length === 0) return fill(out, el("p.quiet", {}, "Within its joint limits the arm is always below its mounting surface: state how it is mounted."));
      const { position_std_mm: std } = await post(`/v1/parameter-sets/${parameterSet.id}/predict`, { q_deg: configurations });
      fill(out, std ? figure(robot, parameterSet, configurations, std) : el("p.quiet", {}, "The uncertainty of these parameters is not known, so there is nothing to show."));
    } catch (error) {
      button.disabled = false;
      fill(out, problem(error));
    }
  };
  const button = el("button", { type: "button", click: show }, "Show it");
  return el("section.card", {}, el("div.head", {}, el("div", {}, el("h2", {}, "Where the tool is known well"), el("p.quiet", {}, "The standard uncertainty of the tool's position over the workspace: where more poses would help, and where a tight task should not be.")), el("div.actions", {}, button)), out);
}

const targetOf = (parameterSet) => parameterSet.targets?.find((t) => t.target === 0)?.position_mm ?? [0, 0, 0];

function figure(robot, parameterSet, configurations, std) {
  const target = targetOf(parameterSet);
  const points = configurations.map((q, i) => ({ position: positionOf(robot, q, target), vectors: {}, errors: { std: std[i] }, target: 0 }));
  const selected = selection(points.length);
  const sorted = [...std].sort((a, b) => a - b);
  const describe = (i) => pointFacts("Configuration", [["Standard uncertainty", mm(std[i])], jointFacts(configurations[i]), ["Tool, mm", points[i].position.map((v) => fixed(v, 0)).join(", ")]]);
  const open = robot.links.some((link) => !link.joint_limits_deg);
  const caption = `${points.length} random configurations${open ? `; a joint without limits is taken from ${WITHOUT_LIMITS[0]}° to ${WITHOUT_LIMITS[1]}°` : " within the joint limits"}${standsOnFloor(robot) ? ", with every joint, flange and reflector above the robot's mounting surface (z = 0 of its base)" : ""}. Half of them are below ${mm(sorted[Math.floor(sorted.length / 2)])}, the largest is ${mm(sorted.at(-1))}. One standard deviation at the measured reflector: of the links, and also of the base and of the reflector's place on the flange.`;
  return armFigure({ title: "Uncertainty over the workspace", caption, robot, points, stages: [["std", "standard uncertainty"]], said: null, shows: "its uncertainty and its joints", targets: [target], selected, postures: (i) => configurations[i], describe }).node;
}

/** Tries for each configuration that is drawn: an arm on the floor reaches below it in half of them. */
const TRIES = 40;

/** Whether the arm is above the surface that it stands on, with its joints, its flange and its reflector. */
function isAbove(robot, q, target) {
  const heights = [...framesOf(robot, q).map((t) => origin(t)[2]), positionOf(robot, q, target)[2]];
  return heights.every((z) => z > -1e-6);
}

/** The same ones each time, so that pictures can be compared; of a robot on the floor those above the floor. */
export function randomConfigurations(robot, target) {
  const random = randomNumbers();
  const drawn = () => robot.links.map(({ joint_limits_deg: limits }) => {
    const [low, high] = limits ?? WITHOUT_LIMITS;
    return low + (high - low) * random();
  });
  const found = [];
  for (let n = 0; n < TRIES * N_CONFIGURATIONS && found.length < N_CONFIGURATIONS; n += 1) {
    const q = drawn();
    if (!standsOnFloor(robot) || isAbove(robot, q, target)) found.push(q);
  }
  return found;
}
