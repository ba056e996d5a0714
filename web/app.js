// The frame of the dashboard: who is signed in, and which page the address names.

import { forget, get, isKey, noAuth, signedIn, signIn as openSession, signOut } from "./api.js";
import { el, fill, problem } from "./dom.js";
import { robotsPage } from "./robots.js";
import { comparePage } from "./compare.js";
import { correctPage } from "./correct.js";
import { planPage } from "./plan.js";
import { robotPage } from "./robot.js";
import { jobPage } from "./job.js";
import { jobsPage } from "./jobs.js";

const main = document.getElementById("main");
const session = document.getElementById("session");
const PAGES = [
  [/^#\/robots\/(\w+)(?:\/(upload))?$/, robotPage],
  [/^#\/robots\/(\w+)\/plan$/, planPage],
  [/^#\/robots\/(\w+)\/correct$/, correctPage],
  [/^#\/robots\/(\w+)\/compare$/, comparePage],
  [/^#\/jobs\/(\w+)$/, jobPage],
  [/^#\/jobs$/, jobsPage],
  [/^(#\/?)?$/, robotsPage],
];

const NO_KEY = { title: "This is not a key", detail: "It has characters that no key has. Copy it once more, from kincal_ to its end." };
const READS_NOTHING = { title: "This key may not read", detail: "Without the scope read nothing can be shown here. Sign in with another key." };

let leaving = new AbortController();
let me = null;
/** Where each visited page was scrolled to, by the number of its entry in the history. */
const scrolled = new Map();
let entry = null;

/** What pages need: where to draw, what the user may do, the signal that ends their requests when they are left, and the query of the address. */
function context(signal, query) {
  const may = (scope) => me.scopes.includes(scope) || me.scopes.includes("admin");
  return { main, signal, may, me, why: (scope, what) => may(scope) ? false : why(scope, what), query: new URLSearchParams(query), keep };
}

/** Keeps the choices of a page in its address, so that Back and a bookmark return to them. Empty ones are left out. */
function keep(choices) {
  const query = new URLSearchParams(Object.entries(choices).filter(([, value]) => value));
  const [path] = location.hash.split("?");
  // the link that skips to the content stands in the place of a page
  if (path === "#main") return;
  history.replaceState(history.state, "", `${path || "#/"}${query.size > 0 ? `?${query}` : ""}`);
}

/** What is missing where somebody may not do something: a page without a button explains nothing. The key that is recommended may all that this one may, too. */
function why(scope, what) {
  const all = [...new Set([...me.scopes, scope])].map((one) => [" ", el("span", {}, `--scope ${one}`)]);
  return el("p.locked", {}, `With this key you cannot ${what}: that takes the scope ${scope}. Whoever runs the server makes such a key with `, el("code", {}, "kincal key create --name NAME", all), ".");
}

/** Begins the entry of a page in the history, and answers where the page was scrolled to: a new one opens at its top, Back and Forward return. */
function beginEntry() {
  if (history.state?.entry === undefined) history.replaceState({ entry: Date.now() }, "");
  if (history.state.entry === entry) return 0;
  scrolled.set(entry, window.scrollY);
  ({ entry } = history.state);
  window.scrollTo(0, 0);
  return scrolled.get(entry) ?? 0;
}

async function show(moveFocus) {
  if (location.hash === "#main") return;
  leaving.abort();
  leaving = new AbortController();
  const { signal } = leaving;
  const top = beginEntry();
  if (!signedIn()) return signIn();
  main.setAttribute("aria-busy", "true");
  try {
    me ??= await get("/v1/me", signal);
    who();
    const [path, query] = location.hash.split("?");
    const [match, page] = PAGES.map(([pattern, page]) => [pattern.exec(path), page]).find(([match]) => match) ?? [];
    if (!page) fill(main, el("h1", {}, "There is no such page"), el("p", {}, el("a", { href: "#/" }, "All robots")));
    else await page(context(signal, query), ...match.slice(1));
    if (top > 0 && !signal.aborted) window.scrollTo(0, top);
  } catch (error) {
    if (error.name === "AbortError") return;
    if (error.status === 401) return signIn(error);
    // Nobody is signed in yet, so there is no previous page.
    if (error.status === 403 && me === null) return signIn({ ...error, ...READS_NOTHING });
    const ways = me === null ? [el("button.primary", { type: "button", click: () => show(true) }, "Try again"), !noAuth && el("button", { type: "button", click: () => signIn() }, "Another key")] : el("a", { href: "#/" }, "All robots");
    fill(main, el("h1", {}, "This page cannot be shown"), problem(error), el("div.actions", {}, ways));
  } finally {
    if (!signal.aborted) main.removeAttribute("aria-busy");
  }
  // a page may have put the focus where its work begins
  if (moveFocus && !signal.aborted && !main.contains(document.activeElement)) main.focus({ preventScroll: true });
}

function who() {
  if (noAuth) return fill(session, el("span.badge", { title: "The server runs with --no-auth on this computer only" }, "no keys needed"));
  const scopes = me.scopes.join(", ");
  const leave = async () => {
    leaving.abort();
    const notEnded = await signOut().then(() => undefined, (error) => error);
    me = null;
    fill(session);
    location.hash = "#/";
    if (notEnded) signIn(notEnded);
    else show(true);
  };
  fill(session, el("span", { title: "The key and what it may do" }, `${me.name ?? "key"}: ${scopes}`), el("button.plain", { type: "button", click: leave }, "Sign out"));
}

function signIn(error) {
  forget();
  me = null;
  fill(session);
  document.title = "kincal: sign in";
  const field = el("input", { id: "key", name: "key", type: "password", autocomplete: "off", spellcheck: "false", required: true });
  const submit = async (event) => {
    event.preventDefault();
    const text = field.value.trim();
    if (text === "") return;
    if (!isKey(text)) return signIn(NO_KEY);
    try {
      await openSession(text);
    } catch (refused) {
      return signIn(refused.status === 403 ? { ...refused, ...READS_NOTHING } : refused);
    }
    show(true);
  };
  fill(main, el("form.signin", { submit }, el("h1", {}, "Sign in"),
    error && problem(error),
    el("label", { for: "key" }, "API key"), field,
    el("button.primary", { type: "submit" }, "Sign in"),
    el("p.note", {}, "Whoever runs the server makes a key. One for calibrating has the scopes read, upload, identify and release; read alone shows everything and changes nothing."),
    el("pre", {}, "kincal key create --name my-desk", ["read", "upload", "identify", "release"].map((scope) => [" ", el("span", {}, `--scope ${scope}`)])),
    el("p.note", {}, "This browser keeps it in a cookie that no script can read, for all its tabs, until you sign out or close the browser.")));
  main.removeAttribute("aria-busy");
  field.focus();
}

history.scrollRestoration = "manual";
window.addEventListener("hashchange", () => {
  // a notice is about the page that is left
  fill(document.getElementById("said"));
  show(true);
});
// Another tab signed in or out.
window.addEventListener("storage", (event) => {
  if (event.key !== "kincal-signed-in") return;
  me = null;
  show(false);
});
show(false);
