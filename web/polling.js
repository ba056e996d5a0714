// Asks again while something runs, so that a page does not say "running" of what has ended: only while the page is visible.

/** Time between two questions, ms. */
const EVERY_MS = 3_000;

export const isRunning = (job) => ["queued", "running"].includes(job?.status);

/** Resolves after a while at which the page is visible; false if the page was left. */
function later(signal) {
  return new Promise((done) => {
    let timer;
    const finish = (goesOn) => {
      clearTimeout(timer);
      document.removeEventListener("visibilitychange", look);
      signal.removeEventListener("abort", leave);
      done(goesOn);
    };
    const look = () => { if (!document.hidden) finish(true); };
    const leave = () => finish(false);
    document.addEventListener("visibilitychange", look);
    signal.addEventListener("abort", leave);
    if (signal.aborted) finish(false);
    else timer = setTimeout(look, EVERY_MS);
  });
}

/** Calls `ask` again and again while `runs()`; what goes wrong once is asked again. */
export async function whileRunning(runs, ask, signal) {
  while (runs() && await later(signal)) {
    try {
      await ask();
    } catch (error) {
      if (signal.aborted || [401, 403].includes(error.status)) return;
    }
  }
}
