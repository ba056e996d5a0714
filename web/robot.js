// One robot: its state, its history, and its stored documents.

import { get, list, post } from "./api.js";
import { armFigure } from "./arm.js";
import { brief, el, fill, problem, say, table, withFocus } from "./dom.js";
import { age, capital, count, EVIDENCE, gateTitle, measuredAt, method, mm, number, parameter, plain, ran, sessionOf, span, when } from "./format.js";
import { best, errorHistory, parameterHistory, past, state } from "./history.js";
import { manageCard } from "./manage.js";
import { SOON_JUDGED, startButton, verifyLink, verifyPage } from "./next.js";
import { isRunning, whileRunning } from "./polling.js";
import { postureCard } from "./posture.js";
import { facts, overviewOf, standing } from "./robots.js";
import { fileStem, saveButton, savePoints } from "./save.js";
import { selection } from "./selection.js";
import { setNames, setsOfJob } from "./sessions.js";
import { uploadCard } from "./upload.js";
import { asksToLook, foundAgainst, findingBadge } from "./verdicts.js";
import { FAILURES } from "./words.js";

const SHOWN = 20;

/** The page of one robot. */
export async function robotPage({ main, signal, may, why, query }, id, part) {
  const robot = await get(`/v1/robots/${id}`, signal);
  document.title = `kincal: ${robot.name}`;
  const [stand, now, sets, jobs, networks] = await Promise.all([
    state(robot, signal),
    overviewOf(robot, signal),
    list(`/v1/robots/${id}/measurement-sets`, SHOWN, signal),
    list(`/v1/robots/${id}/jobs`, SHOWN, signal),
    list(`/v1/robots/${id}/networks`, SHOWN, signal),
  ]);
  const [entries, { trend }, asking, nameOf] = await Promise.all([past(stand, signal), get(`/v1/robots/${id}/history?limit=1`, signal), askingJob(robot, signal), setNames(robot, signal)]);
  const uploads = el("div", {}, setTable(sets));
  const [top, steps, results, runs] = [el("div", {}), el("div", {}), el("div", {}), el("div", {})];
  const isNew = sets.length + jobs.length === 0;
  const shown = { robot, stand, now, sets, jobs, entries, trend, asking, nameOf, may, why, signal };
  const draw = () => {
    fill(top, head(shown), archived(shown.robot), checkRobot(shown), failure(shown.stand.lastJob), known(shown));
    fill(steps, shown.stand.newest ? guide(shown) : firstSteps(shown));
    fill(results, !shown.stand.newest && armOf(shown), history(shown.entries, shown.stand.sessions, shown.nameOf), section("Parameter sets", parameterSets(shown), isNew), shown.stand.newest && armOf(shown));
    fill(runs, jobTable(shown.jobs));
  };
  const uploaded = (set) => {
    sets.unshift(set);
    fill(uploads, setTable(sets));
    if (!shown.stand.newest) fill(steps, firstSteps(shown));
    uploads.closest("section").hidden = false;
  };
  const verifying = await toVerify(query.get("verify"), shown, signal);
  draw();
  fill(main, top, steps, !robot.archived_at && [uploadCard(robot, { sets, parameterSets: stand.sets, may, uploaded, hasNetwork: networks.length > 0, verifying }), may("upload") ? why("identify", "start calibrations") : why("upload", "upload measured points")], results,
    section("Jobs", runs, isNew), section("Measurement sets", uploads, isNew),
    networks.length > 0 && section("Networks", networkTable(networks)), postureCard(robot), manageCard(robot, stand.sets, { may, why, signal }), nominal(robot));
  whileRunning(() => shown.jobs.some(isRunning), () => refresh(shown, main, draw, runs), signal);
  if (part !== "upload") return;
  document.getElementById("calibrate")?.scrollIntoView();
  document.getElementById("set-file")?.focus({ preventScroll: true });
}

