// A program corrected in the page: joint or Cartesian targets in, corrected ones out, with which the identified robot is where the program wants it.

import { get, list, post } from "./api.js";
import { cellCard, cellOf } from "./cell.js";
import { rowsOf } from "./csv.js";
import { el, fill, problem, say, table, warning } from "./dom.js";
import { error, fixed, mm, signed, when } from "./format.js";
import { best, state } from "./history.js";
import { facts } from "./robots.js";
import { saveText } from "./save.js";
import { foundAgainst } from "./verdicts.js";

/** Targets of one request. */
const PART = 5000;
/** Targets that are listed on the page. */
const SHOWN = 40;
const DEG = 180 / Math.PI;

/** The page. */
export async function correctPage({ main, signal, may, query }, id) {
  const [robot, sets, measured, cell] = await Promise.all([get(`/v1/robots/${id}`, signal), list(`/v1/robots/${id}/parameter-sets`, 50, signal), list(`/v1/robots/${id}/measurement-sets`, 50, signal), cellOf(id, signal)]);
  document.title = `kincal: correct a program of ${robot.name}`;
  const usable = sets.filter((set) => set.status !== "withdrawn");
  const doubtOf = await doubts(robot, signal);
  const out = el("div", { "aria-live": "polite" });
  const place = el("div", {});
  const { node, offer } = form(robot, usable, doubtOf, out);
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
function form(robot, sets, doubtOf, out) {
  const pick = (name, label, options) => {
    const select = el("select", { id: name }, options.map(([value, words]) => el("option", { value }, words)));
    return [select, el("div", {}, el("label", { for: name }, label), select)];
  };
  const set = el("select", { id: "correct-set" }, setOptions(sets));
  const setField = el("div", {}, el("label", { for: "correct-set" }, "Parameters, identified"), set);
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
  const file = el("input", { id: "correct-file", type: "file", accept: ".csv,.txt,.tsv,text/csv", required: true });
  const correct = async (unit) => {
    fill(out, el("p.quiet", {}, "Correcting …"));
    try {
      const program = read(await file.files[0].text(), robot.links.length, unit);
      const at = tool.map((input) => input.value);
      const typed = at.some((v) => v !== "") && { tool: { translation_mm: at.map(Number) } };
      const request = { mode: mode.value, ...typed, ...named.value && { tool_name: named.value }, ...program.targets && { frame: frame.value } };
      const posesIn = frame.value === "measuring" ? "robot's base frame, which the controller knows" : frame.selectedOptions[0].textContent;
      fill(out, corrected(program, await compensate(set.value, program, request), { name: file.files[0].name, posesIn, set: chosen(), doubt: doubtOf(chosen()) }));
    } catch (error) {
      fill(out, error.without ? unitQuestion(error.without, correct) : problem(error));
    }
  };
  const submit = (event) => {
    event.preventDefault();
    if (file.files.length > 0) correct();
  };
  const node = el("form.card", { submit }, doubted, el("div.fields.wide", {}, setField, modeField, namedField, el("fieldset", {}, el("legend", {}, "Or its centre point in the flange frame, mm"), el("div.controls", {}, tool)), frameField),
    el("label", { for: "correct-file" }, `A table (CSV with commas, semicolons or tabs) with q1_deg … q${robot.links.length}_deg (or _rad), or with J1 … J${robot.links.length} or A1 … A${robot.links.length}. With x_mm y_mm z_mm and quat_w quat_x quat_y quat_z its targets are Cartesian, and the joint values near ones. Other columns are kept`), el("div.fields", {}, file), el("button.primary", { type: "submit" }, "Correct"));
  return { node, offer };
}

/** The active set first; every other one is in a group of its own, because no cell should run with it. */
function setOptions(sets) {
  const option = (set, words) => el("option", { value: set.id }, `${words}, ${when(set.created_at)}`);
  const [active, others] = [sets.filter(isActive), sets.filter((set) => !isActive(set))];
  return [active.map((set) => option(set, "active set")), others.length > 0 && el("optgroup", { label: "not released, for trial only" }, others.map((set) => option(set, set.status)))];
}

const isActive = (set) => set.status === "released";

/** A function that says what speaks against correcting with a set: {why, rms, job}, `rms` null where no session says how far off it is; null where nothing does. */
async function doubts(robot, signal) {
  const [{ sessions, since }, { tolerance_mm: tolerance }] = await Promise.all([state(robot, signal), get(`/v1/robots/${robot.id}/policy`, signal)]);
  const newer = since && (await get(`/v1/jobs/${since.job_id}/report`, signal));
  const hasChanged = newer?.warnings.some(({ code }) => code === "robot_changed");
  return (set) => {
    const newest = sessions.find(({ job }) => job.parameter_set_from === set.id);
    const { after, n_points: n } = newest ? best(newest.report) : {};
    const found = newest && (foundAgainst(newest.report) ?? (tolerance && tolerance < after.rms_mm && `beyond the robot's tolerance of ${mm(tolerance)}`));
    if (found) return { why: `The newest session speaks against these parameters: ${found}. With them the robot missed its ${n} points by ${mm(after.rms_mm)} rms, at most ${mm(after.max_mm)}.`, rms: newest.report.evidence === "none" ? null : after.rms_mm, job: newest.job.id };
    if (robot.state === "check_robot") return { why: "A session does not fit this robot, and nobody has said why.", rms: null, job: robot.check_job_id };
    return hasChanged && set.created_at < since.created_at ? { why: "A newer calibration found that the robot has changed since these parameters were identified.", rms: null, job: since.job_id } : null;
  };
}

const doubtWarning = (doubt) => doubt && el("div.warning", { role: "alert" }, el("p", {}, el("strong", {}, "These parameters may be wrong. "), doubt.why, " Do not run a corrected program in the cell before the cause is known. ", el("a", { href: `#/jobs/${doubt.job}` }, "Look at that session")));

/** Asks for the unit of joint columns that state none. */
function unitQuestion(names, again) {
  const button = (unit, words) => el("button", { type: "button", click: () => again(unit) }, words);
  return el("div.warning", { role: "alert" }, el("p", {}, el("strong", {}, "In which unit are the joint values? "), `${names.join(", ")} state none.`), el("div.actions", {}, button("deg", "Degrees"), button("rad", "Radians")));
}

/** Why a program that was corrected with another set than the active one must not run in the cell. */
function trialOnly(set) {
  if (isActive(set)) return false;
  const why = set.status === "superseded" ? "This set is not in force any more: another one took its place." : "This set was never released: nobody has decided that a robot may move by it.";
  return el("div.warning", { role: "alert" }, el("p", {}, el("strong", {}, "For trial only. "), why, " Do not run this program in the cell before a set is released and the program corrected with it. ", el("a", { href: `#/jobs/${set.job_id}` }, "To that parameter set")));
}

/** Joint and unit of a column, as programs and controllers name it: q1_deg, J1, A1 [deg], Joint 1 (rad). */
const JOINT = /^(?:q|j|a|jt|joint|axis)[\s_[]*(\d{1,2})\]?[\s_,([]*(deg|rad|mm|°)?(?:rees?|ians?)?[)\]\s]*$/i;

/** The targets of a file, and what is needed to write it again. `unit` is that of joint values whose columns state none. */
function read(text, n, unit) {
  const header = text.split(/\r\n|\n|\r/, 1)[0];
  const separator = header.includes(";") ? ";" : header.includes("\t") ? "\t" : ",";
  const [first, ...rows] = rowsOf(text, separator);
  const joints = (first?.cells ?? []).map((cell, at) => ({ at, name: cell, joint: JOINT.exec(cell) })).filter(({ joint }) => joint);
  const found = Array.from({ length: n }, (_, i) => joints.find(({ joint }) => Number(joint[1]) === i + 1));
  const missing = found.findIndex((column) => column === undefined);
  if (missing >= 0) throw { title: "A joint is missing", detail: `The file has no column for joint ${missing + 1}. It needs one for each of the ${n} joints: q1_deg … q${n}_deg (or _rad), J1 … J${n}, or A1 … A${n}, with commas, semicolons or tabs between them. Its first line has: ${first?.cells.join(", ") || "nothing"}` };
  const without = found.filter(({ joint }) => !joint[2]).map(({ name }) => name);
  if (without.length > 0 && !unit) throw { without };
  const places = found.map(({ at, name, joint }) => ({ at, name, factor: (joint[2] ?? unit).toLowerCase() === "rad" ? DEG : 1 }));
  const q = rows.map(({ cells, line }) => places.map(({ at, name, factor }) => {
    const value = Number(separator === "," ? cells[at] : cells[at]?.replace(",", "."));
    if (!Number.isFinite(value) || cells[at] === "" || cells[at] === undefined) throw { title: "A target cannot be read", detail: `Line ${line}, column ${name}: "${cells[at] ?? ""}" is no number.` };
    return value * factor;
  }));
  if (q.length === 0) throw { title: "No targets", detail: "The file has a header row only." };
  const [position, quaternion] = [["x_mm", "y_mm", "z_mm"], ["quat_w", "quat_x", "quat_y", "quat_z"]].map((names) => {
    const all = names.map((name) => first.cells.findIndex((cell) => cell.toLowerCase() === name));
    return all.includes(-1) ? null : all;
  });
  const values = ({ cells, line }, columns) => columns.map((at) => {
    const value = Number(separator === "," ? cells[at] : cells[at]?.replace(",", "."));
    if (!Number.isFinite(value) || (cells[at] ?? "") === "") throw { title: "A target cannot be read", detail: `Line ${line}, column ${first.cells[at]}: "${cells[at] ?? ""}" is no number.` };
    return value;
  });
  const targets = position && rows.map((row, i) => ({ position_mm: values(row, position), ...quaternion && { quaternion: values(row, quaternion) }, q_near_deg: q[i] }));
  return { header: first.cells, rows: rows.map((row) => row.cells), places, separator, q, targets, position, quaternion };
}

/** Fields of an answer with one entry for each target; the last two are not in every answer. */
const LISTS = ["q_deg", "position_error_before_mm", "position_error_after_mm", "status", "extrapolated", "position_std_mm", "poses"];

async function compensate(id, { q, targets }, request) {
  const all = Object.fromEntries([...LISTS, "warnings"].map((key) => [key, []]));
  for (let from = 0; from < q.length; from += PART) {
    const wanted = targets ? { targets: targets.slice(from, from + PART) } : { q_deg: q.slice(from, from + PART) };
    const part = await post(`/v1/parameter-sets/${id}/compensate`, { ...request, ...wanted });
    for (const key of LISTS) all[key].push(...part[key] ?? []);
    for (const { rows = [], ...said } of part.warnings ?? []) {
      let known = all.warnings.find(({ code, detail }) => code === said.code && detail === said.detail);
      if (known === undefined) all.warnings.push(known = { ...said, rows: [] });
      known.rows.push(...rows.map((row) => row + from));
    }
    all.frame = part.frame;
  }
  return all;
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

function corrected(program, answer, { name, posesIn, set, doubt }) {
  // what the fit alone says of its uncertainty holds no longer: the newest session says more
  if (doubt) answer.position_std_mm = doubt.rms === null ? [] : answer.status.map((_, i) => Math.max(answer.position_std_mm[i] ?? 0, doubt.rms));
  const remarks = toLookAt(answer);
  const odd = remarks.map((remark, i) => [remark, i]).filter(([remark]) => remark.length > 0);
  const outside = answer.extrapolated.filter(Boolean).length;
  // what needs somebody is listed first, and named
  const order = [...odd.map(([, i]) => i), ...remarks.map((_, i) => i).filter((i) => remarks[i].length === 0)];
  const shown = order.slice(0, SHOWN);
  const sum = (i) => answer.position_error_after_mm[i] + (answer.position_std_mm[i] ?? 0);
  const last = answer.status.reduce((best, _, i) => (sum(i) > sum(best) ? i : best), 0);
  const joints = program.q[0].map((_, k) => [`q${k + 1}, °`, (i) => [fixed(answer.q_deg[i][k], 4), el("small.quiet", {}, signed(answer.q_deg[i][k] - program.q[i][k], 4))], "n"]);
  const frame = `in the ${answer.frame === "measuring" ? "measuring" : "robot's base"} frame`;
  return [doubtWarning(doubt), trialOnly(set), facts([["Targets", program.q.length], ["Largest error before", mm(worst(answer.position_error_before_mm))],
    doubt?.rms === null ? ["Largest error after", "not known", "the fit's own figure holds no longer: see the warning above"] : ["Largest error after", `${left(answer.position_error_after_mm[last], answer.position_std_mm[last])} mm`, `by the identified robot, ${frame}; ± ${answer.position_std_mm.length === 0 ? "is not known for these parameters" : doubt ? "the error of the newest session" : "its standard uncertainty there"}`],
    answer.position_std_mm.length > 0 && ["Known to", mm(worst(answer.position_std_mm)), doubt ? "no better than the newest session found, rms" : "standard uncertainty of the tool's position at the least certain target"],
    ["To look at", odd.length, odd.length > 0 ? counted(remarks) : doubt ? "computed for all targets; see the warning above" : "all targets are corrected"], outside > 0 && ["Outside of what was measured", outside, "there the corrections fade to the links alone"]]),
  answer.warnings.map(warning), notCorrected(answer), uncertain(answer, doubt),
  el("section.card", {}, el("div.head", {}, el("h2", {}, "Corrected targets"), el("div.actions", {}, el("button.primary", { type: "button", click: () => save(program, answer, name, isActive(set) && !doubt) }, "Download as CSV"))),
    table(`${shown.length < program.q.length ? `${shown.length} of ${program.q.length} targets` : "All targets"}; below each joint value its ${program.targets ? "difference from the near one" : "change"}. ${program.targets ? `The downloaded poses are in the ${posesIn}. ` : ""}After: what is left by the identified robot ± ${doubt ? "what is known of the tool's position" : "the standard uncertainty of the tool's position"}. Rows are counted from 0 without the header row.`,
      [["Row", (i) => i, "n"], ["State", (i) => (remarks[i].length > 0 ? remarks[i].join(", ") : stateOf(answer.status[i])), "state"], ["Before, mm", (i) => error(answer.position_error_before_mm[i]), "n"], ["After, mm", (i) => left(answer.position_error_after_mm[i], answer.position_std_mm[i]), "n"], ...joints], shown, ""))];
}

/** How many targets have which remark. */
function counted(remarks) {
  const all = new Map();
  for (const remark of remarks.flat()) all.set(remark, (all.get(remark) ?? 0) + 1);
  return [...all].map(([remark, n]) => `${n} ${remark}`).join(", ");
}

/** The first of some rows, named. */
const rowsNamed = (rows) => `Rows ${rows.slice(0, 12).join(", ")}${rows.length > 12 ? ` and ${rows.length - 12} more` : ""}.`;

function notCorrected({ status }) {
  const rows = status.map((_, i) => i).filter((i) => !FINE.includes(status[i]));
  return rows.length > 0 && el("div.warning", {}, el("p", {}, el("strong", {}, rows.length === 1 ? "One target is not fully corrected. " : `${rows.length} targets are not fully corrected. `), "The tool stays off by the error that is stated. They are in the downloaded file with the joint values below: look at them before the program runs. ", rowsNamed(rows)));
}

function uncertain(answer, doubt) {
  const rows = answer.status.map((_, i) => i).filter((i) => isUncertain(answer, i));
  return rows.length > 0 && el("div.warning", {}, el("p", {}, el("strong", {}, rows.length === 1 ? "One target is uncertain. " : `${rows.length} targets are uncertain. `), doubt ? "The newest session missed by more than they are corrected by, so the correction may make them worse. " : "There the tool is known less well than it is corrected by, so the correction may make it worse. Measure poses near these targets, and calibrate again. ", rowsNamed(rows)));
}

function save({ header, rows, places, separator, position, quaternion }, answer, name, isForCell) {
  const quoted = (cell) => (/["\n\r]/.test(cell) || cell.includes(separator) ? `"${cell.replaceAll("\"", "\"\"")}"` : cell);
  const number = (value) => (separator === "," ? String(value) : String(value).replace(".", separator === ";" ? "," : "."));
  const lines = rows.map((cells, i) => cells.map((cell, at) => {
    const pose = answer.poses[i];
    const [axis, part] = [position, quaternion].map((columns) => (pose && columns ? columns.indexOf(at) : -1));
    if (axis >= 0) return number(Number(pose.position_mm[axis].toFixed(5)));
    if (part >= 0) return number(Number(pose.quaternion[part].toFixed(9)));
    const k = places.findIndex((place) => place.at === at);
    return k < 0 ? quoted(cell) : number(Number((answer.q_deg[i][k] / places[k].factor).toFixed(8)));
  }).join(separator));
  saveText(`${header.map(quoted).join(separator)}\n${lines.join("\n")}\n`, name.replace(/(\.\w+)?$/, isForCell ? "-corrected.csv" : "-corrected-for-trial.csv"), "text/csv");
}
