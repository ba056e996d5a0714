// The uncertainty of the tool over the workspace, as dots about the arm.

import { post } from "./api.js";
import { armFigure, jointFacts, pointFacts } from "./arm.js";
import { el, fill, problem } from "./dom.js";
import { fixed, mm } from "./format.js";
import { positionOf } from "./kinematics.js";
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
      const configurations = randomConfigurations(robot);
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

function figure(robot, parameterSet, configurations, std) {
  const target = parameterSet.targets?.find((t) => t.target === 0)?.position_mm ?? [0, 0, 0];
  const points = configurations.map((q, i) => ({ position: positionOf(robot, q, target), vectors: {}, errors: { std: std[i] }, target: 0 }));
  const selected = selection(points.length);
  const sorted = [...std].sort((a, b) => a - b);
  const describe = (i) => pointFacts("Configuration", [["Standard uncertainty", mm(std[i])], jointFacts(configurations[i]), ["Tool, mm", points[i].position.map((v) => fixed(v, 0)).join(", ")]]);
  const open = robot.links.some((link) => !link.joint_limits_deg);
  const caption = `${points.length} random configurations${open ? `; a joint without limits is taken from ${WITHOUT_LIMITS[0]}° to ${WITHOUT_LIMITS[1]}°` : " within the joint limits"}. Half of them are below ${mm(sorted[Math.floor(sorted.length / 2)])}, the largest is ${mm(sorted.at(-1))}. One standard deviation, of the links, the base and the reflector.`;
  return armFigure({ title: "Uncertainty over the workspace", caption, robot, points, stages: [["std", "standard uncertainty"]], said: null, shows: "its uncertainty and its joints", targets: [target], selected, postures: (i) => configurations[i], describe }).node;
}

/** The same ones each time, so that pictures can be compared. */
function randomConfigurations(robot) {
  let state = 1;
  // Lehmer's generator; 48271 and 2³¹ − 1 are those of Park and Miller
  const random = () => { state = (state * 48271) % 2147483647; return state / 2147483647; };
  return Array.from({ length: N_CONFIGURATIONS }, () => robot.links.map(({ joint_limits_deg: limits }) => {
    const [low, high] = limits ?? WITHOUT_LIMITS;
    return low + (high - low) * random();
  }));
}
