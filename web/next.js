// What to do next with a result: from the first fit to the release, one step after the other.

import { get, post } from "./api.js";
import { el, fill, problem } from "./dom.js";
import { gateDetail, gateTitle, mm } from "./format.js";
import { gateItems, linked } from "./gate_texts.js";
import { leftOut } from "./leave_out.js";
import { MATTERS, NO_USE, REMEDIES, WARNINGS } from "./words.js";

/** The code of the warning that makes a result useless; undefined if it is of use. */
export function uselessBy(report) {
  const told = (code) => report.warnings.find((remark) => remark.code === code);
  const code = Object.keys(NO_USE).find((known) => known !== "insisted_upload" && told(known));
  // the text of that warning begins so, and the code of the refusal follows
  const refused = told("insisted_upload")?.detail.match(/^the points were refused as (\w+)/)?.[1] ?? code;
  if (refused === "poor_alignment") return code;
  // what was refused and insisted on is told before what a wrong file looks like
  return ["no_fit", "joint_map_suspect"].includes(code) && refused !== code ? "insisted_upload" : code;
}

/** Where a parameter set is verified: the upload form, which then scores it and takes the frame of its points. */
export const verifyPage = (robot, set) => `#/robots/${robot.id}/upload?verify=${set.id}`;

/** The link to it; for a key that may not, why there is none. */
export function verifyLink(robot, set, { may, why }, kind = "a.button") {
  const scope = ["identify", "upload"].find((one) => !may(one));
  return scope ? why(scope, "verify with another session") : el(kind, { href: verifyPage(robot, set) }, "Verify with another session");
}

/** Whether a search stopped at its limit of iterations and nothing refined what it had: then the points are not to blame. */
export const endedEarly = (report) => report.termination === "iteration_limit" && report.tool_uncertainty_mm === null;

