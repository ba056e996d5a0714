// The public interface. Sign-in turns the key into a cookie that no script can read, so that links and new tabs are signed in.

/** Says to every tab that somebody signed in; the key itself is kept in no script's reach. */
const MARK = "kincal-signed-in";

export const noAuth = document.documentElement.dataset.auth === "none";
export const signedIn = () => noAuth || localStorage.getItem(MARK) !== null;
export const forget = () => localStorage.removeItem(MARK);
/** Characters that a header can carry. A browser sends no request with other characters. */
export const isKey = (text) => /^[\x21-\x7e]+$/.test(text);

/** Signs in with a key. */
export async function signIn(key) {
  await call("/v1/session", { method: "PUT", mayRepeat: true, headers: { Authorization: `Bearer ${key}` } });
  localStorage.setItem(MARK, "1");
}

/** Signs out, here and in every tab. */
export async function signOut() {
  forget();
  await call("/v1/session", { method: "DELETE", mayRepeat: true }).catch((error) => {
    // 401: the session had ended already
    if (error.status !== 401) throw error;
  });
}

/** A page of another origin cannot send this header, so a request with it comes from this page. */
const headers = (more = {}) => ({ "X-Kincal-Session": "1", ...more });

/** Error with the problem document of the service. */
export class Refused extends Error {
  constructor(status, body) {
    super(body.detail ?? `the server answered ${status}`);
    Object.assign(this, { status, title: body.title, detail: body.detail, code: body.code, errors: body.errors ?? [] });
  }
}

const NO_ANSWER = { title: "No answer", detail: "The server does not answer. Is it running, and is this computer on its network?" };
/** Most attempts of a read while the server is busy. */
const MAX_TRIES = 4;
/** Longest pause before the next attempt. */
const LONGEST_PAUSE_S = 5;

/** Resolves after a while; rejects when the page is left. */
function pause(seconds, signal) {
  return new Promise((done, fail) => {
    signal?.throwIfAborted();
    const timer = setTimeout(done, 1000 * seconds);
    signal?.addEventListener("abort", () => { clearTimeout(timer); fail(signal.reason); }, { once: true });
  });
}

async function call(path, options = {}) {
  for (let attempt = 1; ; attempt += 1) {
    try {
      return await once(path, options);
    } catch (error) {
      const mayPass = (!options.method || options.mayRepeat) && [429, 503].includes(error.status) && attempt < MAX_TRIES;
      if (!mayPass) throw error;
      await pause(Math.min(LONGEST_PAUSE_S, error.retryAfter), options.signal);
    }
  }
}

async function once(path, options) {
  let response;
  try {
    response = await fetch(path, { cache: "no-store", credentials: "same-origin", ...options, headers: headers(options.headers) });
  } catch (cause) {
    if (cause.name === "AbortError") throw cause;
    throw new Refused(0, NO_ANSWER);
  }
  if (response.ok) return response;
  const refused = new Refused(response.status, await response.json().catch(() => ({})));
  refused.retryAfter = Number(response.headers.get("Retry-After")) || 1;
  throw refused;
}

export const get = async (path, signal) => (await call(path, { signal })).json();
export const blob = async (path, signal) => (await call(path, { signal })).blob();

/** A POST that may be repeated without a second effect. Text and files go as they are, byte for byte; anything else becomes JSON. */
export async function post(path, body, contentType = "application/json") {
  const isReady = typeof body === "string" || body instanceof Blob || ArrayBuffer.isView(body);
  const answer = await call(path, { method: "POST", body: isReady ? body : JSON.stringify(body), headers: { "Content-Type": contentType, "Idempotency-Key": fresh() } });
  return answer.json();
}

/** Stores a document under its path. */
export const put = (path, body) => send("PUT", path, body);
/** Changes some fields of a document. */
export const patch = (path, body) => send("PATCH", path, body);

async function send(verb, path, body) {
  const answer = await call(path, { method: verb, body: JSON.stringify(body), headers: { "Content-Type": "application/json" } });
  return answer.json();
}

function fresh() {
  const bytes = crypto.getRandomValues(new Uint8Array(16));
  return Array.from(bytes, (byte) => byte.toString(16).padStart(2, "0")).join("");
}

/** Items of a list, page after page, up to a limit. */
export async function list(path, limit = 50, signal) {
  const items = [];
  let cursor = null;
  do {
    const more = cursor ? `&cursor=${encodeURIComponent(cursor)}` : "";
    const page = await get(`${path}${path.includes("?") ? "&" : "?"}limit=${Math.min(200, limit - items.length)}${more}`, signal);
    items.push(...page.items);
    cursor = page.next_cursor;
  } while (cursor && items.length < limit);
  return items;
}

/** Most attempts to reconnect to a server that is restarted or unreachable: about ten minutes. */
const MAX_LOST = 120;
const mayComeBack = (error) => error instanceof Refused && (error.status === 0 || error.status === 429 || error.status >= 500);

/** A job's server-sent events, read by fetch because EventSource cannot send a key. Ends with `finished`; reconnects. `lost` is called when the server does not answer. */
export async function follow(jobId, { moved, lost }, signal) {
  for (let failures = 0; ;) {
    try {
      const response = await call(`/v1/jobs/${jobId}/events`, { signal });
      for await (const [name, job] of events(response.body)) {
        failures = 0;
        moved(job);
        if (name === "finished") return job;
      }
    } catch (error) {
      if (!mayComeBack(error)) throw error;
    }
    // The stream ended early (a restart, a proxy). A long poll waits for the next change; if it fails, a pause waits for the server.
    try {
      const job = await get(`/v1/jobs/${jobId}?wait_s=5`, signal);
      failures = 0;
      moved(job);
      if (!["queued", "running"].includes(job.status)) return job;
    } catch (error) {
      failures += 1;
      if (!mayComeBack(error) || failures > MAX_LOST) throw error;
      lost();
      await pause(Math.min(LONGEST_PAUSE_S, failures), signal);
    }
  }
}

async function* events(body) {
  const reader = body.pipeThrough(new TextDecoderStream()).getReader();
  let text = "";
  for (;;) {
    const { done, value } = await reader.read().catch((cause) => { throw cause.name === "AbortError" ? cause : new Refused(0, NO_ANSWER); });
    if (done) return;
    text += value;
    for (let end = text.indexOf("\n\n"); end >= 0; end = text.indexOf("\n\n")) {
      const lines = text.slice(0, end).split("\n");
      text = text.slice(end + 2);
      const field = (name) => lines.filter((line) => line.startsWith(name)).map((line) => line.slice(name.length).trim()).join("\n");
      if (field("event:")) yield [field("event:"), JSON.parse(field("data:"))];
    }
  }
}

/** Runs one function over many things, a few at a time. */
export async function each(things, work, atOnce = 4) {
  const queue = [...things.entries()];
  const results = new Array(things.length);
  const worker = async () => {
    for (let next = queue.shift(); next; next = queue.shift()) results[next[0]] = await work(next[1]);
  };
  await Promise.all(Array.from({ length: Math.min(atOnce, things.length) }, worker));
  return results;
}