/** Asks for the jobs again. Once one of them has ended, all is drawn anew but the forms. */
async function refresh(shown, main, draw, runs) {
  const { robot: { id }, signal } = shown;
  const jobs = await list(`/v1/robots/${id}/jobs`, SHOWN, signal);
  const states = (some) => some.map((job) => `${job.id} ${job.status}`).join();
  if (states(jobs) === states(shown.jobs)) return;
  if (!jobs.some((job) => !isRunning(job) && isRunning(shown.jobs.find((one) => one.id === job.id)))) {
    shown.jobs = jobs;
    withFocus(runs, () => fill(runs, jobTable(jobs)));
    return;
  }
  const robot = await get(`/v1/robots/${id}`, signal);
  const [stand, now] = await Promise.all([state(robot, signal), overviewOf(robot, signal)]);
  const [entries, { trend }, asking, nameOf] = await Promise.all([past(stand, signal), get(`/v1/robots/${id}/history?limit=1`, signal), askingJob(robot, signal), setNames(robot, signal)]);
  Object.assign(shown, { robot, stand, now, jobs, entries, trend, asking, nameOf });
  withFocus(main, draw);
  say("A job of this robot has ended");
}

/** The parameter set that somebody came here to verify, and the set of points that it was identified from; null if none is named. */
async function toVerify(id, { stand, jobs, sets }, signal) {
  const set = id && stand.sets.find((one) => one.id === id);
  if (!set) return null;
  const { measurement_set_id: from } = jobs.find((job) => job.id === set.job_id) ?? await get(`/v1/jobs/${set.job_id}`, signal);
  return { set, identified: sets.find((one) => one.id === from) ?? await get(`/v1/measurement-sets/${from}`, signal) };
}

/** An archived robot is in no list; somebody who has its address sees why. */
const archived = (robot) => (robot.archived_at ? el("div.warning", {}, el("p", {}, el("strong", {}, `This robot was archived ${when(robot.archived_at)}. `), "It is in no list and cannot be calibrated. Restore it below, under Name, mounting, joint limits, policy of releases, rollback, archive.")) : []);

/** How a robot gets its first set, and which step is next. */
function firstSteps({ robot, sets, stand: { lastJob }, now, may }) {
  if (robot.archived_at) return [];
  const step = sets.length > 0 ? 2 : 0;
  const steps = [["Measure", "Move the robot to 30 or more different poses, and measure a reflector on its flange with a tracker. The plan names good poses."], ["Upload", "A table with the joint values and the measured position of each pose. It is checked before anything is stored."], ["Calibrate, verify, release", "Start the calibration, then verify it with a second session. Nothing reaches the cell before somebody releases it."]];
  const runs = isRunning(lastJob);
  return el("section.card.next", { "aria-label": "What to do next" }, el("h2", {}, "What to do next"), el("p", {}, `${now?.need === "withdrawn" ? `${capital(now.reason)}. ` : "This robot has not been calibrated yet. "}${runs ? "A job of it is running." : sets.length > 0 ? "Its points are stored: start the calibration below." : ""}`),
    el("ol.path", {}, steps.map(([name, said], i) => el(i < step ? "li.done-step" : i === step ? "li.now" : "li", i === step ? { "aria-current": "step" } : {}, el("strong", {}, name), el("span", {}, said)))),
    el("div.actions", {}, runs ? el("a.button.primary", { href: `#/jobs/${lastJob.id}` }, "Watch it") : now?.need === "withdrawn" && el("a.button", { href: `#/jobs/${now.need_job_id}` }, "Look at the withdrawn result"), !runs && sets.length > 0 && may("identify") && el(lastJob?.status === "failed" ? "button" : "button.primary", { type: "button", click: toCalibration }, "To the calibration"), el("a.button", { href: `#/robots/${robot.id}/plan` }, "Plan the poses to measure")));
}

/** To the form that calibrates with stored points, which is folded. */
function toCalibration() {
  const card = document.getElementById("calibrate");
  const stored = [...card?.querySelectorAll(":scope > details") ?? []].at(-1);
  if (stored) stored.open = true;
  (stored ?? card)?.scrollIntoView();
}

/** The arm at rest, to compare with the one in the cell: by the parameters that the cell runs, or as it was registered. */
function armOf({ robot, stand: { active } }) {
  const caption = active ? "The arm at rest, by the parameters of the active set. They differ from the nominal ones by less than can be seen here." : "The nominal arm at rest. Compare it with the one in the cell.";
  return armFigure({ title: "The robot", level: "h2", caption, robot: active ? { ...robot, links: active.links } : robot, points: [], selected: selection(0) }).node;
}

