// What gates found, with links in place of the ids of jobs, and with the names of measurement sets in place of theirs.

import { get } from "./api.js";
import { el, fill } from "./dom.js";
import { gateDetail, gateTitle } from "./format.js";

/** Names of measurement sets that were asked before, by their id. */
const known = new Map();

/** The name of a measurement set, once the service has said it. */
function setName(id) {
  const place = el("span", {}, "a measurement set");
  if (!known.has(id)) known.set(id, get(`/v1/measurement-sets/${id}`).then((set) => set.name ?? "a set without a name"));
  known.get(id).then((name) => fill(place, `"${name}"`), () => known.delete(id));
  return place;
}

/** A sentence with a link for each job and a name for each measurement set. */
export function linked(text) {
  return text.split(/(\bjob job_\w+|\bset_[0-9a-f]{8,})/).map((part, i) => {
    if (i % 2 === 0) return part;
    return part.startsWith("set_") ? setName(part) : el("a", { href: `#/jobs/${part.slice(4)}` }, "this job");
  });
}

/** What gates found, a list item each. */
export const gateItems = (gates) => el("ul", {}, gates.map((gate) => el("li", {}, el("strong", {}, gateTitle(gate)), ": ", linked(gateDetail(gate.detail)))));
