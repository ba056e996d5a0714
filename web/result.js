// Result of a calibration, in this order: errors, release, changes, method.

import { get, list, post } from "./api.js";
import { checkTables, checkVerdict } from "./check.js";
import { convergence, histogram, IDENTIFIED, interval, RECALIBRATED, VERIFIED } from "./figures.js";
import { contents } from "./contents.js";
import { el, fill, problem, say, table, warning } from "./dom.js";
import { capital, correctionTitle, count, error, EVIDENCE, fixed, method, mm, number, parameter, plain, sessionOf, signed, span, when } from "./format.js";
import { gateItems } from "./gate_texts.js";
import { best } from "./history.js";
import { leftOut } from "./leave_out.js";
import { decisions, statusBadge } from "./robot.js";
import { facts, overviewOf } from "./robots.js";
import { endedEarly, nextSteps, uselessBy } from "./next.js";
import { resultPoints } from "./result_points.js";
import { fileStem, saveButton } from "./save.js";
import { nPoints, sessionsCard, setNames } from "./sessions.js";
import { files, origin } from "./take_along.js";
import { asksToLook, foundAgainst, foundBadge } from "./verdicts.js";
import { NO_USE } from "./words.js";
import { workspaceCard } from "./workspace.js";

/** Points were held out, but they are no evidence. */
const NO_EVIDENCE = "These points are no evidence: they are too few, or the warnings below say why.";
const BASE_HIDDEN = "Checked on another upload, whose base was placed anew: a wrong base would not show.";

/** Draws a finished job. */
export async function result(body, context, { job, robot, sets, verified }) {
  const { signal } = context;
  const [set] = sets;
  const verifySet = job.request?.verify?.measurement_set_id;
  const [report, curve, parameterSet, other, later] = await Promise.all([
    get(`/v1/jobs/${job.id}/report`, signal), get(`/v1/jobs/${job.id}/convergence`, signal),
    job.parameter_set_id ? get(`/v1/parameter-sets/${job.parameter_set_id}`, signal) : null, verifySet ? get(`/v1/measurement-sets/${verifySet}`, signal) : null, job.parameter_set_id ? laterSession(job.parameter_set_id, robot, signal) : null,
  ]);
  const half = report.verify ?? report.identify;
  const against = foundBadge(report, job.kind);
  if (against) fill(document.querySelector(`[data-state="${job.id}"]`) ?? el("div"), against);
  const names = job.kind !== "identify" ? VERIFIED : isPartial(job) ? RECALIBRATED : IDENTIFIED;
  const drawn = resultPoints({ report, job, sets, other, robot, parameterSet: parameterSet ?? verified, names }, context);
  const next = el("div", {});
  const steps = (current) => fill(next, nextSteps({ report, job, robot, set, parameterSet: current, verified, outliers: drawn.outliers, later }, context));
  steps(parameterSet);
  const swarm = curve.iteration.length > 1 && convergence(curve, costWords(report, curve));
  fill(body, report.check ? checkVerdict(report, { robot, set: verified, may: context.may }) : job.kind !== "identify" ? score(report, half, verified, byHandIn(sets), job) : verdict(report, half, isPartial(job) ? "held parameter set" : "nominal robot", byHandIn(other ? [other] : sets), later), next, summary(report, half, job, verified, later), parameterSet && !noUse(report) && decision(parameterSet, context, steps, robot, half, set),
    report.check && checkTables(report), sessionsCard(report, sets), report.warnings.filter((remark) => !isSetUp(remark, report, set)).map(warning), drawn.cell, drawn.errors, el("div.two", {}, errorTable(report, job, sets, drawn.name), histogram(report.per_point, names)), drawn.table,
    parameterTable(report), priors(report), pairs([swarm, comparison(report)].flat().filter(Boolean)), corrections(report), repeatability(report), changed(report, set), parameterSet && !noUse(report) && workspaceCard(robot, parameterSet), files(job, sets, parameterSet, drawn.download, robot), origin(report, sets, parameterSet, job));
  next.before(contents(body));
}

