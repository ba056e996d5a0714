// The poses to measure next: planned by the service, shown with the arm, and downloaded as a table to fill in.

import { get, list, post } from "./api.js";
import { armFigure, jointFacts, pointFacts } from "./arm.js";
import { el, fill, problem, table } from "./dom.js";
import { capital, fixed, mm, plain } from "./format.js";
import { positionOf, reachOf } from "./kinematics.js";
import { facts } from "./robots.js";
import { saveText } from "./save.js";
import { selection } from "./selection.js";

/** Sets that were measured already and are taken into account. */
const MAX_MEASURED = 20;
/** Range that the service plans for a joint without limits, degrees. */
const WITHOUT_LIMITS = [-90, 90];

/** The page. */
export async function planPage({ main, signal, query }, id) {
  const [robot, sets] = await Promise.all([get(`/v1/robots/${id}`, signal), list(`/v1/robots/${id}/measurement-sets`, MAX_MEASURED, signal)]);
  document.title = `kincal: poses for ${robot.name}`;
  const out = el("div", { "aria-live": "polite" });
  fill(main, el("p.crumbs", {}, el("a", { href: "#/" }, "Robots"), " / ", el("a", { href: `#/robots/${id}` }, robot.name)), el("h1", {}, "Poses to measure"),
    el("p.quiet", {}, "The poses that tell most about the parameters, within the joint limits and outside of what you keep out. Move the robot there slowly at first: the plan knows no cables, no fixtures and no people."),
    form(robot, sets, out, query.get("n")), out);
}

/** Directions in which a reflector can look, in the flange frame. */
const DIRECTIONS = [["", "every direction"], ["0,0,1", "the flange's +z"], ["0,0,-1", "the flange's \u2212z"], ["1,0,0", "the flange's +x"], ["-1,0,0", "the flange's \u2212x"], ["0,1,0", "the flange's +y"], ["0,-1,0", "the flange's \u2212y"]];

function form(robot, sets, out, asked) {
  const number = (name, value, more = {}) => el("input", { id: name, type: "number", value, ...more });
  const field = (name, label, input) => el("div", {}, el("label", { for: name }, label), input);
  const [n, floor] = [number("plan-n", Number(asked) >= 1 && Number(asked) <= 300 ? Math.round(Number(asked)) : 30, { min: 1, max: 300, step: 1, required: true }), number("plan-floor", standsOnFloor(robot) ? 0 : "", { step: "any", placeholder: "none" })];
  const kind = el("select", { id: "plan-kind" }, el("option", { value: "position" }, "positions of a reflector"), el("option", { value: "pose" }, "poses of a 6D target"));
  const frame = el("select", { id: "plan-frame" }, el("option", { value: "base" }, "the robot's base frame"), el("option", { value: "instrument", selected: sets[0]?.frame === "instrument" }, "the instrument's frame"));
  const axis = el("select", { id: "plan-axis" }, DIRECTIONS.map(([value, words]) => el("option", { value }, words)));
  const before = el("input", { id: "plan-before", type: "checkbox", checked: sets.length > 0 });
  const boxes = rowsOfNumbers({ note: "Boxes to keep out of, in the robot's base frame, mm: fixtures, fences, the tracker. Neither the arm's axis lines nor the line of sight crosses them.", add: "Add a box", labels: ["x from", "y from", "z from", "x to", "y to", "z to"], required: true });
  const places = rowsOfNumbers({ note: "Places of the instrument, in the robot's base frame, mm. The poses are shared out over several places. Without a place, the line of sight is not looked at.", add: "Add a place", named: "Name of the place", labels: ["x", "y", "z"], required: true });
  const button = el("button.primary", { type: "submit" }, "Plan");
  const submit = async (event) => {
    event.preventDefault();
    button.disabled = true;
    fill(out, el("p.quiet", {}, "Looking for the best poses …"));
    const shown = { floor: floor.value === "" ? null : Number(floor.value), keepOut: boxes.read().map(({ values: v }) => ({ min_mm: v.slice(0, 3), max_mm: v.slice(3) })), places: places.read().map(({ name, values }) => ({ name, instrument_mm: values })) };
    const request = { n_configurations: Number(n.value), kind: kind.value, frame: frame.value, ...floor.value === "" ? {} : { floor_z_mm: Number(floor.value) }, ...shown.keepOut.length > 0 ? { keep_out: shown.keepOut } : {},
      ...shown.places.length > 1 ? { set_ups: shown.places } : shown.places.length === 1 ? { instrument_mm: shown.places[0].instrument_mm } : {}, ...axis.value === "" ? {} : { target_axis: axis.value.split(",").map(Number) },
      ...before.checked && sets.length > 0 ? { measured: sets.map((set) => set.id) } : {} };
    try {
      const plan = await post(`/v1/robots/${robot.id}/pose-plans`, request);
      const heading = el("h2", { tabindex: -1 }, `The plan: ${plan.configurations.length} poses`);
      fill(out, heading, planned(robot, plan, shown, kind.value));
      heading.focus();
    } catch (error) {
      fill(out, problem(error));
    }
    button.disabled = false;
  };
  return el("form.card", { submit }, el("div.fields", {}, field("plan-n", "Number of poses", n), field("plan-kind", "What is measured", kind), field("plan-frame", "Measured in", frame), field("plan-floor", "Nothing below z, mm", floor), field("plan-axis", "The reflector can be seen from", axis)),
    standsOnFloor(robot) && el("p.note", {}, "Nothing below z: 0 is the robot's mounting surface. Give another height if it stands on a pedestal, or none if the arm may reach below it."),
    sets.length > 0 && el("label.choice", {}, before, `count what was measured already (${sets.length === 1 ? "one set" : `${sets.length} sets`})`), places.node, boxes.node, el("div.actions", {}, button));
}

