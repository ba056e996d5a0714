// One job: its progress while it runs, then its result.

import { follow, get, post } from "./api.js";
import { armFigure } from "./arm.js";
import { convergence } from "./figures.js";
import { el, fill, problem, say } from "./dom.js";
import { capital, count, instrument, measuredAt, method, number, when } from "./format.js";
import { statusBadge } from "./robot.js";
import { result } from "./result.js";
import { selection } from "./selection.js";
import { nPoints, rotationsOf, setIds, setsInWords } from "./sessions.js";
import { FAILURES, STAGES } from "./words.js";

const isOver = (job) => !["queued", "running"].includes(job.status);

/** The page of one job. */
export async function jobPage(context, id) {
  const { main, signal, may } = context;
  let job = await get(`/v1/jobs/${id}`, signal);
  const [robot, sets, verified] = await Promise.all([get(`/v1/robots/${job.robot_id}`, signal), Promise.all(setIds(job).map((set) => get(`/v1/measurement-sets/${set}`, signal))), scoredSet(job, signal)]);
  document.title = `kincal: ${noun(job)} of ${robot.name}`;
  const [top, body] = [el("div", {}), el("div", {})];
  fill(main, top, body);
  fill(top, head(job, robot, sets, verified));
  if (!isOver(job)) {
    const live = watch(job, may);
    fill(body, live.node, armOf(robot));
    job = await follow(id, live, signal);
    say(`The ${noun(job)} ${job.status === "succeeded" ? "is done" : `has ${job.status === "failed" ? "failed" : "been cancelled"}`}`);
    fill(top, head(job, robot, sets, verified));
  }
  if (signal.aborted) return;
  if (job.status === "succeeded") await result(body, context, { job, robot, sets, verified });
  else fill(body, ending(job, robot, context));
}

const noun = (job) => ({ verify: "verification", check: "check" }[job.kind] ?? "calibration");

/** The parameter set that a job of kind verify or check scores; null where that is the nominal robot, or an older server does not say. */
function scoredSet(job, signal) {
  const id = job.kind !== "identify" && (job.parameter_set_from ?? job.request?.parameter_set_id);
  return id ? get(`/v1/parameter-sets/${id}`, signal) : null;
}

/** The request of the job. */
function asked(job, verified) {
  if (job.kind === "identify") return `method: ${method(job.method)}`;
  if (!verified) return "nothing is identified";
  return ["scores the ", el("a", { href: `#/jobs/${verified.job_id}` }, `parameters identified ${when(verified.created_at)}`), `, now ${verified.status}; nothing is identified`];
}

function head(job, robot, sets, verified) {
  const [set] = sets;
  const frame = `${set.frame === "base" ? "robot base" : "instrument"} frame`;
  const stated = `${set.instrument ? `; instrument: ${instrument(set.instrument)}` : ""}${set.record?.measured_at ? `; ${measuredAt(set.record)}` : ""}${rotationsOf(set).map((said) => `; ${said}`).join("")}`;
  const points = sets.length > 1 ? `${sets.length} sessions, ${count(nPoints(sets))} points together, ${frame}: ${setsInWords(sets)}` : `${set.name ?? "a set without a name"} (${count(set.n_points)} points, ${frame}${stated})`;
  return el("div.head", {}, el("div", {}, el("p.crumbs", {}, el("a", { href: "#/" }, "Robots"), " / ", el("a", { href: `#/robots/${robot.id}` }, robot.name)),
    el("h1", {}, `${capital(noun(job))} of ${robot.name}`),
    el("p.quiet", {}, `${job.kind !== "identify" ? "on" : "from"} ${points} · begun ${when(job.created_at)} · `, asked(job, verified))),
    el("div.actions", { "data-state": job.id }, statusBadge(job.status)));
}

/** The robot that is being measured, while there is nothing else to look at. */
const armOf = (robot) => armFigure({ title: "The robot", level: "h2", caption: "The nominal arm at rest. The measured points appear with the result.", robot, points: [], selected: selection(0) }).node;