/** Why the newest job failed. Its page starts it again. */
function failure(job) {
  if (job?.status !== "failed") return [];
  const noun = { verify: "verification", check: "check" }[job.kind] ?? "calibration";
  return el("section.card.next", { "aria-label": `The newest ${noun} failed` }, problem({ ...job.error, code: undefined, title: `The newest ${noun} failed, ${age(job.finished_at ?? job.created_at)}` }),
    el("p", {}, FAILURES[job.error?.code] ?? FAILURES.other), el("div.actions", {}, el("a.button.primary", { href: `#/jobs/${job.id}` }, "Look at that job and start it again")));
}

/** A longer description ends after its first sentence; the nominal links below have the whole of it. */
const MAX_DESCRIPTION = 120;

function head({ robot, stand, now }) {
  const short = robot.description?.length > MAX_DESCRIPTION ? `${/^.*?[.;](?= )/s.exec(robot.description)?.[0] ?? `${robot.description.slice(0, MAX_DESCRIPTION)} …`}` : robot.description;
  const details = [robot.serial_number ? `serial number ${robot.serial_number}` : "no serial number", `${robot.links.length} ${robot.links.length === 1 ? "joint" : "joints"}`, typeof robot.mounting === "string" && { floor: "on the floor", wall: "on a wall", ceiling: "on the ceiling" }[robot.mounting], short].filter(Boolean);
  return el("div.head", {}, el("div", {}, el("p.crumbs", {}, el("a", { href: "#/" }, "Robots")), el("h1", {}, robot.name), el("p.quiet", {}, details.join(" · "))),
    el("div.actions", {}, now && standing(now), el("span", { id: "drifted" }), el("a.button", { href: `#/robots/${robot.id}/plan` }, "Plan poses"), stand.newest && el("a.button", { href: `#/robots/${robot.id}/correct` }, "Correct a program"), stand.sets.length > 1 && el("a.button", { href: `#/robots/${robot.id}/compare` }, "Compare sets")));
}

/** The job whose session asks somebody to look at the robot; null if none does. */
const askingJob = (robot, signal) => (robot.state === "check_robot" && robot.check_job_id ? get(`/v1/jobs/${robot.check_job_id}`, signal) : null);

/** What to do where a session speaks against the robot: the file is wrong, or the robot has changed. */
function checkRobot(shown) {
  const { robot, asking, stand: { active, sessions }, may, why } = shown;
  if (robot.state !== "check_robot") return [];
  const session = sessions.find(({ job }) => job.id === robot.check_job_id);
  const { isFarOff, sentence } = asksToLook(asking, scoredSet(shown));
  const cause = isFarOff ? "Its points fit the robot, so the arm, its base or its tool has changed" : "The file is in another frame or of another robot, or the arm, its base or its tool has changed by much";
  return el("section.card.alarm", {}, el("h2", {}, "Check this robot"),
    el("p", {}, el("strong", {}, `${sentence}. `), "This was found on the ", el("a", { href: `#/jobs/${robot.check_job_id}` }, session ? sessionOf(session) : "session of this job"), `. ${cause}. No release is made until a new session fits, or somebody marks the robot as checked.`),
    active && el("p", {}, el("strong", {}, "The cell still runs the active set until it is withdrawn.")),
    waysOn(shown, isFarOff), why("release", "mark the robot as checked"), may("release") && markAsChecked(robot));
}

/** How the set is called that the session was scored with. */
const scoredSet = ({ asking, stand: { active, sets } }) => (asking?.parameter_set_from && asking.parameter_set_from !== active?.id ? `${sets.find(({ id }) => id === asking.parameter_set_from)?.status ?? "older"} set` : "active set");

