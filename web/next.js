// What to do next with a result: from the first fit to the release, one step after the other.

import { get, post } from "./api.js";
import { el, fill, problem } from "./dom.js";
import { gateDetail, gateTitle, mm } from "./format.js";
import { NO_USE } from "./words.js";

/** The code of the warning that makes a result useless; undefined if it is of use. */
export function uselessBy(report) {
  const told = (code) => report.warnings.find((remark) => remark.code === code);
  const code = Object.keys(NO_USE).find((known) => known !== "insisted_upload" && told(known));
  const refused = told("insisted_upload")?.detail ?? code ?? "";
  if (refused.includes("poor_alignment")) return code;
  // what was refused and insisted on is told before what a wrong file looks like
  return ["no_fit", "joint_map_suspect"].includes(code) && !refused.includes(code) ? "insisted_upload" : code;
}

/** The card. `verified` is the set that a verification scored. */
export function nextSteps({ report, job, robot, set, parameterSet, verified }, { may, why, signal }) {
  const useless = uselessBy(report);
  const card = (...content) => el("section.card.next", { "aria-label": "What to do next" }, el("h2", {}, "What to do next"), ...content);
  if (report.check) return false; // its verdict says what to measure next
  if (useless) return card(remedy(useless, { job, robot, set, may }), may("identify") ? false : why("identify", "start another calibration"));
  if (job.kind !== "identify") return card(afterVerification(report, robot, verified));
  if (!parameterSet) return false;
  const [way, words] = [el("div", {}), el("div", {})];
  const draw = (gates) => {
    const evidence = gates?.evidence ?? report.evidence;
    fill(way, path(report, evidence, parameterSet));
    fill(words, advice(report, evidence, robot, parameterSet, may, gates?.releasable === false), gates && ["candidate", "superseded"].includes(parameterSet.status) && judged(gates));
  };
  draw(null);
  // the gates know of verifications that were made since
  const ask = () => get(`/v1/parameter-sets/${parameterSet.id}/gates`, signal).then(draw, () => { /* the release itself says what is wrong */ });
  if (set.n_points <= SOON_JUDGED) {
    ask();
    return card(way, words);
  }
  const button = el("button", { type: "button", click: () => { fill(button, "Checking …"); ask().then(() => button.remove()); } }, "Check what a release asks for");
  return card(way, words, el("div.actions", {}, button));
}

/** With more points the service takes many seconds to judge a set, and other pages wait meanwhile: it is asked only on demand. */
export const SOON_JUDGED = 20_000;

/** The three steps, and where this result stands. */
function path(report, evidence, { status }) {
  const isOver = ["released", "superseded"].includes(status);
  const isVerified = evidence === "independent_session";
  const steps = [["Fit", true, report.verify ? `checked on ${report.verify.n_points} points that were not fitted` : "no point was kept aside"], ["Verify", isVerified, isVerified ? "on another session" : "on another session: not yet"], ["Release", isOver, { released: "the cell gets it", superseded: "was released once", withdrawn: "withdrawn" }[status] ?? "not yet"]];
  const now = steps.findIndex(([, done]) => !done);
  return el("ol.path", {}, steps.map(([name, done, said], i) => el(done ? "li.done-step" : i === now && status !== "withdrawn" ? "li.now" : "li", i === now ? { "aria-current": "step" } : {}, el("strong", {}, name), el("span", {}, said))));
}

function advice(report, evidence, robot, parameterSet, may, isRefused) {
  const isVerified = evidence === "independent_session";
  const robotLink = (text, part) => el("a.button", { href: `#/robots/${robot.id}${part ? `/${part}` : ""}` }, text);
  const half = report.verify ?? report.identify;
  if (parameterSet.status === "withdrawn") return el("p", {}, "This set was withdrawn. Calibrate anew, or release an older set.");
  if (parameterSet.status === "released") return [el("p", {}, "It is in force. Load it into the controller, or correct a program with it. Verify it with a short session from time to time: the robot's page says when."),
    el("div.actions", {}, robotLink("Correct a program", "correct"), robotLink("Verify with another session", "upload"))];
  const better = half.after.mean_mm < half.before.mean_mm;
  if (!better) return el("p", {}, "It is no better than the nominal robot. Look at the warnings below, leave out points that do not fit, or measure again.");
  return [el("p", {}, isVerified ? `The fit holds on another session. ${isRefused ? "What a release still lacks is below." : "It can be released below."}`
    : `The fit is good: ${mm(half.after.mean_mm)} on average instead of ${mm(half.before.mean_mm)}. Measure some 20 to 30 other poses in a session of their own, and verify it with them: only that shows a wrong tool, base or scale. Then release it.`),
  el("div.actions", {}, !isVerified && robotLink("Verify with another session", "upload"), !isVerified && robotLink("Plan the poses to measure", "plan"), may("release") && el("button", { type: "button", click: () => { const decision = document.querySelector(".decision"); decision?.scrollIntoView({ block: "center" }); decision?.querySelector("button")?.focus({ preventScroll: true }); } }, "To the release"))];
}

