// One robot: its state, its history, and its stored documents.

import { get, list, post } from "./api.js";
import { brief, el, fill, problem, table } from "./dom.js";
import { age, error, EVIDENCE, method, mm, number, parameter, ran, span, when } from "./format.js";
import { best, errorHistory, parameterHistory, past, state } from "./history.js";
import { manageCard } from "./manage.js";
import { facts, standing } from "./robots.js";
import { saveButton, savePoints } from "./save.js";
import { uploadCard } from "./upload.js";

const SHOWN = 20;

/** The page of one robot. */
export async function robotPage({ main, signal, may, why }, id) {
  const robot = await get(`/v1/robots/${id}`, signal);
  document.title = `kincal: ${robot.name}`;
  const [stand, sets, jobs, networks] = await Promise.all([
    state(robot, signal),
    list(`/v1/robots/${id}/measurement-sets`, SHOWN, signal),
    list(`/v1/robots/${id}/jobs`, SHOWN, signal),
    list(`/v1/robots/${id}/networks`, SHOWN, signal),
  ]);
  const [entries, { trend }] = await Promise.all([past(stand, signal), get(`/v1/robots/${id}/history?limit=1`, signal)]);
  const uploads = el("div", {}, setTable(sets));
  const uploaded = (set) => {
    sets.unshift(set);
    fill(uploads, setTable(sets));
  };
  fill(main, head(robot, stand), checkRobot(robot, may), known(robot, stand, trend), uploadCard(robot, sets, stand.sets, may, uploaded), may("upload") ? why("identify", "start calibrations") : why("upload", "upload measured points"), history(entries),
    section("Parameter sets", parameterSets(entries)), section("Jobs", jobTable(jobs, sets)), section("Measurement sets", uploads),
    networks.length > 0 && section("Networks", networkTable(networks)), manageCard(robot, stand.sets, may, signal), nominal(robot));
}

function head(robot, stand) {
  const details = [robot.serial_number && `serial number ${robot.serial_number}`, robot.description, `${robot.links.length} ${robot.links.length === 1 ? "joint" : "joints"}`].filter(Boolean);
  return el("div.head", {}, el("div", {}, el("p.crumbs", {}, el("a", { href: "#/" }, "Robots")), el("h1", {}, robot.name), el("p.quiet", {}, details.join(" · "))),
    el("div.actions", {}, standing({ robot, ...stand }), el("a.button", { href: `#/robots/${robot.id}/plan` }, "Plan poses"), stand.newest && el("a.button", { href: `#/robots/${robot.id}/correct` }, "Correct a program"), stand.sets.length > 1 && el("a.button", { href: `#/robots/${robot.id}/compare` }, "Compare sets")));
}

/** What to do where a session does not fit the robot. */
function checkRobot(robot, may) {
  if (robot.state !== "check_robot") return [];
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
  return el("section.card", {}, el("h2", {}, "Check this robot"),
    el("p", {}, "The file of ", el("a", { href: `#/jobs/${robot.check_job_id}` }, "this verification"), " does not fit this robot: it is in another frame or of another robot, or the robot has changed. No release is made until a new session fits, or somebody says why all is well."),
    may("release") && el("form", { submit }, el("label", { for: "checked-reason" }, "Why all is well"),
      el("div.fields", {}, reason, el("div", {}, el("button", { type: "submit" }, "Say so"))), out));
}

/** Probability of calling an unchanged robot changed, as in the service's test. */
const FALSE_ALARMS = 0.01;

/** Whether the two sessions themselves differ: a drift that chance explains is none. */
function beyondChance(sessions) {
  if (!sessions) return "";
  return sessions.probability < FALSE_ALARMS ? "; more than chance" : "; may be chance";
}