/** Where the robot has changed, the points that show it lead on; where the file is in doubt, another session does. */
function waysOn({ robot, asking, stand: { active, newest }, may }, isFarOff) {
  const out = el("div", {});
  const [page, set] = [`#/robots/${robot.id}`, { id: asking?.measurement_set_id }];
  const withdraw = may("release") && active && el("a.button", { href: `#/jobs/${active.job_id}` }, "Withdraw the set");
  const again = may("upload") && el(isFarOff ? "a.button" : "a.button.primary", { href: active || newest ? verifyPage(robot, active ?? newest) : `${page}/upload` }, "Measure again and upload a session");
  const check = { kind: "check", ...asking?.parameter_set_from ? { parameter_set_id: asking.parameter_set_from } : {} };
  const quick = may("identify") && asking && startButton("Quick check", { job: null, robot, set }, check, out, isFarOff ? undefined : "button");
  if (!isFarOff) return [out, el("div.actions", {}, again, quick, may("identify") && el("a.button", { href: `${page}/upload` }, "Calibrate anew"), withdraw)];
  return [out, el("div.actions", {}, quick, may("identify") && startButton("Calibrate with these points", { job: null, robot, set }, {}, out, "button"), again, withdraw)];
}

/** The form that ends the state without a new session. */
function markAsChecked(robot) {
  const out = el("div", {});
  const reason = el("input", { id: "checked-reason", required: true, maxlength: 2000 });
  const submit = async (event) => {
    event.preventDefault();
    try {
      await post(`/v1/robots/${robot.id}/checked`, JSON.stringify({ reason: reason.value }));
      location.reload();
    } catch (error) {
      fill(out, problem(error));
    }
  };
  return el("form", { submit }, el("label", { for: "checked-reason" }, "Why the robot is in order"), el("p.note", {}, "The alarm ends, and sets can be released again. Your name and this reason are kept in the record."),
    el("div.fields", {}, reason, el("div", {}, el("button", { type: "submit" }, "Mark as checked"))), out);
}

/** Probability of calling an unchanged robot changed, as in the service's test. */
const FALSE_ALARMS = 0.01;

/** Whether the two sessions themselves differ: a drift that chance explains is none. */
function beyondChance(sessions) {
  if (!sessions) return "";
  return sessions.probability < FALSE_ALARMS ? "; more than chance" : "; may be chance";
}

/** The rms of a job, as every list has it. */
const rmsOf = ({ job, report }) => job.rms_mm ?? best(report).after.rms_mm;

/** The errors of a report, with the rms that the list of robots has: one figure for one robot. */
function asListed(source, lastSession, now) {
  const { before, after } = best(source);
  if (lastSession) return [before, { ...after, rms_mm: rmsOf(lastSession) }];
  const stored = now?.active ?? now?.newest;
  return [{ ...before, rms_mm: stored?.before_rms_mm ?? before.rms_mm }, { ...after, rms_mm: stored?.after_rms_mm ?? after.rms_mm }];
}

/** The newest error that is known of a set, and where it comes from: the figures, their evidence and their points belong together. */
function errorFacts({ active, report, lastSession, doubt }, now) {
  const which = active ? "active set" : "newest result";
  const source = lastSession?.report ?? report;
  const { n_points: n } = best(source);
  const [before, after] = asListed(source, lastSession, now);
  const [words] = EVIDENCE[source.evidence] ?? [source.evidence];
  const doubted = doubt ? ". The file of a newer session does not fit the robot" : "";
  const evidence = (remark) => {
    return doubt ? ["Evidence", "a newer session does not fit", `the ${sessionOf(doubt)} misses by ${mm(rmsOf(doubt))} rms; before it: ${words}${remark ? `, ${remark}` : ""}`] : ["Evidence", words, remark];
  };
  if (lastSession) {
    const found = foundAgainst(lastSession.report);
    // of the active set the service decides, by the tolerance if there is one; a set that is far off needs none
    const isFarOff = lastSession.report.warnings.some(({ code }) => code === "set_far_off");
    const against = active && !isFarOff ? now?.need === "drifted" && now.reason : found && `${found}: ${mm(after.rms_mm)} rms`;
    return [[`${doubt ? "Error when a session last fitted" : "Error now"} (${which})`, mm(after.rms_mm), ["rms on the ", el("a", { href: `#/jobs/${lastSession.job.id}` }, sessionOf(lastSession)), `; nominal robot ${mm(before.rms_mm)}${doubted}`]],
      ["Largest error", mm(after.max_mm), `of the points of that session; nominal robot ${mm(before.max_mm)}`],
      against && !doubt ? ["Evidence", "a later session speaks against it", capital(against)] : evidence(`${against ? "a later session speaks against it" : "a later session verified it"}: ${count(n)} points`)];
  }
  if (!source.verify || source.evidence === "none") return [[`Error at identification (${which})`, "not verified", source.verify ? "the points that were kept aside are no evidence" : `no point was kept aside; ${mm(after.rms_mm)} on the points of the fit itself`], evidence()];
  return [[`Error at identification (${which})`, mm(after.rms_mm), `rms; nominal robot ${mm(before.rms_mm)}${doubted}`], ["Largest error", mm(after.max_mm), `of the held-out points; nominal robot ${mm(before.max_mm)}`], evidence(`${count(n)} points checked`)];
}

