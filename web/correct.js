// A program corrected in the page: joint or Cartesian targets in, corrected ones out, with which the identified robot is where the program wants it.

import { get, list, post } from "./api.js";
import { cellCard, cellOf } from "./cell.js";
import { el, fill, problem, say, table, warning } from "./dom.js";
import { capital, error, fixed, mm, signed } from "./format.js";
import { best, state } from "./history.js";
import { facts } from "./robots.js";
import { conventionChoice } from "./rotations.js";
import { saveBytes } from "./save.js";
import { setNames } from "./sessions.js";
import { asksToLook, foundAgainst } from "./verdicts.js";

/** Targets that are listed on the page. */
const SHOWN = 40;

/** The page. */
export async function correctPage({ main, signal, may, query }, id) {
  const [robot, sets, measured, cell, nameOf] = await Promise.all([get(`/v1/robots/${id}`, signal), list(`/v1/robots/${id}/parameter-sets`, 50, signal), list(`/v1/robots/${id}/measurement-sets`, 50, signal), cellOf(id, signal), setNames({ id }, signal)]);
  document.title = `kincal: correct a program of ${robot.name}`;
  const usable = sets.filter((set) => set.status !== "withdrawn");
  const doubtOf = await doubts(robot, signal);
  const out = el("div", { "aria-live": "polite", tabindex: -1 });
  const place = el("div", {});
  const { node, offer } = form(robot, usable, nameOf, doubtOf, out);
  const draw = (of) => {
    offer(of);
    fill(place, cellCard(robot, of, measured, may, changed));
  };
  const changed = async ({ name }) => {
    draw(await cellOf(id, signal));
    const card = place.querySelector("details");
    card.open = true;
    card.querySelector("summary").focus();
    say(`${name} is stored`);
  };
  draw(cell);
  fill(main, el("p.crumbs", {}, el("a", { href: "#/" }, "Robots"), " / ", el("a", { href: `#/robots/${id}` }, robot.name)), el("h1", {}, "Correct a program"),
    el("p.quiet", {}, "For targets that were programmed offline. Targets that were taught at the robot contain its errors already and stay as they are."),
    usable.length === 0 ? el("p.empty", {}, "This robot has no parameter set yet.") : node, place, out);
  if (query.get("cell") !== "open") return;
  const card = place.querySelector("details");
  card.open = true;
  card.scrollIntoView();
}

