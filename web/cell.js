// The cell's work frames, tools and references: a list of them, and a form that keeps another one under a name.

import { list, put } from "./api.js";
import { rowsOf } from "./csv.js";
import { el, fill, problem, table, warning } from "./dom.js";
import { fixed, mm, when } from "./format.js";
import { referenceForm, referencesOf, referenceTable } from "./references.js";
import { ofMatrix, quaternion, ROTATIONS } from "./rotations.js";

/** Most frames and most tools that are listed. */
const SHOWN = 200;

/** What a robot has of all three. */
export async function cellOf(id, signal) {
  const [frames, tools, references] = await Promise.all([...["work-frames", "tools"].map((kind) => list(`/v1/robots/${id}/${kind}`, SHOWN, signal)), referencesOf(id, signal)]);
  return { frames, tools, references };
}

const numberInput = (name, label) => el("input", { type: "number", step: "any", "aria-label": label, placeholder: name });

/** Three lengths and a rotation, as a controller has them. */
function poseFields(id, legend) {
  const lengths = ["x", "y", "z"].map((axis) => numberInput(axis, `${axis}, mm`));
  const kind = el("select", { id: `${id}-rotation` }, ROTATIONS.map(([value, words]) => el("option", { value }, words)));
  const angles = el("span.controls", {});
  const inputs = () => [...angles.querySelectorAll("input")];
  kind.addEventListener("change", () => fill(angles, ROTATIONS.find(([value]) => value === kind.value)[2].map((name) => numberInput(name, `Rotation ${name}`))));
  const values = (all) => all.map((input) => {
    if (input.value === "") throw { title: "A number is missing", detail: `${input.getAttribute("aria-label")} is empty. Enter 0 where it is 0.` };
    return Number(input.value);
  });
  const isTyped = () => [...lengths, ...inputs()].some((input) => input.value !== "");
  const pose = () => ({ translation_mm: values(lengths), ...kind.value === "none" ? {} : { quaternion: quaternion(kind.value, values(inputs())) } });
  return [el("fieldset", {}, el("legend", {}, legend), el("div.controls", {}, lengths)), el("div", {}, el("label", { for: kind.id }, "Rotation"), kind, angles), pose, isTyped];
}

/** Tools, work frames and references, folded. `changed` is called when one was stored. */
export function cellCard(robot, { frames, tools, references }, sets, may, changed) {
  const at = ({ translation_mm: p }) => p.map((v) => fixed(v, 2)).join(", ");
  const turned = ({ rotation }) => ofMatrix(rotation).map((v) => fixed(v, 5)).join(", ");
  const of = (set) => sets.find((s) => s.id === set)?.name ?? "a measurement set";
  const shared = (pose) => [["Origin, mm", (row) => at(pose(row))], ["Quaternion w, x, y, z", (row) => turned(pose(row))]];
  return el("section.card", {}, el("details", { id: "cell" }, el("summary", {}, `Work frames (${frames.length}), tools (${tools.length}) and references (${references.length}) of the cell`),
    table("Work frames, newest first. A frame that was fitted to measured points has residuals.", [["Name", (f) => f.name, "name"], ["Given in", (f) => (f.reference === "base" ? "robot's base" : `measuring frame of ${of(f.measurement_set_id)}`)], ...shared((f) => f.t_reference_work),
      ["Points", (f) => f.residuals_mm.length || "typed", "n"], ["Residuals, rms", (f) => (f.rms_mm === undefined ? "–" : mm(f.rms_mm)), "n"], ["Origin known to", (f) => (f.origin_std_mm === undefined ? "–" : mm(f.origin_std_mm)), "n"], ["Stored", (f) => when(f.created_at)]], frames, "No work frame is stored."),
    frames.filter((f) => f.residuals_mm.length > 0).map(residuals),
    table("Tools, newest first: the tool centre point in the flange frame.", [["Name", (t) => t.name, "name"], ...shared((t) => t.t_flange_tool), ["Known to", (t) => (t.std_mm === undefined ? "from a drawing" : mm(t.std_mm)), "n"], ["Stored", (t) => when(t.created_at)]], tools, "No tool is stored."),
    referenceTable(references),
    may("upload") && [toolForm(robot, changed), frameForm(robot, sets, changed), referenceForm(robot, stored, changed)]));
}

/** What is left at each point of a frame that was fitted to points, in their order; what the service remarks on them stands above. */
function residuals(frame) {
  const worst = Math.max(...frame.residuals_mm);
  const points = frame.residuals_mm.map((value, row) => ({ row, value }));
  return [(frame.warnings ?? []).map(({ code, detail, rows }) => warning({ code, detail: `work frame ${frame.name}: ${detail}`, rows })),
    el("details", {}, el("summary", {}, `Residual of each point of ${frame.name}, at most ${mm(worst)}`),
      el("div.residual-list", {}, table("Distance between the measured and the fitted place of each point. Rows are counted from 0 without the header.", [["Row", (p) => p.row, "n"], ["Residual", (p) => (p.value === worst ? el("strong", {}, mm(p.value)) : mm(p.value)), "n"]], points, "")))];
}

