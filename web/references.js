// References of a robot's instruments: a scale bar or other lengths with a certificate, and what the instrument measured of them.

import { list, post } from "./api.js";
import { el, fill, table } from "./dom.js";
import { fixed, when } from "./format.js";

/** Most references that are listed. */
const SHOWN = 200;

/** A robot's references, of each name the newest. */
export const referencesOf = (id, signal) => list(`/v1/robots/${id}/references`, SHOWN, signal);

/** The scale that a reference gives its instrument. */
const scale = ({ scale_error_ppm: error, scale_std_ppm: std }) => `${fixed(error, 1)} ± ${std.toFixed(1)}`;

/** The list. */
export const referenceTable = (references) => table("References, newest first: lengths with a certificate, as the instrument measured them. Scale: by how much it measures too long, in µm per m, with its standard uncertainty.", [
  ["Name", (r) => [r.name, r.version > 1 && el("small.quiet", {}, `version ${r.version}`)], "name"], ["Instrument", (r) => r.instrument ?? "–"],
  ["Lengths, nominal and measured, mm", (r) => r.items.map((item) => el("div", {}, `${item.name}: ${item.nominal_mm} and ${item.measured_mm} ± ${item.std_mm}`))],
  ["Scale, ppm", scale, "n"], ["Scale is", (r) => (r.is_off ? el("span.badge.bad", {}, "off by more than twice that") : el("span.badge.good", {}, "in order"))], ["Stored", (r) => when(r.created_at)]], references, "No reference is stored.");

/** The form: `stored` frames its fields and button, `changed` is called with what was stored. */
export function referenceForm(robot, stored, changed) {
  const name = el("input", { id: "reference-name", required: true, maxlength: 200 });
  const instrument = el("input", { id: "reference-instrument", maxlength: 500, placeholder: "maker, model, certificate" });
  const rows = el("div", {});
  const add = () => {
    const field = (what, words, more) => el("input", { "data-of": what, "aria-label": words, placeholder: words, required: true, ...more });
    const length = (what, words) => field(what, words, { type: "number", step: "any", min: 0 });
    const row = el("div.controls.length", {}, field("name", "Name of the length", { maxlength: 200 }), length("nominal_mm", "Nominal, mm"), length("measured_mm", "Measured, mm"), length("std_mm", "± std, mm"),
      el("button.plain", { type: "button", click: () => { if (rows.children.length > 1) row.remove(); } }, "Remove"));
    rows.append(row);
    return row;
  };
  add();
  const value = (input) => (input.type === "number" ? Number(input.value) : input.value.trim());
  const items = () => [...rows.children].map((row) => Object.fromEntries([...row.querySelectorAll("input")].map((input) => [input.dataset.of, value(input)])));
  const body = () => ({ name: name.value.trim(), items: items(), ...instrument.value.trim() === "" ? {} : { instrument: instrument.value.trim() } });
  const lengths = el("div", {}, el("p.note", {}, "Each length: what its certificate says, what the instrument measured, and the standard uncertainty of their difference (certificate and measurement together). A reference of the same name replaces the earlier one for later uploads."), rows,
    el("button", { type: "button", click: () => add().querySelector("input").focus() }, "Another length"));
  return stored("Store a reference", [el("div", {}, el("label", { for: name.id }, "Name"), name), el("div", {}, el("label", { for: instrument.id }, "Instrument and its certificate"), instrument)],
    async () => changed(await post(`/v1/robots/${robot.id}/references`, body())), lengths);
}

/** A choice of the stored references, with a way to the page that stores one. */
export function referenceChoice(robot, id) {
  const select = el("select", { id }, el("option", { value: "" }, "none"));
  referencesOf(robot.id).then((all) => { for (const r of all) select.append(el("option", { value: r.name }, `${r.name}: ${scale(r)} ppm${r.is_off ? ", off" : ""}`)); }, () => { /* an upload goes without */ });
  const node = el("div", {}, el("label", { for: id }, "Its reference (a scale bar that it measured)"), select,
    el("p.note", {}, el("a", { href: `#/robots/${robot.id}/correct?cell=open` }, "Store a reference, or look at those that there are")));
  return [select, node];
}
