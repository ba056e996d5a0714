// What can be taken along from a result, and where the result comes from.

import { el } from "./dom.js";
import { method, ran, span } from "./format.js";
import { fileStem, saveButton, savePoints } from "./save.js";

/** What other programs read the links as: the query of the export, the ending of the file, the name of the button. */
const FORMATS = [["format=json", "json", "JSON with the nominal robot"], ["format=urdf", "urdf", "URDF"], ["format=csv", "csv", "CSV"], ["format=csv&beta=refit", "csv", "CSV without β"], ["format=yaml", "yaml", "YAML"], ["format=ur_kinematics", "yaml", "Universal Robots' kinematics"], ["format=mastering", "json", "joint offsets for mastering"]];

/** Whether an arm may be one of Universal Robots: joints 2, 3 and 4 of theirs are parallel. */
const mayBeUniversal = ({ links }) => links.length === 6 && [links[2], links[3]].every(({ alpha_deg: alpha }) => Math.abs(Math.sin((alpha * Math.PI) / 180)) < 0.1);

/** A format that is not for this robot has a button that cannot be pressed, and says why. */
const notForIt = (name) => el("button", { type: "button", disabled: true, title: "For robots of Universal Robots only" }, `… as ${name} (for robots of Universal Robots only)`);

function exports(set, robot, stem) {
  return FORMATS.map(([query, ending, name]) => query.endsWith("ur_kinematics") && !mayBeUniversal(robot) ? notForIt(name) : saveButton(`… as ${name}`, `/v1/parameter-sets/${set.id}/export?${query}`, ["urdf", "csv", "yaml"].includes(query.slice(7)) ? stem(set.id) : stem(`${set.id}-${/\w+$/.exec(query)[0]}`), `.${ending}`, `Parameters as ${name}`));
}

/** One menu with everything that can be taken along. */
export function files(job, sets, parameterSet, residuals, robot) {
  const reportPage = `/v1/jobs/${job.id}/report.html`;
  const stem = (what) => fileStem(robot, sets[0], what);
  const group = (title, note, ...buttons) => el("div.group", {}, el("h3", {}, title), el("p.note", {}, note), el("div.actions", {}, buttons));
  return el("section.card", { id: "exports", tabindex: -1, "aria-label": "Export: take it along" }, el("h2", {}, "Export: take it along"), el("div.groups", {},
    group("Report", "To print or to keep in a quality file; the browser's print dialogue makes a PDF of it.", el("a.button", { href: reportPage, target: "_blank", rel: "noopener" }, "Report to print"), saveButton("Report as JSON", `/v1/jobs/${job.id}/report`, stem(`report-${job.id}`), ".json")),
    parameterSet && group("Parameters", "Links, base and reflectors as they were identified. Corrections stand in JSON and YAML only. Joint offsets are for controllers that take nothing else.", saveButton("Parameters", `/v1/parameter-sets/${parameterSet.id}`, stem(parameterSet.id), ".json"), exports(parameterSet, robot, stem)),
    group("Points", `${sets.length > 1 ? "The files as they were uploaded" : "The file as it was uploaded"}${sets.some(({ joined }) => joined) ? "; two files that were joined as one table" : ""}, and what remains of every point.`, sets.map((set, i) => savePoints(sets.length > 1 ? `Measured points ${i + 1}` : "Measured points", set)), el("button", { type: "button", click: residuals }, "Residuals of all points as CSV")),
    parameterSet && group("Programs", "Joint targets that were programmed offline, corrected with these parameters.", el("a.button", { href: `#/robots/${parameterSet.robot_id}/correct` }, "Correct a program"))));
}

export function origin(report, sets, parameterSet, job) {
  const { rank, n_parameters: n } = report.identifiability;
  const alone = report.parameters.filter((p) => p.identifiable).length;
  // the robot's page has the same figure; what the service computed is the smaller part of a short job
  const took = `${span(ran(job) ?? report.duration_ms / 1000)} from start to end, computed for ${span(report.duration_ms / 1000)}; ${job.kind !== "identify" ? "to score the points" : `${report.n_iterations} iterations, ${method(report.method)}`}`;
  const entries = [["Took", took], n > 0 && ["Identified", alone < n || rank < n ? `${alone} of ${n} parameters alone, ${rank} independent combinations` : `all ${n} parameters`], ["Model", report.model], ["Preset", report.preset], ["Seed", report.seed], ["Ended by", report.termination.replaceAll("_", " ")], ["Version", report.version],
    ["Result SHA-256", report.result_sha256], ...sets.map((set, i) => [sets.length > 1 ? `Upload ${i + 1} SHA-256` : "Upload SHA-256", set.sha256]), parameterSet && ["Parameters SHA-256", parameterSet.sha256]].filter(Boolean);
  return el("section.card", {}, el("details", {}, el("summary", {}, "Where it comes from"),
    el("dl.facts.plain", {}, entries.map(([name, value]) => el("div.fact.plain", {}, el("dt", {}, name), el("dd.hash", {}, value))))));
}