function toolForm(robot, changed) {
  const name = el("input", { id: "tool-name", required: true, maxlength: 200 });
  const [lengths, rotation, pose] = poseFields("tool", "Tool centre point in the flange frame, mm");
  const std = el("input", { id: "tool-std", type: "number", step: "any", min: 0, max: 10000, placeholder: "from a drawing" });
  const known = el("div", {}, el("label", { for: "tool-std" }, "Measured with this robot to, mm (one standard deviation)"), std);
  const body = () => ({ ...pose(), ...std.value !== "" && { std_mm: Number(std.value) } });
  return stored("Store a tool", [el("div", {}, el("label", { for: "tool-name" }, "Name"), name), lengths, rotation, known], async () => changed(await put(`/v1/robots/${robot.id}/tools/${encodeURIComponent(name.value)}`, body())));
}

function frameForm(robot, sets, changed) {
  const name = el("input", { id: "frame-name", required: true, maxlength: 200 });
  const [lengths, rotation, pose, isTyped] = poseFields("frame", "Origin, mm; or a file of measured points below");
  const file = el("input", { id: "frame-file", type: "file", accept: ".csv,text/csv" });
  const set = el("select", { id: "frame-set" }, el("option", { value: "" }, "the robot's base frame"), sets.map((s) => el("option", { value: s.id }, `the measuring frame of ${s.name ?? s.id}`)));
  const std = el("input", { id: "frame-std", type: "number", step: "any", min: 0, max: 10000 });
  const station = el("input", { id: "frame-station", maxlength: 200 });
  const stationField = el("div", { hidden: true }, el("label", { for: station.id }, "Station they were measured from, where the set has several"), station);
  set.addEventListener("change", () => { stationField.hidden = set.value === ""; });
  const keep = async () => {
    if (file.files.length > 0 && isTyped()) throw { title: "Typed and measured", detail: "A work frame is either typed or fitted to a file of points: empty one of them." };
    const where = file.files.length > 0 ? { points: fixturePoints(await file.files[0].text()) } : pose();
    // of a typed frame the service says that an uncertainty has no place
    if (std.value !== "") where.std_mm = Number(std.value);
    const reference = set.value === "" ? {} : { reference: "measuring", measurement_set_id: set.value, ...station.value.trim() === "" ? {} : { station: station.value.trim() } };
    await changed(await put(`/v1/robots/${robot.id}/work-frames/${encodeURIComponent(name.value)}`, { ...reference, ...where }));
  };
  return stored("Store a work frame", [el("div", {}, el("label", { for: "frame-name" }, "Name"), name), el("div", {}, el("label", { for: "frame-set" }, "Its numbers are given in"), set), stationField, lengths, rotation,
    el("div", {}, el("label", { for: "frame-file" }, "Three or more measured points: a CSV with nominal_x_mm nominal_y_mm nominal_z_mm (as drawn) and x_mm y_mm z_mm (as measured)"), file),
    el("div", {}, el("label", { for: std.id }, "Standard uncertainty of one measured coordinate, mm"), std)], keep);
}

/** A form whose button stores something. */
function stored(words, fields, keep, more) {
  const out = el("div", { "aria-live": "polite" });
  const submit = async (event) => {
    event.preventDefault();
    try {
      await keep();
    } catch (error) {
      if (error.name !== "AbortError") fill(out, problem(error));
    }
  };
  return el("form", { submit }, el("h2", {}, words), el("div.fields.low", {}, fields), more, out, el("p", {}, el("button", { type: "submit" }, words)));
}

/** Points of a fixture, from a CSV file. */
function fixturePoints(text) {
  const separator = text.split(/\r\n|\n|\r/, 1)[0].includes(";") ? ";" : ",";
  const [first, ...rows] = rowsOf(text, separator);
  const column = (name) => {
    const at = first?.cells.findIndex((cell) => cell.toLowerCase() === name) ?? -1;
    if (at < 0) throw { title: "A column is missing", detail: `The file has no column ${name}.` };
    return at;
  };
  const axes = ["x", "y", "z"];
  const [drawn, seen] = ["nominal_", ""].map((before) => axes.map((axis) => column(`${before}${axis}_mm`)));
  const number = ({ cells, line }, at) => {
    const value = Number(separator === ";" ? cells[at]?.replace(",", ".") : cells[at]);
    if (!Number.isFinite(value) || (cells[at] ?? "") === "") throw { title: "A point cannot be read", detail: `Line ${line}, column ${first.cells[at]}: "${cells[at] ?? ""}" is no number.` };
    return value;
  };
  return rows.map((row) => ({ nominal_mm: drawn.map((at) => number(row, at)), measured_mm: seen.map((at) => number(row, at)) }));
}
