// The worker that draws: it reports that it is ready, receives the canvas, then orders.

import { Renderer } from "./renderer.js";

const page = /** @type {any} */ (globalThis);
/** @type {Renderer | null} */
let renderer = null;

page.onmessage = (/** @type {MessageEvent} */ { data }) => {
  if (renderer) renderer.setOrder(data);
  else renderer = new Renderer(data, (report) => page.postMessage(report));
};
page.postMessage(null);
