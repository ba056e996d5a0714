// The answer of a quick check, in plain words: does the released set still hold, what could these poses have seen, what to measure next.

import { el, table } from "./dom.js";
import { capital, chance, mm, number, parameter, plain, sentence, signed } from "./format.js";

const VERDICTS = {
  holds: ["div.done", "The released set still holds."],
  changed: ["div.problem", "The robot, its base or its tool has changed: the released set no longer holds."],
  cannot_tell: ["div.warning", "These poses cannot tell whether the released set holds."],
};
const AFTER = { collision: "after a collision", mastering: "after a mastering", motor: "after a motor was exchanged" };

/** The name of what may change, as people say it. Where the poses cannot tell which of several it is, all are named. */
function thing(name) {
  if (name.includes(" or ")) return name.split(" or ").map(thing).map((said, i) => (i === 0 ? said : said.replace(/^./, (c) => c.toLowerCase()))).join(" or ");
  if (name === "base") return "Base, shifted";
  const target = /^target_(\d+)$/.exec(name);
  if (target) return `Reflector ${target[1]}, shifted`;
  const zero = /^theta_offset_(\d+)$/.exec(name);
  return zero ? `Zero of joint ${zero[1]}` : capital(parameter(name));
}

const withUnit = (value, unit) => (unit === "deg" ? `${number(value)}°` : mm(value));

/** Causes that are named. */
const MAX_CAUSES = 3;

/** The verdict, at the top of the page: what was found, by how much, and the likeliest causes; then what to do, with the buttons for it. `set` is the parameter set that was checked. */
export function checkVerdict({ check }, { robot, set, may }) {
  const [box, said] = VERDICTS[check.verdict] ?? ["div.warning", sentence(check.verdict)];
  const by = `${AFTER[check.after] ? `Checked ${AFTER[check.after]}: the` : "The"} set misses these ${check.n_configurations} poses by ${mm(check.rms_mm)} rms${check.verified_rms_mm == null ? "" : `; when it was verified, it missed by ${mm(check.verified_rms_mm)}`}.`;
  const link = (kind, href, words) => el(kind, { href }, words);
  const n = /\b(\d+) poses\b/.exec(check.next)?.[1];
  const hasChanged = check.verdict === "changed";
  return el(box, hasChanged ? { role: "alert" } : {}, el("p", {}, el("strong", {}, said), ` ${by} `, hasChanged ? causes(check.likeliest) : doubt(check)), el("p", {}, el("strong", {}, "Next: "), `${plain(check.next)}.`),
    el("div.actions", {}, n && link("a.button.primary", `#/robots/${robot.id}/plan?n=${n}`, `Plan ${n} poses`), hasChanged && set?.status === "released" && may("release") && link("a.button", `#/jobs/${set.job_id}`, "Withdraw")));
}

/** The causes that explain the change best. */
function causes(likeliest) {
  const named = likeliest.slice(0, MAX_CAUSES).map(({ name, delta, unit }) => `${thing(name).replace(/^[A-Z](?=[a-z])/, (c) => c.toLowerCase())} by ${signed(delta, unit === "deg" ? 4 : 3)}${unit === "deg" ? "°" : " mm"}`);
  return named.length === 0 ? "" : `${named.length === 1 ? "The likeliest cause" : "The likeliest causes together"}: ${named.join("; ")}.`;
}

/** Why the poses cannot tell, without the figures that stand before it. */
const doubt = ({ verdict, reason }) => (verdict !== "cannot_tell" ? "" : `${capital(plain(reason).replace(/^it cannot be told whether the released set holds: /, "").replace(/(?: \(|: )[\d.]+ mm rms on the points.*$/, ""))}.`);

/** What the poses could have seen, and the figures of the test. */
export function checkTables({ check }) {
  const seen = check.detectable.length > 0 && table(`The smallest change of each kind, alone, that these poses find in ${Math.round(100 * check.power)} of 100 cases. One of ${Math.round(1 / check.level)} unchanged robots is called changed.`, [
    ["What", (row) => thing(row.name)], ["Smallest change", (row) => (row.change === null ? "not seen by these poses" : withUnit(row.change, row.unit))],
    ["Moves the tool by", (row) => (row.tool_mm === null ? "" : mm(row.tool_mm))]], check.detectable, "");
  const test = check.test && el("p.note", {}, `The poses have ${mm(check.rms_mm)} rms${check.verified_rms_mm == null ? "" : `, ${mm(check.verified_rms_mm)} when the set was verified`}; an unchanged robot is expected to show ${mm(check.test.expected_rms_mm)}. Sum of squares ${number(check.test.statistic)} of ${check.test.n_combinations} combinations; an unchanged robot shows as much with probability ${chance(check.test.probability)}.`);
  return (seen || test) && el("section.card", {}, el("h2", {}, "What this check could have seen"), test, seen);
}
