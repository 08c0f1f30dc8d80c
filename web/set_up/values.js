// Fields whose values are stored when the field loses the focus or Enter is pressed, and the undo of changes.

import { disableFor, whyNotNow } from "../access/why_not.js";
import { readNumber } from "../text/format.js";
import { t } from "../text/language.js";
import { button, h, isRemoved, setAttr } from "../ui/dom.js";
import { icon } from "../ui/icons.js";

/**
 * A section of the panel Set up.
 * @typedef {{title: string, create: (app: import("../main.js").App) => {element: HTMLElement, render: () => void, read: () => void}}} Section
 */

/** Numbers without a unit. @type {import("../text/units.js").Scale} */
const UNITLESS = { unit: "", size: 1, decimals: 3 };

/**
 * A number field. Typed text uses the displayed unit; if the unit changes before it is stored, the text is discarded.
 * @param {import("../main.js").App} app
 * @param {string} label
 * @param {(value: number) => void} store of a length or an angle, mm or degrees
 */
export function numberField(app, label, store) {
  let scale = UNITLESS;
  const input = h("input", { type: "text", inputmode: "decimal", class: "input value", "aria-label": label, autocomplete: "off" });
  let shown = "";
  // typed text stays while the field is disabled, which removes its focus
  let isTyped = false;
  const leave = () => {
    // a row that is removed or disabled does not store a half-typed number
    if (isRemoved() || input.disabled) return;
    isTyped = false;
    const text = input.value.trim();
    if (text === shown) return;
    shown = text;
    const value = readNumber(text);
    const isNumber = Number.isFinite(value);
    setAttr(input, "aria-invalid", !isNumber);
    if (isNumber) store(value * scale.size);
  };
  input.addEventListener("input", () => {
    isTyped = true;
  });
  input.addEventListener("change", leave);
  input.addEventListener("keydown", (event) => {
    if (event.key === "Enter") leave();
    if (event.key !== "Escape") return;
    input.value = shown;
    isTyped = false;
  });
  return {
    element: input,
    /** Discards typed text, because the field shows another value from now on. */
    forget() {
      isTyped = false;
    },
    /** Shows a value, unless a value is being typed. @param {string} text @param {import("../text/units.js").Scale} [of] its unit */
    show(text, of = UNITLESS) {
      const isUnstored = isTyped && input.value !== shown;
      if (isUnstored && of.unit === scale.unit) return;
      if (isUnstored) app.toast(t("values.discarded", { field: label, typed: input.value, before: scale.unit, unit: of.unit }), "error");
      isTyped = false;
      scale = of;
      shown = text;
      if (input.value !== text) input.value = text;
      setAttr(input, "aria-invalid", false);
    },
  };
}

/** Changes that can be undone, the last first: a name, and the undo. */
export class Undo {
  /** @type {{says: string, back: () => Promise<void>}[]} */
  #changes = [];

  /** @param {import("../main.js").App} app @param {() => void} read after a change was undone */
  constructor(app, read) {
    this.app = app;
    this.read = read;
    this.element = button({ class: "button small undo", onclick: () => void this.#back() }, icon("back"), t("undo.undo"));
  }

  /**
   * Executes a change.
   * @param {string} says @param {() => Promise<void>} change @param {() => Promise<void>} back
   */
  async do(says, change, back) {
    if (await this.app.attempt(change)) this.#changes.push({ says, back });
    this.read();
  }

  render() {
    const last = this.#changes.at(-1);
    disableFor(this.element, last ? whyNotNow(this.app.model) : t("undo.nothing_has_been_changed_here"), t("undo.take_back", { change: last?.says ?? "" }));
  }

  async #back() {
    const last = this.#changes.pop();
    if (last && !(await this.app.attempt(last.back))) this.#changes.push(last);
    this.read();
  }
}