function known({ stand, trend, now }) {
  const { active, newest, drift } = stand;
  if (!newest) return [];
  return facts([
    ["Active set", active ? `released ${age(active.released_at)}` : "none", active ? when(active.released_at) : ["review", "withdrawn"].includes(now?.need) ? now.reason : "the newest result waits for its release"],
    ...errorFacts(stand, now),
    drift && ["Drift", mm(drift.mean_mm), `from the active set to the newest, at the tool on average; at most ${mm(drift.max_mm)}${beyondChance(drift.sessions)}`],
    active && ["Next calibration", trend.days_to_limit === null ? "cannot be said yet" : `in ${Math.round(trend.days_to_limit)} d`, capital(plain(trend.detail))],
  ]);
}

/** What to do next with a robot that has a result. */
function guide({ robot, stand, now, sets, may, why, signal }) {
  if (robot.archived_at || robot.state === "check_robot" || !stand.newest) return [];
  const { active, newest, since, lastJob, lastSession } = stand;
  const link = (kind, href, words) => el(kind, { href }, words);
  const card = (said, ...links) => el("section.card.next", { "aria-label": "What to do next" }, el("h2", {}, "What to do next"), el("p", {}, said), el("div.actions", {}, links));
  const verify = (set, kind = "a.button") => verifyLink(robot, set, { may, why }, kind);
  if (isRunning(lastJob)) return card("A job of this robot is running.", link("a.button.primary", `#/jobs/${lastJob.id}`, "Watch it"));
  const review = since ?? (active ? null : newest);
  const found = lastSession && foundAgainst(lastSession.report);
  if (active && now?.need === "drifted") return card(`The newest session speaks against the active set. ${capital(now.reason)}. The cell runs this set until another one is released, or it is withdrawn.`, since && link("a.button.primary", `#/jobs/${since.job_id}`, "Review the newer result"), link(since ? "a.button" : "a.button.primary", `#/jobs/${now.need_job_id}`, "Look at that session"),
    verify(active), may("identify") && link("a.button", `#/robots/${robot.id}/upload`, "Calibrate anew"), may("release") && link("a.button", `#/jobs/${active.job_id}`, "Withdraw the set"));
  if (review) return card([now?.need === "withdrawn" ? `${capital(now.reason)}. ` : "", active ? "A newer result waits for a review: release it, or keep the active set. " : now?.newest?.refused_by ? `${capital(now.reason)}. ` : "The newest result waits for a review. ", found && !active ? `A later session speaks against it: ${found}. ` : "", releasable(review, sets, now, signal)], link("a.button.primary", `#/jobs/${review.job_id}`, "Review the result"), verify(review));
  if (!lastSession) return card("The active set was not verified by another session yet. Measure some 20 to 30 other poses: only that shows a wrong tool, base or scale.", verify(active, "a.button.primary"), link("a.button", `#/robots/${robot.id}/plan`, "Plan the poses to measure"));
  return card("The active set is in force, and the newest session agrees with it. Verify it with a short session from time to time.", link("a.button.primary", `#/robots/${robot.id}/correct`, "Correct a program"), verify(active));
}

