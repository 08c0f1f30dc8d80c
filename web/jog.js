// A button that moves an axis while it is held. The machine stops 200 ms after the last refresh by itself, so whatever
// ends the refreshes ends the motion: release, lost focus, a hidden window, a lost connection, a page that is gone.

import { Refusal } from "./api.js";
import { h, setAttr } from "./dom.js";

/** Time between two refreshes, ms. */
const REFRESH_MS = 80;

/**
 * @typedef {object} JogChoice
 * @property {number} velocity mm/min or deg/min
 * @property {number} distance mm or degrees; 0: as long as the button is held
 */

export class JogButton {
  /** Names the jog that runs; null: none. @type {string | null} */
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
    const button = h("button", { type: "button", class: "button jog", "aria-label": `Jog ${axis} ${direction > 0 ? "plus" : "minus"}: hold` }, `${axis}${sign}`);
    this.element = button;
    button.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      button.setPointerCapture(event.pointerId);
      this.#begin();
    });
    // comes after a release and after everything else that takes the pointer away
    button.addEventListener("lostpointercapture", () => this.end());
    button.addEventListener("contextmenu", (event) => event.preventDefault());
    button.addEventListener("keydown", (event) => {
      if (event.key !== " " && event.key !== "Enter") return;
      event.preventDefault();
      if (!event.repeat) this.#begin();
    });
    button.addEventListener("keyup", () => this.end());
    button.addEventListener("blur", () => this.end());
    addEventListener("blur", () => this.end());
    document.addEventListener("visibilitychange", () => this.end());
  }

  render() {
    const { model } = this.app;
    if (!model.online) this.end();
    this.element.disabled = this.#refreshId === null && !model.movesByHand;
    setAttr(this.element, "data-held", this.#refreshId !== null);
  }

  /** Refreshes no more: the machine stops. */
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
      // a refresh is refused when the way is done or the soft limit reached: nothing to tell
      if (first) this.app.toast(error.message, "error");
      if (this.#refreshId === args.refresh_id) this.end();
      return;
    }
    if (this.#refreshId !== args.refresh_id) return;
    this.#timer = window.setTimeout(() => void this.#refresh(cs, args, false), Math.max(0, sent + REFRESH_MS - Date.now()));
  }
}
