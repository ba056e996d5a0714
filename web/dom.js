// Elements from data. Text always becomes a text node, so that no name can become markup.

import { capital, plain, warningTitle } from "./format.js";
import { MATTERS, REMEDIES, WARNINGS } from "./words.js";

const SVG = "http://www.w3.org/2000/svg";

/** An HTML element: el("a.button", {href: "#/"}, "text", child…). Functions among the attributes are listeners. */
export function el(what, attributes = {}, ...children) {
  const [tag, ...classes] = what.split(".");
  return filled(document.createElement(tag), classes, attributes, children);
}

/** An SVG element, likewise. */
export function svg(what, attributes = {}, ...children) {
  const [tag, ...classes] = what.split(".");
  return filled(document.createElementNS(SVG, tag), classes, attributes, children);
}

function filled(node, classes, attributes, children) {
  if (classes.length > 0) node.setAttribute("class", classes.join(" "));
  for (const [name, value] of Object.entries(attributes)) {
    if (value === undefined || value === null || value === false) continue;
    if (typeof value === "function") node.addEventListener(name, value);
    else node.setAttribute(name, value === true ? "" : String(value));
  }
  if (node.type === "number") takeCommas(node);
  append(node, children);
  return node;
}

/** A number field drops a comma, and 0,02 becomes 002: a comma that is typed or pasted is written as a point. */
function takeCommas(field) {
  const write = (event, text) => { event.preventDefault(); document.execCommand("insertText", false, text); };
  field.addEventListener("keydown", (event) => { if (event.key === "," && !event.ctrlKey && !event.metaKey) write(event, "."); });
  field.addEventListener("paste", (event) => {
    const text = event.clipboardData?.getData("text/plain").trim() ?? "";
    if (/^[-+]?\d*,\d+$/.test(text)) write(event, text.replace(",", "."));
  });
}

function append(node, children) {
  for (const child of children.flat(Infinity)) {
    if (child === undefined || child === null || child === false) continue;
    node.append(child instanceof Node ? child : document.createTextNode(String(child)));
  }
}

/** Draws a part of the page anew, and gives the focus back to the link or button that had it. */
export function withFocus(part, draw) {
  const had = document.activeElement;
  const isInside = part.contains(had);
  const key = (node) => node.getAttribute("href") ?? node.innerText;
  const name = isInside && key(had);
  draw();
  if (isInside && !document.contains(had)) [...part.querySelectorAll("a, button")].find((node) => key(node) === name)?.focus({ preventScroll: true });
}

/** Draws more rows of a table, and goes to the first of them. */
export async function drawMore(part, draw) {
  const before = part.querySelectorAll("tbody tr").length;
  await draw();
  part.querySelectorAll("tbody tr")[before]?.querySelector("a, button")?.focus();
}

/** Puts these children in place of those that are there. */
export function fill(node, ...children) {
  node.replaceChildren();
  append(node, children);
  return node;
}

/** A table: columns are [heading, cell of a row, class?]. Wide tables scroll inside a region of their own. */
export function table(caption, columns, rows, empty) {
  if (rows.length === 0) return el("p.empty", {}, empty);
  const head = el("tr", {}, columns.map(([heading, , kind]) => el(kind ? `th.${kind}` : "th", { scope: "col" }, heading)));
  // on a phone a table with names shows each row as a list; the heading of each cell stands before it
  const isStacked = columns.some(([, , kind]) => kind === "name");
  const body = rows.map((row) => el("tr", {}, columns.map(([heading, cell, kind]) => {
    const content = cell(row);
    return el(["td", kind, isStacked && content === "–" && "none"].filter(Boolean).join("."), isStacked ? { "data-label": heading } : {}, content);
  })));
  return [el("p.caption", {}, caption), el("div.scroll", { tabindex: 0, role: "region", "aria-label": caption },
    el(isStacked ? "table.stacked" : "table", { "aria-label": caption }, el("thead", {}, head), el("tbody", {}, body)))];
}

/** Shows a notice, which screen readers also read out. */
export function say(text) {
  const place = document.getElementById("said");
  fill(place, text);
  clearTimeout(saying);
  saying = setTimeout(() => fill(place), SAID_MS);
}

/** Time for which a notice is visible. */
const SAID_MS = 6_000;
let saying;

/** A problem as the service tells it: its sentence, and every single reason. */
export function problem(error) {
  const reasons = (error.errors ?? []).filter((issue) => !String(error.detail ?? "").endsWith(issue.detail)).map((issue) => el("li", {}, capital(plain(issue.detail))));
  return el("div.problem", { role: "alert" }, el("p", {}, el("strong", {}, WARNINGS[error.code] ?? error.title ?? "It did not work"), ". ", plain(error.detail ?? String(error.message ?? error))),
    reasons.length > 0 && el("ul", {}, reasons));
}

/** A sentence with long lists of names cut, and the whole sentence below it, folded. */
export function brief(whole) {
  const text = capital(plain(whole));
  const short = text.replace(LONG_LIST, (list) => {
    const names = list.split(", ");
    return `${names.slice(0, MAX_NAMES).join(", ")} and ${names.length - MAX_NAMES} more`;
  });
  return short === text ? [text, false] : [short, el("details", {}, el("summary", {}, "In full"), el("p.note", {}, `${capital(text)}.`))];
}

/** Longest list of names that is not cut. */
const MAX_NAMES = 6;
const LONG_LIST = /\w+(?:, \w+){6,}/g;

/** A warning: what, why it matters, what to do; its details and rows are folded below, where they are long. */
export function warning({ code, detail, rows = [], points = [] }) {
  const some = (all) => all.slice(0, MAX_ROWS).join(", ") + (all.length > MAX_ROWS ? ` and ${all.length - MAX_ROWS} more` : "");
  const [matters, remedy] = [MATTERS[code], REMEDIES[code]];
  // the name of a point is found in the file, also where two files were joined
  const which = points.length > 0 ? ` (${some(points)})` : rows.length > 0 && !/\brows? \d/.test(detail) ? ` (rows ${some(rows)} of the file)` : "";
  const whole = `${capital(plain(detail))}${which}.`.replace(/\.\.$/, ".");
  const details = matters && whole.length > SHORT_DETAIL ? el("details", {}, el("summary", {}, "In this file"), el("p.note", {}, whole)) : el("p", {}, whole);
  return el("div.warning", {}, el("p", {}, el("strong", {}, warningTitle(code), ". "), matters && `${matters} `, remedy && el("span.remedy", {}, remedy)), details);
}

/** A longer detail is folded: the three sentences above it are what counts. */
const SHORT_DETAIL = 140;
/** Most rows that are named; further rows are counted. */
const MAX_ROWS = 12;
