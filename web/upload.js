// Uploads measured points, and posts a calibration or a verification with them.

import { post } from "./api.js";
import { askColumns, isAboutColumns, saidBefore, understoodDetails, withChoices } from "./columns.js";
import { rowsOf } from "./csv.js";
import { brief, el, fill, problem, say, table, warning } from "./dom.js";
import { capital, plain, when } from "./format.js";
import { jobForm } from "./job_form.js";
import { posesOf } from "./poses.js";
import { referenceChoice } from "./references.js";
import { equallyGood } from "./joint_maps.js";
import { asksForChoice, inPageWords, remedies } from "./remedies.js";
import { conventionChoice } from "./rotations.js";
import { sheetsIn, twoSheets } from "./sheets.js";
import { SUSPICIONS } from "./words.js";

/** Upload by drag and drop or by choice, then the request; also for sets that are there already. `uploaded` is told of a new one; `verifying` is the parameter set that somebody came to verify, and the points that it was identified from. */
export function uploadCard(robot, { sets, parameterSets, may, uploaded, hasNetwork, verifying }) {
  const known = [...sets];
  const again = el("div", {});
  const here = el("details", {}, el("summary", {}, "Use a set that is here already"), again);
  const offer = () => {
    here.hidden = known.length === 0;
    if (known.length > 0) fill(again, jobForm(robot, known, { parameterSets, hasNetwork, verifying }));
  };
  const came = (set) => {
    known.unshift(set);
    offer();
    uploaded(set);
  };
  offer();
  const parts = [];
  if (may("upload")) parts.push(uploadForm({ robot, parameterSets, may, came, sets, hasNetwork, verifying }));
  if (may("identify")) parts.push(here);
  const title = verifying ? [el("h2", {}, "Verify with another session"), el("p.note", {}, `Upload a session of other poses, in the frame of the first. It scores the parameters identified ${when(verifying.set.created_at)} (${verifying.set.status === "released" ? "active set" : verifying.set.status}); nothing is identified anew. `, el("a", { href: `#/robots/${robot.id}/upload` }, "Calibrate anew instead"))] : el("h2", {}, "Calibrate");
  return parts.length > 0 && el("section.card", { id: "calibrate" }, title, parts);
}

function uploadForm(context) {
  const usual = (context.verifying?.identified ?? context.sets[0])?.frame;
  const out = el("div", { "aria-live": "polite", tabindex: -1 });
  const file = el("input", { id: "set-file", type: "file", multiple: true, accept: ".csv,.txt,.tsv,.xlsx,.ods,.json,.dat,.mod,.ls,text/csv,application/json" });
  const radio = (value, text, checked) => el("label.choice", {}, el("input", { type: "radio", name: "frame", value, checked }), text);
  const frames = el("fieldset", {}, el("legend", {}, "Positions were measured in"), radio("base", "the robot's base frame", usual !== "instrument"), radio("instrument", "the instrument's own frame (base pose and reflector are found too)", usual === "instrument"));
  const instrument = instrumentForm(context.robot, frames);
  const stated = statedForm(context.robot, frames);
  const record = recordForm();
  const query = () => ({ frame: frames.querySelector("input:checked").value, ...instrument.read(), ...stated.read(), ...record.read() });
  // the next file is most likely of the same frame
  context.framed = (frame) => { frames.querySelector(`[value=${frame}]`).checked = true; };
  const take = async (chosen) => {
    const files = [...chosen];
    if (files.length === 2) twoFiles(context, files, query(), out);
    else if (files.length === 1) await upload(context, single(files[0]), query(), out);
    else if (files.length > 2) fill(out, el("p.problem", { role: "alert" }, "One file, or two: the robot's and the instrument's."));
  };
  file.addEventListener("change", () => take(file.files).then(() => { file.value = ""; }));
  const drop = el("div.drop", {}, el("label", { for: "set-file" }, "Drop a measurement set here, or choose one; or two files, the robot's and the instrument's"), file,
    el("p.note", {}, "A table (CSV, xlsx, ods) with q1_deg … q", context.robot.links.length, "_deg, x_mm, y_mm, z_mm, or with columns of other names: you are asked once what they mean."));
  const over = (is) => (event) => { event.preventDefault(); drop.classList.toggle("over", is); };
  drop.addEventListener("dragover", over(true));
  drop.addEventListener("dragleave", over(false));
  drop.addEventListener("drop", (event) => {
    over(false)(event);
    take(event.dataTransfer.files);
  });
  return el("div", {}, frames, instrument.node, stated.node, record.node, drop, out);
}

