// The job that is posted with a stored set, or with several sessions as one.

import { post } from "./api.js";
import { el, fill, problem } from "./dom.js";
import { count, when } from "./format.js";
import { jobOptions } from "./job_options.js";

function choice(id, label, options) {
  const select = el("select", { id }, options.map(([value, text]) => el("option", { value }, text)));
  return [select, el("div", {}, el("label", { for: id }, label), select)];
}

/** What a job may do, where the robot has parameters to verify. */
const KINDS = [["identify", "Identify parameters"], ["verify", "Only verify the robot's parameters (identifies nothing)"], ["check", "Quick check: do the robot's parameters still hold? (five to ten poses)"]];

/** What may have happened before a quick check. */
const AFTER = [["", "nothing in particular"], ["collision", "a collision"], ["mastering", "joints were mastered anew"], ["motor", "a motor was exchanged"]];

/** Whether a set is large enough only for a verification. */
const onlyVerifies = (set) => set.warnings.some((remark) => remark.code === "under_determined");

/** Parameter sets that can be verified: the active one first, then the newest. Withdrawn sets are left out. */
function verifiable(parameterSets) {
  const usable = parameterSets.filter((set) => set.status !== "withdrawn");
  return [...usable.filter((set) => set.status === "released"), ...usable.filter((set) => set.status !== "released")];
}

/** Most sessions of one job. */
const MAX_SESSIONS = 8;
const sessionName = (set) => `${set.name ?? set.id}: ${count(set.n_points)} points, uploaded ${when(set.created_at)}`;

/** Further sessions of the robot that are fitted together with the chosen set, folded; only sets in the same frame go together. `points` is what the request says of them. */
function furtherSessions(chosen, sets, stored) {
  const all = [...new Map([...sets, ...stored].map((set) => [set.id, set])).values()];
  const list = el("div", {});
  const node = el("details", {}, el("summary", {}, "Fit further sessions together with it"),
    el("p.note", {}, "The same robot, measured again: the instrument stood elsewhere, or the reflector was fixed anew. The links are fitted to all of the points; each session keeps its own base, reflectors and noise. First it is tested whether the sessions are one robot in one state: if not, nothing is fitted together, and the job says what differs."), list);
  const boxes = () => [...list.querySelectorAll("input:checked")];
  const limit = () => { for (const box of list.querySelectorAll("input:not(:checked)")) box.disabled = boxes().length >= MAX_SESSIONS - 1; };
  const draw = () => {
    const { frame } = all.find((set) => set.id === chosen());
    const others = all.filter((set) => set.frame === frame && set.id !== chosen());
    fill(list, others.length === 0 ? el("p.empty", {}, "The robot has no other set in this frame.") : others.map((set) => el("label.choice", {}, el("input", { type: "checkbox", value: set.id, change: limit }), sessionName(set))));
  };
  const points = () => {
    const ids = [chosen(), ...boxes().map((box) => box.value)];
    // the base is that of the last session: the newest
    const inOrder = all.filter((set) => ids.includes(set.id)).sort((a, b) => Date.parse(a.created_at) - Date.parse(b.created_at));
    return ids.length > 1 ? { measurement_set_ids: inOrder.map((set) => set.id) } : { measurement_set_id: chosen() };
  };
  draw();
  return { node, draw, points };
}

/** What hung on the flange while the points were measured: its mass, and where its centre of mass is. */
function payloadFields(n) {
  const number = (name, label, more) => el("input", { id: `job-payload-${name}-${n}`, type: "number", step: "any", "aria-label": label, placeholder: name, ...more });
  const mass = number("mass", "Payload while measuring, kg", { min: 0, max: 10000, placeholder: "not stated" });
  const centre = ["x", "y", "z"].map((axis) => number(axis, `Centre of mass ${axis}, mm`, { min: -10000, max: 10000 }));
  const node = el("div", {}, el("div.fields", {}, el("div", {}, el("label", { for: mass.id }, "Payload while measuring, kg"), mass), el("fieldset", {}, el("legend", {}, "Its centre of mass in the flange frame, mm"), el("div.controls", {}, centre))),
    el("p.note", {}, "The report prints it, and corrections of the sag then hold for other payloads, too. An empty centre is the flange's origin."));
  const typed = () => centre.filter((input) => input.value !== "");
  const isHalf = () => (mass.value === "" && typed().length > 0) || ![0, 3].includes(typed().length);
  const read = () => (mass.value === "" ? {} : { payload: { mass_kg: Number(mass.value), ...typed().length === 3 ? { centre_mm: centre.map((input) => Number(input.value)) } : {} } });
  return { node, isHalf, read };
}

