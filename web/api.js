// The public interface. The key lives in this tab's session storage and leaves it in the Authorization header only.

const STORED = "kincal-key";

export const noAuth = document.documentElement.dataset.auth === "none";
export const key = () => sessionStorage.getItem(STORED);
export const keepKey = (text) => sessionStorage.setItem(STORED, text);
export const dropKey = () => sessionStorage.removeItem(STORED);
export const signedIn = () => noAuth || key() !== null;

function headers(more = {}) {
  return key() ? { ...more, Authorization: `Bearer ${key()}` } : more;
}

/** The service's problem, thrown. */
export class Refused extends Error {
  constructor(status, body) {
    super(body.detail ?? `the server answered ${status}`);
    Object.assign(this, { status, title: body.title, detail: body.detail, code: body.code, errors: body.errors ?? [] });
  }
}

async function call(path, options = {}) {
  let response;
  try {
    response = await fetch(path, { cache: "no-store", credentials: "omit", ...options, headers: headers(options.headers) });
  } catch (cause) {
    if (cause.name === "AbortError") throw cause;
    throw new Refused(0, { title: "No answer", detail: "The server does not answer. Is it running, and is this computer on its network?" });
  }
  if (response.ok) return response;
  throw new Refused(response.status, await response.json().catch(() => ({})));
}

export const get = async (path, signal) => (await call(path, { signal })).json();
export const blob = async (path) => (await call(path)).blob();

/** A POST that may be repeated without a second effect. Text and files go as they are, byte for byte; anything else becomes JSON. */
export async function post(path, body, contentType = "application/json") {
  const isReady = typeof body === "string" || body instanceof Blob;
  const answer = await call(path, { method: "POST", body: isReady ? body : JSON.stringify(body), headers: { "Content-Type": contentType, "Idempotency-Key": fresh() } });
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
    const page = await get(`${path}?limit=${Math.min(200, limit - items.length)}${more}`, signal);
    items.push(...page.items);
    cursor = page.next_cursor;
  } while (cursor && items.length < limit);
  return items;
}

/** A job's server-sent events, read by fetch because EventSource cannot send a key. Ends with `finished`; reconnects. */
export async function follow(jobId, moved, signal) {
  for (;;) {
    try {
      const response = await call(`/v1/jobs/${jobId}/events`, { signal });
      for await (const [name, job] of events(response.body)) {
        moved(job);
        if (name === "finished") return job;
      }
    } catch (error) {
      if (error.name === "AbortError" || (error.status && error.status < 500)) throw error;
    }
    // The stream ended early (a restart, a proxy): a long poll waits for the server and for the next change.
    const job = await get(`/v1/jobs/${jobId}?wait_s=5`, signal);
    moved(job);
    if (!["queued", "running"].includes(job.status)) return job;
  }
}

async function* events(body) {
  const reader = body.pipeThrough(new TextDecoderStream()).getReader();
  let text = "";
  for (;;) {
    const { done, value } = await reader.read();
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

/** Offers what a path answers as a file; a plain link could not send the key. */
export async function download(path, name) {
  const url = URL.createObjectURL(await blob(path));
  const link = document.createElement("a");
  link.href = url;
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(url), 10_000);
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