/** The newest session that scored a parameter set after it was identified: {job, report, against}; null if there is none. */
async function laterSession(id, robot, signal) {
  const jobs = await list(`/v1/robots/${robot.id}/jobs?kind=verify&status=succeeded`, MAX_SESSIONS, signal);
  const job = jobs.filter((one) => one.parameter_set_from === id).sort((a, b) => Date.parse(b.created_at) - Date.parse(a.created_at))[0];
  if (!job) return null;
  const report = await get(`/v1/jobs/${job.id}/report`, signal);
  return { job, report, against: foundAgainst(report) };
}

/** Verifications among which the newest of a parameter set is looked for. */
const MAX_SESSIONS = 30;

/** What a later session found, with a link to it. */
const laterWords = ({ job, report }) => [el("a", { href: `#/jobs/${job.id}` }, sessionOf({ job, report })), `, ${mm(best(report).after.mean_mm)} on average on ${best(report).n_points} points`];

/** A search counts more in F than the points, or is refined afterwards: why the last F of the curve is not that of the result; undefined if it is. */
function costWords(report, { iteration, best_cost_mm2: cost }) {
  if (Math.abs(cost.at(-1) - report.cost_mm2) < 0.01 * report.cost_mm2) return undefined;
  const why = report.method === "least_squares" ? `Least squares also counts how far each parameter is from what is usual of robots; the points alone have F ${number(report.cost_mm2)} mm², which the table of methods states` : `Least squares then refined it to ${number(report.cost_mm2)} mm²`;
  return `The cost F, the sum of the squared position errors on the identify points, from ${number(cost[0])} to ${number(cost.at(-1))} mm² in ${iteration.at(-1)} iterations. ${why}.`;
}

/** Whether parameters are only the place of the instrument, which is another one with every set-up. */
const isPlace = (name, set) => set.frame === "instrument" && /^base_/.test(name);
/** Whether a warning says no more than that. */
const isSetUp = ({ code }, { changed }, set) => code === "placement_changed" && changed?.length > 0 && changed.filter(({ name }) => /^(base|target)_/.test(name)).every(({ name }) => isPlace(name, set));

const pairs = (figures) => figures.length > 0 && el("div.two", {}, figures);

/** Whether a correction was kept. If not, the errors with corrections equal those without. */
const isCorrected = (half) => half.corrected && half.corrected.rms_mm !== half.after.rms_mm;

/** Reason why the result cannot be used, in words; undefined if it can. */
function noUse(report) {
  const code = uselessBy(report);
  return code && endedEarly(report) ? "The search ended at its limit of iterations before it had settled, and nothing that was found is of use" : NO_USE[code];
}

/** Whether a job began with an earlier parameter set, of which it identified a part anew. */
const isPartial = (job) => job.kind === "identify" && job.request?.parameters?.rest === "parameter_set";

function useless(report, half, before, said = plain(noUse(report))) {
  return el("div.problem", { role: "alert" }, el("p", {}, el("strong", {}, `${said}.`), ` The mean position error is ${mm(half.after.mean_mm)}, and ${mm(half.before.mean_mm)} with the ${before}. The warnings below say more.`));
}

/** Largest error beside the mean from which on the points are looked at one by one. */
const STRAY = 10;