/** The form, and a function that offers the cell's work frames and tools in it. */
function form(robot, sets, nameOf, doubtOf, out) {
  const pick = (name, label, options) => {
    const select = el("select", { id: name }, options.map(([value, words]) => el("option", { value }, words)));
    return [select, el("div", {}, el("label", { for: name }, label), select)];
  };
  const set = el("select", { id: "correct-set" }, setOptions(sets, nameOf));
  const setField = el("div", {}, el("label", { for: "correct-set" }, "Parameter set"), set);
  const chosen = () => sets.find((one) => one.id === set.value);
  const doubted = el("div", {});
  const showDoubt = () => fill(doubted, chosen() && doubtWarning(doubtOf(chosen())));
  set.addEventListener("change", showDoubt);
  showDoubt();
  const [mode, modeField] = pick("correct-mode", "What of the tool is corrected", [["pose", "position and orientation"], ["position", "position only"]]);
  const [frame, frameField] = pick("correct-frame", "Frame of Cartesian targets", []);
  const [named, namedField] = pick("correct-tool", "Tool", []);
  const options = (select, all) => {
    const before = select.value;
    fill(select, all.map(([value, words]) => el("option", { value, selected: value === before }, words)));
  };
  const offer = (cell) => {
    options(frame, [["base", "robot's base"], ["measuring", "measuring frame"], ...cell.frames.map(({ name }) => [name, `work frame ${name}`])]);
    options(named, [["", "reflector, or as typed"], ...cell.tools.map(({ name }) => [name, name])]);
  };
  const tool = ["x", "y", "z"].map((axis) => el("input", { type: "number", step: "any", "aria-label": `Tool ${axis}, mm`, placeholder: axis }));
  const rotation = conventionChoice("correct-rotation");
  const file = el("input", { id: "correct-file", type: "file", accept: ".csv,.txt,.tsv,.xlsx,.ods,text/csv", required: true });
  const unmark = () => {
    node.querySelector("#correct-wrong")?.remove();
    for (const field of node.querySelectorAll("[aria-invalid]")) ["aria-invalid", "aria-describedby"].forEach((name) => field.removeAttribute(name));
  };
  /** What is wrong stands at its field, which gets the focus. */
  const atField = (field, said) => {
    unmark();
    said.id = "correct-wrong";
    (field.closest("fieldset, .fields:not(.wide)") ?? field).after(said);
    field.setAttribute("aria-invalid", "true");
    field.setAttribute("aria-describedby", said.id);
    field.focus();
    fill(out);
  };
  /** The field that a refusal is about; what is about no other field is about the file. */
  const fieldOf = ([issue]) => {
    const [, name, , axis] = issue.pointer?.split("/") ?? [];
    return { tool_name: named, tool: tool[axis ?? 0], frame, rotation, mode }[name] ?? file;
  };
  const correct = async (unit) => {
    unmark();
    const missing = tool.find((input) => input.value === "");
    if (missing && tool.some((input) => input.value !== "")) {
      atField(missing, problem({ title: "A number is missing", detail: `${missing.getAttribute("aria-label")} is empty. Enter 0 where it is 0` }));
      return;
    }
    fill(out, el("p.quiet", {}, "Correcting …"));
    try {
      const [program] = file.files;
      const typed = ["x", "y", "z"].map((axis, i) => [`tool_${axis}_mm`, tool[i].value]).filter(([, value]) => value !== "");
      const stated = new URLSearchParams([["mode", mode.value], ["frame", frame.value], ...named.value ? [["tool_name", named.value]] : [], ...typed, ...rotation.value ? [["rotation", rotation.value]] : [], ...unit ? [["columns", JSON.stringify({ joint_unit: unit })]] : []]);
      const answer = await post(`/v1/parameter-sets/${set.value}/compensate-program?${stated}`, program, "text/csv");
      const posesIn = frame.value === "measuring" ? "robot's base frame, which the controller knows" : frame.selectedOptions[0].textContent;
      fill(out, corrected(answer, { name: program.name, posesIn, set: chosen(), doubt: doubtOf(chosen()), hasTool: named.value !== "" || typed.length > 0 }));
      // the question for the unit is gone
      if (unit) out.focus();
    } catch (error) {
      const without = withoutUnit(error);
      const said = without.length > 0 && !unit ? unitQuestion(without, correct) : refused(error);
      if (error.errors?.length > 0) atField(fieldOf(error.errors), said);
      else fill(out, said);
    }
  };
  const submit = (event) => {
    event.preventDefault();
    if (file.files.length > 0) correct();
  };
  const node = el("form.card", { submit }, doubted, el("div.fields.wide", {}, setField, modeField, namedField, el("fieldset", {}, el("legend", {}, "Or its centre point in the flange frame, mm"), el("div.controls", {}, tool)), frameField, el("div", {}, el("label", { for: "correct-rotation" }, "Angles rx_deg ry_deg rz_deg of Cartesian targets"), rotation)),
    el("label", { for: "correct-file" }, `A table (CSV, xlsx, ods) with q1_deg … q${robot.links.length}_deg (or _rad), or with J1 … J${robot.links.length} or A1 … A${robot.links.length}. With x_mm y_mm z_mm and quat_w quat_x quat_y quat_z (or rx_deg ry_deg rz_deg) its targets are Cartesian, and the joint values near ones. Everything else stays as it is`), el("div.fields", {}, file), el("button.primary", { type: "submit" }, "Correct"));
  return { node, offer };
}

