// Numbers, times and the service's codes as people read them.

import { CORRECTIONS, GATES, METHODS, REMARKED, UNMET, WARNINGS } from "./words.js";

const MINUS = "\u2212";
const THIN = "\u202f";

/** About three significant digits; very small and very large ones as powers of ten. */
export function number(value, digits = 3) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  if (size === 0) return "0";
  if (size < 1e-3 || size >= 1e6) return power(value);
  const decimals = Math.max(0, Math.min(6, digits - 1 - Math.floor(Math.log10(size))));
  return value.toFixed(decimals).replace("-", MINUS);
}

function power(value) {
  const [mantissa, exponent] = value.toExponential(1).split("e");
  return `${mantissa}·10${superscript(Number(exponent))}`.replace("-", MINUS);
}

/** 10 to a whole power. */
export function powerOfTen(exponent) {
  return `10${superscript(exponent)}`;
}

function superscript(exponent) {
  return String(exponent).replace(/./g, (c) => (c === "-" ? "⁻" : "⁰¹²³⁴⁵⁶⁷⁸⁹"[Number(c)]));
}

/** Smallest error that is shown as a number, mm: no instrument resolves a tenth of a micrometre. */
export const SMALLEST_MM = 1e-4;

/** A number of things, with separated thousands. */
export const count = (n) => n.toLocaleString("en-GB");

/** A position error, in mm. */
export function error(value) {
  if (value === null || value === undefined) return "–";
  return value >= 0 && value < SMALLEST_MM ? `<${SMALLEST_MM.toFixed(4)}` : number(value);
}

/** Likewise with its unit. */
export const mm = (value) => (value === null || value === undefined ? "–" : `${error(value)}${THIN}mm`);

/** With a sign and a fixed number of decimals, for columns. */
export function signed(value, decimals = 4) {
  if (value === null || value === undefined) return "–";
  const text = Math.abs(value).toFixed(decimals);
  return (Number(text) === 0 ? "" : value < 0 ? MINUS : "+") + text;
}

/** A value, not a change: a sign only below zero. */
export const fixed = (value, decimals = 4) => signed(value, decimals).replace("+", "");

/** When a session was measured, and how that is known. */
export const measuredAt = (record) => `measured ${when(record.measured_at)}${record.measured_at_of_points ? ", by the times of its points" : ""}`;

/** A session of a job, by the time at which it was measured or, where its upload does not say it, computed. */
export const sessionOf = ({ job, report }) => `session of ${when(report.measured_at ?? job.created_at)}`;

/** A local date. */
export const day = (text) => new Date(text).toLocaleDateString("en-GB", { year: "numeric", month: "short", day: "numeric" });

/** A local date and time. */
export function when(text) {
  if (!text) return "–";
  return new Date(text).toLocaleString("en-GB", { year: "numeric", month: "short", day: "numeric", hour: "2-digit", minute: "2-digit" });
}

/** Time since an instant. */
export function age(text) {
  if (!text) return "–";
  const seconds = (Date.now() - new Date(text)) / 1000;
  if (seconds < 60) return "just now";
  return `${span(seconds)} ago`;
}

/** A duration in its largest unit that makes sense. */
export function span(seconds) {
  const units = [["d", 86400], ["h", 3600], ["min", 60]];
  for (const [unit, size] of units) if (seconds >= 1.5 * size) return `${Math.round(seconds / size)}${THIN}${unit}`;
  if (seconds < 1) return `${Math.max(1, Math.round(1000 * seconds))}${THIN}ms`;
  return seconds < 10 ? `${seconds.toFixed(1)}${THIN}s` : `${Math.round(seconds)}${THIN}s`;
}

/** Duration of a job; null until it has ended. */
export const ran = ({ started_at: from, finished_at: to }) => (from && to ? (new Date(to) - new Date(from)) / 1000 : null);

export const method = (name) => METHODS[name] ?? name.replaceAll("_", " ");

/** A small probability as people say it. */
export function chance(probability) {
  if (probability < 1e-6) return "less than 1 in a million";
  return probability < 0.01 ? `1 in ${count(Number((1 / probability).toPrecision(2)))}` : number(probability, 2);
}

