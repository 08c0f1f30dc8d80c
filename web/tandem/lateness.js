// Lateness with which the page handles a press: while the page is suspended or busy, a press waits in the browser. Requests of
// such a press carry the age of the press, not of its handling.

/** Requests within this time after a press was handled belong to it, ms. */
const BELONGS_MS = 1000;

let handledAt = Number.NEGATIVE_INFINITY;
let lateMs = 0;

/** Time between the newest press of a person and its handling, ms; 0 if no press was handled within the last second. */
export function latenessMs() {
  return performance.now() - handledAt < BELONGS_MS ? lateMs : 0;
}

/** @param {Event} event */
function handle({ isTrusted, timeStamp }) {
  if (!isTrusted) return;
  handledAt = performance.now();
  lateMs = Math.max(0, handledAt - timeStamp);
}

for (const kind of ["pointerdown", "click", "keydown"]) globalThis.addEventListener?.(kind, handle, { capture: true });