function known(robot, { active, newest, report, drift }, trend) {
  if (!newest) return el("p", {}, "This robot has not been calibrated yet. Upload measured points below to begin.");
  const now = best(report);
  return facts([
    ["Active set", active ? `released ${age(active.released_at)}` : "none", active ? when(active.released_at) : "the newest result waits for its release"],
    [`Error now (${active ? "active set" : "newest result"})`, mm(now.after.rms_mm), `rms; nominal robot ${mm(now.before.rms_mm)}`],
    ["Largest error", mm(now.after.max_mm), `nominal robot ${mm(now.before.max_mm)}`],
    ["Evidence", EVIDENCE[report.evidence]?.[0] ?? report.evidence, `${now.n_points} points checked`],
    drift && ["Drift", mm(drift.mean_mm), `from the active set to the newest, at the tool on average; at most ${mm(drift.max_mm)}${beyondChance(drift.sessions)}`],
    active && ["Next calibration", trend.days_to_limit === null ? "cannot be said yet" : `in ${Math.round(trend.days_to_limit)} d`, trend.detail],
  ]);
}

function history(entries) {
  if (entries.length === 0) return [];
  return el("div.two", {}, errorHistory(entries), parameterHistory(entries));
}

const section = (title, content) => el("section.card", {}, el("h2", {}, title), content);

/** The status of a parameter set or a job. That a job has succeeded says nothing of how good its result is. */
export function statusBadge(status) {
  const kinds = { released: "good", failed: "bad", withdrawn: "bad", running: "wait", queued: "wait", candidate: "wait" };
  return el(kinds[status] ? `span.badge.${kinds[status]}` : "span.badge", {}, status);
}

/** Significant changes, the most significant first. */
function moved({ changed }) {
  if (!changed) return "–";
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
  return [told("Released", set.released_at, set.released_by, set.release_reason), told("Withdrawn", set.withdrawn_at, set.withdrawn_by, set.withdraw_reason)].filter(Boolean);
}

function parameterSets(entries) {
  const columns = [
    ["Identified", ({ set }) => el("a", { href: `#/jobs/${set.job_id}` }, when(set.created_at))],
    ["State", ({ set }) => [statusBadge(set.status), decided(set)]],
    ["Moved", ({ report }) => moved(report), "name"],
    ["Error, rms", ({ report }) => [mm(best(report).after.rms_mm), el("small.quiet", {}, `nominal ${error(best(report).before.rms_mm)}`)], "n"],
    ["Evidence", ({ report }) => EVIDENCE[report.evidence]?.[0] ?? report.evidence],
    ["Parameters", ({ set }) => saveButton("Download", `/v1/parameter-sets/${set.id}`, set.id, ".json", `Download the parameter set of ${when(set.created_at)}`)],
  ];
  return table("What was identified, newest first. Moved: parameters that differ from the set before by more than chance. Errors are those on the verify points.", columns, [...entries].reverse(), "None yet.");
}

function jobTable(jobs, sets) {
  const name = (job) => sets.find((set) => set.id === job.measurement_set_id)?.name ?? "without a name";
  const columns = [
    ["Begun", (job) => el("a", { href: `#/jobs/${job.id}` }, when(job.created_at))],
    ["State", (job) => statusBadge(job.status)],
    ["Method", (job) => (job.kind === "verify" ? "verification" : job.kind === "check" ? "check" : method(job.method))],
    ["Measurement set", name, "name"],
    ["Took", (job) => (ran(job) === null ? "–" : span(ran(job))), "n"],
    ["Remark", (job) => job.error?.detail ?? "", "name"],
  ];
  return table(`The last ${SHOWN} jobs: calibrations, and verifications of what was identified. Took: from start to end.`, columns, jobs, "None yet.");
}

function setTable(sets) {
  const columns = [
    ["Name", (set) => set.name ?? "without a name", "name"],
    ["Uploaded", (set) => when(set.created_at)],
    ["Frame", (set) => (set.frame === "base" ? "robot base" : "instrument")],
    ["Points", (set) => set.n_points, "n"],
    ["Configurations", (set) => set.n_configurations, "n"],
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
  return el("section.card", {}, el("details", {}, el("summary", {}, "Nominal links"), table("As the robot was registered, in Craig's convention.", columns, robot.links.map((l, i) => [l, i]), "")));
}
