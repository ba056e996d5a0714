// What mends a refused upload by one click: a choice that the file leaves open, or the reading that the service found to fit.

import { post } from "./api.js";
import { mappingOf, SEPARATORS } from "./columns.js";
import { el, fill, problem } from "./dom.js";
import { equallyGood, jointMapRemedy, MAP, mapIn } from "./joint_maps.js";
import { sheetChoice, sheetsIn } from "./sheets.js";
import { SUSPICIONS } from "./words.js";

/** Which of two files an issue is about: robot or instrument; undefined for the only file. */
const partOf = (issue) => /^\/(robot|instrument)\b/.exec(issue.pointer ?? "")?.[1];

/** What a mapping states of one file: of the only one, or of one of two. */
const stated = (part, said) => ({ stated: part ? { [part]: said } : said });

/** "the robot's file", or "the file". */
const fileOf = (part) => (part ? `the ${part}'s file` : "the file");

/** The separators that a refusal asks to choose from, and of which file: {separators, part}. */
function separatorsIn(errors) {
  const issue = (errors ?? []).find(({ detail }) => detail.includes('"separator": '));
  return { separators: [...new Set((issue?.detail.split("State it")[0].match(/"[^"]+"/g) ?? []).map((quoted) => JSON.parse(quoted)))], part: issue && partOf(issue) };
}

/** The refusal that does not tell which decimal mark a table has. */
const decimalIn = (errors) => (errors ?? []).find((issue) => /"decimal": "(comma|point)"/.test(issue.detail));

/** Whether a refusal is mended by one of a few buttons; what the columns are is asked afterwards. */
export const asksForChoice = ({ errors }) => sheetsIn(errors).sheets.length > 0 || separatorsIn(errors).separators.length > 0 || decimalIn(errors) !== undefined;

/** Units that a refusal names: its words, those of the button, and the unit of a column. */
const isJoint = ({ means }) => /^q\d+$/.test(means);
const isAxis = ({ means }) => /^[xyz]$/.test(means);
const UNITS = [[/joint values are radians/, "the joints as radians", isJoint, "rad"], [/joint values are degrees/, "the joints as degrees", isJoint, "deg"], [/positions are metres/, "the positions as metres", isAxis, "m"], [/positions are millimetres/, "the positions as millimetres", isAxis, "mm"], [/positions are inches/, "the positions as inches", isAxis, "in"]];

/** The reading of the columns that fits, as a refusal names it: {words, change}, `change` of a column; undefined where it names none. */
function readingIn(detail) {
  const supposed = /; if (.*?), it fits to /s.exec(detail)?.[1] ?? "";
  const units = UNITS.filter(([said]) => said.test(supposed));
  if (units.length > 0) return { words: units.map(([, words]) => words).join(", "), change: (column) => ({ ...column, unit: units.find(([, , is]) => is(column))?.[3] ?? column.unit }) };
  const axes = /stand in the columns named ([xyz]), ([xyz]), ([xyz])/.exec(supposed)?.slice(1);
  if (axes) return { words: `x, y and z in the columns named ${axes.join(", ")}`, change: (column) => (isAxis(column) ? { ...column, means: "xyz"[axes.indexOf(column.means)] } : column) };
  const joints = /columns of joints (\d+) and (\d+) are exchanged/.exec(supposed)?.slice(1).map((joint) => `q${joint}`);
  const other = (means) => (joints.includes(means) ? joints[1 - joints.indexOf(means)] : means);
  return joints && { words: `with the columns of ${joints.join(" and ")} exchanged`, change: (column) => ({ ...column, means: other(column.means) }) };
}

/** The text of a refusal in words for a page: what stands below as a button is not repeated as text for programs. */
export const inPageWords = (detail) => detail.replace(MAP, "the robot's joint map is the one below").replace(/ To keep (?:it|them) all the same, insist on \w+(?:: no release then rests on it)?/, "").replace("rotation=", "").replace(": say so, or write them as stated", "").replace(/ Say inverse_poses=true \([^)]*\) with frame=instrument, or invert them/, " Invert them by the button below").replace(" (inverse_poses=true)", "").replace(/\.$/, "");

/** Reads the file once more with its columns changed. */
async function readAs({ change }, context, out) {
  const { robot, file, query, retry } = context;
  try {
    const asked = new URLSearchParams(Object.entries({ columns: query.columns ?? "", decimal: query.decimal ?? "" }).filter(([, value]) => value));
    const { files } = await post(`/v1/robots/${robot.id}/measurement-sets/preview?${asked}`, file.body, file.type);
    const read = Object.fromEntries(files.map(({ part, understood }) => [part, mappingOf(understood, change)]));
    const { join } = query.columns?.startsWith("{") ? JSON.parse(query.columns) : {};
    retry({ columns: JSON.stringify(read.table ?? { ...read, join }) })();
  } catch (error) {
    fill(out, problem(error));
  }
}

/** Remedies that one click applies to a refused upload. A JSON file states its frame and its units itself. `context` is {robot, file, query, retry, asPair}. */
export function remedies({ code, errors }, context) {
  const { retry, file: { isJson } } = context;
  const issues = errors ?? [];
  const choose = (question, choices) => el("div", {}, el("p", {}, question), el("div.actions", {}, choices.map(([words, more]) => el("button", { type: "button", click: retry(more) }, words))));
  const asked = sheetsIn(errors);
  if (asked.sheets.length > 0 && !isJson) return sheetChoice(asked, context);
  const { separators, part } = separatorsIn(errors);
  if (separators.length > 0 && !isJson) return choose(`What stands between the columns of ${fileOf(part)}?`, separators.map((separator) => [SEPARATORS[separator] ?? separator, stated(part, { separator })]));
  const decimal = decimalIn(errors);
  if (decimal && !isJson) return choose(`Which decimal mark has ${fileOf(partOf(decimal))}?`, [["A comma: 12,5", "comma"], ["A point: 12.5", "point"]].map(([words, mark]) => [words, partOf(decimal) ? stated(partOf(decimal), { decimal: mark }) : { decimal: mark }]));
  const texts = issues.map(({ detail }) => detail);
  const convention = texts.map((text) => /Read as (?:rotation=)?(rotation_vector|\w+_[xyz]{3}) /.exec(text) ?? /(?:^|[^\w])(rotation_vector|\w+_[xyz]{3}) fits this robot best/.exec(text)).find(Boolean)?.[1];
  const isBoard = texts.some((text) => text.includes("inverse_poses=true"));
  const poses = [convention && el("button.primary", { type: "button", click: retry({ rotation: convention }) }, `Read the angles as ${convention}`), isBoard && el(convention ? "button" : "button.primary", { type: "button", click: retry({ inverse_poses: true, frame: "instrument" }) }, "A camera on the arm sees a fixed board: invert the poses")];
  if (!SUSPICIONS.includes(code)) return poses.some(Boolean) ? el("div.actions", {}, poses) : [];
  const out = el("div", {});
  const reading = isJson ? undefined : texts.map(readingIn).find(Boolean);
  const map = mapIn(issues);
  const mapped = map && jointMapRemedy(map, issues, { isFirst: !reading && code !== "frame_suspect", out, context });
  // of several explanations that fit equally well none is the main one
  const first = equallyGood(issues).length > 0 ? "button" : "button.primary";
  return el("div", {}, mapped?.node, out, el("div.actions", {},
    code === "frame_suspect" && !isJson && el(first, { type: "button", click: retry({ frame: "instrument" }) }, "Read it in the instrument's frame"),
    reading && el(first, { type: "button", click: () => readAs(reading, context, out) }, `Read ${reading.words}`),
    mapped?.place, poses,
    el("button", { type: "button", click: retry({ insist: code }) }, "Keep it all the same: no release will rest on it")));
}
