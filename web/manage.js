// What a robot is called and how it hangs, the policy of its releases, going back to the set before, and the archive.

import { get, patch, post, put } from "./api.js";
import { el, fill, problem, say } from "./dom.js";

/** What can be done with a robot, folded. */
export function manageCard(robot, sets, { may, why, signal }) {
  const body = el("div", {});
  let drawn = false;
  const open = async (event) => {
    if (!event.target.open || drawn) return;
    drawn = true;
    try {
      const [policy, contract] = await Promise.all([get(`/v1/robots/${robot.id}/policy`, signal), get("/openapi.json", signal)]);
      fill(body, may("upload") && editForm(robot), policyForm(robot, policy, may), may("release") ? rollback(robot, sets) : why("release", "roll back to the set before"), archive(robot, contract, may), why("upload", "rename this robot, archive or restore it"));
    } catch (error) {
      if (error.name !== "AbortError") fill(body, problem(error));
    }
  };
  return el("section.card", {}, el("details", { toggle: open }, el("summary", {}, "Name, mounting, joint limits, policy of releases, rollback, archive"), body));
}

/** How an arm may hang: [value, words]. */
export const MOUNTINGS = [["floor", "on the floor"], ["wall", "on a wall"], ["ceiling", "on the ceiling"]];
/** What stands before them while nobody has stated it. */
export const NOT_STATED = ["", "not stated: the floor is assumed"];

function editForm(robot) {
  const out = el("div", {});
  const field = (id, label, input) => el("div", {}, el("label", { for: id }, label), input);
  const name = el("input", { id: "edit-name", value: robot.name, required: true, maxlength: 200 });
  const serial = el("input", { id: "edit-serial", value: robot.serial_number ?? "", maxlength: 200 });
  const isOther = robot.mounting && typeof robot.mounting !== "string";
  const mounting = el("select", { id: "edit-mounting" }, [...isOther ? [["other", "as it was stated"]] : robot.mounting ? [] : [NOT_STATED], ...MOUNTINGS].map(([value, words]) => el("option", { value, selected: value === (isOther ? "other" : robot.mounting ?? "") }, words)));
  const before = mounting.value;
  const limits = robot.links.map(({ joint_limits_deg: known }, i) => ["lower", "upper"].map((end, k) => el("input", { type: "number", step: "any", min: -3600, max: 3600, value: known?.[k] ?? "", "aria-label": `Joint ${i + 1}, ${end} limit, °` })));
  const stated = () => limits.map(([lower, upper]) => (lower.value === "" && upper.value === "" ? null : [lower, upper].map((input) => (input.value === "" ? null : Number(input.value)))));
  const knownLimits = JSON.stringify(stated());
  const submit = async (event) => {
    event.preventDefault();
    try {
      const changes = {};
      if (name.value !== robot.name) changes.name = name.value;
      if (serial.value.trim() !== (robot.serial_number ?? "")) changes.serial_number = serial.value.trim() || null;
      if (mounting.value !== before) changes.mounting = mounting.value;
      if (JSON.stringify(stated()) !== knownLimits) {
        const half = stated().findIndex((pair) => pair?.includes(null));
        if (half >= 0) return fill(out, el("div.problem", { role: "alert" }, el("p", {}, `Joint ${half + 1} has one limit: type both, or neither.`)));
        changes.joint_limits_deg = stated();
      }
      if (Object.keys(changes).length === 0) return say("Nothing was changed");
      await patch(`/v1/robots/${robot.id}`, changes);
      location.reload();
    } catch (error) {
      fill(out, problem(error));
    }
  };
  return el("form", { submit }, el("h3", {}, "Name"), el("p.note", {}, "The serial number stands in the report, and tells two arms of one type apart. The mounting says which way the arm sags."),
    el("div.fields", {}, field("edit-name", "Name", name), field("edit-serial", "Serial number", serial), field("edit-mounting", "Mounting", mounting)),
    el("fieldset", {}, el("legend", {}, "Joint limits, °, lower and upper"), el("p.note", {}, "Pose plans and corrected programs stay within them. A joint without limits stays empty."),
      el("div.fields", {}, limits.map((pair, i) => el("div.controls", {}, el("span", {}, `Joint ${i + 1}`), pair)))), out, el("p", {}, el("button", { type: "submit" }, "Store")));
}