/** Why there is no result, and what to do about it. */
function ending(job, robot, { may, why }) {
  const out = el("div", {});
  const again = (text, changes, kind = "button") => el(kind, { type: "button", click: async () => {
    try {
      const { request } = await get(`/v1/jobs/${job.id}`);
      const next = await post(`/v1/robots/${robot.id}/jobs`, { ...request, ...changes });
      location.hash = `#/jobs/${next.id}`;
    } catch (error) {
      fill(out, problem(error));
    }
  } }, text);
  const isMethod = job.kind !== "verify" && job.method !== "auto";
  const next = el("section.card.next", { "aria-label": "What to do next" }, el("h2", {}, "What to do next"), el("p", {}, job.status === "failed" ? FAILURES[job.error?.code] ?? FAILURES.other : "Nothing is lost: the points are stored."), out,
    el("div.actions", {}, may("identify") && [isMethod && again("With the automatic method", { method: "auto", preset: "default", options: undefined }, "button.primary"), again("Start it again", {})], el("a.button", { href: `#/robots/${robot.id}` }, `To ${robot.name}`)),
    why("identify", "start another calibration"));
  if (job.status === "failed") return [problem({ title: `The ${noun(job)} failed`, ...job.error }), next];
  return [el("p", {}, `The ${noun(job)} was cancelled; nothing came out of it.`), next];
}

const WAITING = "Waiting for a worker …";

/** The current stage in words. No remaining time is shown: only the main method has iterations, and it seldom reaches their limit. */
function at({ stage, iteration, n_iterations, best_cost_mm2 }) {
  const words = STAGES[stage] ?? "Computing";
  if (!iterates(stage) || n_iterations === 0) return `${words} …`;
  const cost = best_cost_mm2 === null ? "" : ` Smallest cost so far: ${number(best_cost_mm2)} mm².`;
  return `${words}: iteration ${iteration} of at most ${n_iterations}.${cost}`;
}

/** Whether the iterations are those of what it is at; an older server does not say. */
const iterates = (stage) => stage === undefined || ["least_squares", "pso", "bpnn_pso"].includes(stage);

/** Progress by stages, and the curve so far. */
function watch(first, may) {
  const bar = el("progress", { max: 1, "aria-label": `Progress of the ${noun(first)}` });
  const text = el("p", {}, WAITING);
  const plot = el("div", {});
  const out = el("div", {});
  const cancel = async () => {
    try {
      await post(`/v1/jobs/${first.id}/cancel`, {});
      say("Cancelling");
    } catch (error) {
      fill(out, problem(error));
    }
  };
  const node = el("div", {}, el("section.card", {}, el("h2", {}, "Running"), bar, text, out, may("identify") && el("button.danger", { type: "button", click: cancel }, "Cancel")), plot);
  const curve = { iteration: [], best_cost_mm2: [], limit: 1 };
  let chart = null;
  const moved = (job) => {
    const progress = job.progress;
    if (isOver(job)) return;
    const badge = document.querySelector(`[data-state="${first.id}"]`);
    if (badge) fill(badge, statusBadge(job.status));
    if (job.status === "queued") fill(text, WAITING);
    if (job.status === "running") fill(text, progress ? at(progress) : "A worker has begun …");
    if (job.status === "queued" || !progress || !iterates(progress.stage) || progress.n_iterations === 0) {
      // Such a stage has no measurable progress.
      bar.removeAttribute("value");
      return;
    }
    bar.max = progress.n_iterations;
    bar.value = progress.iteration;
    if (progress.best_cost_mm2 === null || progress.iteration <= (curve.iteration.at(-1) ?? -1)) return;
    curve.iteration.push(progress.iteration);
    curve.best_cost_mm2.push(progress.best_cost_mm2);
    curve.limit = progress.n_iterations;
    if (curve.iteration.length < 2) return;
    if (chart) chart.redraw();
    else fill(plot, (chart = convergence(curve, "The smallest cost F so far, mm²; the axis ends at the limit of iterations.")));
  };
  const lost = () => fill(text, "The server does not answer. This page waits for it; the job is not lost.");
  moved(first);
  return { node, moved, lost };
}
