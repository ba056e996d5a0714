// A joint map that a refused upload names: in words, beside what explains the points as well, and stored only by somebody who looked at the controller.

import { get, patch } from "./api.js";
import { el, fill, problem, say } from "./dom.js";
import { capital } from "./format.js";

/** A joint map as it stands in a text of the service. */
export const MAP = /the robot's joint_map is (\{"sign".*?\]\]\})/s;

/** The joint map that a refusal names; undefined where it names none. */
export function mapIn(issues) {
  const stated = issues.map((issue) => issue.joint_map).find(Boolean);
  const written = issues.map(({ detail }) => MAP.exec(detail)?.[1]).find(Boolean);
  return stated ?? (written && JSON.parse(written));
}

/** What explains the points of a refused file equally well, in words; empty where one explanation fits best. */
export function equallyGood(issues) {
  const details = issues.map(({ detail }) => detail ?? "").filter((detail) => MAP.test(detail) || /counted|frame|columns/.test(detail));
  const others = [...new Set(details.flatMap((detail) => [...detail.matchAll(/It fits as well if (.*?)(?:: then|\. |$)/gs)].map(([, words]) => words)))];
  const first = details.map((detail) => /; if (.*?), it fits to /s.exec(detail)?.[1]).find(Boolean);
  return others.length > 0 ? [first ?? "the positions are in the instrument's frame", ...others] : [];
}

/** An explanation as it is told, and what to look at. */
function explained(words) {
  if (/left-handed|wrong sign|columns named/.test(words)) return [/left-handed|wrong sign/.test(words) ? "Two columns of the table are exchanged, or its frame is left-handed" : `Columns of the table are exchanged: ${words}`, "Look at the instrument's export: x, y and z in this order, in a right-handed frame. If they are not, export it again and upload that file"];
  if (/counted|turns|zero/.test(words)) return [`The controller counts otherwise: ${words}`, `Move ${jointIn(words) ? `joint ${jointIn(words)}` : "each of these joints"} alone at the controller, and compare with the arm under "Compare a posture with the pendant" below`];
  return [capital(words), "Look at the instrument: in which frame does it write positions"];
}

const jointIn = (words) => /joints? (\d+)/.exec(words)?.[1];

/** A joint map in words, a sentence for each joint that it counts otherwise than the model. */
export function mapInWords({ sign = [], offset_deg: offset = [], coupling = [] }) {
  const n = Math.max(sign.length, offset.length, coupling.length);
  const joints = Array.from({ length: n }, (_, i) => {
    const others = (coupling[i] ?? []).map((share, k) => k !== i && share !== 0 && `turns along with joint ${k + 1} (${share > 0 ? "+" : "\u2212"}${Math.abs(share)} of its angle)`);
    const said = [sign[i] < 0 && "is counted the other way round", offset[i] && `has its zero ${offset[i] > 0 ? "+" : "\u2212"}${Math.abs(offset[i])}° away`, coupling[i] && coupling[i][i] !== 1 && `turns ${coupling[i][i]} times as far`, ...others].filter(Boolean);
    return said.length > 0 && `Joint ${i + 1} ${said.join(", ")}.`;
  }).filter(Boolean);
  return joints.length > 0 ? joints : ["Every joint is counted as in the model."];
}

/** A joint map with nothing left out, to compare it. */
function whole({ sign, offset_deg: offset, coupling } = {}, n) {
  const each = (make) => Array.from({ length: n }, (_, i) => make(i));
  return JSON.stringify([sign ?? each(() => 1), offset ?? each(() => 0), coupling ?? each((i) => each((k) => Number(i === k)))].map((part) => part.flat().map(Number)));
}

/** Where the joint map of a robot comes from, if that is the library; else null. */
async function librarySource(robot) {
  const id = /^Nominal arm (\S+) of the library\b/.exec(robot.description ?? "")?.[1];
  const model = id && await get(`/v1/robot-models/${encodeURIComponent(id)}`).catch(() => null);
  const n = robot.links.length;
  return model && whole(model.robot.joint_map ?? {}, n) === whole(robot.joint_map ?? {}, n) ? model.joint_map_source : null;
}

/** What a refusal says of the joint map, and the way to store it: {node, button}. One click is enough only where nothing else explains the points and the map is not the library's. */
export function jointMapRemedy(map, issues, { isFirst, out, context }) {
  const equal = equallyGood(issues);
  const node = el("div", {});
  const place = el("span", {});
  const told = el("ul", {}, mapInWords(map).map((said) => el("li", {}, said)));
  const store = () => countSo(map, context, out);
  const button = (more = {}) => el(isFirst && !more.disabled ? "button.primary" : "button", { type: "button", click: store, ...more }, "Store this joint map with the robot, and read the file so");
  if (equal.length > 0) fill(node, el("p", {}, "The points cannot say which is true, and with the wrong one a mirrored or turned robot is identified:"),
    el("ul", {}, equal.map(explained).sort(([a], [b]) => Number(b.includes("olumns")) - Number(a.includes("olumns"))).map(([what, look]) => el("li", {}, el("strong", {}, `${what}. `), `${look}.`))));
  else fill(node, el("p", {}, isFirst ? "The controller counts its joints otherwise than the robot that is stored:" : "Or the controller counts its joints otherwise:"), told);
  librarySource(context.robot).then((source) => {
    if (equal.length === 0 && source === null) fill(place, button());
    else node.append(...[source !== null && el("p", {}, "The joint map of this robot comes from the library", source ? ` (${source})` : "", ". It is more likely that the file is written otherwise: look at its columns and its frame first."), looked(issues, equal, told, button)].filter(Boolean));
  });
  return { node, place };
}

/** For whoever looked at the controller: what the map says, and its button, which waits for that statement. */
function looked(issues, equal, told, button) {
  const joint = jointIn(equal.join(" ")) ?? jointIn(issues.map(({ detail }) => /; if (.*?), it fits to /s.exec(detail)?.[1] ?? "").join(" "));
  const box = el("input", { type: "checkbox", change: () => { store.disabled = !box.checked; } });
  const store = button({ disabled: true });
  return el("details", {}, el("summary", {}, "I looked at the controller, and it does count otherwise"), el("p", {}, "The joint map would be:"), told,
    el("label.choice", {}, box, joint ? `Joint ${joint} was moved alone: it turns the other way than the arm on this page` : "Each joint was moved alone, and compared with the arm on this page"), el("div.actions", {}, store));
}

/** Stores a joint map with the robot, and reads the file once more. */
async function countSo(map, { robot, retry }, out) {
  try {
    const { joint_map: now } = await patch(`/v1/robots/${robot.id}`, { joint_map: map });
    robot.joint_map = now;
    say("The robot's joint map was changed");
    retry({})();
  } catch (error) {
    fill(out, problem(error));
  }
}
