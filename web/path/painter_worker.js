// The worker that draws: it reports that it is ready, receives the canvas, then orders.

import { Painter } from "./painter.js";

const page = /** @type {any} */ (globalThis);
/** @type {Painter | null} */
let painter = null;

page.onmessage = (/** @type {MessageEvent} */ { data }) => {
  if (painter) painter.take(data);
  else painter = new Painter(data, (report) => page.postMessage(report));
};
page.postMessage(null);