/** The active set first; every other one is in a group of its own, because no cell should run with it. */
function setOptions(sets, nameOf) {
  const option = (set) => el("option", { value: set.id }, nameOf(set));
  const [active, others] = [sets.filter(isActive), sets.filter((set) => !isActive(set))];
  return [active.map(option), others.length > 0 && el("optgroup", { label: "not released, for trial only" }, others.map(option))];
}

const isActive = (set) => set.status === "released";

/** A function that says what speaks against correcting with a set: {why, rms, job}, `rms` null where no session says how far off it is; null where nothing does. */
async function doubts(robot, signal) {
  const [{ sessions, since }, { tolerance_mm: tolerance }] = await Promise.all([state(robot, signal), get(`/v1/robots/${robot.id}/policy`, signal)]);
  const asking = robot.state === "check_robot" && robot.check_job_id && (await get(`/v1/jobs/${robot.check_job_id}`, signal));
  const newer = since && (await get(`/v1/jobs/${since.job_id}/report`, signal));
  const hasChanged = newer?.warnings.some(({ code }) => code === "robot_changed");
  return (set) => {
    const newest = sessions.find(({ job }) => job.parameter_set_from === set.id);
    const { after, n_points: n } = newest ? best(newest.report) : {};
    const found = newest && (foundAgainst(newest.report) ?? (tolerance && tolerance < after.rms_mm && `beyond the robot's tolerance of ${mm(tolerance)}`));
    if (found) return { why: `The newest session speaks against these parameters: ${found}. With them the robot missed its ${n} points by ${mm(after.rms_mm)} rms, at most ${mm(after.max_mm)}.`, rms: newest.report.evidence === "none" ? null : after.rms_mm, job: newest.job.id };
    if (robot.state === "check_robot") return { why: `${asksToLook(asking).sentence}. Nobody has marked the robot as checked.`, rms: null, job: robot.check_job_id };
    return hasChanged && set.created_at < since.created_at ? { why: "A newer calibration found that the robot has changed since these parameters were identified.", rms: null, job: since.job_id } : null;
  };
}

const doubtWarning = (doubt) => doubt && el("div.warning", { role: "alert" }, el("p", {}, el("strong", {}, "These parameters may be wrong. "), doubt.why, " Do not run a corrected program in the cell before the cause is known. ", el("a", { href: `#/jobs/${doubt.job}` }, "Look at that session")));

/** What is wrong, with the line of the file. */
const placed = ({ line, detail }) => (line && !/^line \d/.test(detail) ? `Line ${line}: ${detail.replace(/^row \d+,? ?/, "")}` : capital(detail));

/** Why a program was not corrected; one reason alone is said once. */
function refused(error) {
  const texts = new Set((error.errors ?? []).map(placed));
  const errors = [...texts].map((detail) => ({ detail }));
  const said = { code: undefined, title: "The program was not corrected", detail: errors.length === 1 ? errors[0].detail : capital(error.detail), errors: errors.length > 1 ? errors : [] };
  return problem({ ...error, ...errors.length > 0 ? said : {}, message: error.message });
}

/** Joint columns that a refusal says have no unit. */
const withoutUnit = (error) => [...new Set((error.errors ?? []).filter((issue) => issue.code === "missing_unit").map((issue) => issue.column ?? "The joint columns"))];

/** Asks for the unit of joint columns that state none. */
function unitQuestion(names, again) {
  const button = (unit, words) => el("button", { type: "button", click: () => again(unit) }, words);
  return el("div.warning", { role: "alert" }, el("p", {}, el("strong", {}, "In which unit are the joint values? "), `${names.join(", ")} state none.`), el("div.actions", {}, button("deg", "Degrees"), button("rad", "Radians"), button("gon", "Gons")));
}

/** Why a program that was corrected with another set than the active one must not run in the cell. */
function trialOnly(set) {
  if (isActive(set)) return false;
  const why = set.status === "superseded" ? "This set is not in force any more: another one took its place." : "This set was never released: nobody has decided that a robot may move by it.";
  return el("div.warning", { role: "alert" }, el("p", {}, el("strong", {}, "For trial only. "), why, " Do not run this program in the cell before a set is released and the program corrected with it. ", el("a", { href: `#/jobs/${set.job_id}` }, "To that parameter set")));
}