const KINDS = { a: "a", alpha: "α", d: "d", theta_offset: "θ", beta: "β" };
/** `theta_offset_3` as θ₃, `base_rx` as "base, turned about x". Where positions cannot tell which one moved there are several. */
export function parameter(name) {
  if (name.includes(" or ")) return name.split(" or ").map(parameter).join(" or ");
  const found = /^(a|alpha|d|theta_offset|beta)_(\d+)$/.exec(name);
  const turned = /^base_r([xyz])$/.exec(name);
  if (turned) return `base, turned about ${turned[1]}`;
  const target = /^target_(\d+)(?:_([xyz]))?$/.exec(name);
  if (target) return `reflector ${target[1]}${target[2] ? `, ${target[2]}` : ""}`;
  if (!found) return name.replaceAll("_", " ");
  return KINDS[found[1]] + found[2].replace(/\d/g, (c) => "₀₁₂₃₄₅₆₇₈₉"[Number(c)]);
}

export const EVIDENCE = {
  none: ["no evidence", "No held-out points count as evidence: these errors prove nothing."],
  same_upload: ["same upload", "Checked on points that were not fitted, but measured in the same session: a wrong tool, base or scale would not show."],
  independent_session: ["independent session", "Checked on points of another measuring session: the strongest evidence there is here, for or against the set."],
};

export const warningTitle = (code) => WARNINGS[code] ?? sentence(code);
/** What a gate found, as a title: where it refuses, where it passed with a remark, and otherwise. */
export const gateTitle = ({ gate, passed, warning }) => (passed ? warning && REMARKED[gate] : UNMET[gate]) || (GATES[gate] ?? sentence(gate));
/** What a gate found. The code that some begin with is said by the rest of the sentence. */
export const gateDetail = (detail) => plain(detail.replace(/^(\w+): /, (all, code) => (EVIDENCE[code] ? "" : all)));
export const correctionTitle = (kind) => CORRECTIONS[kind] ?? sentence(kind);

/** A mapping of columns in a sentence. The page has choices for it instead, below the sentence. */
const MAPPING = / in the column mapping: \{(?:"(?:[^"\\]|\\.)*"|[^{}"]|\{(?:"(?:[^"\\]|\\.)*"|[^{}"])*\})*\}(?: \(or [^)]*\))?/gu;

/** The unit of a parameter: ° for angles. */
export const unitOf = (name) => (/^(alpha|theta_offset|beta)_|^base_r[xyz]/.test(name) ? "°" : "mm");

/** Names of parameters in a sentence of the service. */
const PARAMETERS = /\b(?:(?:alpha|theta_offset|beta)_\d+|[ad]_\d+|base_r?[xyz]|target_\d+(?:_[xyz])?)\b/g;
/** Words that only programs need, and those that people say. */
const FOR_PEOPLE = [
  [/min_mm is the lowest corner and max_mm the highest/g, "each number \"from\" has to be below its number \"to\""],
  [/ \(flange_rotation_std_deg\)|: flange_rotation_std_deg/g, ""],
  [/\/keep_out\/(\d+): ?/g, (_, i) => `Box ${Number(i) + 1}: `], [/\/set_ups\/(\d+): ?/g, (_, i) => `Place ${Number(i) + 1}: `], [/\bmin_mm\b/g, "from"], [/\bmax_mm\b/g, "to"], [/\bchange_reason\b/g, "a reason for the change"],
  [/\bserial_number\b/g, "serial number"], [/\bjoint_map\b/g, "joint map"], [/\bjoint_limits_deg\b/g, "joint limits"], [/\bsame_upload\b/g, "same upload"], [/\bindependent_session\b/g, "independent session"], [/\bcheck_robot\b/g, "check this robot"],
  [/`/g, ""]];

/** A sentence of the service, without what only programs need. */
export const plain = (text) => FOR_PEOPLE.reduce((said, [word, words]) => said.replace(word, words), String(text).replace(MAPPING, " below").replace(PARAMETERS, parameter)).replace(/([?!])\.$/, "$1");

/** What an instrument states of its noise and its level. */
export function instrument({ range_std_mm: range, range_std_mm_per_m: perMetre, angle_std_deg: angle, levelled }) {
  return [range !== undefined && `length ± ${range} mm${perMetre ? ` ± ${perMetre} mm per m` : ""}`, angle !== undefined && `angles ± ${angle}°`, levelled && "levelled"].filter(Boolean).join(", ");
}

/** With a capital letter, as a sentence begins. */
export const capital = (text) => text.charAt(0).toUpperCase() + text.slice(1);

/** `no_verify_points` as a sentence's beginning. */
export function sentence(code) {
  return capital(code.replaceAll("_", " "));
}
