// What a job may be asked for beyond its usual choices, without JSON: model, corrections, parameters that are held, priors.

import { el, fill } from "./dom.js";
import { parameter } from "./format.js";

const KINDS = ["a", "alpha", "d", "theta_offset", "beta"];
let forms = 0;

/** The choices, folded, and what they add to a request. */
export function jobOptions(robot) {
  forms += 1;
  const id = (name) => `${name}-${forms}`;
  const pick = (name, label, options) => {
    const select = el("select", { id: id(name) }, options.map(([value, words]) => el("option", { value }, words)));
    return [select, el("div", {}, el("label", { for: id(name) }, label), select)];
  };
  const [model, modelField] = pick("model", "Model", [["", "by default"], ["complete", "complete: links, base, reflectors"], ["paper", "the paper's 24 parameters"]]);
  const [corrections, correctionsField] = pick("corrections", "Corrections (compliance, harmonics, network)", [["", "where they help"], ["off", "none"]]);
  const [finalFit, finalField] = pick("final", "Delivered parameters are fitted to", [["", "all points, after the verification"], ["identify_subset", "the identify half only"]]);
  const [choice, choiceField] = pick("choice", "Parameters", [["", "identify all of the model"], ["hold", "hold some at nominal"], ["identify", "identify only some"]]);
  const seed = el("input", { id: id("seed"), type: "number", min: 0, step: 1, value: 0 });
  const names = robot.links.flatMap((_, i) => KINDS.map((kind) => `${kind}_${i + 1}`));
  const chosen = new Set();
  const grid = el("div", {});
  const drawGrid = () => fill(grid, choice.value !== "" && parameterGrid(robot, chosen, choice.value));
  choice.addEventListener("change", drawGrid);
  const priors = priorRows(names);
  const node = el("details", {}, el("summary", {}, "More choices: model, corrections, held parameters, priors"),
    el("div.fields", {}, modelField, correctionsField, finalField, choiceField, el("div", {}, el("label", { for: id("seed") }, "Seed of random numbers"), seed)), grid, priors.node);
  return { node, add: (request) => {
    if (model.value) request.model = model.value;
    if (corrections.value) request.corrections = corrections.value;
    if (finalFit.value) request.final_fit = finalFit.value;
    if (Number(seed.value) > 0) request.seed = Number(seed.value);
    const known = priors.read();
    const parameters = { ...choice.value && chosen.size > 0 ? { [choice.value]: names.filter((name) => chosen.has(name)) } : {}, ...known.length > 0 ? { priors: known } : {} };
    if (Object.keys(parameters).length > 0) request.parameters = parameters;
    return request;
  } };
}

function parameterGrid(robot, chosen, mode) {
  const head = ["Link", ...KINDS.map((kind) => parameter(`${kind}_1`).replace(/₁/, ""))];
  const box = (name) => el("input", { type: "checkbox", "aria-label": `${mode === "hold" ? "Hold" : "Identify"} ${name}`, checked: chosen.has(name), change: (event) => (event.target.checked ? chosen.add(name) : chosen.delete(name)) });
  return [el("p.note", {}, mode === "hold" ? "Ticked parameters stay at their nominal values." : "Only ticked parameters are identified; all others stay at their nominal values."),
    el("div.scroll.narrow", { tabindex: 0, role: "region", "aria-label": "Parameters of the links" }, el("table", {}, el("thead", {}, el("tr", {}, head.map((h) => el("th", { scope: "col" }, h)))),
      el("tbody", {}, robot.links.map((_, i) => el("tr", {}, el("th", { scope: "row" }, i + 1), KINDS.map((kind) => el("td", {}, box(`${kind}_${i + 1}`))))))))];
}

function priorRows(names) {
  const list = el("div", {});
  const rows = [];
  const add = () => {
    const number = (label) => el("input", { type: "number", step: "any", "aria-label": label, placeholder: label });
    const row = { name: el("select", { "aria-label": "Parameter of the prior" }, names.map((name) => el("option", { value: name }, `${parameter(name)} (${name})`))), std: number("± std"), mean: number("expected"), min: number("least"), max: number("most") };
    const drop = el("button.plain", { type: "button", click: () => { rows.splice(rows.indexOf(row), 1); node.remove(); } }, "Remove");
    const node = el("div.controls", {}, row.name, row.std, row.mean, row.min, row.max, drop);
    rows.push(row);
    list.append(node);
    row.name.focus();
  };
  const read = () => rows.filter(({ std }) => std.value !== "").map((row) => Object.fromEntries(["name", "std", "mean", "min", "max"].filter((key) => row[key].value !== "").map((key) => [key, key === "name" ? row[key].value : Number(row[key].value)])));
  return { read, node: el("div", {}, el("p.note", {}, "Priors: what is known of a parameter beforehand, in mm or degrees; the standard deviation says how well."), list, el("button", { type: "button", click: add }, "Add a prior")) };
}