const worst = (values) => values.reduce((a, b) => Math.max(a, b), 0);
const FINE = ["ok"];
/** What a status means for whoever runs the program. */
const STATES = { ok: "corrected", near_singular: "near a singularity", not_reached: "not reached", joint_limit: "at a joint limit" };
const stateOf = (status) => STATES[status] ?? status.replaceAll("_", " ");

/** Whether a target is corrected by less than what is not known of it: the correction may be in any direction. */
const isUncertain = ({ position_std_mm: std, position_error_before_mm: before }, i) => std[i] > before[i];

/** What is to be looked at, one entry for each target. */
const toLookAt = (answer) => answer.status.map((status, i) => [!FINE.includes(status) && stateOf(status), isUncertain(answer, i) && "uncertain"].filter(Boolean));

/** The error that is left by the identified robot, with how well that robot is known: the first alone says nothing of the real tool. */
const left = (mm, std) => `${error(mm)} ± ${std === undefined ? "?" : error(std)}`;

function corrected(program, { name, posesIn, set, doubt, hasTool }) {
  const { position_std_mm: known, ...found } = program.corrected;
  // what the fit alone says of its uncertainty holds no longer: the newest session says more
  const std = !doubt ? known : doubt.rms === null ? [] : found.status.map((_, i) => Math.max(known?.[i] ?? 0, doubt.rms));
  const answer = { ...found, position_std_mm: std ?? [] };
  const { lines, program_q_deg: q } = program;
  const isCartesian = answer.poses !== undefined;
  const remarks = toLookAt(answer);
  const odd = remarks.map((remark, i) => [remark, i]).filter(([remark]) => remark.length > 0);
  const outside = answer.extrapolated.filter(Boolean).length;
  // what needs somebody is listed first, and named
  const order = [...odd.map(([, i]) => i), ...remarks.map((_, i) => i).filter((i) => remarks[i].length === 0)];
  const shown = order.slice(0, SHOWN);
  const sum = (i) => answer.position_error_after_mm[i] + (answer.position_std_mm[i] ?? 0);
  const last = answer.status.reduce((best, _, i) => (sum(i) > sum(best) ? i : best), 0);
  const joints = q[0].map((_, k) => [`q${k + 1}, °`, (i) => [fixed(answer.q_deg[i][k], 4), el("small.quiet", {}, signed(answer.q_deg[i][k] - q[i][k], 4))], "n"]);
  const frame = `in the ${answer.frame === "measuring" ? "measuring" : "robot's base"} frame`;
  return [doubtWarning(doubt), trialOnly(set), facts([["Targets", q.length], ["Largest error before", mm(worst(answer.position_error_before_mm))],
    doubt?.rms === null ? ["Largest error after", "not known", "the fit's own figure holds no longer: see the warning above"] : ["Largest error after", `${left(answer.position_error_after_mm[last], answer.position_std_mm[last])} mm`, `by the identified robot, ${frame}; ± ${answer.position_std_mm.length === 0 ? "is not known for these parameters" : doubt ? "the error of the newest session, or its standard uncertainty there where that is larger" : "its standard uncertainty there"}`],
    answer.position_std_mm.length > 0 && ["Known to", mm(worst(answer.position_std_mm)), doubt && worst(answer.position_std_mm) === doubt.rms ? "the error of the newest session, rms" : `standard uncertainty at the least certain target${hasTool ? ", for the tool that was stated" : "; it contains the reflector's place on the nominal flange: to state the tool's centre point changes it"}${doubt ? `; the newest session missed by ${mm(doubt.rms)} rms` : ""}`],
    ["To look at", odd.length, odd.length > 0 ? counted(remarks) : doubt ? "computed for all targets; see the warning above" : "all targets are corrected"], outside > 0 && ["Outside of what was measured", outside, "there the corrections fade to the links alone"]]),
  (answer.warnings ?? []).map(({ rows = [], ...said }) => warning({ ...said, detail: rows.length > 0 ? `${said.detail} (${linesNamed(rows, lines)})` : said.detail })),
  program.left_columns.length > 0 && el("div.warning", {}, el("p", {}, el("strong", {}, "Poses beside the joint values stay as they are. "), `${program.left_columns.join(", ")} are the poses of the joint values before the correction: do not run the program by them.`)),
  notCorrected(answer, lines), uncertain(answer, doubt, lines),
  el("section.card", {}, el("div.head", {}, el("h2", {}, "Corrected targets"), el("div.actions", {}, el("button.primary", { type: "button", click: () => save(program, name, isActive(set) && !doubt) }, "Download the corrected program"))),
    el("div.targets", {}, table(`${shown.length < q.length ? `${shown.length} of ${q.length} targets` : "All targets"}; below each joint value its ${isCartesian ? "difference from the near one" : "change"}. ${isCartesian ? `The downloaded poses are in the ${posesIn}. ` : ""}After: what is left by the identified robot ± ${doubt ? "what is known of the tool's position" : "the standard uncertainty of the tool's position"}.`,
      [["Line", (i) => lines[i], "n"], ["State", (i) => (remarks[i].length > 0 ? remarks[i].join(", ") : stateOf(answer.status[i])), "state"], ["Before, mm", (i) => error(answer.position_error_before_mm[i]), "n"], ["After, mm", (i) => left(answer.position_error_after_mm[i], answer.position_std_mm[i]).split(/ (?=±)/).map((part, at) => (at === 0 ? part : [" ", el("span", {}, part)])), "n"], ...joints], shown, "")))];
}