function judged(found) {
  const failed = found.gates.filter((gate) => !gate.passed);
  if (failed.length === 0) return el("p.note", {}, "A release would be accepted now.");
  return el("div.warning", {}, el("p", {}, el("strong", {}, "A release would be refused now:")), el("ul", {}, failed.map((gate) => el("li", {}, el("strong", {}, gateTitle(gate.gate, true)), ": ", gateDetail(gate.detail)))));
}

function afterVerification(report, robot, verified) {
  if (!verified) return el("p", {}, "The nominal robot was scored. Calibrate with these points to see what can be gained.");
  const link = el("a.button", { href: `#/jobs/${verified.job_id}` }, "To that parameter set");
  // a verification fits nothing: its points are those of the verify half
  const half = report.verify ?? report.identify;
  const better = half.after.mean_mm < half.before.mean_mm;
  if (report.evidence !== "independent_session") return [el("p", {}, "These points are no independent session. Measure other poses at another time, and verify with them."), el("div.actions", {}, link)];
  if (!better) return [el("p", {}, "The set is no better than the nominal robot on this session. Do not release it; calibrate anew with these points."), el("div.actions", {}, link)];
  if (report.warnings.some((remark) => remark.code === "worse_than_identified")) return [el("p", {}, "The set is several times worse on this session than when it was identified. Look at the warning below and at the robot, and measure another session: if it agrees, calibrate anew."), el("div.actions", {}, link)];
  if (report.warnings.some((remark) => remark.code === "misses_session")) return [el("p", {}, "The set misses this session by far more than the session scatters. Calibrate with these points, with all parameters."), el("div.actions", {}, link)];
  return [el("p", {}, { candidate: "The set holds on this session. Its page says whether a release would be accepted.", released: "The released set still holds on this session.", superseded: "The older set holds on this session.", withdrawn: "That set was withdrawn." }[verified.status] ?? ""), el("div.actions", {}, link)];
}

/** What to do about a result that is of no use; by one click where one is enough. */
function remedy(code, { job, robot, set, may }) {
  const out = el("div", {});
  const again = (text, changes) => may("identify") && el("button.primary", { type: "button", click: async () => {
    try {
      const { request } = await get(`/v1/jobs/${job.id}`);
      const next = await post(`/v1/robots/${robot.id}/jobs`, { ...request, measurement_set_id: set.id, ...changes });
      location.hash = `#/jobs/${next.id}`;
    } catch (error) {
      fill(out, problem(error));
    }
  } }, text);
  const page = el("a.button", { href: `#/robots/${robot.id}` }, `To ${robot.name}`);
  const known = {
    model_too_small: [el("p", {}, "These points need a model with base and reflector, which the paper's model has not."), el("div.actions", {}, again("Calibrate again with the complete model", { model: "complete", frames_id: undefined, preset: "default" }))],
    joint_map_suspect: [el("p", {}, "A joint is counted in another way than the robot's joint map says. The warning below names it. Correct the robot's joint map, then calibrate again."), el("div.actions", {}, page)],
    set_far_off: [el("p", {}, "The robot is not as it was when this set was identified. Identify anew with these points."), el("div.actions", {}, again("Calibrate with these points", { kind: "identify", parameter_set_id: undefined }))],
    no_better_than_nominal: [el("p", {}, "Leave out points that do not fit, or measure more poses that move every joint, and calibrate again."), el("div.actions", {}, el("a.button", { href: `#/robots/${robot.id}/plan` }, "Plan the poses to measure"))],
  };
  return [known[code] ?? [el("p", {}, "Check the file: is it of this robot, in this frame, with joints and positions of the same rows? Pick a point in the arm below and compare the posture with the cell. Then upload it again."), el("div.actions", {}, page)], out];
}