/** How numbers are written in a table. */
const DECIMALS = [["", "as the file shows"], ["point", "12.5, with a point"], ["comma", "12,5, with a comma"]];

/** What is known of the measurement beside the file. */
function statedForm(robot, frames) {
  const serial = el("input", { id: "stated-serial", type: "text", maxlength: 200, autocomplete: "off", placeholder: "on the type plate" });
  const pick = (id, options) => el("select", { id }, options.map(([value, words]) => el("option", { value }, words)));
  const [rotation, decimal] = [conventionChoice("stated-rotation"), pick("stated-decimal", DECIMALS)];
  // the board's frame is the instrument's
  const board = el("input", { id: "stated-board", type: "checkbox", change: () => { if (board.checked) { frames.querySelector("[value=instrument]").checked = true; frames.dispatchEvent(new Event("change")); } } });
  const field = (input, label) => el("div", {}, el("label", { for: input.id }, label), input);
  const why = "Read it off the type plate of the robot that was measured: this page does not know which one that was. With it a file of another robot is refused, and a release knows that it is the same one.";
  // a robot without a serial number has nothing to compare it with
  const asked = robot.serial_number ? el("div.fields.stated", {}, field(serial, "Serial number of the measured robot"), el("p.note", {}, why)) : el("p.note", {}, "This robot has no serial number yet: store it under Name, at the end of this page, so that a file of another robot is refused.");
  const node = el("div", {}, asked,
    el("details", {}, el("summary", {}, "How the file is written: rotations, decimal mark"), el("p.note", {}, "Angles are asked for where the table has rx, ry and rz of a 6D target. KUKA's C, B and A turn about the fixed x, y and z, too."), el("div.fields", {}, field(rotation, "Angles rx, ry, rz of a pose"), field(decimal, "Decimal mark of a table")), el("label.choice", {}, board, "A camera on the arm sees a fixed board: the file has the board's poses, with rotations")));
  const read = () => Object.fromEntries([["serial_number", serial.value.trim()], ["rotation", rotation.value], ["decimal", decimal.value], ["inverse_poses", board.checked ? "true" : ""]].filter(([, value]) => value !== ""));
  return { node, read };
}

/** When, by whom and with what the session was measured, for the report. */
function recordForm() {
  const at = el("input", { id: "record-measured-at", type: "datetime-local" });
  const texts = [["instrument_name", "Instrument: maker, model, serial number"], ["instrument_certificate", "Its certificate: number, valid until"], ["operator", "Measured by"]].map(([name, label]) => [name, label, el("input", { id: `record-${name}`, type: "text", maxlength: 200 })]);
  const field = (input, label) => el("div", {}, el("label", { for: input.id }, label), input);
  const node = el("details", {}, el("summary", {}, "For the quality record: when, with what and by whom it was measured"), el("p.note", {}, "The report prints it, and the figures over time stand at this time. Nothing is computed from it."),
    el("div.fields.low", {}, field(at, "Measured on"), texts.map(([, label, input]) => field(input, label))));
  const read = () => ({ ...at.value ? { measured_at: new Date(at.value).toISOString() } : {}, ...Object.fromEntries(texts.map(([name, , input]) => [name, input.value.trim()]).filter(([, text]) => text !== "")) });
  return { node, read };
}

/** What the instrument states; only where positions are in its own frame. */
function instrumentForm(robot, frames) {
  const number = (name, label) => [name, el("input", { id: `instrument-${name}`, type: "number", min: 0, step: "any" }), label];
  const noise = [number("range_std_mm", "Length, mm"), number("range_std_mm_per_m", "Length, mm per m"), number("angle_std_deg", "Each angle, degrees")];
  const levelled = el("input", { id: "instrument-levelled", type: "checkbox" });
  const [reference, referenceField] = referenceChoice(robot, "instrument-reference");
  const node = el("details", {}, el("summary", {}, "The instrument: noise, level, reference"),
    el("p.note", {}, "Standard uncertainties of a tracker at the origin of its frame. Every point then counts in each direction by what it is worth there."),
    el("div.fields", {}, noise.map(([, input, label]) => el("div", {}, el("label", { for: input.id }, label), input))),
    el("label.choice", {}, levelled, "It was levelled: gravity is −z of its frame"),
    el("div.fields", {}, referenceField));
  const isOwn = () => frames.querySelector("input:checked").value === "instrument";
  const show = () => { node.hidden = !isOwn(); };
  frames.addEventListener("change", show);
  show();
  const read = () => (isOwn() ? { ...Object.fromEntries(noise.filter(([, input]) => input.value !== "").map(([name, input]) => [name, input.value])), ...levelled.checked ? { instrument_levelled: true } : {}, ...reference.value !== "" ? { reference: reference.value } : {} } : {});
  return { node, read };
}

