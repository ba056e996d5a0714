// The poses to measure next: planned by the service, shown with the arm, and downloaded as a table to fill in.

import { get, list, post } from "./api.js";
import { armFigure, jointFacts, pointFacts } from "./arm.js";
import { el, fill, problem, table } from "./dom.js";
import { fixed, mm } from "./format.js";
import { positionOf } from "./kinematics.js";
import { facts } from "./robots.js";
import { saveText } from "./save.js";
import { selection } from "./selection.js";

/** Sets that were measured already and are taken into account. */
const MAX_MEASURED = 20;

/** The page. */
export async function planPage({ main, signal }, id) {
  const [robot, sets] = await Promise.all([get(`/v1/robots/${id}`, signal), list(`/v1/robots/${id}/measurement-sets`, MAX_MEASURED, signal)]);
  document.title = `kincal: poses for ${robot.name}`;
  const out = el("div", { "aria-live": "polite" });
  fill(main, el("p.crumbs", {}, el("a", { href: "#/" }, "Robots"), " / ", el("a", { href: `#/robots/${id}` }, robot.name)), el("h1", {}, "Poses to measure"),
    el("p.quiet", {}, "The poses that tell most about the parameters, within the joint limits and outside of what you keep out. Move the robot there slowly at first: the plan knows no cables, no fixtures and no people."),
    form(robot, sets, out), out);
}

function form(robot, sets, out) {
  const number = (name, value, more = {}) => el("input", { id: name, type: "number", value, ...more });
  const field = (name, label, input) => el("div", {}, el("label", { for: name }, label), input);
  const [n, floor] = [number("plan-n", 30, { min: 1, max: 300, step: 1, required: true }), number("plan-floor", "", { step: "any", placeholder: "none" })];
  const frame = el("select", { id: "plan-frame" }, el("option", { value: "base" }, "the robot's base frame"), el("option", { value: "instrument", selected: sets[0]?.frame === "instrument" }, "the instrument's frame"));
  const before = el("input", { id: "plan-before", type: "checkbox", checked: sets.length > 0 });
  const boxes = keepOuts();
  const button = el("button.primary", { type: "submit" }, "Plan");
  const submit = async (event) => {
    event.preventDefault();
    button.disabled = true;
    fill(out, el("p.quiet", {}, "Looking for the best poses …"));
    const kept = boxes.read();
    const request = { n_configurations: Number(n.value), frame: frame.value, ...floor.value === "" ? {} : { floor_z_mm: Number(floor.value) }, ...kept.length > 0 ? { boxes: kept } : {}, ...before.checked && sets.length > 0 ? { measured: sets.map((set) => set.id) } : {} };
    try {
      fill(out, planned(robot, await post(`/v1/robots/${robot.id}/pose-plans`, request), kept));
    } catch (error) {
      fill(out, problem(error));
    }
    button.disabled = false;
  };
  return el("form.card", { submit }, el("div.fields", {}, field("plan-n", "Number of poses", n), field("plan-frame", "Positions will be measured in", frame), field("plan-floor", "Nothing below z, mm", floor)),
    sets.length > 0 && el("label.choice", {}, before, `count what was measured already (${sets.length === 1 ? "one set" : `${sets.length} sets`})`), boxes.node, el("div.actions", {}, button));
}

function keepOuts() {
  const rows = [];
  const place = el("div", {});
  const add = () => {
    const inputs = ["x from", "y from", "z from", "x to", "y to", "z to"].map((label) => el("input", { type: "number", step: "any", "aria-label": `${label}, mm`, placeholder: label, required: true }));
    const row = { inputs };
    const drop = el("button.plain", { type: "button", click: () => { rows.splice(rows.indexOf(row), 1); node.remove(); } }, "Remove");
    const node = el("div.controls", {}, inputs, drop);
    rows.push(row);
    place.append(node);
    inputs[0].focus();
  };
  const read = () => rows.map(({ inputs }) => { const v = inputs.map((input) => Number(input.value)); return { min_mm: v.slice(0, 3), max_mm: v.slice(3) }; });
  return { read, node: el("div", {}, el("p.note", {}, "Boxes to keep out of, in the robot's base frame, mm: fixtures, fences, the tracker."), place, el("button", { type: "button", click: add }, "Add a box")) };
}

function planned(robot, plan, boxes) {
  const poses = plan.configurations;
  // the number of the pose that is repeated, counted from 0
  const isRepeat = (i) => Number.isInteger(poses[i].repeats);
  const again = poses.some((_, i) => isRepeat(i));
  const points = poses.map(({ q_deg: q }) => ({ position: positionOf(robot, q), target: 0 }));
  const selected = selection(points.length);
  const cell = armFigure({ title: "The planned poses", level: "h2", caption: "Dots: the nominal flange at each pose. Dashed: what is kept out.", robot, points, selected, boxes, postures: (i) => poses[i].q_deg,
    describe: (i) => pointFacts(`Pose ${i + 1} of ${poses.length}`, [jointFacts(poses[i].q_deg), ["Flange, mm", points[i].position.map((v) => fixed(v, 0)).join(", ")], isRepeat(i) && ["Repeats", `pose ${poses[i].repeats + 1}`]]),
    actions: () => el("div.actions", {}, el("button", { type: "button", click: () => selected.step(-1) }, "Previous"), el("button", { type: "button", click: () => selected.step(1) }, "Next")) });
  selected.set(0);
  const { mean, max } = plan.predicted_std_mm;
  const joints = robot.links.map((_, k) => [`Joint ${k + 1}, °`, (i) => fixed(poses[i].q_deg[k], 2), "n"]);
  return [facts([["Poses", poses.length], ["Uncertainty to expect", mm(mean), `at worst ${mm(max)}, at the tool over the workspace`],
    ["With random poses", mm(plan.predicted_std_mm_random.mean), `at worst ${mm(plan.predicted_std_mm_random.max)}`]]), cell.node,
  el("section.card", {}, el("div.head", {}, el("h2", {}, "Joint values"), el("div.actions", {}, el("button", { type: "button", click: () => save(poses, robot) }, "Download as CSV"))),
    table(`Measure them in this order.${again ? " The last ones repeat the first: what has moved between shows a drift of base or instrument." : ""} The downloaded table has empty columns for the measured positions.`, [["Pose", (i) => i + 1, "n"], ...again ? [["Repeats", (i) => (isRepeat(i) ? `pose ${poses[i].repeats + 1}` : "")]] : [], ...joints], poses.map((_, i) => i), ""))];
}

function save(poses, robot) {
  const header = [...robot.links.map((_, k) => `q${k + 1}_deg`), "x_mm", "y_mm", "z_mm"].join(",");
  const lines = poses.map(({ q_deg: q }) => `${q.join(",")},,,`);
  saveText(`${header}\n${lines.join("\n")}\n`, "poses.csv", "text/csv");
}