let forms = 0;

/** The job that is posted with a set. Whoever came to verify finds that chosen, with the parameters to score and the newest other session. */
export function jobForm(robot, sets, { parameterSets, hasNetwork, verifying, sets: stored = sets }) {
  forms += 1;
  const n = forms;
  const [set, setField] = choice(`job-set-${n}`, "Measurement set", sets.map((s) => [s.id, `${s.name ?? s.id} (${s.n_points} points)`]));
  const [method, methodField] = choice(`job-method-${n}`, "Method", [
    ["auto", "automatic (recommended)"], ["least_squares", "least squares"], ["pso", "particle swarm"], ...hasNetwork ? [["bpnn_pso", "swarm from the network"]] : []]);
  const [verify, verifyField] = choice(`job-verify-${n}`, "Verify on", [
    ["", "its verify points, else half"], ...sets.length > 1 ? sets.map((s) => [s.id, `another session: ${s.name ?? s.id}`]) : []]);
  const [preset, presetField] = choice(`job-preset-${n}`, "Search settings", [["default", "recommended"], ["paper", "those of the paper"]]);
  const candidates = verifiable(parameterSets);
  const other = verifying && sets.find((s) => s.id !== verifying.identified.id);
  if (other) set.value = other.id;
  const [scored, scoredField] = choice(`job-scored-${n}`, "Parameters to score", candidates.map((p) => [p.id, `${p.status === "released" ? "active" : p.status}, identified ${when(p.created_at)}`]));
  const [after, afterField] = choice(`job-after-${n}`, "What happened before", AFTER);
  const kinds = el("fieldset.kinds", { hidden: candidates.length === 0 }, el("legend", {}, "What to do"),
    KINDS.map(([value, text]) => el("label.choice", {}, el("input", { type: "radio", name: `job-kind-${n}`, value }), text)));
  if (verifying && candidates.some((p) => p.id === verifying.set.id)) scored.value = verifying.set.id;
  const further = furtherSessions(() => set.value, sets, stored);
  const options = jobOptions(robot);
  const payload = payloadFields(n);
  const out = el("div", {});
  const button = el("button.primary", { type: "submit" });
  const kind = () => kinds.querySelector("input:checked").value;
  const shape = () => {
    const verifies = kind() !== "identify";
    for (const field of [methodField, verifyField, presetField, payload.node, options.node, further.node]) field.hidden = verifies;
    scoredField.hidden = !verifies;
    afterField.hidden = kind() !== "check";
    fill(button, { verify: "Start verification", check: "Start check" }[kind()] ?? "Start calibration");
  };
  const preselect = () => {
    const chosen = sets.find((s) => s.id === set.value);
    kinds.querySelector(`[value=${candidates.length > 0 && (verifying || onlyVerifies(chosen)) ? "verify" : "identify"}]`).checked = true;
    shape();
  };
  set.addEventListener("change", () => { further.draw(); preselect(); });
  kinds.addEventListener("change", shape);
  preselect();
  const submit = async (event) => {
    event.preventDefault();
    if (kind() === "identify" && payload.isHalf()) return fill(out, problem({ title: "The payload is not complete", detail: "Type its mass. Of the centre of mass type all three numbers, or none" }));
    button.disabled = true;
    const request = kind() !== "identify" ? { kind: kind(), measurement_set_id: set.value, parameter_set_id: scored.value, ...kind() === "check" && after.value ? { after: after.value } : {} }
      : options.add({ ...further.points(), method: method.value, preset: preset.value, ...payload.read() });
    if (kind() === "identify" && verify.value) request.verify = { source: "set", measurement_set_id: verify.value };
    try {
      const job = await post(`/v1/robots/${robot.id}/jobs`, request);
      location.hash = `#/jobs/${job.id}`;
    } catch (error) {
      fill(out, problem(error));
      button.disabled = false;
    }
  };
  return el("form", { submit }, kinds, el("div.fields", {}, setField, methodField, verifyField, presetField, scoredField, afterField), payload.node, further.node, options.node, out, button);
}
