// Which sheet of a workbook has what: one of them, one for each of two files, or two sheets of one workbook as the robot's and the instrument's file.

import { el } from "./dom.js";

/** The sheets that a refusal asks to choose from, and of which file: {sheets, part}; no sheets where it asks for something else. */
export function sheetsIn(errors) {
  const issue = (errors ?? []).find(({ detail }) => detail?.includes("sheets of the workbook have cells"));
  const sheets = (issue?.detail.split(": name one")[0].match(/"(?:[^"\\]|\\.)*"/g) ?? []).map((quoted) => JSON.parse(quoted.replace(/\\'/g, "'")));
  return { sheets, part: /^\/(robot|instrument)\b/.exec(issue?.pointer ?? "")?.[1] };
}

const QUESTIONS = { robot: "Which sheet has the robot's joint values?", instrument: "Which sheet has the instrument's positions?", undefined: "Which sheet has the measured points?" };

/** The question for a sheet of one file. `context` is {file, retry, asPair}. */
export function sheetChoice({ sheets, part }, context) {
  const { file, retry } = context;
  const chosen = (sheet) => retry({ stated: part ? { [part]: { sheet } } : { sheet }, sheets });
  const other = el("input", { id: "other-sheet", type: "text", maxlength: 200 });
  const read = () => { if (other.value.trim() !== "") chosen(other.value.trim())(); };
  return [el("div", {}, el("p", {}, QUESTIONS[part]), el("div.actions", {}, sheets.map((sheet) => el("button", { type: "button", click: chosen(sheet) }, sheet)))),
    el("div.controls", {}, el("label", { for: other.id }, "Or another one"), other, el("button", { type: "button", click: read }, "Read this sheet")), !file.parts && twoSheets(sheets, context)];
}

/** Names by which a sheet of joint values is proposed. */
const OF_ROBOT = /robot|joint|axis|axes|achse|gelenk|controller/i;

/** One workbook as both files: a sheet for each. */
export function twoSheets(sheets, { asPair }) {
  const robot = sheets.find((name) => OF_ROBOT.test(name)) ?? sheets[0];
  const list = el("datalist", { id: "sheet-names" }, sheets.map((name) => el("option", { value: name })));
  const field = (id, label, value) => { const input = el("input", { id, type: "text", maxlength: 200, list: list.id, value, required: true }); return [input, el("div", {}, el("label", { for: id }, label), input)]; };
  const [[joints, jointsField], [positions, positionsField]] = [field("sheet-robot", "The robot's joint values are on", robot), field("sheet-instrument", "The instrument's positions are on", sheets.find((name) => name !== robot) ?? "")];
  const submit = (event) => {
    event.preventDefault();
    asPair({ robot: { sheet: joints.value.trim() }, instrument: { sheet: positions.value.trim() } });
  };
  return el("form", { submit }, el("p", {}, "Or the robot's and the instrument's values stand on two sheets:"), el("div.fields", {}, jointsField, positionsField), list, el("div.actions", {}, el("button", { type: "submit" }, "Read the two sheets together")));
}