function verdict(report, half, before, left, later) {
  if (noUse(report)) return useless(report, half, before);
  const share = 1 - half.after.mean_mm / half.before.mean_mm;
  const where = onVerify(half, left) ?? `${report.verify ? `On ${half.n_points} points that were not fitted` : `On the ${half.n_points} points of the fit itself`}${byHand(left)}`;
  const better = share > 0.001 ? `fell from ${mm(half.before.mean_mm)} to ${mm(half.after.mean_mm)}, by ${share > 0.9995 ? "more than 99.9" : (100 * share).toFixed(1)} %` : `went from ${mm(half.before.mean_mm)} to ${mm(half.after.mean_mm)}: it did not get better`;
  const isBaseHidden = report.evidence === "same_upload" && report.warnings.some((remark) => remark.code === "base_not_checked");
  const own = report.evidence === "none" && report.verify ? NO_EVIDENCE : isBaseHidden ? BASE_HIDDEN : evidenceWords(report);
  const isStray = half.after.max_mm > STRAY * half.after.mean_mm;
  const hasOutliers = isStray || report.per_point.some((p) => p.outlier);
  const stray = isStray && ` The largest error is ${mm(half.after.max_mm)}, ${Math.round(half.after.max_mm / half.after.mean_mm)} times the mean: look at that point before you believe the fit.`;
  const verified = later?.report.evidence === "independent_session";
  const why = later?.against ? ["A later session speaks against it (", later.against, "): ", laterWords(later), "."] : verified ? ["A later session verified it: ", laterWords(later), "."] : own;
  const isGood = share > 0.001 && (report.evidence !== "none" || verified) && !left?.verify && !hasOutliers && !later?.against;
  return el(isGood ? "div.verdict.done" : "div.warning", {}, el("p", {}, el("strong", {}, `${where}, the mean position error ${better}.`), stray, " ", why));
}

/** What the evidence is worth; of several sessions each has points on both sides. */
const evidenceWords = ({ evidence, pooled }) => (EVIDENCE[evidence]?.[1] ?? "").replace("in the same session", pooled ? "in the same sessions" : "in the same session");

/** What was left out by hand of all these sets; null if nothing was. */
function byHandIn(sets) {
  const all = sets.map(leftOut).filter(Boolean);
  const sum = (key) => all.reduce((total, left) => total + left[key], 0);
  return all.length > 0 ? { points: sum("points"), verify: sum("verify"), of: sum("of") } : null;
}

/** Where the halves stayed as they were: on which of the points that were kept aside. */
const onVerify = ({ n_points: n }, left) => (left?.verify > 0 && n === left.of - left.verify ? `On ${n} of the ${left.of} verify points (${left.verify === 1 ? "one" : left.verify} left out by hand)` : undefined);

/** Points that somebody left out: an error without the points that do not fit looks better than the robot is. */
function byHand(left) {
  if (!left) return "";
  return left.verify > 0 ? ` (${left.verify} of ${left.of} verify points left out by hand)` : ` (${left.points === 1 ? "one point" : `${left.points} points`} of the file left out by hand)`;
}

/** Result of a verification. If no set was scored, the nominal robot was. */
function score(report, half, verified, left, job) {
  if (uselessBy(report) === "set_far_off") return useless(report, half, "nominal robot", `${asksToLook({ finding: "set_far_off", rms_mm: job.rms_mm ?? half.after.rms_mm }, verified?.status === "released" ? "active set" : `${verified?.status ?? "parameter"} set`).sentence}. These points fit the robot`);
  if (noUse(report)) return useless(report, half, "nominal robot");
  if (!verified && !half.corrected) return el(report.evidence === "none" ? "div.warning" : "div.done", {}, el("p", {}, el("strong", {}, `On ${half.n_points} points, the nominal robot has a mean position error of ${mm(half.after.mean_mm)}.`), " No identified parameters were verified."));
  const share = 1 - half.after.mean_mm / half.before.mean_mm;
  const isAnew = report.evidence === "independent_session";
  const which = verified ? `the parameters identified ${when(verified.created_at)}` : "these parameters";
  const beside = share > 0.001 ? `${share > 0.9995 ? "more than 99.9" : (100 * share).toFixed(1)} % less than with the nominal robot (${mm(half.before.mean_mm)})` : `no less than with the nominal robot (${mm(half.before.mean_mm)})`;
  // what the words for an upload's own verify points say is not true here: these poses are those of the fit
  const same = "These poses repeat those that the parameters were identified from, and nothing in their noise shows that they were measured anew: that they fit proves little. Measure other poses.";
  const against = verified && foundAgainst(report);
  const why = against ? `It speaks against these parameters: ${against}.` : { independent_session: EVIDENCE.independent_session[1], same_upload: same, none: NO_EVIDENCE }[report.evidence] ?? "";
  return el(share > 0.001 && isAnew && !left && !against ? "div.done" : "div.warning", {}, el("p", {}, el("strong", {}, `On ${half.n_points} points${byHand(left)}, the mean position error with ${which} is ${mm(half.after.mean_mm)}, ${beside}.`), " ", why));
}