/** Whether a release would be accepted, by the gates. Large sets take them long, so of these only what stored facts decide is told, as in the list. */
function releasable(set, sets, now, signal) {
  const said = el("span", {}, "Its page says what a release still asks for.");
  const tell = (isAccepted, gates) => {
    // the points of the newer result say that the robot is not as the active set has it, as in the list
    const badge = document.getElementById("drifted");
    if (badge && now?.active && now.active.id !== set.id && now.need !== "drifted" && gates.includes("change_plausible")) fill(badge, el("a.badge.bad", { href: `#/jobs/${set.job_id}` }, "drifted"));
    fill(said, isAccepted ? "A release would be accepted now." : `A release would be refused now${gates.length > 0 ? `: ${gates.map((gate) => gateTitle({ gate, passed: false }).replace(/^./, (c) => c.toLowerCase())).join("; ")}` : ""}.`);
  };
  if (now?.newest?.id === set.id && now.newest.refused_by) tell(false, [now.newest.refused_by]);
  if (sets.every(({ n_points: n }) => n <= SOON_JUDGED)) get(`/v1/parameter-sets/${set.id}/gates`, signal).then((found) => tell(found.releasable, found.gates.filter((gate) => !gate.passed).map(({ gate }) => gate)), () => { /* its page says so, too */ });
  return said;
}

function history(entries, sessions, nameOf) {
  if (entries.length === 0) return [];
  return el("div.two", {}, errorHistory(entries, sessions, nameOf), parameterHistory(entries, nameOf));
}

/** A part of the page; an empty one is not shown. */
const section = (title, content, isEmpty = false) => el("section.card", { hidden: isEmpty }, el("h2", {}, title), content);

/** The status of a parameter set or a job. That a job has succeeded says nothing of how good its result is. */
export function statusBadge(status) {
  const kinds = { released: "good", failed: "bad", withdrawn: "bad", running: "wait", queued: "wait", candidate: "wait" };
  return el(kinds[status] ? `span.badge.${kinds[status]}` : "span.badge", {}, status);
}

/** Frames of the measurement sets that parameter sets were identified from, by their job; of the newest only. */
const framesOf = (jobs, sets) => new Map(jobs.map((job) => [job.id, sets.find((set) => set.id === job.measurement_set_id)?.frame]));

/** Significant changes, the most significant first. In an instrument's own frame a base that moved is an instrument that stands elsewhere. */
function moved({ changed: all }, frame) {
  if (!all) return "–";
  const changed = all.filter(({ name }) => frame === "base" || !name.startsWith("base_"));
  if (changed.length === 0) return "nothing beyond chance";
  const surest = [...changed].sort((a, b) => b.sigmas - a.sigmas).slice(0, 3).map((c) => parameter(c.name));
  return changed.length > surest.length ? `${surest.join(", ")} and ${changed.length - surest.length} more` : surest.join(", ");
}

/** Longest reason that is not cut here; the page of the set shows the whole reason. */
const MAX_REASON = 80;

/** Last decision about a set, and its reason. */
function decided(set) {
  const said = decisions(set, MAX_REASON).at(-1);
  return said && el("small.quiet", {}, said);
}

/** Who released and withdrew a set, when and why, in this order: a sentence each. */
export function decisions(set, limit = Infinity) {
  const cut = (reason) => (reason.length > limit ? `${reason.slice(0, limit)} …` : reason);
  const told = (what, at, by, reason) => at && `${what} ${when(at)}${by ? ` by ${by}` : ""}${reason ? `: ${cut(reason)}` : ""}`;
  return [told("Released", set.released_at, set.released_by_name ?? set.released_by, set.release_reason), told("Withdrawn", set.withdrawn_at, set.withdrawn_by_name ?? set.withdrawn_by, set.withdraw_reason)].filter(Boolean);
}

