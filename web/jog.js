// A button that moves an axis while it is held. The machine stops by itself 200 ms after the last refresh, so whatever
// ends the refreshes ends the motion: release, lost focus, a hidden window, a lost connection, a closed page.

import { Refusal } from "./api.js";
import { button, setAttr } from "./dom.js";

/** Time between two refreshes, ms. */
const REFRESH_MS = 80;

/**
 * @typedef {object} JogChoice
 * @property {number} velocity mm/min or deg/min
 * @property {number} distance mm or degrees; 0: as long as the button is held
 */

export class JogButton {
  /** Id of the running jog; null: none. @type {string | null} */
  #refreshId = null;
  #timer = 0;

  /**
   * @param {import("./main.js").App} app
   * @param {string} axis
   * @param {1 | -1} direction
   * @param {() => JogChoice} chosen
   */
  constructor(app, axis, direction, chosen) {
    this.app = app;
    this.axis = axis;
    this.direction = direction;
    this.chosen = chosen;
    const sign = direction > 0 ? "+" : "−";
    const element = button({ class: "button jog", "aria-label": `Jog ${axis} ${direction > 0 ? "plus" : "minus"}: hold` }, `${axis}${sign}`);
    this.element = element;
    element.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      element.setPointerCapture(event.pointerId);
      this.#begin();
    });
    // follows a release and everything else that takes the pointer away
    element.addEventListener("lostpointercapture", () => this.end());
    element.addEventListener("contextmenu", (event) => event.preventDefault());
    element.addEventListener("keydown", (event) => {
      if (event.key !== " " && event.key !== "Enter") return;
      event.preventDefault();
      if (!event.repeat) this.#begin();
    });
    element.addEventListener("keyup", () => this.end());
    element.addEventListener("blur", () => this.end());
    addEventListener("blur", () => this.end());
    document.addEventListener("visibilitychange", () => this.end());
  }

  render() {
    const { model } = this.app;
    if (!model.online) this.end();
    this.element.disabled = this.#refreshId === null && !model.movesByHand;
    setAttr(this.element, "data-held", this.#refreshId !== null);
  }

  /** Ends the refreshes: the machine stops. */
  end() {
    if (this.#refreshId === null) return;
    this.#refreshId = null;
    clearTimeout(this.#timer);
    this.app.invalidate();
  }

  #begin() {
    if (this.#refreshId !== null || !this.app.model.movesByHand) return;
    const bytes = crypto.getRandomValues(new Uint32Array(3));
    const refreshId = `hmi-${[...bytes].map((part) => part.toString(36)).join("")}`;
    this.#refreshId = refreshId;
    this.app.invalidate();
    const { velocity, distance } = this.chosen();
    const args = { axis: this.axis, velocity: this.direction * velocity, refresh_id: refreshId, ...(distance > 0 && { distance }) };
    void this.#refresh(this.app.model.selected, args, true);
  }

  /**
   * Sends the jog, and again while the button is held. One request at a time: on a slow network the machine stops by
   * itself rather than obeying a queue.
   * @param {number} cs
   * @param {{refresh_id: string}} args
   * @param {boolean} first
   */
  async #refresh(cs, args, first) {
    const sent = Date.now();
    try {
      await this.app.api.jog(cs, args);
    } catch (error) {
      if (!(error instanceof Refusal)) throw error;
      // a refresh is refused when the distance is done or the soft limit reached: nothing to report
      if (first) this.app.toast(error.message, "error");
      if (this.#refreshId === args.refresh_id) this.end();
      return;
    }
    if (this.#refreshId !== args.refresh_id) return;
    this.#timer = window.setTimeout(() => void this.#refresh(cs, args, false), Math.max(0, sent + REFRESH_MS - Date.now()));
  }
}