function summary(report, half, job, verified, later) {
  const before = job.kind !== "identify" ? "nominal robot" : "before";
  const [evidence] = EVIDENCE[report.evidence] ?? [report.evidence];
  return facts([
    verified && ["Verified", el("a", { href: `#/jobs/${verified.job_id}` }, verified.status === "released" ? "active set" : `${verified.status} set`), `identified ${when(verified.created_at)}`],
    ["Mean error", mm(half.after.mean_mm), `${before} ${mm(half.before.mean_mm)}`],
    isCorrected(half) && ["With corrections", mm(half.corrected.mean_mm), "mean error; for predictions and corrected targets"],
    ["Largest error", mm(half.after.max_mm), `${report.verify && job.kind === "identify" ? "of the held-out points; " : ""}${before} ${mm(half.before.max_mm)}`],
    report.tool_uncertainty_mm && ["Uncertainty at the tool", mm(report.tool_uncertainty_mm.mean), `at worst ${mm(report.tool_uncertainty_mm.max)} over the workspace; one standard deviation at the measured reflector, by the links alone${report.reference ? " and the scale of the instrument" : ""}`],
    report.tool_uncertainty_corrected_mm && ["Uncertainty with corrections", mm(report.tool_uncertainty_corrected_mm.mean), `at worst ${mm(report.tool_uncertainty_corrected_mm.max)}; of predictions and corrected targets`],
    report.reference && ["Instrument, by its reference", `${report.reference.scale_error_ppm.toFixed(1)} ppm`, `standard uncertainty ${report.reference.scale_std_ppm.toFixed(1)} ppm; ${mm(report.reference.at_reach_std_mm)} at the arm's reach`],
    report.tool_uncertainty_absent_because && ["Uncertainty at the tool", "not stated", capital(plain(report.tool_uncertainty_absent_because))],
    report.flange_rotation_std_deg != null && ["Flange's rotation known to", `${number(report.flange_rotation_std_deg)}°`, report.flange_rotation_std_deg > 0.5 ? "one standard deviation; corrected poses are refused, positions of a measured reflector are not" : `one standard deviation${report.last_joint_zero_std_deg == null ? "" : `; ${number(report.last_joint_zero_std_deg)}° by the zero of the last joint, which positions never show`}`],
    !report.check && (later?.against ? ["Evidence", "speaks against it", [later.against, ": ", laterWords(later)]] : later?.report.evidence === "independent_session" ? ["Evidence", EVIDENCE.independent_session[0], laterWords(later)] : ["Evidence", evidence, `${half.n_points} points`]),
  ]);
}

/** The state of the parameter set and what this user may do with it. */
function decision(parameterSet, context, steps, robot, half, set) {
  const node = el("section.card.decision", { "aria-label": "Parameter set", tabindex: -1 });
  const draw = (current, said) => {
    const again = (action, title) => () => ask(action, title, current, draw, robot, half);
    const buttons = [];
    if (context.may("release") && ["candidate", "superseded"].includes(current.status)) buttons.push(el("button.primary.release", { type: "button", click: again("release", "Release this parameter set") }, current.status === "candidate" ? "Release …" : "Release again …"));
    if (context.may("release") && ["released", "candidate"].includes(current.status)) buttons.push(el("button.danger", { type: "button", click: again("withdraw", "Withdraw this parameter set") }, "Withdraw …"));
    buttons.push(saveButton("Download parameters", `/v1/parameter-sets/${current.id}`, fileStem(robot, set, current.id), ".json"), el("button", { type: "button", click: toExports }, "Export …"));
    const history = decisions(current).map((sentence) => el("p.quiet.reason", {}, sentence));
    fill(node, said && el("div.done", {}, el("p", {}, said)), el("div.head", {}, el("div", {}, el("h2", {}, "Parameter set ", statusBadge(current.status)), el("p.quiet", {}, MEANING[current.status] ?? ""), history), el("div.actions", {}, buttons)));
    const remarks = (current.release_checks ?? []).filter((gate) => gate.warning);
    if (!context.may("release")) node.append(context.why("release", "decide about it"));
    if (remarks.length > 0) node.append(el("div.warning", {}, el("p", {}, el("strong", {}, "Released, but look at:")), gateItems(remarks)));
    if (!said) return;
    // the button that had the focus is gone
    node.focus({ preventScroll: true });
    say(said);
    steps(current);
  };
  draw(parameterSet, null);
  return node;
}

