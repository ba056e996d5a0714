// The point that is selected: arrow, bar and row of the table show the same one.

/** A selection among n points. Listeners get the index, or null. */
export function selection(n) {
  const listeners = [];
  let current = null;
  const set = (index) => {
    if (index === current) return;
    current = index;
    for (const tell of listeners) tell(current);
  };
  return {
    get index() { return current; },
    set,
    /** Goes on by some points, around the end. */
    step: (by) => n > 0 && set(current === null ? (by > 0 ? 0 : n - 1) : (current + by + n) % n),
    listen: (tell) => { listeners.push(tell); },
  };
}
