// Bringing measured points, and asking for a calibration of them.

import { post } from "./api.js";
import { el, fill, problem, say, table, warning } from "./dom.js";

/** Rows of the file that are shown around its faults. */
const MAX_SHOWN = 25;

/** Upload by drag and drop or by choice, then the request; also for sets that are there already. */
export function uploadCard(robot, sets, may) {
  const parts = [];
  if (may("upload")) parts.push(uploadForm(robot, may));
  if (may("identify") && sets.length > 0) parts.push(el("details", {}, el("summary", {}, "Calibrate from a set that is here already"), jobForm(robot, sets)));
  return parts.length > 0 && el("section.card", {}, el("h2", {}, "Calibrate"), parts);
}

function uploadForm(robot, may) {
  const out = el("div", { "aria-live": "polite" });
  const file = el("input", { id: "set-file", type: "file", accept: ".csv,.json,text/csv,application/json" });
  const radio = (value, text, checked) => el("label.choice", {}, el("input", { type: "radio", name: "frame", value, checked }), text);
  const frames = el("fieldset", {}, el("legend", {}, "Positions were measured in"), radio("base", "the robot's base frame", true), radio("instrument", "the instrument's own frame (base pose and reflector are found too)", false));
  const take = async (chosen) => {
    const frame = frames.querySelector("input:checked").value;
    fill(out, el("p.quiet", {}, `Checking ${chosen.name} …`));
    await upload(robot, chosen, frame, out, may);
  };
  file.addEventListener("change", () => file.files.length > 0 && take(file.files[0]).then(() => { file.value = ""; }));
  const drop = el("div.drop", {}, el("label", { for: "set-file" }, "Drop a measurement set here, or choose one"), file,
    el("p.note", {}, "CSV with a header row: q1_deg … q", robot.links.length, "_deg, x_mm, y_mm, z_mm (or _rad, _m); subset, configuration and target if you have them."));
  const over = (is) => (event) => { event.preventDefault(); drop.classList.toggle("over", is); };
  drop.addEventListener("dragover", over(true));
  drop.addEventListener("dragleave", over(false));
  drop.addEventListener("drop", (event) => {
    over(false)(event);
    if (event.dataTransfer.files.length > 0) take(event.dataTransfer.files[0]);
  });
  return el("div", {}, frames, drop, out);
}

async function upload(robot, file, frame, out, may) {
  const text = await file.text();
  const isJson = /\.json$/i.test(file.name);
  const name = file.name.replace(/\.\w+$/, "").slice(0, 200) || "set";
  try {
    const path = `/v1/robots/${robot.id}/measurement-sets?frame=${frame}&name=${encodeURIComponent(name)}`;
    const set = await post(path, text, isJson ? "application/json" : "text/csv");
    say(`${set.n_points} points were understood`);
    fill(out, el("div.done", {}, el("strong", {}, set.name), `: ${set.n_points} points in ${set.n_configurations} configurations, ${set.n_targets === 1 ? "one target" : `${set.n_targets} targets`}.`),
      set.warnings.map(warning),
      may("identify") && jobForm(robot, [set]));
  } catch (error) {
    fill(out, problem({ ...error, errors: [], detail: error.errors?.length > 0 ? `Nothing was stored. ${count(error.errors.length)} to mend in ${file.name}:` : error.detail }), faults(error.errors ?? [], isJson ? "" : text));
  }
}

const count = (n) => (n === 1 ? "One thing is" : `${n} things are`);

/** The cells of one line, without the quotation marks that hold a comma. */
const cellsOf = (line) => (line.match(/("([^"]|"")*"|[^,]*)(,|$)/g) ?? []).map((cell) => cell.replace(/,$/, "").replace(/^"(.*)"$/, "$1"));

/** Every fault with the line of the file that it stands in. */
function faults(errors, text) {
  const lines = text.split(/\r?\n/).filter((line) => line.trim() !== "");
  const header = cellsOf((lines[0] ?? "").replace(/^\uFEFF/, "")).map((name) => name.trim());
  const value = (issue) => {
    const cells = cellsOf(lines[(issue.row ?? -2) + 1] ?? "");
    const at = header.indexOf(issue.column);
    return at >= 0 && cells[at] !== undefined ? el("code", {}, cells[at].trim() === "" ? "(empty)" : cells[at]) : "–";
  };
  const columns = [
    ["Row", (issue) => (issue.row === undefined ? "–" : issue.row), "n"],
    ["Line in file", (issue) => (issue.row === undefined ? "–" : issue.row + 2), "n"],
    ["Column", (issue) => issue.column ?? issue.pointer ?? "–"],
    ["Found", value, "wrong"],
    ["What is wrong", (issue) => issue.detail, "name"],
  ];
  if (errors.length === 0) return [];
  const more = errors.length > MAX_SHOWN ? el("p.note", {}, `and ${errors.length - MAX_SHOWN} more`) : [];
  return [table("Rows are counted from 0 without the header row.", columns, errors.slice(0, MAX_SHOWN), ""), more];
}

function choice(id, label, options) {
  const select = el("select", { id }, options.map(([value, text]) => el("option", { value }, text)));
  return [select, el("div", {}, el("label", { for: id }, label), select)];
}

let forms = 0;

function jobForm(robot, sets) {
  forms += 1;
  const n = forms;
  const [set, setField] = choice(`job-set-${n}`, "Measurement set", sets.map((s) => [s.id, `${s.name ?? s.id} (${s.n_points} points)`]));
  const [method, methodField] = choice(`job-method-${n}`, "Method", [
    ["auto", "automatic (recommended)"], ["least_squares", "least squares"], ["pso", "particle swarm"], ["bpnn_pso", "swarm started by the robot's network"]]);
  const [verify, verifyField] = choice(`job-verify-${n}`, "Verify on", [
    ["", "its verify points, else half"], ...sets.length > 1 ? sets.map((s) => [s.id, `another session: ${s.name ?? s.id}`]) : []]);
  const [preset, presetField] = choice(`job-preset-${n}`, "Search settings", [["default", "ours"], ["paper", "the paper's, to the letter"]]);
  const out = el("div", {});
  const button = el("button.primary", { type: "submit" }, "Start calibration");
  const submit = async (event) => {
    event.preventDefault();
    button.disabled = true;
    const request = { measurement_set_id: set.value, method: method.value, preset: preset.value };
    if (verify.value) request.verify = { source: "set", measurement_set_id: verify.value };
    try {
      const job = await post(`/v1/robots/${robot.id}/jobs`, request);
      location.hash = `#/jobs/${job.id}`;
    } catch (error) {
      fill(out, problem(error));
      button.disabled = false;
    }
  };
  return el("form", { submit }, el("div.fields", {}, setField, methodField, verifyField, presetField), out, button);
}