/** Whether a robot stands on the floor, as one does that states no mounting. */
export const standsOnFloor = ({ mounting }) => mounting === undefined || mounting === null || mounting === "floor";

/** A list of rows of numbers, each with a name if `named`, to which rows are added and from which they are removed. */
function rowsOfNumbers({ note, add: text, named, labels, required }) {
  const rows = [];
  const place = el("div", {});
  const add = () => {
    const name = named && el("input", { type: "text", "aria-label": named, required, value: `place ${rows.length + 1}`, maxlength: 100 });
    const inputs = labels.map((label) => el("input", { type: "number", step: "any", "aria-label": `${label}, mm`, required }));
    const row = { name, inputs };
    const drop = el("button.plain", { type: "button", click: () => { rows.splice(rows.indexOf(row), 1); node.remove(); } }, "Remove");
    const node = el("div.controls.numbers", {}, name && el("span.numbered", {}, el("small", { "aria-hidden": "true" }, "name"), name), inputs.map((input, i) => el("span.numbered", {}, el("small", { "aria-hidden": "true" }, `${labels[i]}, mm`), input)), drop);
    rows.push(row);
    place.append(node);
    (name ?? inputs[0]).focus();
  };
  const read = () => rows.map(({ name, inputs }) => ({ name: name?.value, values: inputs.map((input) => Number(input.value)) }));
  return { read, node: el("div", {}, el("p.note", {}, note), place, el("button", { type: "button", click: add }, text)) };
}