/** The menu of exports gets the keyboard, too. */
function toExports() {
  const menu = document.getElementById("exports");
  menu.scrollIntoView();
  menu.focus({ preventScroll: true });
}

const MEANING = {
  candidate: "Identified, but no controller gets it before someone releases it.",
  released: "This is the robot's active set: the cell gets it.",
  superseded: "It was active once; another set took its place.",
  withdrawn: "It was taken back and cannot be released any more.",
};

const CONSEQUENCE = {
  release: "The cell gets it from now on; the set that is active today, if there is one, is superseded.",
  withdraw: "It cannot be released any more. If it is the active one, the robot has none afterwards.",
};

/** Asks for the reason in a dialog and does it. A refusal lists the gates in words. */
function ask(action, title, set, draw, robot, half) {
  const reason = el("textarea", { id: "reason", rows: 3, required: true, maxlength: 2000 });
  const change = el("textarea", { id: "change-reason", rows: 2, maxlength: 2000 });
  // asked for only when the service asks for it
  const changeField = el("div", { hidden: true }, el("label", { for: "change-reason" }, "Why the robot may have changed this much (a collision, a new part)"), change);
  const out = el("div", {});
  // a request that was sent cannot be taken back, so the dialog stays until its answer is there
  let [isAsked, isSent] = [false, false];
  const close = (event) => { if (isSent) event.preventDefault(); else dialog.close(); };
  const submit = async (event) => {
    event.preventDefault();
    if (isAsked) return;
    isAsked = true;
    try {
      if (preview) {
        fill(out, el("p.quiet", { role: "status" }, "Released as soon as the check above has ended …"));
        await preview.ended;
        fill(out);
        if (!dialog.open) return;
      }
      isSent = true;
      const now = await post(`/v1/parameter-sets/${set.id}/${action}`, { reason: reason.value, ...(change.value.trim() === "" ? {} : { change_reason: change.value }) });
      dialog.close();
      draw(now, action === "release" ? `Released: ${robot.name} now uses this set.` : "Withdrawn.");
    } catch (refused) {
      // what was foretold is said by the refusal now
      if (preview) fill(preview.node);
      fill(out, refused.code === "release_refused" ? refusal(refused) : problem(refused));
      if (refused.errors.some((issue) => issue.code === "change_plausible")) {
        changeField.hidden = false;
        change.focus();
      }
    } finally {
      [isAsked, isSent] = [false, false];
    }
  };
  const preview = action === "release" && gates(set.id);
  const dialog = el("dialog", { "aria-label": title, cancel: close, close: () => dialog.remove() },
    el("form", { submit }, el("h2", {}, title), about(action, set, robot, half), el("p", {}, CONSEQUENCE[action]), preview && preview.node, out,
      el("label", { for: "reason" }, "Reason, for those who come after"), reason, changeField,
      el("p", {}), el("div.actions", {}, el(action === "release" ? "button.primary" : "button.danger", { type: "submit" }, action === "release" ? "Release" : "Withdraw"), el("button", { type: "button", click: close }, "Not now"))));
  document.body.append(dialog);
  dialog.showModal();
}

