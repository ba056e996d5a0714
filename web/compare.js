// Two parameter sets beside each other: how far apart they put the tool, where, and whether the robot has changed.

import { get, list } from "./api.js";
import { armFigure, jointFacts, pointFacts } from "./arm.js";
import { el, fill, problem, table } from "./dom.js";
import { chance, fixed, mm, number, parameter, signed, unitOf } from "./format.js";
import { facts } from "./robots.js";
import { selection } from "./selection.js";
import { setNames } from "./sessions.js";

/** Probability of calling an unchanged robot changed, as in the service's test. */
const FALSE_ALARMS = 0.01;

/** The page. */
export async function comparePage({ main, signal }, id) {
  const [robot, sets, nameOf] = await Promise.all([get(`/v1/robots/${id}`, signal), list(`/v1/robots/${id}/parameter-sets`, 100, signal), setNames({ id }, signal)]);
  document.title = `kincal: compare parameter sets of ${robot.name}`;
  const top = [el("p.crumbs", {}, el("a", { href: "#/" }, "Robots"), " / ", el("a", { href: `#/robots/${id}` }, robot.name)), el("h1", {}, "Compare parameter sets")];
  if (sets.length < 2) return fill(main, top, el("p.empty", {}, "There are not yet two parameter sets to compare."));
  const pick = (name, label, chosen) => {
    const select = el("select", { id: name, change: draw }, sets.map((set) => el("option", { value: set.id, selected: set.id === chosen }, nameOf(set))));
    return [select, el("div", {}, el("label", { for: name }, label), select)];
  };
  const active = sets.find((set) => set.status === "released") ?? sets[1];
  const newest = sets.find((set) => set.id !== active.id);
  const [one, oneField] = pick("compare-one", "Parameter set", newest.id);
  const [other, otherField] = pick("compare-other", "Compared with", active.id);
  const out = el("div", { "aria-live": "polite" });
  async function draw() {
    if (one.value === other.value) return fill(out, el("p.empty", {}, "Choose two different sets."));
    try {
      const found = await get(`/v1/parameter-sets/${one.value}/compare?with=${other.value}`, signal);
      const frames = await Promise.all([one, other].map(({ value }) => frameOf(sets.find(({ id: of }) => of === value), signal)));
      if (!signal.aborted) fill(out, drawn(robot, found, frames.includes("instrument")));
    } catch (error) {
      if (error.name !== "AbortError") fill(out, problem(error));
    }
  }
  fill(main, top, el("section.card", {}, el("div.fields", {}, oneField, otherField)), out);
  await draw();
}

/** The frame of the points that a set was identified from. */
async function frameOf({ job_id: id }, signal) {
  const { measurement_set_id: from } = await get(`/v1/jobs/${id}`, signal);
  return (await get(`/v1/measurement-sets/${from}`, signal)).frame;
}

/** What changed. In an instrument's own frame the base says where the instrument stood, and that is no change of the robot. */
function changes(changed, isOwnFrame) {
  const isBase = ({ name }) => isOwnFrame && name.startsWith("base_");
  const [base, others] = [changed.filter(isBase), changed.filter((c) => !isBase(c))];
  return el("section.card", {}, el("h2", {}, "What changed"),
    base.length > 0 && el("p.note", {}, `The instrument stood elsewhere: ${base.map((c) => `${parameter(c.name)} ${signed(c.delta, 2)} ${unitOf(c.name)}`).join(", ")}. Measured in the instrument's own frame, a base says only that: it is no change of the robot.`),
    el("div.narrow", {}, table("The first set minus the second.", [["Parameter", (c) => parameter(c.name)], ["Unit", (c) => unitOf(c.name)], ["Change", (c) => signed(c.delta, 5), "n"], ["In units of its uncertainty", (c) => number(c.sigmas), "n"]], others, "Nothing else beyond chance.")));
}

/** A smaller difference is rounding, mm. */
const EQUAL_MM = 0.001;

function drawn(robot, found, isOwnFrame) {
  if (found.max_mm < EQUAL_MM) return [facts([["Difference at the tool", "none", "less than a micrometre at every configuration that was tried"]]), found.sessions?.changed?.length > 0 && changes(found.sessions.changed, isOwnFrame)];
  const length = (v) => Math.hypot(...v);
  const points = found.map.map((p) => ({ position: p.position_mm, vectors: { difference: p.difference_mm }, errors: { difference: length(p.difference_mm) }, target: 0 }));
  const selected = selection(points.length);
  const cell = armFigure({ title: "Where they differ", level: "h2", caption: "The tool at configurations over the workspace.", robot, points, stages: [["difference", "difference"]], selected, postures: (i) => found.map[i].q_deg,
    shows: "its joints and the difference there", said: "Each arrow goes from where the second set has the tool to where the first one has it,",
    describe: (i) => pointFacts(`Configuration ${i + 1}`, [["Difference", mm(points[i].errors.difference)], ["x, y, z, mm", found.map[i].difference_mm.map((v) => fixed(v, 3)).join(", ")], jointFacts(found.map[i].q_deg)]),
    actions: () => el("div.actions", {}, el("button", { type: "button", click: () => selected.step(-1) }, "Previous"), el("button", { type: "button", click: () => selected.step(1) }, "Next")) });
  const { sessions } = found;
  const said = !sessions ? ["cannot be said", "both sets are of one upload, or a session is too small"] : sessions.probability < FALSE_ALARMS ? ["changed", `probability of this by chance: ${chance(sessions.probability)}`] : ["not beyond chance", `probability of this by chance: ${chance(sessions.probability)}`];
  return [facts([["Difference at the tool", mm(found.mean_mm), `on average; at most ${mm(found.max_mm)}`], ["The robot", ...said]]), cell.node, sessions?.changed?.length > 0 && changes(sessions.changed, isOwnFrame)];
}
