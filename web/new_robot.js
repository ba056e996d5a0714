// Adds a robot: from its file, from a URDF, or from a table of its links; with the arm to look at before anything is stored.

import { get, post } from "./api.js";
import { el, fill, problem } from "./dom.js";
import { MOUNTINGS, NOT_STATED } from "./manage.js";
import { postureCheck } from "./posture.js";
import { fileForm } from "./robot_file.js";

/** Most joints of a robot, as the service has it. */
const MAX_JOINTS = 12;
const COLUMNS = [["a_mm", "a, mm"], ["alpha_deg", "α, °"], ["d_mm", "d, mm"], ["theta_offset_deg", "θ offset, °"], ["low", "least, °"], ["high", "most, °"]];

/** The card. */
export function newRobot() {
  const out = el("div", { "aria-live": "polite" });
  const show = (robot, remarks = []) => { fill(out, remarks.map((remark) => el("p.note", {}, remark)), check(robot)); out.scrollIntoView({ block: "nearest" }); };
  const waits = (said) => fill(out, el("p.note", { role: "status" }, said));
  const failed = (error) => fill(out, problem(error));
  return el("section.card", { id: "add-robot" }, el("h2", {}, "Add a robot"), el("p.note", {}, "Take an arm from the library, a file, or a table. Nothing is stored before you have seen the arm and confirmed it."),
    library(show, failed), fileForm({ show, failed, waits }), el("details", {}, el("summary", {}, "Or fill in a table of the links"), tableForm(show)), out);
}

/** A type as it is compared: however it is spaced, "KR 10 R1100" is "kr10r1100". */
const squeezed = (text) => text.toLowerCase().replace(/[^\p{L}\p{N}]/gu, "");

/** Ready arms, where this server has a library of them. */
function library(show, failed) {
  const place = el("div", {});
  const open = async () => {
    try {
      const { items } = await get("/v1/robot-models?limit=200");
      const select = el("select", { id: "robot-model" });
      const count = el("span.note", { role: "status" });
      const search = el("input", { id: "robot-model-search", type: "search", placeholder: "maker or type", autocomplete: "off", input: () => draw() });
      const draw = () => {
        const words = search.value.split(/\s+/).map(squeezed).filter(Boolean);
        const found = items.filter((model) => words.every((word) => squeezed(`${model.maker} ${model.name}`).includes(word)));
        // "kr 10" as it stands comes before a type that has its parts elsewhere
        const isWhole = (model) => squeezed(`${model.maker} ${model.name}`).includes(squeezed(search.value));
        fill(select, [...found.filter(isWhole), ...found.filter((model) => !isWhole(model))].map((model) => el("option", { value: model.id }, `${model.maker} ${model.name}${model.n_joints === 6 ? "" : `, ${model.n_joints} joints`}`)));
        select.disabled = look.disabled = found.length === 0;
        fill(count, found.length === items.length ? `${items.length} arms` : found.length === 0 ? `No arm matches "${search.value.trim()}". Try the maker or a part of the type, or add it by its file below.` : `${found.length} of ${items.length} arms`);
      };
      const use = async () => { if (!select.value) return; try { const found = await get(`/v1/robot-models/${select.value}`); show(found.robot ?? found); } catch (error) { failed(error); } };
      const look = el("button", { type: "button", click: use }, "Look at it");
      draw();
      fill(place, el("div.controls", {}, el("span.pair", {}, el("label.inline", { for: "robot-model-search" }, "Find"), search), el("span.pair", {}, el("label.inline", { for: "robot-model" }, "Ready arms"), select), look, count));
    } catch (error) {
      fill(place, error.status === 404 ? el("p.note", {}, "This server has no library of ready arms.") : problem(error));
    }
  };
  return el("details", { toggle: (event) => event.target.open && place.childNodes.length === 0 && open() }, el("summary", {}, "Choose from the library of ready arms"), place);
}

