// A robot from its file: kincal's JSON, a URDF, or a table of its links. What a file leaves open is asked, and never assumed.

import { post } from "./api.js";
import { el, fill } from "./dom.js";
import { mm } from "./format.js";

/** Conventions of a table of links. None of them is chosen beforehand. */
const CONVENTIONS = [["", "choose one"], ["mdh", "modified (Craig)"], ["dh", "standard (distal)"]];

/** Differences below this are rounding, mm. */
const NOTHING_MM = 1e-6;

/** The form. `show` is called with a robot and what is to be said of its file, `failed` with an error, `waits` with what is still to be said. */
export function fileForm({ show, failed, waits }) {
  const file = el("input", { id: "robot-file", type: "file", accept: ".json,.urdf,.xml,.csv,application/json,application/xml,text/csv" });
  const convention = el("select", { id: "robot-convention" }, CONVENTIONS.map(([value, words]) => el("option", { value }, words)));
  const asked = el("div", { hidden: true }, el("label", { for: convention.id }, "Convention of the table"), convention, el("p.note", {}, "The table does not say it; its author or the maker's drawing does. With the wrong one it is another arm."));
  const tip = el("select", { id: "robot-tip" });
  const ends = el("div", { hidden: true }, el("label", { for: tip.id }, "The arm ends at the link"), tip, el("p.note", {}, "Take the flange, not a finger or a camera."));
  const read = async () => {
    if (file.files.length === 0) return;
    const [chosen] = file.files;
    const isTable = /\.csv$/i.test(chosen.name);
    const isJson = /\.json$/i.test(chosen.name);
    asked.hidden = !isTable;
    ends.hidden = isTable || isJson;
    if (isTable && convention.value === "") {
      waits("Choose the convention of the table: standard or modified. The arm is shown then.");
      return;
    }
    try {
      if (isJson) return show(JSON.parse(await chosen.text()));
      const query = new URLSearchParams({ format: isTable ? convention.value : "urdf", name: chosen.name.replace(/\.\w+$/, "").replaceAll("_", " ").trim().slice(0, 200) || "robot", ...!isTable && tip.value ? { tip: tip.value } : {} });
      const found = await post(`/v1/robot-imports?${query}`, chosen, isTable ? "text/csv" : "application/xml");
      show(found.robot, remarks(found));
    } catch (error) {
      if (!isTable && !isJson) offerLinks(tip, tip.value, linksIn(await chosen.text()), error.detail ?? "");
      failed(error instanceof SyntaxError ? { title: "This is no JSON", detail: error.message } : error);
    }
  };
  file.addEventListener("change", async () => {
    // what was said of another file says nothing of this one
    convention.value = "";
    const [chosen] = file.files;
    if (chosen && !/\.(csv|json)$/i.test(chosen.name)) offerLinks(tip, "", linksIn(await chosen.text()), "");
    await read();
    if (!asked.hidden && convention.value === "") convention.focus();
  });
  convention.addEventListener("change", read);
  tip.addEventListener("change", read);
  return el("form", { submit: (event) => event.preventDefault() }, el("div.fields.from-top", {}, el("div", {}, el("label", { for: file.id }, "Robot file: kincal's JSON, a URDF, or a CSV table of the links"), file), asked, ends));
}

/** Names of the links of a URDF. */
const linksIn = (text) => [...new Set([...text.matchAll(/<link\s[^>]*?name\s*=\s*["']([^"']+)["']/g)].map(([, name]) => name))];

/** The links among which the end of the arm is chosen: those that a refusal names stand first. */
function offerLinks(tip, chosen, links, refusal) {
  const words = refusal.split(/[\s,.:;"]+/);
  const named = links.filter((link) => words.includes(link));
  const others = links.filter((link) => !named.includes(link));
  const options = (some) => some.map((link) => el("option", { value: link, selected: link === chosen }, link));
  fill(tip, el("option", { value: "" }, named.length > 0 ? "choose one" : "as the file says"), named.length > 0 ? [el("optgroup", { label: "Named in the message" }, options(named)), el("optgroup", { label: "Other links" }, options(others))] : options(others));
}

/** What was understood of a file, a sentence each. */
function remarks({ robot, root, tip, fixed_frames: fixed = [], skipped_frames: skipped = [], largest_difference_mm: apart }) {
  const from = root && tip ? `, from ${root} to ${tip}` : "";
  return [`Read with ${robot.links.length} joints${from}. The links agree with the file to ${apart < NOTHING_MM ? "less than a nanometre" : mm(apart)}.`,
    fixed.length > 0 && `Fixed frames that are part of the arm: ${fixed.join(", ")}.`,
    skipped.length > 0 && `Not part of the arm: ${skipped.join(", ")}. If the tool sits on one of them, choose it above.`].filter(Boolean);
}
