// A slider that does not move by accident: only a drag of its thumb or a key sets it, and one action ends at 100 percent. A tap on its
// track does nothing, and a vertical swipe that begins on it scrolls the page.

import { h } from "./dom.js";

/** Limit of one action, percent; the next action may exceed it. */
const ONE_ACTION_MAX = 100;
/** Steps of the slider, percent. */
const STEP = 5;

/**
 * Returns the value that an action that began at `from` may set.
 * @param {number} percent @param {number} from @param {number} max
 */
export function limited(percent, from, max) {
  return Math.max(0, Math.min(percent, from < ONE_ACTION_MAX ? Math.min(ONE_ACTION_MAX, max) : max));
}

export class OverrideSlider {
  /** Value at which the present action began. */
  #from = 0;
  /** @type {{pointerId: number, clientX: number} | null} the drag, and its start */
  #drag = null;
  #isKeyDown = false;
  /** Last value of `show`. */
  #shown = 0;

  /** @param {string} label @param {number} max percent @param {(percent: number) => void} set called with each value that the operator sets */
  constructor(label, max, set) {
    this.max = max;
    this.set = set;
    // the input is for keys and assistive technology; pointers reach the thumb alone
    this.input = h("input", { type: "range", min: 0, max, step: STEP, "aria-label": label });
    this.thumb = h("span", { class: "thumb" });
    this.element = h("span", { class: "override-slider" }, this.input, this.thumb);
    this.input.addEventListener("keydown", ({ repeat }) => {
      if (repeat) return;
      this.#isKeyDown = true;
      this.#from = this.value;
    });
    for (const event of ["keyup", "blur"]) this.input.addEventListener(event, () => (this.#isKeyDown = false));
    this.input.addEventListener("input", () => {
      if (!this.#isKeyDown) this.#from = this.#shown;
      this.#change(this.value);
    });
    this.thumb.addEventListener("pointerdown", (event) => this.#begin(event));
    this.thumb.addEventListener("pointermove", (event) => this.#move(event));
    for (const event of ["pointerup", "pointercancel", "lostpointercapture"]) this.thumb.addEventListener(event, () => (this.#drag = null));
  }

  /** The value shown, percent. */
  get value() {
    return Number(this.input.value);
  }

  /** Shows a value. @param {number} percent */
  show(percent) {
    this.input.value = String(percent);
    this.#shown = this.value;
    this.thumb.style.setProperty("--at", String(this.value / this.max));
  }

  /** Adds to the value, as one action. @param {number} by percent */
  step(by) {
    this.#from = this.value;
    this.#change(this.value + by);
  }

  /** @param {number} percent */
  #change(percent) {
    const value = limited(percent, this.#from, this.max);
    this.show(value);
    this.set(value);
  }

  /** @param {PointerEvent} event */
  #begin({ button, pointerId, clientX }) {
    if (button !== 0 || this.input.disabled) return;
    this.thumb.setPointerCapture(pointerId);
    this.#from = this.value;
    this.#drag = { pointerId, clientX };
  }

  /** @param {PointerEvent} event */
  #move({ pointerId, clientX }) {
    if (this.#drag?.pointerId !== pointerId || this.input.disabled) return;
    const travel = this.element.clientWidth - this.thumb.offsetWidth;
    const moved = ((clientX - this.#drag.clientX) / travel) * this.max;
    const percent = Math.round((this.#from + moved) / STEP) * STEP;
    if (limited(percent, this.#from, this.max) !== this.value) this.#change(percent);
  }
}
