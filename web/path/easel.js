// Location of the drawing: a worker with its own canvas, or the page if the browser has no worker canvas. An order is
// sent when the previous one is drawn; of the orders in between, only the last is kept.

import { Painter } from "./painter.js";

/** @typedef {import("./painter.js").Order} Order */
/** @typedef {import("./painter.js").Report} Report */

export class Easel {
  /** @type {((order: Order) => void) | null} null: not ready, or busy with the last order */
  #idle = null;
  /** @type {((order: Order) => void) | null} */
  #take = null;
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
    if (this.#worker) this.#drawThere(this.#worker);
    else this.#drawHere();
  }

  /** Orders a drawing. @param {Order} order */
  order(order) {
    this.#waiting = this.#waiting ? both(this.#waiting, order) : order;
    this.#send();
  }

  /** Ends drawing. */
  end() {
    this.#worker?.terminate();
    [this.#take, this.#idle, this.#waiting] = [null, null, null];
  }

  /** @param {Worker} worker */
  #drawThere(worker) {
    worker.onerror = (event) => {
      if (this.#take) return;
      // a page may forbid workers: the page then draws
      event.preventDefault();
      worker.terminate();
      this.#drawHere();
    };
    worker.onmessage = () => {
      const drawn = this.#canvas.transferControlToOffscreen();
      worker.onmessage = ({ data }) => this.#on(data);
      worker.postMessage(drawn, [drawn]);
      this.#begin((order) => worker.postMessage(order));
    };
  }

  #drawHere() {
    const painter = new Painter(this.#canvas, (report) => this.#on(report));
    this.#begin((order) => painter.take(order));
  }

  /** @param {(order: Order) => void} take */
  #begin(take) {
    [this.#take, this.#idle] = [take, take];
    this.#send();
  }

  /** @param {Report} report */
  #on(report) {
    this.#idle = this.#take;
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
    return new Worker(new URL("./painter_worker.js", import.meta.url), { type: "module" });
  } catch {
    return null;
  }
}

/** Merges two orders; vertices added by the first and forgotten by the second are not sent. @param {Order} one @param {Order} later @returns {Order} */
function both(one, later) {
  const [gone, come] = [new Set(later.forgotten), new Set(one.added.map(({ id }) => id))];
  const added = [...one.added.filter(({ id }) => !gone.has(id)), ...later.added];
  const forgotten = [...one.forgotten, ...later.forgotten.filter((id) => !come.has(id))];
  return { ...later, added, forgotten, pieces: later.pieces ?? one.pieces };
}