/** How many targets have which remark. */
function counted(remarks) {
  const all = new Map();
  for (const remark of remarks.flat()) all.set(remark, (all.get(remark) ?? 0) + 1);
  return [...all].map(([remark, n]) => `${n} ${remark}`).join(", ");
}

/** The lines of some targets, the first of them named. */
const linesNamed = (targets, lines) => `${targets.length === 1 ? "line" : "lines"} ${targets.slice(0, 12).map((i) => lines[i]).join(", ")}${targets.length > 12 ? ` and ${targets.length - 12} more` : ""} of the file`;
const sentenceOf = (targets, lines) => `${capital(linesNamed(targets, lines))}.`;

function notCorrected({ status }, lines) {
  const rows = status.map((_, i) => i).filter((i) => !FINE.includes(status[i]));
  return rows.length > 0 && el("div.warning", {}, el("p", {}, el("strong", {}, rows.length === 1 ? "One target is not fully corrected. " : `${rows.length} targets are not fully corrected. `), "The tool stays off by the error that is stated. They are in the downloaded file with the joint values below: look at them before the program runs. ", sentenceOf(rows, lines)));
}

function uncertain(answer, doubt, lines) {
  const rows = answer.status.map((_, i) => i).filter((i) => isUncertain(answer, i));
  return rows.length > 0 && el("div.warning", {}, el("p", {}, el("strong", {}, rows.length === 1 ? "One target is uncertain. " : `${rows.length} targets are uncertain. `), doubt ? "The newest session missed by more than they are corrected by, so the correction may make them worse. " : "There the tool is known less well than it is corrected by, so the correction may make it worse. Measure poses near these targets, and calibrate again. ", sentenceOf(rows, lines)));
}

/** Offers the program as the service wrote it, byte for byte. */
function save({ program_base64: text, is_workbook: isWorkbook }, name, isForCell) {
  const bytes = Uint8Array.from(atob(text), (char) => char.charCodeAt(0));
  const [, stem, ending] = /^(.*?)(\.\w+)?$/.exec(name);
  saveBytes(bytes, `${stem}-corrected${isForCell ? "" : "-for-trial"}${isWorkbook ? ".tsv" : ending ?? ".csv"}`);
}