const TYPES = { json: "application/json", xlsx: "application/vnd.openxmlformats-officedocument.spreadsheetml.sheet", ods: "application/vnd.oasis.opendocument.spreadsheet" };

/** One file, sent as it is, so that what is stored has the checksum of the file. */
function single(file) {
  const extension = /\.(\w+)$/.exec(file.name)?.[1].toLowerCase();
  return { name: file.name, body: file, type: TYPES[extension] ?? "text/csv", isJson: extension === "json", text: file };
}

/** Two files in a form; their bytes stay as they are. The boundary is made from the files, so that the same files are the same upload. */
async function pair(robotFile, instrumentFile) {
  const boundary = `kincal-${await fingerprint(robotFile)}-${await fingerprint(instrumentFile)}`;
  const head = (part) => `--${boundary}\r\nContent-Disposition: form-data; name="${part}"\r\n\r\n`;
  const body = new Blob([head("robot"), robotFile, "\r\n", head("instrument"), instrumentFile, `\r\n--${boundary}--\r\n`]);
  return { name: robotFile.name, body, type: `multipart/form-data; boundary=${boundary}`, isJson: false, text: null, parts: 2 };
}

/** A number that differs between most files: their FNV-1a hash. */
async function fingerprint(file) {
  let hash = 0x811c9dc5;
  for (const byte of new Uint8Array(await file.arrayBuffer())) hash = Math.imul(hash ^ byte, 0x01000193);
  return `${file.size}-${(hash >>> 0).toString(16)}`;
}

/** Asks which of two files is the robot's. */
function twoFiles(context, [one, other], query, out) {
  const choose = (robot, instrument) => el("button", { type: "button", click: () => { out.focus(); uploadPair(context, [robot, instrument], {}, query, out); } }, robot.name);
  fill(out, el("div", {}, el("p", {}, "Which of the two has the robot's joint values? The other one is the instrument's."), el("div.actions", {}, choose(one, other), choose(other, one))));
}

/** Sends two files as one upload. */
async function uploadPair(context, [robotFile, instrumentFile], more, query, out) {
  fill(out, el("p.quiet", {}, `Reading ${robotFile.name} …`));
  try {
    await upload(context, { ...await pair(robotFile, instrumentFile), ...more }, query, out);
  } catch (error) {
    fill(out, problem(error));
  }
}

