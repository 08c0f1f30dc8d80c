// Motion of one axis by hand. A held jog is refreshed while its button, key or stick is held, and ended on release; a step is
// refreshed until it is done. Whatever else ends the refreshes ends the motion, too: 200 ms later the machine stops by itself.

import { Refusal } from "./api.js";
import { button, setAttr } from "./dom.js";
import { t } from "./language.js";
import { disableFor, whyNot } from "./why_not.js";

/** Time between two refreshes, ms. */
const REFRESH_MS = 80;

/**
 * @typedef {object} JogChoice
 * @property {number} velocity mm/min or deg/min
 * @property {number} distance mm or degrees; 0: as long as it is held
 * @property {string} says the distance in the unit of the screen
 */

/**
 * @typedef {object} RunningJog
 * @property {number} cs
 * @property {string} axis
 * @property {1 | -1} direction
 * @property {boolean} isStep
 * @property {{refresh_id: string}} args
 * @property {string | null | undefined} before the run before it
 */

export class Jogger {
  /** @type {RunningJog | null} */
  running = null;
  #timer = 0;

  /** @param {import("./main.js").App} app */
  constructor(app) {
    this.app = app;
    for (const event of ["blur", "pagehide"]) addEventListener(event, () => this.cancel());
    document.addEventListener("visibilitychange", () => this.cancel());
  }

  /** Begins a jog, unless one runs. @param {string} axis @param {1 | -1} direction @param {JogChoice} choice */
  begin(axis, direction, { velocity, distance }) {
    const { model } = this.app;
    if (this.running || whyNot(model, "jog") !== null) return;
    const bytes = crypto.getRandomValues(new Uint32Array(3));
    const refresh_id = `hmi-${[...bytes].map((part) => part.toString(36)).join("")}`;
    const args = { axis, velocity: direction * velocity, refresh_id, ...(distance > 0 && { distance }) };
    const run = { cs: model.selected, axis, direction, isStep: distance > 0, args, before: model.current?.state?.run_id };
    this.running = run;
    this.app.invalidate();
    void this.#refresh(run, true);
  }

  /** The button, key or stick is released: a held jog ends, a step goes on to its end. */
  release() {
    if (this.running && !this.running.isStep) this.cancel();
  }

  /** Ends the jog, also a step. */
  cancel() {
    const run = this.#forget();
    if (run) void this.app.api.endJog(run.cs, run.axis, run.args.refresh_id);
  }

  /** Looks whether the jog has ended by itself, or nothing is heard of the machine. */
  render() {
    const { running } = this;
    if (!running) return;
    const { model } = this.app;
    const state = model.systems.get(running.cs)?.state;
    if (!model.online) this.cancel();
    else if (state && state.run_id !== running.before && state.run_kind !== "jog") this.#forget();
  }

  #forget() {
    const run = this.running;
    this.running = null;
    clearTimeout(this.#timer);
    if (run) this.app.invalidate();
    return run;
  }

  /**
   * Sends the jog, and again while it lasts. One request at a time: on a slow network the machine stops by itself rather
   * than obeying a queue.
   * @param {RunningJog} run @param {boolean} first
   */
  async #refresh(run, first) {
    const sent = Date.now();
    try {
      await this.app.api.jog(run.cs, run.args);
    } catch (error) {
      if (!(error instanceof Refusal)) throw error;
      if (this.running !== run) return;
      // a refresh is refused when the distance is done or the soft limit reached: nothing to report
      this.#forget();
      if (first) this.app.toast(error.message, "error");
      return;
    }
    if (this.running !== run) return;
    this.#timer = window.setTimeout(() => void this.#refresh(run, false), Math.max(0, sent + REFRESH_MS - Date.now()));
  }
}

/**
 * A button that jogs: while it is held, or one step for each click.
 * @param {import("./main.js").App} app
 * @param {string} axis
 * @param {1 | -1} direction
 * @param {() => JogChoice} chosen
 */
export function jogButton(app, axis, direction, chosen) {
  const { jogger } = app;
  const element = button({ class: "button jog", "data-jog": `${axis}${direction > 0 ? "+" : "-"}` }, `${axis}${direction > 0 ? "+" : "−"}`);
  const begin = () => jogger.begin(axis, direction, chosen());
  const release = () => isOwn() && jogger.release();
  const isOwn = () => jogger.running?.axis === axis && jogger.running.direction === direction;
  element.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return;
    element.setPointerCapture(event.pointerId);
    begin();
  });
  // follows a release and everything else that takes the pointer away
  element.addEventListener("lostpointercapture", release);
  element.addEventListener("contextmenu", (event) => event.preventDefault());
  element.addEventListener("keydown", (event) => {
    if (event.key !== " " && event.key !== "Enter") return;
    event.preventDefault();
    if (!event.repeat) begin();
  });
  element.addEventListener("keyup", release);
  element.addEventListener("blur", release);
  // a press without a pointer or key, as assistive technology makes it, can ask for a step only
  element.addEventListener("click", (event) => {
    if (event.detail === 0 && chosen().distance > 0) begin();
  });
  const render = () => {
    const { distance, says } = chosen();
    setAttr(element, "aria-label", t(direction > 0 ? "jog.plus" : "jog.minus", { axis, way: distance > 0 ? says : t("jog.hold") }));
    setAttr(element, "data-held", isOwn());
    disableFor(element, isOwn() ? null : whyNot(app.model, "jog"));
  };
  return { element, render };
}