function tableForm(show) {
  const name = el("input", { id: "robot-name", maxlength: 200, required: true });
  const joints = el("input", { id: "robot-joints", type: "number", min: 1, max: MAX_JOINTS, value: 6 });
  const body = el("tbody", {});
  const cell = (i, [key, label]) => el("td", {}, el("input", { type: "number", step: "any", "data-key": key, "aria-label": `Link ${i + 1}, ${label}` }));
  const grow = () => {
    const n = Math.max(1, Math.min(MAX_JOINTS, Number(joints.value) || 1));
    while (body.children.length > n) body.lastChild.remove();
    while (body.children.length < n) { const i = body.children.length; body.append(el("tr", {}, el("th", { scope: "row" }, i + 1), COLUMNS.map((column) => cell(i, column)))); }
  };
  joints.addEventListener("input", grow);
  grow();
  const out = el("div", {});
  const submit = (event) => {
    event.preventDefault();
    const missing = [...body.children].flatMap((row, i) => missingIn(row, i));
    for (const input of body.querySelectorAll("[aria-invalid]")) input.removeAttribute("aria-invalid");
    fill(out, missing.length > 0 && problem({ title: "The table is not complete", detail: "Nothing was taken as 0", errors: missing.map(({ said }) => ({ detail: said })) }));
    if (missing.length > 0) {
      for (const { input } of missing) input.setAttribute("aria-invalid", "true");
      missing[0].input.focus();
      return;
    }
    const links = [...body.children].map((row) => {
      const values = valuesIn(row);
      const limits = values.low !== "" ? { joint_limits_deg: [Number(values.low), Number(values.high)] } : {};
      return { a_mm: Number(values.a_mm), alpha_deg: Number(values.alpha_deg), d_mm: Number(values.d_mm), theta_offset_deg: Number(values.theta_offset_deg), ...limits };
    });
    show({ name: name.value, links });
  };
  return el("form", { submit }, el("p.note", {}, "Craig's convention: Rx(α) · Dx(a) · Rz(q + θ) · Dz(d) from each link to the next."),
    el("div.fields", {}, el("div", {}, el("label", { for: "robot-name" }, "Name"), name), el("div", {}, el("label", { for: "robot-joints" }, "Joints"), joints)),
    el("div.scroll.links", { tabindex: 0, role: "region", "aria-label": "Links" }, el("table", {}, el("thead", {}, el("tr", {}, ["Link", ...COLUMNS.map(([, label]) => label)].map((h) => el("th", { scope: "col" }, h)))), body)), el("p.note", {}, "Type 0 where a number is 0. A joint without limits has both cells empty."), out,
    el("div.actions", {}, el("button", { type: "submit" }, "Look at the arm")));
}

const valuesIn = (row) => Object.fromEntries([...row.querySelectorAll("input")].map((input) => [input.dataset.key, input.value]));

/** The cells of a link that have to be filled in: {input, said}. */
function missingIn(row, i) {
  const values = valuesIn(row);
  const cell = (key) => row.querySelector(`[data-key=${key}]`);
  const empty = COLUMNS.slice(0, 4).filter(([key]) => values[key] === "").map(([key, label]) => ({ input: cell(key), said: `Link ${i + 1}: ${label} is empty` }));
  const lone = (values.low === "") !== (values.high === "") ? [{ input: cell(values.low === "" ? "low" : "high"), said: `Link ${i + 1} has one joint limit: type both, or neither` }] : [];
  return [...empty, ...lone];
}

/** The arm in a posture to compare with the pendant, and the button that stores it. */
function check(robot) {
  if (!Array.isArray(robot.links) || robot.links.length === 0) return problem({ title: "No links", detail: "A robot has links; this file names none." });
  const out = el("div", {});
  const name = el("input", { id: "robot-stored-name", value: robot.name ?? "", maxlength: 200, required: true });
  const serial = el("input", { id: "robot-stored-serial", value: robot.serial_number ?? "", maxlength: 200, placeholder: "on the type plate" });
  const mounting = !robot.mounting && el("select", { id: "robot-stored-mounting" }, [NOT_STATED, ...MOUNTINGS].map(([value, words]) => el("option", { value }, words)));
  const field = (id, label, input) => input && el("div", {}, el("label", { for: id }, label), input);
  const store = async (event) => {
    event.preventDefault();
    try {
      const stored = await post("/v1/robots", { ...robot, name: name.value, ...serial.value.trim() ? { serial_number: serial.value.trim() } : {}, ...mounting && mounting.value ? { mounting: mounting.value } : {} });
      location.hash = `#/robots/${stored.id}`;
    } catch (error) {
      fill(out, problem(error));
    }
  };
  return el("form", { submit: store }, postureCheck(robot, { title: `Is this your ${robot.name || "robot"}?` }), el("div.fields", {}, field("robot-stored-name", "Name", name), field("robot-stored-serial", "Serial number", serial), field("robot-stored-mounting", "Mounting", mounting)), out, el("button.primary", { type: "submit" }, "Add robot"));
}