/** Sends what was chosen. */
async function upload(context, file, query, out, isTried = false) {
  const { robot, may, came } = context;
  const { isJson } = file;
  const name = file.name.replace(/\.\w+$/, "").slice(0, 200) || "set";
  fill(out, el("p.quiet", {}, `Checking ${file.name} …`));
  try {
    const stated = isJson ? { ...query, decimal: "" } : query;
    const path = `/v1/robots/${robot.id}/measurement-sets?${new URLSearchParams(Object.entries({ ...stated, columns: withStated(query.columns, file.stated), name }).filter(([, value]) => value !== ""))}`;
    const set = await post(path, file.body, file.type);
    say(`${set.n_points} points were understood`);
    fill(out, el("div.done", {}, el("strong", {}, set.name), `: ${set.n_points} points in ${set.n_configurations} configurations, ${set.n_targets === 1 ? "one target" : `${set.n_targets} targets`}.`),
      set.insisted_on && el("div.warning", {}, el("p", {}, el("strong", {}, "It was refused and kept because you insisted."), " No release will rest on it.")),
      set.warnings.map(warning), understoodDetails(set), posesOf(robot, set),
      may("identify") && jobForm(robot, [set], context));
    came(set);
  } catch (error) {
    if (!isJson && !isTried && isAboutColumns(error)) {
      const known = await saidBefore(robot, file.text === null);
      if (known) return upload(context, file, { ...query, columns: JSON.stringify(known) }, out, true);
    }
    // columns that were said do not fit this file: they are asked anew
    if (isTried && query.columns && !SUSPICIONS.includes(error.code) && !asksForChoice(error)) return upload(context, file, { ...query, columns: "" }, out, true);
    const text = isJson || !file.text ? "" : await textOf(file.text);
    const columns = el("div", {});
    const retry = ({ stated, sheets = file.sheets, ...more }) => () => {
      out.focus();
      if (more.frame) context.framed?.(more.frame);
      upload(context, { ...file, sheets, stated: withChoices(file.stated ?? {}, stated ?? {}) }, { ...query, ...more }, out, !stated && (isTried || Boolean(more.columns)));
    };
    const asPair = (sheets) => { out.focus(); uploadPair(context, [file.body, file.body], { stated: sheets }, { ...query, columns: "" }, out); };
    const isOneSheet = !file.parts && file.sheets?.length > 1 && sheetsIn(error.errors).sheets.length === 0;
    fill(out, refused(error, file, text), columns, remedies(error, { robot, file, query, retry, asPair }), isOneSheet && twoSheets(file.sheets, { asPair }));
    if (!isJson && isAboutColumns(error) && !asksForChoice(error)) {
      const read = (chosen) => retry({ columns: JSON.stringify(chosen) })();
      // the choice of the columns says what is missing; without a preview the refusal stays
      if (await askColumns(robot, file, query.decimal, columns, read).catch(() => false)) out.replaceChildren(...[columns, isOneSheet && twoSheets(file.sheets, { asPair })].filter(Boolean));
    }
  }
}

/** A mapping of columns with the sheet and the separator that were chosen. */
const withStated = (columns, stated) => (Object.keys(stated ?? {}).length > 0 ? JSON.stringify(withChoices(columns ? JSON.parse(columns) : {}, stated)) : columns ?? "");

/** The file as text, to show its faults in; none where it is not UTF-8, or has changed on the disk since it was chosen. */
async function textOf(file) {
  try {
    return new TextDecoder("utf-8", { fatal: true }).decode(await file.arrayBuffer());
  } catch {
    return "";
  }
}

/** Why nothing was stored: faults in rows as a table, what is wrong with the file as a whole as a sentence. */
function refused(error, file, text) {
  const errors = (error.errors ?? []).map((issue) => ({ ...issue, detail: inPageWords(issue.detail) }));
  const inPlaces = errors.some((issue) => issue.row !== undefined || issue.column || (issue.pointer && !/^\/(robot|instrument)$/.test(issue.pointer)));
  // none of several explanations that fit equally well is a heading
  const told = equallyGood(error.errors ?? []).length > 0 ? { ...error, code: undefined, title: "The points fit in more than one way" } : error;
  if (!inPlaces || told !== error) return problem({ ...told, errors: [], detail: errors.length > 0 ? `Nothing was stored: ${errors.map((issue) => plain(issue.detail)).join("; ")}.` : error.detail });
  return [problem({ ...error, errors: [], detail: `Nothing was stored. ${errors.length >= MOST_TOLD ? `The first ${errors.length} things` : count(errors.length)} to mend in ${file.name}:` }), faults(errors, text)];
}

/** The service tells no more faults of one file. */
const MOST_TOLD = 100;
const count = (n) => (n === 1 ? "One thing is" : `${n} things are`);

/** Every fault with the line of the file that it stands in. */
function faults(errors, text) {
  const separator = [";", "\t"].find((mark) => text.split(/\r?\n/, 1)[0].includes(mark)) ?? ",";
  const [header, ...rows] = rowsOf(text, separator);
  const value = (issue) => {
    const row = issue.line === undefined ? rows[issue.row] : rows.find((found) => found.line === issue.line);
    const cell = row?.cells[header.cells.indexOf(issue.column)];
    return cell === undefined ? "–" : el("code", {}, cell === "" ? "(empty)" : cell);
  };
  const columns = [
    ["Row", (issue) => (issue.row === undefined ? "–" : issue.row), "n"],
    ["Line in file", (issue) => issue.line ?? "–", "n"],
    ["Column", (issue) => issue.column ?? issue.pointer ?? "–"],
    ["Found", value, "wrong"],
    ["What is wrong", (issue) => capital(plain(issue.detail)), "name"],
  ];
  return table("Rows are counted from 0 without the header row.", columns, errors, "");
}