/** Which robot and which set it is about, how good the set is, and what it replaces. */
function about(action, set, robot, half) {
  const [which, replaced] = [el("span", {}, "this set"), el("span", {})];
  const figure = `${mm(half.after.rms_mm)} rms on ${count(half.n_points)} points`;
  setNames(robot).then((nameOf) => {
    fill(which, nameOf(set));
    if (action !== "release") return;
    return overviewOf(robot).then(({ active } = {}) => {
      const before = active?.after_rms_mm == null ? "" : `, ${mm(active.after_rms_mm)} rms when it was identified`;
      fill(replaced, active ? `It replaces ${nameOf({ ...active, job_id: active.job_id })}${before}.` : "The robot has no active set now.");
    });
  }).catch(() => { /* the release itself says what is wrong */ });
  return el("p", {}, el("strong", {}, robot.name), robot.serial_number ? `, serial number ${robot.serial_number}` : ", without a serial number", ": ", which, `. Error: ${figure}. `, replaced);
}

/** What a release would find now, before anybody asks for it: what refuses it, and what is worth a look. */
function gates(id) {
  const node = el("div", { "aria-live": "polite" }, el("p.quiet", {}, "Checking what a release asks for …"));
  const ended = get(`/v1/parameter-sets/${id}/gates`).then((found) => {
    const told = (title, kind, some) => some.length > 0 && el(kind, {}, el("p", {}, el("strong", {}, title)), gateItems(some));
    fill(node, told("A release would be refused:", "div.problem", found.gates.filter((gate) => !gate.passed)),
      told(found.releasable ? "It may be released. Worth a look:" : "Worth a look, too:", "div.warning", found.gates.filter((gate) => gate.passed && gate.warning)));
  }, () => fill(node));
  return { node, ended };
}

function refusal({ errors, detail }) {
  return el("div.problem", { role: "alert" }, el("p", {}, el("strong", {}, "It was not released. "), errors.length > 0 ? "What was not fulfilled:" : detail),
    errors.length > 0 && gateItems(errors.map(({ code, detail: found }) => ({ gate: code, passed: false, detail: found }))));
}

function errorTable(report, job, sets, name) {
  const verifies = job.kind !== "identify";
  const [before, after] = verifies ? ["nominal robot", "these parameters"] : ["before", "after"];
  const rows = [["identify", "Identify", report.identify], ["verify", "Verify", report.verify], ["without", "Verify, without outliers", report.verify_without_outliers]].filter(([, , half]) => half?.n_points > 0);
  const flat = rows.flatMap(([, name, half]) => [[`${name} (${half.n_points})`, before, half.before], ["", after, half.after], ...(isCorrected(half) ? [["", `${after}, with corrections`, half.corrected]] : [])]);
  const columns = [["Points", ([name]) => name], ["Robot", ([, stage]) => stage], ...["mean", "std", "rms", "max"].map((name) => [name, ([, , e]) => error(e[`${name}_mm`]), "n"])];
  return el("section.card", {}, el("h2", {}, verifies ? "Errors beside the nominal robot" : "Errors before and after"),
    table(verifies ? "Position errors in mm, on all points of the set." : "Position errors in mm. Identify: the points of the fit. Verify: points kept aside.", columns, flat, ""),
    rotations(report, before, after),
    report.final && el("p.note", {}, `The delivered parameters were then fitted ${toPoints(report, nPoints(sets), name)}, with ${mm(report.final.rms_mm)} rms there: the tool is ${mm(report.final.moved_mm)} on average from where the verified fit has it, over the workspace.`));
}

/** Points that are named one by one. */
const MAX_NAMED = 4;

/** To how many of the points of the sessions the delivered parameters were fitted, and which were left out. */
function toPoints({ final: { n_points: n }, per_point: points }, total, name) {
  if (n === total) return `to all ${count(n)} points`;
  const outliers = points.map((_, i) => i).filter((i) => i < total && points[i].outlier);
  const isExplained = outliers.length === total - n;
  const which = outliers.length <= MAX_NAMED ? outliers.map((i) => points[i].name ?? name(i)).join(", ") : count(outliers.length);
  return `to ${count(n)} of ${count(total)} points${isExplained ? ` (${which} left out as ${outliers.length === 1 ? "an outlier" : "outliers"})` : ""}`;
}

