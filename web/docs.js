// The contract as a page: /openapi.json, drawn. Offline, like everything here.

import { el, fill, problem } from "./dom.js";

const main = document.getElementById("main");
const VERBS = ["get", "post", "put", "patch", "delete"];
/** Schemas inside schemas are shown down to this depth; deeper ones by name. */
const MAX_DEPTH = 3;

function draw(api) {
  const tags = new Map();
  for (const [path, item] of Object.entries(api.paths)) {
    for (const verb of VERBS.filter((v) => item[v])) {
      const tag = item[verb].tags?.[0] ?? "other";
      tags.set(tag, [...(tags.get(tag) ?? []), { path, verb, operation: item[verb] }]);
    }
  }
  const id = (tag) => `tag-${tag.replaceAll(" ", "-")}`;
  fill(main, el("h1", {}, "API"), el("p", {}, text(api.info.description)),
    el("p", {}, "The document itself: ", el("a", { href: "/openapi.yaml" }, "openapi.yaml"), ", ", el("a", { href: "/openapi.json" }, "openapi.json"), `. Version ${api.info.version}.`),
    el("nav", { "aria-label": "Sections" }, el("ul.toc", {}, [...tags.keys()].map((tag) => el("li", {}, el("a", { href: `#${id(tag)}` }, tag))), el("li", {}, el("a", { href: "#schemas" }, "shapes")))),
    [...tags].map(([tag, all]) => el("section", { id: id(tag) }, el("h2", {}, tag), all.map((one) => operation(api, one)))),
    el("section", { id: "schemas" }, el("h2", {}, "Shapes"), Object.entries(api.components?.schemas ?? {}).map(([name, schema]) => shape(api, name, schema))));
}

/** Documentation is text; `code` in backquotes is the only markup that is drawn. */
function text(source = "") {
  return source.split(/(`[^`]*`)/).map((part) => (part.startsWith("`") ? el("code", {}, part.slice(1, -1)) : part));
}

function operation(api, { path, verb, operation: op }) {
  return el("details", { id: op.operationId }, el("summary", {}, el("span.verb", {}, verb.toUpperCase()), " ", el("code", {}, path), " ", el("span.quiet", {}, text(op.summary ?? ""))),
    op.description && el("p", {}, text(op.description)),
    op.security && el("p.note", {}, `Takes a key with the scope ${op.security.flatMap((s) => Object.values(s).flat()).join(", ") || "of any kind"}.`),
    parameters(api, op.parameters ?? []), body(api, op.requestBody), answers(api, op.responses ?? {}), example(path, verb, op));
}

function parameters(api, list) {
  if (list.length === 0) return [];
  const rows = list.map((p) => el("tr", {}, el("th", { scope: "row" }, el("code", {}, p.name)), el("td", {}, p.in), el("td", {}, type(api, p.schema)), el("td", {}, text(p.description))));
  return [el("h4", {}, "Parameters"), el("div.scroll", { tabindex: 0, role: "region", "aria-label": "Parameters" }, el("table", {}, el("thead", {}, el("tr", {}, ["Name", "In", "Type", "Meaning"].map((h) => el("th", { scope: "col" }, h)))), el("tbody", {}, rows)))];
}

function body(api, request) {
  if (!request) return [];
  return [el("h4", {}, "Body"), request.description && el("p", {}, text(request.description)), contents(api, request.content)];
}

function contents(api, content = {}) {
  return Object.entries(content).map(([media, { schema }]) => [el("p", {}, el("code", {}, media), " ", type(api, schema)), fields(api, schema, 1)]);
}

function answers(api, responses) {
  const good = Object.entries(responses).filter(([status]) => status < "400");
  const bad = Object.entries(responses).filter(([status]) => status >= "400");
  return [el("h4", {}, "Answers"), good.map(([status, one]) => [el("p", {}, el("strong", {}, status), " ", text(one.description)), contents(api, one.content)]),
    bad.length > 0 && el("p.note", {}, "Problems: ", bad.map(([status, one], i) => `${i > 0 ? "; " : ""}${status} ${one.description}`))];
}

function example(path, verb, op) {
  const types = Object.keys(op.requestBody?.content ?? {});
  const parts = [`curl -s localhost:8080${path}`];
  if (op.security) parts.push("-H \"Authorization: Bearer $KINCAL_KEY\"");
  if (verb === "post" && types.length === 0) parts.push("-X POST");
  if (types.length > 0) parts.push(`-H 'Content-Type: ${types[0]}' --data-binary @FILE`);
  return [el("h4", {}, "By curl"), el("pre", { tabindex: 0 }, parts.join(" \\\n  "))];
}

const nameOf = (schema) => schema?.$ref?.split("/").at(-1);
const resolve = (api, schema) => (nameOf(schema) ? api.components.schemas[nameOf(schema)] : schema);

/** A type in one line. */
function type(api, schema) {
  if (!schema) return "";
  if (nameOf(schema)) return el("a", { href: `#schema-${nameOf(schema)}` }, nameOf(schema));
  const options = schema.oneOf ?? schema.anyOf ?? schema.allOf;
  if (options) return options.map((one, i) => [i > 0 ? " or " : "", type(api, one)]);
  if (schema.enum) return schema.enum.map((v) => JSON.stringify(v)).join(" | ");
  if (schema.const !== undefined) return JSON.stringify(schema.const);
  const names = [schema.type ?? "any"].flat();
  const inner = names.includes("array") ? [" of ", schema.items ? type(api, schema.items) : "any"] : [];
  const limits = [schema.minimum !== undefined && `≥ ${schema.minimum}`, schema.maximum !== undefined && `≤ ${schema.maximum}`, schema.default !== undefined && `default ${JSON.stringify(schema.default)}`].filter(Boolean);
  return [names.join(" or "), inner, limits.length > 0 ? ` (${limits.join(", ")})` : ""];
}

/** The fields of an object; empty for other types. */
function fields(api, schema, depth) {
  const real = resolve(api, schema);
  const options = real?.oneOf ?? real?.anyOf;
  if (options && depth < MAX_DEPTH) return options.filter((one) => one.type !== "null").map((one) => fields(api, one, depth + 1));
  if (!real?.properties) return [];
  const rows = Object.entries(real.properties).map(([name, property]) => el("tr", {}, el("th", { scope: "row" }, el("code", {}, name), real.required?.includes(name) ? "" : el("span.note", {}, " optional")), el("td", {}, type(api, property)), el("td", {}, text(property.description))));
  return el("div.scroll", { tabindex: 0, role: "region", "aria-label": `Fields of ${nameOf(schema) ?? "the object"}` }, el("table", {}, el("thead", {}, el("tr", {}, ["Field", "Type", "Meaning"].map((h) => el("th", { scope: "col" }, h)))), el("tbody", {}, rows)));
}

function shape(api, name, schema) {
  const inside = fields(api, schema, 1);
  const alone = [inside].flat().length === 0;
  return el("details", { id: `schema-${name}` }, el("summary", {}, el("code", {}, name), " ", el("span.quiet", {}, text(schema.description))), alone ? el("p", {}, type(api, schema)) : inside);
}

// A link to a shape opens it.
window.addEventListener("hashchange", open);
function open() {
  const target = location.hash.length > 1 && document.getElementById(decodeURIComponent(location.hash.slice(1)));
  if (!target) return;
  if (target.tagName === "DETAILS") target.open = true;
  target.scrollIntoView();
}

const response = await fetch("/openapi.json").catch(() => null);
if (response?.ok) draw(await response.json());
else fill(main, problem({ title: "The contract cannot be read", detail: "The server does not answer." }));
open();