function planned(robot, plan, { floor, keepOut, places }, kind) {
  const poses = plan.configurations;
  // the number of the pose that is repeated, counted from 0
  const isRepeat = (i) => Number.isInteger(poses[i].repeats);
  const again = poses.some((_, i) => isRepeat(i));
  const points = poses.map(({ q_deg: q }) => ({ position: positionOf(robot, q), target: 0 }));
  const selected = selection(points.length);
  const cell = armFigure({ title: "The planned poses", level: "h2", caption: `Dots: the nominal flange at each pose.${floor === null ? " Nothing keeps the arm above the floor: state a height below which it must not go." : ` Dashed square: reflector, flange, wrist and elbow stay above z = ${fixed(floor, 0)} mm.`}${keepOut.length > 0 ? " Dashed boxes: the arm keeps out." : ""}${places.length > 0 ? " Dashed cubes: the instrument." : ""}`, robot, points, selected, boxes: [...keepOut, ...places.map(instrumentCube), ...floor === null ? [] : [plane(floor, reachOf(robot))]], postures: (i) => poses[i].q_deg,
    describe: (i) => pointFacts(`Pose ${i + 1} of ${poses.length}`, [jointFacts(poses[i].q_deg), ["Flange, mm", points[i].position.map((v) => fixed(v, 0)).join(", ")], poses[i].set_up && ["Measured from", poses[i].set_up], isRepeat(i) && ["Repeats", `pose ${poses[i].repeats + 1}`]]),
    actions: () => el("div.actions", {}, el("button", { type: "button", click: () => selected.step(-1) }, "Previous"), el("button", { type: "button", click: () => selected.step(1) }, "Next")) });
  selected.set(0);
  const { mean, max } = plan.predicted_std_mm;
  const joints = robot.links.map((_, k) => [`Joint ${k + 1}, °`, (i) => fixed(poses[i].q_deg[k], 2), "n"]);
  return [withoutLimits(robot), (plan.warnings ?? []).map((w) => el("div.warning", { role: "alert" }, el("p", {}, capital(plain(w.detail))))), facts([["Poses", poses.length], ["Uncertainty to expect", mm(mean), `at worst ${mm(max)}, at the tool over the workspace${plan.set_ups?.length > 0 ? ", seen from the place where it is largest" : ""}`],
    ["With random poses", mm(plan.predicted_std_mm_random.mean), `at worst ${mm(plan.predicted_std_mm_random.max)}`]]), cell.node,
  el("section.card", {}, el("div.head", {}, el("h2", {}, "Joint values"), el("div.actions", {}, el("button", { type: "button", click: () => save(poses, robot, kind) }, "Download as CSV"))),
    table(`Measure them in this order.${again ? " The last ones repeat the first: what has moved between shows a drift of base or instrument." : ""} The downloaded table has empty columns for the measured positions.`, [["Pose", (i) => i + 1, "n"], ...plan.set_ups?.length > 0 ? [["Measured from", (i) => poses[i].set_up]] : [], ...again ? [["Repeats", (i) => (isRepeat(i) ? `pose ${poses[i].repeats + 1}` : "")]] : [], ...joints], poses.map((_, i) => i), ""))];
}

/** The joints for which the robot states no limits: the plan takes a range for them that the arm may not have, or may exceed. */
function withoutLimits({ links }) {
  const open = links.map((link, i) => [link, i + 1]).filter(([link]) => !link.joint_limits_deg).map(([, number]) => number);
  if (open.length === 0) return false;
  const joints = open.length === 1 ? `Joint ${open[0]} has` : `Joints ${open.slice(0, -1).join(", ")} and ${open.at(-1)} have`;
  return el("div.warning", {}, el("p", {}, el("strong", {}, `${joints} no stated limits. `), `The plan takes ${WITHOUT_LIMITS.map((limit) => fixed(limit, 0)).join("° to ")}° for ${open.length === 1 ? "it" : "each of them"}: check that the robot can go there. Poses beyond that range are not planned before the robot's limits are stated (on its page, under Name, mounting, joint limits).`));
}

/** A square at a height, as wide as the arm reaches. */
const plane = (z, reach) => ({ min_mm: [-reach, -reach, z], max_mm: [reach, reach, z], colour: "--quiet" });

/** A cube of 200 mm where the instrument stands. */
const instrumentCube = ({ instrument_mm: at }) => ({ min_mm: at.map((v) => v - 100), max_mm: at.map((v) => v + 100), colour: "--accent" });

/** A table to fill in. A repeat has the number of the configuration that it repeats, so that no split separates the two. */
function save(poses, robot, kind) {
  const stations = poses.some((pose) => pose.set_up);
  const measured = ["x_mm", "y_mm", "z_mm", ...kind === "pose" ? ["quat_w", "quat_x", "quat_y", "quat_z"] : []];
  const header = ["configuration", ...stations ? ["station"] : [], ...robot.links.map((_, k) => `q${k + 1}_deg`), ...measured].join(",");
  const quoted = (name) => (/[",\r\n]/.test(name) || name.trim() !== name ? `"${name.replaceAll('"', '""')}"` : name);
  const lines = poses.map((pose, i) => [(pose.repeats ?? i) + 1, ...stations ? [quoted(pose.set_up)] : [], ...pose.q_deg, ...measured.map(() => "")].join(","));
  saveText(`${header}\n${lines.join("\n")}\n`, "poses.csv", "text/csv");
}
