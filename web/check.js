// The answer of a quick check, in plain words: does the released set still hold, what could these poses have seen, what to measure next.

import { el, table } from "./dom.js";
import { mm, number, parameter, plain } from "./format.js";

const VERDICTS = {
  holds: ["div.done", "The released set still holds."],
  changed: ["div.problem", "The robot, its base or its tool has changed: the released set no longer holds."],
  cannot_tell: ["div.warning", "These poses cannot tell whether the released set holds."],
};
const AFTER = { collision: "after a collision", mastering: "after a mastering", motor: "after a motor was exchanged" };

/** The name of what may change, as people say it. */
function thing(name) {
  if (name === "base") return "Base, shifted";
  const target = /^target_(\d+)$/.exec(name);
  if (target) return `Reflector ${target[1]}, shifted`;
  const zero = /^theta_offset_(\d+)$/.exec(name);
  return zero ? `Zero of joint ${zero[1]}` : parameter(name);
}

const withUnit = (value, unit) => (unit === "deg" ? `${number(value)}°` : mm(value));

/** The verdict, at the top of the page. */
export function checkVerdict({ check }) {
  const [box, said] = VERDICTS[check.verdict] ?? ["div.warning", check.verdict];
  const before = AFTER[check.after] ? ` Checked ${AFTER[check.after]}.` : "";
  return el(box, check.verdict === "changed" ? { role: "alert" } : {}, el("p", {}, el("strong", {}, said), ` ${plain(check.reason)}.${before}`), el("p", {}, el("strong", {}, "Next: "), `${plain(check.next)}.`));
}

/** What the poses could have seen, and the figures of the test. */
export function checkTables({ check }) {
  const seen = check.detectable.length > 0 && table(`The smallest change of each kind, alone, that these poses find in ${Math.round(100 * check.power)} of 100 cases. One of ${Math.round(1 / check.level)} unchanged robots is called changed.`, [
    ["What", (row) => thing(row.name)], ["Smallest change", (row) => (row.change === null ? "not seen by these poses" : withUnit(row.change, row.unit))],
    ["Moves the tool by", (row) => (row.tool_mm === null ? "" : mm(row.tool_mm))]], check.detectable, "");
  const test = check.test && el("p.note", {}, `The poses have ${mm(check.rms_mm)} rms${check.verified_rms_mm == null ? "" : `, ${mm(check.verified_rms_mm)} when the set was verified`}; an unchanged robot is expected to show ${mm(check.test.expected_rms_mm)}. Sum of squares ${number(check.test.statistic)} of ${check.test.n_combinations} combinations; probability ${check.test.probability < 1e-6 ? "below 0.000001" : number(check.test.probability)}.`);
  return (seen || test) && el("section.card", {}, el("h2", {}, "What this check could have seen"), test, seen);
}
