// Location of the drawing: a worker with its own canvas, or the page if the browser has no worker canvas. An order is
// sent when the previous one is drawn; of the orders in between, only the last is kept.

import { Renderer } from "./renderer.js";

/** @typedef {import("./renderer.js").Order} Order */
/** @typedef {import("./renderer.js").Report} Report */

export class RenderQueue {
  /** @type {((order: Order) => void) | null} null: not ready, or busy with the last order */
  #idle = null;
  /** @type {((order: Order) => void) | null} */
  #target = null;
  /** @type {Order | null} */
  #waiting = null;
  #canvas;
  #report;
  #worker;

  /** @param {HTMLCanvasElement} canvas @param {(report: Report) => void} report after each frame */
  constructor(canvas, report) {
    this.#canvas = canvas;
    this.#report = report;
    this.#worker = workerFor(canvas);
    if (this.#worker) this.#drawInWorker(this.#worker);
    else this.#drawInPage();
  }

  /** Adds an order; it is sent when the previous one is drawn. @param {Order} order */
  enqueue(order) {
    this.#waiting = this.#waiting ? mergeOrders(this.#waiting, order) : order;
    this.#send();
  }

  /** Stops drawing permanently. */
  stop() {
    this.#worker?.terminate();
    [this.#target, this.#idle, this.#waiting] = [null, null, null];
  }

  /** @param {Worker} worker */
  #drawInWorker(worker) {
    worker.onerror = (event) => {
      if (this.#target) return;
      // a page may forbid workers: the page then draws
      event.preventDefault();
      worker.terminate();
      this.#drawInPage();
    };
    worker.onmessage = () => {
      const drawn = this.#canvas.transferControlToOffscreen();
      worker.onmessage = ({ data }) => this.#on(data);
      worker.postMessage(drawn, [drawn]);
      this.#setTarget((order) => worker.postMessage(order));
    };
  }

  #drawInPage() {
    const renderer = new Renderer(this.#canvas, (report) => this.#on(report));
    this.#setTarget((order) => renderer.setOrder(order));
  }

  /** @param {(order: Order) => void} target */
  #setTarget(target) {
    [this.#target, this.#idle] = [target, target];
    this.#send();
  }

  /** @param {Report} report */
  #on(report) {
    this.#idle = this.#target;
    this.#report(report);
    this.#send();
  }

  #send() {
    const [idle, order] = [this.#idle, this.#waiting];
    if (!idle || !order) return;
    [this.#idle, this.#waiting] = [null, null];
    idle(order);
  }
}

/** A worker of a page of another origin does not start. @param {HTMLCanvasElement} canvas */
function workerFor(canvas) {
  if (!("transferControlToOffscreen" in canvas) || !("Worker" in globalThis)) return null;
  try {
    return new Worker(new URL("./renderer_worker.js", import.meta.url), { type: "module" });
  } catch {
    return null;
  }
}

/** Merges two orders; vertices added by the first and forgotten by the second are not sent. @param {Order} one @param {Order} later @returns {Order} */
function mergeOrders(one, later) {
  const [gone, come] = [new Set(later.forgotten), new Set(one.added.map(({ id }) => id))];
  const added = [...one.added.filter(({ id }) => !gone.has(id)), ...later.added];
  const forgotten = [...one.forgotten, ...later.forgotten.filter((id) => !come.has(id))];
  return { ...later, added, forgotten, pieces: later.pieces ?? one.pieces };
}