/** The decision rules of ILAC-G8 and JCGM 106. */
const RULES = [["guarded_acceptance", "guarded: rms plus its uncertainty"], ["simple_acceptance", "simple: rms alone"]];

function policyForm(robot, policy, may) {
  const out = el("div", {});
  const locked = !may("admin");
  const tolerance = el("input", { id: "policy-tolerance", type: "number", min: 0, step: "any", value: policy.tolerance_mm ?? "", placeholder: "none", disabled: locked });
  const rule = el("select", { id: "policy-rule", disabled: locked }, RULES.map(([value, words]) => el("option", { value, selected: value === policy.decision_rule }, words)));
  const box = (checked) => el("input", { type: "checkbox", checked, disabled: locked });
  const [session, person] = [box(policy.independent_session_required), box(policy.second_person_required)];
  const submit = async (event) => {
    event.preventDefault();
    try {
      await put(`/v1/robots/${robot.id}/policy`, { ...policy, tolerance_mm: tolerance.value === "" ? null : Number(tolerance.value), decision_rule: rule.value, independent_session_required: session.checked, second_person_required: person.checked });
      fill(out, el("div.done", {}, el("p", {}, "Stored. It holds from the next release on.")));
      say("Policy stored");
    } catch (error) {
      fill(out, problem(error));
    }
  };
  return el("form", { submit }, el("h3.below", {}, "Policy"), el("p.note", {}, "What a parameter set must fulfil before this robot uses it, beside what always holds."),
    el("div.fields", {}, el("div", {}, el("label", { for: "policy-tolerance" }, "Tolerance, mm (rms on verify points, and uncertainty at the tool)"), tolerance),
      el("div", {}, el("label", { for: "policy-rule" }, "What must be within the tolerance (95 %)"), rule)),
    el("label.choice", {}, session, "another measuring session must have verified it"), el("label.choice", {}, person, "who releases must not be who uploaded"),
    out, locked ? el("p.note", {}, "Changing the policy takes a key with the scope admin.") : el("p", {}, el("button", { type: "submit" }, "Store the policy")));
}

function rollback(robot, sets) {
  if (!sets.some((set) => set.status === "released") || !sets.some((set) => set.status === "superseded")) return false;
  return reasoned({ title: "Rollback", note: "Takes the active set out of force and releases the one that was active before it.", label: "Why", button: "Roll back", kind: "button.danger", id: "rollback-reason",
    send: (reason) => post(`/v1/robots/${robot.id}/parameter-sets/rollback`, JSON.stringify({ reason })) });
}

/** Only where this server has the route. */
function archive(robot, contract, may) {
  const away = robot.archived_at ? "restore" : "archive";
  if (!contract.paths?.[`/v1/robots/{robot_id}/${away}`]) return false;
  if (!may("upload")) return false;
  return reasoned({ title: robot.archived_at ? "Restore" : "Archive", note: robot.archived_at ? "Lists the robot again." : "Takes the robot out of the lists. Nothing is deleted, and its released history stays.", label: "Why", button: robot.archived_at ? "Restore" : "Archive", kind: "button", id: "archive-reason",
    send: (reason) => post(`/v1/robots/${robot.id}/${away}`, JSON.stringify({ reason })) });
}

function reasoned({ title, note, label, button, kind, id, send }) {
  const out = el("div", {});
  const reason = el("input", { id, required: true, maxlength: 2000 });
  const submit = async (event) => {
    event.preventDefault();
    try {
      await send(reason.value);
      location.reload();
    } catch (error) {
      fill(out, problem(error));
    }
  };
  return el("form", { submit }, el("h3.below", {}, title), el("p.note", {}, note), el("label", { for: id }, label), el("div.fields", {}, reason, el("div", {}, el(kind, { type: "submit" }, button))), out);
}