/** The card. `verified` is the set that a verification scored. */
export function nextSteps({ report, job, robot, set, parameterSet, verified, outliers, later }, context) {
  const { may, why, signal } = context;
  const useless = uselessBy(report);
  const card = (...content) => el("section.card.next", { "aria-label": "What to do next" }, el("h2", {}, "What to do next"), ...content);
  if (report.check) return false; // its verdict says what to measure next
  if (useless) {
    setAside(true);
    return card(remedy(endedEarly(report) ? "not_converged" : useless, { job, robot, set, may }), may("identify") ? false : why("identify", "start another calibration"));
  }
  if (job.kind !== "identify") {
    const out = el("div", {});
    return card(afterVerification(report, verified, may("identify") && startButton("Calibrate with these points", { job: null, robot, set }, {}, out)), out);
  }
  if (!parameterSet) return false;
  const [way, words] = [el("div", {}), el("div", {})];
  const draw = (gates) => {
    const evidence = gates?.evidence ?? (later?.against ? undefined : later?.report.evidence) ?? report.evidence;
    const isOpen = ["candidate", "superseded"].includes(parameterSet.status);
    const against = isOpen ? hindrances(report, gates) : [];
    // once another session supports the set, a reading that does not fit the others is a remark and no hindrance
    const isSupported = evidence === "independent_session" && !later?.against;
    const [isStray, remark] = outliers.rows.length === 0 || !isOpen ? [false, false] : [!isSupported, isSupported && strayRemark(report, outliers)];
    setAside(against.length > 0 || isStray, evidence === "independent_session");
    fill(way, path(report, evidence, parameterSet, isStray ? "outliers" : against[0]?.code));
    if (isStray) fill(words, lookFirst(report, outliers, gates, robot, parameterSet, context), gates && judged(gates));
    else fill(words, against.length > 0 ? notYet(against[0], { job, robot, set, parameterSet, may, why }) : advice(report, evidence, robot, parameterSet, context, later), remark, gates && isOpen && judged(gates, against[0], set));
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

/** The headline is good news only where nothing stands against a release, and the release is the main button of its card only where it is the next step. Both may be drawn after this card. */
function setAside(isAside, isVerified = false) {
  const change = () => {
    document.querySelector(".decision .release")?.classList.toggle("primary", !isAside && isVerified);
    const headline = document.querySelector(".verdict");
    headline?.classList.toggle("done", !isAside);
    headline?.classList.toggle("warning", isAside);
  };
  change();
  queueMicrotask(change);
}

/** With more points the service takes many seconds to judge a set, and other pages wait meanwhile: it is asked only on demand. */
export const SOON_JUDGED = 20_000;

/** What hinders the later steps; everything else hinders the first. */
const LATER = ["evidence", "check_robot", "measured_since_check", "sessions_fit", "scored_on_later_sessions", "sessions_better_than_nominal", "improved_on_active", "source_withdrawn", "archived", "withdrawn", "joint_map_changed", "identity"];

/** The three steps, and where this result stands; `hindrance` is the code of what stands against a release. */
function path(report, evidence, { status }, hindrance) {
  const isOver = ["released", "superseded"].includes(status);
  const isVerified = evidence === "independent_session";
  const isFit = !hindrance || LATER.includes(hindrance);
  const fit = report.verify ? `checked on ${report.verify.n_points} points that were not fitted` : "no point was kept aside";
  const steps = [["Fit", isFit, isFit ? fit : hindrance === "outliers" ? "points to look at" : "not usable yet"], ["Verify", isVerified, isVerified ? "on another session" : "on another session: not yet"], ["Release", isOver && !hindrance, { released: "the cell gets it", superseded: "was released once", withdrawn: "withdrawn" }[status] ?? "not yet"]];
  const now = steps.findIndex(([, done]) => !done);
  return el("ol.path", {}, steps.map(([name, done, said], i) => el(done ? "li.done-step" : i === now && status !== "withdrawn" ? "li.now" : "li", i === now ? { "aria-current": "step" } : {}, el("strong", {}, name), el("span", {}, said))));
}

/** Largest uncertainty of the tool, one standard deviation, with which a set corrects programs if the robot's policy has no tolerance, mm: what an uncalibrated arm is off by. */
const SEVERAL_MM = 2;
/** Gates whose answer is given with the release itself. */
const WITH_THE_RELEASE = ["change_plausible", "second_person"];
/** Gates in the order in which they hinder; those that are not here come after them. */
const FIRST = ["withdrawn", "archived", "joint_map_changed", "upload_not_insisted", "fits", "check_robot", "verified", "verify_errors_improved", "final_fit_near_verified", "uncertainty_within_tolerance", "verify_errors_within_tolerance"];

/** What stands against a release, the first cause first: {code, title, why}. `gates` are null until the service has answered. */
function hindrances(report, gates) {
  const told = (code) => report.warnings.some((remark) => remark.code === code);
  const said = (code) => ({ code, title: WARNINGS[code], why: [`${MATTERS[code]} ${REMEDIES[code]}`] });
  const half = report.verify ?? report.identify;
  const failed = (gates?.gates ?? []).filter((gate) => !gate.passed && !WITH_THE_RELEASE.includes(gate.gate));
  const place = ({ gate }) => (FIRST.includes(gate) ? FIRST.indexOf(gate) : FIRST.length);
  failed.sort((a, b) => place(a) - place(b));
  const found = failed.map((gate) => ({ code: gate.gate, title: gateTitle(gate), why: sentenceOf(gate.detail), detail: gate.detail }));
  const isKnown = (...codes) => found.some(({ code }) => codes.includes(code));
  if (told("not_converged") || endedEarly(report)) found.unshift(said("not_converged"));
  // what the gates say of the same is not said twice
  if (!gates && report.evidence === "none") found.push(said(report.verify ? "few_verify_points" : "no_verify_points"));
  if (half.after.mean_mm >= half.before.mean_mm && !isKnown("verify_errors_improved", "fits")) found.push(said("no_better_than_nominal"));
  if (told("tool_uncertain") && !isKnown("final_fit_near_verified", "uncertainty_within_tolerance")) found.push(said("tool_uncertain"));
  const worst = report.tool_uncertainty_mm?.max;
  if (worst > SEVERAL_MM && !told("tool_uncertain") && !isKnown("uncertainty_within_tolerance")) found.push({ ...said("tool_uncertain"), title: `The tool is known only to ${mm(worst)} at worst` });
  return found;
}

/** The detail of a gate as a sentence, with links. */
function sentenceOf(detail) {
  const text = gateDetail(detail);
  return linked(`${text.charAt(0).toUpperCase()}${text.slice(1)}.`.replace(/([.?!])\.$/, "$1"));
}

/** The point that fits the others least. */
const worstOf = ({ per_point: points }, rows) => rows.reduce((a, b) => (points[b].after_mm > points[a].after_mm ? b : a));

/** Points that do not fit the others, of a set that another session supports. */
function strayRemark(report, { rows, name, lookAt }) {
  const worst = worstOf(report, rows);
  const which = rows.length === 1 ? `${name(worst)} does not fit the others` : `${rows.length} points do not fit the others; the worst is ${name(worst)}`;
  return el("p.note", {}, `${which.charAt(0).toUpperCase()}${which.slice(1)}, off by ${mm(report.per_point[worst].after_mm)}. The other session holds all the same. `, el("button.plain", { type: "button", click: lookAt }, rows.length === 1 ? "Look at it" : "Look at them"));
}

/** Points that do not fit the others come before everything else: what they mean is decided by who measured them. */
function lookFirst(report, { rows, name, lookAt }, gates, robot, parameterSet, context) {
  const half = report.verify ?? report.identify;
  const worst = worstOf(report, rows);
  const one = rows.length === 1;
  const compared = gates?.gates.some(({ gate, passed, warning }) => gate === "improved_on_active" && (warning || !passed));
  return [el("p", {}, el("strong", {}, `${one ? `Look at ${name(worst)} first` : `Look at ${rows.length} points first`}: `, `${one ? "it is" : "the worst is"} off by ${mm(report.per_point[worst].after_mm)}${one ? "" : `, ${name(worst)}`}. `), `The mean error is ${mm(half.after.mean_mm)}. Was the reading bad, leave it out and calibrate again; was it right, verify with another session.`,
    compared && " The active set was scored with such points, and this set without them: do not compare the two before."),
  el("div.actions", {}, el("button.primary", { type: "button", click: lookAt }, one ? `Look at ${name(worst)}` : "Look at these points"), verifyLink(robot, parameterSet, context))];
}

/** Why a set is not usable yet, and the one button that leads on. */
function notYet(first, context) {
  const out = el("div", {});
  return [el("p", {}, el("strong", {}, `Not usable yet: ${first.title.charAt(0).toLowerCase()}${first.title.slice(1)}.`), " ", first.why), out, el("div.actions", {}, wayOut(first, context, out))];
}

/** The button for a cause. */
function wayOut({ code, detail = "" }, { job, robot, set, parameterSet, may, why }, out) {
  const link = (words, href) => el("a.button.primary", { href }, words);
  const page = `#/robots/${robot.id}`;
  const plan = link("Plan the poses to measure", `${page}/plan`);
  const verify = verifyLink(robot, parameterSet, { may, why }, "a.button.primary");
  const session = /job (job_\w+)/.exec(detail)?.[1];
  const other = /\b(set_\w+)/.exec(detail)?.[1];
  const again = (text, changes) => may("identify") && startButton(text, { job, robot, set }, changes, out);
  const known = {
    not_converged: again("Calibrate again with the automatic method", { method: "auto", preset: "default", options: undefined }),
    fits: job.method === "auto" ? plan : again("Calibrate again with the automatic method", { method: "auto", preset: "default", options: undefined }),
    joint_map_changed: again("Calibrate again", {}), upload_not_insisted: link("Upload a mended file", `${page}/upload`), archived: link(`To ${robot.name}`, page), check_robot: link(`To ${robot.name}`, page),
    sessions_fit: session && link("Look at that session", `#/jobs/${session}`), sessions_better_than_nominal: session && link("Look at that session", `#/jobs/${session}`),
    scored_on_later_sessions: other && may("identify") && startButton("Verify with that session", { job: null, robot, set: { id: other } }, { kind: "verify", parameter_set_id: parameterSet.id }, out),
    improved_on_active: link("Compare the sets", `${page}/compare`), verify_errors_within_tolerance: /guard band|too few/.test(detail) ? verify : plan,
    final_fit_near_verified: plan, uncertainty_within_tolerance: plan, tool_uncertain: plan, no_better_than_nominal: plan,
    verify_errors_improved: /there are no verify points/.test(detail) ? verify : plan, orientation_known: plan, identity: link(`To ${robot.name}`, page), withdrawn: plan, all_finite: plan,
  };
  return known[code] || (code in known ? plan : verify);
}

function advice(report, evidence, robot, parameterSet, { may, why }, later) {
  const isVerified = evidence === "independent_session";
  const link = (text, href) => el("a.button", { href }, text);
  const verify = verifyLink(robot, parameterSet, { may, why }, isVerified || parameterSet.status !== "candidate" ? "a.button" : "a.button.primary");
  const half = report.verify ?? report.identify;
  if (parameterSet.status === "withdrawn") return el("p", {}, "This set was withdrawn. Calibrate anew, or release an older set.");
  if (parameterSet.status === "released" && robot.state === "check_robot") return [el("p", {}, "It is in force, but a session speaks against the robot. Look at the robot before programs are corrected with this set; its page says what to do."), el("div.actions", {}, el("a.button.primary", { href: `#/robots/${robot.id}` }, `To ${robot.name}`))];
  if (parameterSet.status === "released" && later?.against) return [el("p", {}, `It is in force, but a later session speaks against it: ${later.against}. Look at that session before programs are corrected with this set.`), el("div.actions", {}, el("a.button.primary", { href: `#/jobs/${later.job.id}` }, "Look at that session"), verify)];
  if (parameterSet.status === "released") return [el("p", {}, "It is in force. Load it into the controller, or correct a program with it. Verify it with a short session from time to time: the robot's page says when."),
    el("div.actions", {}, link("Correct a program", `#/robots/${robot.id}/correct`), verify)];
  return [el("p", {}, isVerified ? "The fit holds on another session. It can be released below."
    : `The fit is good: ${mm(half.after.mean_mm)} on average instead of ${mm(half.before.mean_mm)}. Measure some 20 to 30 other poses in a session of their own, and verify it with them: only that shows a wrong tool, base or scale. Then release it.`),
  el("div.actions", {}, !isVerified && verify, !isVerified && link("Plan the poses to measure", `#/robots/${robot.id}/plan`), may("release") && el(isVerified ? "button.primary" : "button", { type: "button", click: () => { const decision = document.querySelector(".decision"); decision?.scrollIntoView({ block: "center" }); decision?.querySelector("button")?.focus({ preventScroll: true }); } }, "To the release"))];
}

/** What a release would find, beside the cause that was told above. */
function judged(found, told, set) {
  const failed = found.gates.filter((gate) => !gate.passed);
  if (failed.length === 0) return el("p.note", {}, told ? "A release would be accepted all the same." : "A release would be accepted now.");
  const others = failed.filter((gate) => gate.gate !== told?.code);
  if (others.length === 0) return [el("p.note", {}, "A release would be refused now."), sameWithout(found, set)];
  return [sameWithout(found, set), el("div.warning", {}, el("p", {}, el("strong", {}, told ? "A release would be refused now, also for this:" : "A release would be refused now:")), gateItems(others))];
}

/** A comparison with the active set is made on the points of this file. */
const sameWithout = (found, set) => leftOut(set) && found.gates.some(({ gate, passed }) => gate === "improved_on_active" && !passed) && el("p.note", {}, "Both sets were scored on the points of this file, without those that were left out by hand. A figure of the active set from another session may differ.");

function afterVerification(report, verified, again) {
  if (!verified) return el("p", {}, "The nominal robot was scored. Calibrate with these points to see what can be gained.");
  const link = el("a.button", { href: `#/jobs/${verified.job_id}` }, "To that parameter set");
  // a verification fits nothing: its points are those of the verify half
  const half = report.verify ?? report.identify;
  const better = half.after.mean_mm < half.before.mean_mm;
  if (report.evidence !== "independent_session") return [el("p", {}, "These points are no independent session. Measure other poses at another time, and verify with them."), el("div.actions", {}, link)];
  if (!better) return [el("p", {}, "The set is no better than the nominal robot on this session. Do not release it; calibrate anew with these points."), el("div.actions", {}, again, link)];
  if (report.warnings.some((remark) => remark.code === "worse_than_identified")) return [el("p", {}, "The set is several times worse on this session than when it was identified. Look at the warning below and at the robot, and measure another session: if it agrees, calibrate anew."), el("div.actions", {}, link)];
  if (report.warnings.some((remark) => remark.code === "misses_session")) return [el("p", {}, "The set misses this session by far more than the session scatters. Calibrate with these points, with all parameters."), el("div.actions", {}, again, link)];
  return [el("p", {}, { candidate: "The set holds on this session. Its page says whether a release would be accepted.", released: "The released set still holds on this session.", superseded: "The older set holds on this session.", withdrawn: "That set was withdrawn." }[verified.status] ?? ""), el("div.actions", {}, link)];
}

/** A button that posts a job: the request of an earlier one with changes, or a new one. */
export function startButton(text, { job, robot, set }, changes, out, kind = "button.primary") {
  return el(kind, { type: "button", click: async () => {
    try {
      const request = job ? (await get(`/v1/jobs/${job.id}`)).request : {};
      const points = request.measurement_set_ids ? {} : { measurement_set_id: set.id };
      const next = await post(`/v1/robots/${robot.id}/jobs`, { ...request, ...points, ...changes });
      location.hash = `#/jobs/${next.id}`;
    } catch (error) {
      fill(out, problem(error));
    }
  } }, text);
}

/** Where a robot misses points that are its own. */
const HAS_CHANGED = "The robot, its base or its tool is not as it was when this set was identified. A quick check names what changed; a calibration identifies the robot anew.";

/** What to do about a result that is of no use; by one click where one is enough. */
function remedy(code, { job, robot, set, may }) {
  const out = el("div", {});
  const again = (text, changes) => may("identify") && startButton(text, { job, robot, set }, changes, out);
  const page = el("a.button", { href: `#/robots/${robot.id}` }, `To ${robot.name}`);
  const scored = job.parameter_set_from;
  // points of a file that is in doubt are no points to calibrate with
  const changedWays = (areOfRobot) => el("div.actions", {}, job.kind !== "identify" && scored && may("identify") && startButton("Quick check", { job: null, robot, set }, { kind: "check", parameter_set_id: scored }, out),
    areOfRobot && startButton("Calibrate with these points", { job, robot, set }, { kind: "identify", parameter_set_id: undefined }, out, job.kind !== "identify" ? "button" : "button.primary"));
  const known = {
    model_too_small: [el("p", {}, "These points need a model with base and reflector, which the paper's model has not."), el("div.actions", {}, again("Calibrate again with the complete model", { model: "complete", frames_id: undefined, preset: "default" }))],
    joint_map_suspect: [el("p", {}, "Joints are counted otherwise than the robot's joint map says, or the file's axes are mirrored. Check x, y and z of the export first, then the joint that the warning names. Then calibrate again."), el("div.actions", {}, page)],
    set_far_off: [el("p", {}, HAS_CHANGED), changedWays(may("identify"))],
    session_does_not_fit: [el("p", {}, `Check the file first: is it of this robot, in this frame, with joints and positions of the same rows? Pick a point in the arm below and compare the posture with the cell. If the file is right: ${HAS_CHANGED}`), changedWays(false), el("div.actions", {}, page)],
    not_converged: [el("p", {}, "The search ended before it had settled, so nothing can be said of the points. The automatic method searches until it has settled."), el("div.actions", {}, again("Calibrate again with the automatic method", { method: "auto", preset: "default", options: undefined }))],
    no_better_than_nominal: [el("p", {}, "Leave out points that do not fit, or measure more poses that move every joint, and calibrate again."), el("div.actions", {}, el("a.button", { href: `#/robots/${robot.id}/plan` }, "Plan the poses to measure"))],
  };
  return [known[code] ?? [el("p", {}, "Check the file: is it of this robot, in this frame, with joints and positions of the same rows? Pick a point in the arm below and compare the posture with the cell. Then upload it again."), el("div.actions", {}, page)], out];
}