function parameterSets({ robot, entries, jobs, sets, nameOf }) {
  const frames = framesOf(jobs, sets);
  const rms = (set, report) => jobs.find((job) => job.id === set.job_id)?.rms_mm ?? best(report).after.rms_mm;
  const uploaded = (set) => sets.find((one) => one.id === jobs.find((job) => job.id === set.job_id)?.measurement_set_id)?.created_at;
  const measured = (set, report) => ({ created_at: report.measured_at ?? uploaded(set) ?? set.created_at });
  const columns = [
    ["Identified from", ({ set }) => [el("a", { href: `#/jobs/${set.job_id}` }, nameOf(set).replace(/, [^,]*$/, "")), el("small.quiet", {}, `identified ${when(set.created_at)}`)], "name"],
    ["State", ({ set }) => [statusBadge(set.status), decided(set)]],
    ["Moved", ({ set, report }) => moved(report, frames.get(set.job_id)), "name"],
    ["Error, rms", ({ set, report }) => (report.verify && report.evidence !== "none" ? [mm(rms(set, report)), el("small.quiet", {}, `nominal ${mm(best(report).before.rms_mm)}`)] : ["not verified", el("small.quiet", {}, report.verify ? "no evidence" : `fit itself ${mm(best(report).after.rms_mm)}`)]), "n"],
    ["Evidence", ({ report }) => EVIDENCE[report.evidence]?.[0] ?? report.evidence],
    ["Parameters", ({ set, report }) => saveButton("Download", `/v1/parameter-sets/${set.id}`, fileStem(robot, measured(set, report), set.id), ".json", `Download the parameter set of ${nameOf(set)}`)],
  ];
  return table("What was identified, newest first. Moved: parameters that differ from the set before by more than chance, without a base that was measured in the instrument's own frame. Errors and evidence are those at identification, on the verify points.", columns, [...entries].reverse(), "None yet.");
}

function jobTable(jobs) {
  const columns = [
    ["Begun", (job) => el("a", { href: `#/jobs/${job.id}` }, when(job.created_at))],
    ["State", (job) => findingBadge(job) ?? statusBadge(job.status)],
    ["Method", (job) => (job.kind === "verify" ? "verification" : job.kind === "check" ? "check" : method(job.method))],
    ["Measurement set", setsOfJob, "name"],
    ["Took", (job) => (ran(job) === null ? "–" : span(ran(job))), "n"],
    ["Remark", (job) => plain(job.error?.detail ?? ""), "name"],
  ];
  return table(`The last ${SHOWN} jobs: calibrations, and verifications of what was identified. Took: from start to end.`, columns, jobs, "None yet.");
}

function setTable(sets) {
  const columns = [
    ["Name", (set) => set.name ?? "without a name", "name"],
    ["Uploaded", (set) => [when(set.created_at), ...[set.record?.measured_at && measuredAt(set.record), set.record?.instrument_name, set.record?.operator].filter(Boolean).map((text) => el("small.quiet", {}, text))], "name"],
    ["Frame", (set) => (set.frame === "base" ? "robot base" : "instrument")],
    ["Points", (set) => count(set.n_points), "n"],
    ["Configurations", (set) => count(set.n_configurations), "n"],
    ["Remarks", (set) => set.warnings.map((remark) => el("div", {}, brief(remark.detail))), "name"],
    ["File", (set) => savePoints("Download", set, `Download ${set.name ?? set.id}`)],
  ];
  return table(`The last ${SHOWN} uploads.`, columns, sets, "None yet.");
}

function networkTable(networks) {
  const columns = [
    ["Trained", (network) => el("a", { href: `#/jobs/${network.job_id}` }, when(network.created_at))],
    ["Model", (network) => network.model],
    ["Preset", (network) => network.preset],
    ["Hidden nodes", (network) => network.n_hidden, "n"],
    ["Validation error", (network) => number(network.validation_error), "n"],
    ["Weights", (network) => saveButton("Download", `/v1/networks/${network.id}/weights`, network.id, ".safetensors", `Download the weights of ${when(network.created_at)}`)],
  ];
  return table("Small networks that start the next calibration near its answer. Errors in units of the search box.", columns, networks, "None yet.");
}

function nominal(robot) {
  const link = (i) => i + 1;
  const columns = [
    ["Link", ([, i]) => link(i), "n"], ["a, mm", ([l]) => l.a_mm, "n"], ["α, °", ([l]) => l.alpha_deg, "n"], ["d, mm", ([l]) => l.d_mm, "n"],
    ["θ offset, °", ([l]) => l.theta_offset_deg ?? 0, "n"], ["Joint limits, °", ([l]) => l.joint_limits_deg?.join(" to ") ?? "–", "n"],
  ];
  return el("section.card", {}, el("details", {}, el("summary", {}, "Nominal links"), robot.description && el("p.note", {}, robot.description), table("As the robot was registered, in Craig's convention.", columns, robot.links.map((l, i) => [l, i]), "")));
}