/** Rotation errors, where poses were measured. */
function rotations(report, before, after) {
  const halves = [["Identify", report.identify], ["Verify", report.verify]].filter(([, half]) => half?.rotation);
  const flat = halves.flatMap(([name, { rotation }]) => [[`${name} (${rotation.n_poses})`, before, rotation.before], ["", after, rotation.after]]);
  const columns = [["Poses", ([name]) => name], ["Robot", ([, stage]) => stage], ...["mean", "rms", "max"].map((name) => [name, ([, , e]) => fixed(e[`${name}_deg`]), "n"])];
  return flat.length > 0 && table("Rotation errors in degrees.", columns, flat, "");
}

function parameterTable(report) {
  const rows = report.parameters;
  if (rows.length === 0) return [];
  // links move by tenths, base and targets by tens of mm: each kind has a scale of its own
  const kind = (r) => `${r.link ? "links" : "base and targets"}, ${r.unit === "deg" ? "°" : r.unit}`;
  const scales = new Map();
  for (const r of rows) scales.set(kind(r), Math.max(scales.get(kind(r)) ?? 1e-9, Math.abs(r.delta) + 2 * (r.std_uncertainty ?? 0)));
  const unit = (row) => (row.unit === "deg" ? "°" : row.unit);
  const columns = [
    ["Parameter", (r) => (r.link ? el("span.symbol", {}, parameter(r.name)) : parameter(r.name))],
    ["Unit", unit], ["Nominal", (r) => (r.link ? fixed(r.nominal) : [fixed(r.nominal), el("small.quiet.start", {}, "start value")]), "n"], ["Identified", (r) => fixed(r.identified), "n"], ["Change", (r) => signed(r.delta, 4), "n"],
    ["± std", (r) => (!r.identifiable ? "not seen alone" : r.std_uncertainty === null ? "–" : number(r.std_uncertainty, 2)), "n"],
    ["Change ± 2 std", (r) => interval(r, scales.get(kind(r)))],
  ];
  const ends = [...scales].map(([name, end]) => `±${number(end, 2)} ${name.split(", ")[1]} (${name.split(", ")[0]})`).join(", ");
  const [caption, body] = table(`Hollow marks: the data cannot see this parameter alone, so its value says nothing by itself. The last column's scale ends at ${ends}.`, columns, rows, "");
  [...body.querySelectorAll("tbody tr")].forEach((tr, i) => rows[i].identifiable || tr.classList.add("unseen"));
  const groups = report.identifiability.unidentifiable;
  return el("section.card", {}, el("h2", {}, "Parameters"), caption, body,
    groups.length > 0 && [el("h3.below", {}, "What could not be identified"), el("p.note", {}, groups.some((group) => group.length > 1) && "Of parameters that stand together, only the sum of their effects can be seen in the measured positions. ",
      "The positions of the measured reflector are right all the same; of another tool they may not be."),
      el("ul", {}, groups.map((group) => el("li", {}, group.length > 1 ? group.map(parameter).join(" with ") : `${parameter(group[0])} cannot be seen at all`)))]);
}

function comparison(report) {
  if (report.comparison.length === 0) return [];
  const own = { n_iterations: report.n_iterations, duration_ms: report.duration_ms, cost_mm2: report.cost_mm2, verify_after: report.verify?.after ?? null, used: true };
  // the row of the method that ran has its search alone, without what refined and settled it
  const rows = [own, ...report.comparison.filter((r) => r.method !== report.method || r.cost_mm2 !== report.cost_mm2)];
  const columns = [
    ["Method", (r) => (r.used ? el("strong", {}, "this result") : `${method(r.method)}${r.method === report.method ? ", its search alone" : ""}`)],
    ["Iterations", (r) => r.n_iterations, "n"], ["Time", (r) => span(r.duration_ms / 1000), "n"], ["F, mm²", (r) => number(r.cost_mm2), "n"],
    ["Verify rms", (r) => mm(r.verify_after?.rms_mm), "n"],
  ];
  return el("section.card", {}, el("h2", {}, "Methods on the same points"), table(`${capital(method(report.method))}: ${plain(report.method_reason)}.`, columns, rows, ""));
}

