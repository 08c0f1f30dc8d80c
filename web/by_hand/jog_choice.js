// Velocities and steps of motion by hand. The choice is kept in mm or degrees: if the unit changes, the same velocity and step are
// shown in the new unit, so that no number changes its meaning.

import { plain, readNumber } from "../text/format.js";
import { t } from "../text/language.js";
import { degrees, lengthScale } from "../text/units.js";
import { button, fill, h, setAttr, setText } from "../ui/dom.js";

/** @typedef {import("../text/units.js").Scale} Scale */
/** @typedef {import("../text/units.js").Unit | "degrees"} JogUnit */

/**
 * Presets of each unit, per minute and for one step; 0: until the button is released. The longest steps are below the
 * default of `jog_step_max`, so that they need no refresh.
 * @type {Record<JogUnit, {velocities: number[], steps: number[]}>}
 */
const PRESETS = {
  mm: { velocities: [100, 500, 2000, 6000], steps: [0, 0.01, 0.1, 1, 10] },
  inch: { velocities: [4, 20, 80, 240], steps: [0, 0.001, 0.01, 0.1, 0.25] },
  degrees: { velocities: [100, 500, 2000, 6000], steps: [0, 0.01, 0.1, 1, 10] },
};
/** Initial presets: 500 mm/min or the nearest value, and continuous. */
const FIRST_VELOCITY = 1;
const FIRST_STEP = 0;
/** Typed values that are larger are rejected, mm/min or deg/min, and mm or degrees. */
const VELOCITY_MAX = 1_000_000;
const STEP_MAX = 10_000;
/** Relative difference below which a value equals a preset. */
const EQUAL = 1e-9;

/** Velocity and step of all axes with one kind of unit: lengths, or degrees. */
export class JogChoices {
  #velocity;
  #step;
  /** @type {HTMLElement[]} */
  elements;

  /** @param {JogUnit} unit at first */
  constructor(unit) {
    const sign = unit === "degrees" ? "\u00b0" : "";
    const stepText = (/** @type {number} */ value) => (value === 0 ? `${t("by_hand.hold")}${sign && ` ${sign}`}` : `${plain(value)}${sign}`);
    this.#velocity = new Choice(t("by_hand.velocity"), t("by_hand.own_velocity"), FIRST_VELOCITY, VELOCITY_MAX, (value) => `${plain(value)}${sign}`);
    this.#step = new Choice(t("by_hand.step"), t("by_hand.own_step"), FIRST_STEP, STEP_MAX, stepText);
    this.elements = [this.#velocity.element, this.#step.element];
    this.render(unit, true);
  }

  /** @param {JogUnit} unit @param {boolean} isUsed an axis has this kind of unit */
  render(unit, isUsed) {
    const scale = unit === "degrees" ? degrees() : lengthScale(unit);
    const { velocities, steps } = PRESETS[unit];
    this.#velocity.render(velocities, scale, `${scale.unit}/min`);
    this.#step.render(steps, scale, scale.unit);
    for (const element of this.elements) setAttr(element, "hidden", !isUsed);
  }

  /** Returns the current choice as shown. @returns {import("./jog.js").JogChoice} */
  chosen() {
    const { value: distance, shown, unit } = this.#step;
    return { velocity: this.#velocity.value, distance, shown, unit, says: t("by_hand.one_step_of", { value: plain(shown), unit }) };
  }
}

/** A choice between presets and a typed value. */
class Choice {
  /** The choice in mm or degrees (per minute); null: the first preset of each unit. @type {number | null} */
  #chosen = null;
  /** @type {number[]} */
  #presets = [];
  /** @type {Scale} */
  #scale = { unit: "", size: 1, decimals: 3 };
  #label;
  #ownLabel;
  #first;
  #text;
  #name = h("span", { class: "label" });
  #picks = h("div", { class: "picks" });
  #own = h("input", { type: "text", inputmode: "decimal", class: "input own", autocomplete: "off", placeholder: t("by_hand.own") });
  element = h("div", { class: "choice", role: "radiogroup" }, this.#name, this.#picks, this.#own);

  /**
   * @param {string} label @param {string} ownLabel of the typed value
   * @param {number} first the initial preset
   * @param {number} max mm or degrees (per minute)
   * @param {(value: number) => string} text of a preset
   */
  constructor(label, ownLabel, first, max, text) {
    this.#label = label;
    this.#ownLabel = ownLabel;
    this.#first = first;
    this.#text = text;
    this.#own.addEventListener("input", () => {
      const value = readNumber(this.#own.value) * this.#scale.size;
      const isRight = value > 0 && value <= max;
      setAttr(this.#own, "aria-invalid", this.#own.value !== "" && !isRight);
      if (isRight) this.#choose(value);
    });
  }

  /** mm or degrees (per minute). */
  get value() {
    return this.#chosen ?? (this.#presets[this.#first] ?? 0) * this.#scale.size;
  }

  /** The same in the unit that is shown. */
  get shown() {
    const preset = this.#preset();
    return preset ?? this.value / this.#scale.size;
  }

  get unit() {
    return this.#scale.unit;
  }

  /** @param {number[]} presets in the unit @param {Scale} scale @param {string} unit as it is shown */
  render(presets, scale, unit) {
    if (scale.unit === this.#scale.unit) return;
    [this.#presets, this.#scale] = [presets, scale];
    setText(this.#name, `${this.#label}, ${unit}`);
    setAttr(this.element, "aria-label", `${this.#label}, ${unit}`);
    setAttr(this.#own, "aria-label", `${this.#ownLabel}, ${unit}`);
    const pick = (/** @type {number} */ value) => button({ class: "button pick", role: "radio", onclick: () => this.#choose(value * scale.size) }, this.#text(value));
    fill(this.#picks, ...presets.map(pick));
    // typed text that was not accepted was in the previous unit
    this.#own.value = this.#preset() === undefined ? plain(this.shown) : "";
    setAttr(this.#own, "aria-invalid", false);
    this.#mark();
  }

  /** @param {number} value */
  #choose(value) {
    this.#chosen = value;
    this.#mark();
  }

  /** Returns the chosen preset; undefined if a typed value is chosen. */
  #preset() {
    return this.#presets.find((preset) => Math.abs(preset * this.#scale.size - this.value) <= EQUAL * this.value);
  }

  #mark() {
    const chosen = this.#preset();
    for (const [at, pick] of [...this.#picks.children].entries()) setAttr(pick, "aria-checked", String(this.#presets[at] === chosen));
    setAttr(this.#own, "data-chosen", chosen === undefined);
  }
}
