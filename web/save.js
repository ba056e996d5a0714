// Buttons that save what a path answers as a file.

import { blob } from "./api.js";
import { el, say } from "./dom.js";
import { plain } from "./format.js";
import { pointsPath } from "./rows.js";

/** File name extension by media type, for files whose type is known only from the answer. */
const ENDINGS = { "application/json": ".json", "text/csv": ".csv" };

/** Why a format is not for this robot, by the code of the refusal. */
const NOT_FOR = { not_a_universal_robot: "this file is for robots of Universal Robots only. Take URDF." };

/** A button that saves what a path answers; `ending` null stands for that of the answer's type. What goes wrong is said. */
export function saveButton(text, path, stem, ending, label) {
  // not disabled meanwhile: that would take the focus away
  let busy = false;
  const click = async () => {
    if (busy) return;
    busy = true;
    try {
      await save(path, stem, ending);
    } catch (error) {
      say(`Nothing was downloaded: ${NOT_FOR[error.code] ?? plain(error.detail ?? error.message)}`);
    } finally {
      busy = false;
    }
  };
  return el("button", { type: "button", click, "aria-label": label }, text);
}

/** What was uploaded, by the name of its set. Two files that were joined are one table of their points. */
export const savePoints = (text, set, label) => saveButton(text, set.joined ? pointsPath(set) : `/v1/measurement-sets/${set.id}/points`, set.name ?? set.id, null, label);

/** Longest part of a file's name that is taken from a robot's name. */
const MAX_ROBOT = 60;

/** The name of a file without its ending, as the service names exports: the robot, the day on which the points were measured, and what it is. */
export function fileStem(robot, set, what) {
  const name = robot.name.split(/[^A-Za-z0-9.-]+/).filter(Boolean).join("-").slice(0, MAX_ROBOT).replace(/^[.-]+|[.-]+$/g, "");
  const day = (set.record?.measured_at ?? set.created_at).slice(0, 10);
  return [name, day, what].filter(Boolean).join("_");
}

/** Offers what a path answers as a file; a plain link could not send the key. */
async function save(path, stem, ending) {
  const content = await blob(path);
  offer(content, stem + (ending ?? ENDINGS[content.type.split(";")[0].trim()] ?? ""));
}

/** Offers a text as a file. */
export const saveText = (text, name, type) => offer(new Blob([text], { type }), name);
/** Offers bytes as a file. */
export const saveBytes = (bytes, name) => offer(new Blob([bytes]), name);

function offer(content, name) {
  const url = URL.createObjectURL(content);
  const link = document.createElement("a");
  link.href = url;
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(url), 10_000);
}