function corrections(report) {
  if (!report.corrections?.length) return [];
  const columns = [["Correction", (c) => correctionTitle(c.kind)], ["Kept", (c) => (c.kept ? el("strong", {}, "yes") : c.dropped_because ? "dropped: worse on the verify points" : "no")],
    ["Without", (c) => mm(c.cross_validated_rms_mm_before), "n"], ["With", (c) => mm(c.cross_validated_rms_mm_after), "n"],
    ["Gain, mm²", (c) => number(c.gain_mm2), "n"], ["± standard error", (c) => number(c.standard_error_mm2), "n"]];
  return el("section.card", {}, el("h2", {}, "Corrections"), table("Rms on points that were left out in turn. Each is kept only where it gains more than twice its standard error; and all are dropped where the points to verify are further from the robot with corrections than from its links alone.", columns, report.corrections, ""));
}

/** Repeatability at poses that were measured several times. */
function repeatability({ repeatability: found }) {
  if (!found) return [];
  const columns = [["Configuration", (p) => p.configuration, "name"], ["Target", (p) => p.target, "n"], ["Visits", (p) => p.n, "n"], ["RP", (p) => mm(p.rp_mm), "n"],
    ["AP before", (p) => mm(p.ap_before_mm), "n"], ["AP after", (p) => mm(p.ap_after_mm), "n"]];
  if (found.poses.some((p) => p.ap_corrected_mm !== undefined)) columns.push(["AP corrected", (p) => mm(p.ap_corrected_mm), "n"]);
  const caption = `RP ${mm(found.rp_mm)} over ${found.n_poses} poses with ${found.n_points} points; one coordinate scatters by ${mm(found.std_mm)}. As ISO 9283 has them: RP, how closely the robot returns to a pose (with fewer than 30 visits it comes out too small); AP, how far from where it should be.`;
  return el("section.card", {}, el("h2", {}, "Repeatability"), table(caption, columns, found.poses.slice(0, MAX_POSES), ""),
    found.poses.length > MAX_POSES && el("p.note", {}, `and ${found.poses.length - MAX_POSES} poses more, in the report as JSON`));
}

/** More revisited poses than this are not listed. */
const MAX_POSES = 40;

/** Priors of parameters, and how much they decided. */
function priors(report) {
  const rows = report.parameters.filter((p) => p.prior);
  if (rows.length === 0) return [];
  const allowed = ({ min, max }) => [min !== undefined && `from ${fixed(min)}`, max !== undefined && `to ${fixed(max)}`].filter(Boolean).join(" ") || "any";
  const columns = [["Parameter", (p) => parameter(p.name)], ["Unit", (p) => (p.unit === "deg" ? "°" : p.unit)], ["Expected", (p) => fixed(p.prior.mean), "n"], ["± std", (p) => number(p.prior.std), "n"],
    ["Allowed", (p) => `${allowed(p.prior)}${p.prior.at_bound ? `, ended at ${p.prior.at_bound}` : ""}`], ["Share", (p) => (p.prior.share === null ? "–" : `${Math.round(100 * p.prior.share)} %`), "n"]];
  return el("section.card", {}, el("h2", {}, "Known beforehand"), table("Share: how much of what is known now comes from beforehand; at 100 % the measured points say nothing of it.", columns, rows, ""));
}

function changed(report, set) {
  if (!report.changed?.length) return [];
  const rows = report.changed.filter(({ name }) => !isPlace(name, set));
  const elsewhere = rows.length < report.changed.length && el("p.note", {}, "The instrument stood elsewhere than in the set before, as with every set-up.");
  if (rows.length === 0) return elsewhere;
  // where positions cannot tell which of several moved, all of them have one unit
  const unit = (c) => ({ deg: "°" })[report.parameters.find((p) => p.name === c.name.split(" or ")[0])?.unit] ?? "mm";
  const columns = [["Parameter", (c) => parameter(c.name)], ["Unit", unit], ["Change", (c) => signed(c.delta, 5), "n"], ["In units of its uncertainty", (c) => number(c.sigmas), "n"]];
  return el("section.card", {}, el("h2", {}, "Moved since the set before"), el("div.narrow", {}, table("Changes that are larger than chance.", columns, rows, "")), elsewhere);
}
