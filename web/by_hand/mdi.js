// Manual data input: a line of NC text with a history, and its diagnostics.

import { disableFor } from "../access/why_not.js";
import { diagnosticsOf } from "../machine/api.js";
import { explained } from "../machine/explain.js";
import { finding } from "../programs/findings.js";
import { t } from "../text/language.js";
import { lengthScale, manualUnitOf } from "../text/units.js";
import { button, fill, h, setAttr, setText, showPending } from "../ui/dom.js";
import { icon } from "../ui/icons.js";

/** Lines of the history. */
const HISTORY_MAX = 50;
/** The code of each unit, and a pattern for both. */
const UNIT_CODES = { mm: "G21", inch: "G20" };
const HAS_UNIT = /G0*2[01](?![\d.])/i;

/** NC text and the unit in which its numbers were written; null: not known. @typedef {{text: string, unit: import("../text/units.js").Unit | null}} Line */

/** The line that is typed, with the lines that were run before. Each keeps the unit in which it was written. */
class LineField {
  input = h("input", {
    type: "text", class: "mdi-input", "aria-label": t("mdi.nc_text_to_run_at"), placeholder: "G54 G00 X0 Y0",
    autocomplete: "off", autocapitalize: "characters", spellcheck: "false", "aria-describedby": "mdi-findings",
  });
  /** The unit in which the next line begins. @type {Line["unit"]} */
  unit = null;
  /** True after the text was sent, while it runs. */
  isSent = false;
  /** The unit in which the text was written. @type {Line["unit"]} */
  #written = null;
  /** @type {Line[]} */
  #history = [];
  /** Index in the history; its length means the line that is being typed. */
  #at = 0;
  /** @type {Line} */
  #draft = { text: "", unit: null };
  #toast;

  /** @param {(text: string) => void} toast */
  constructor(toast) {
    this.#toast = toast;
    this.input.addEventListener("input", () => this.keepUnit());
    this.input.addEventListener("keydown", (event) => {
      const step = { ArrowUp: -1, ArrowDown: 1 }[event.key] ?? 0;
      const next = this.#at + step;
      if (step === 0 || next < 0 || next > this.#history.length) return;
      event.preventDefault();
      if (this.#at === this.#history.length) this.#draft = this.line;
      this.#at = next;
      this.#show(this.#history[next] ?? this.#draft);
    });
  }

  /** @returns {Line} */
  get line() {
    return { text: this.input.value.trim(), unit: this.#written };
  }

  /** Adds the code of its unit to a text that was written in another unit than that of the next line. */
  keepUnit() {
    if (this.isSent) return;
    const { input, unit } = this;
    if (input.value.trim() === "") this.#written = null;
    else if (this.#written !== null && unit !== null && this.#written !== unit) {
      const code = UNIT_CODES[this.#written];
      if (!HAS_UNIT.test(input.value)) {
        input.setRangeText(`${code} `, 0, 0, "preserve");
        this.#toast(t("mdi.keeps_unit", { unit: lengthScale(unit).unit, code }));
      }
      this.#written = unit;
    } else this.#written ??= unit;
  }

  /** Appends a line that was run to the history, and empties the field. @param {Line} line */
  done(line) {
    if (this.#history.at(-1)?.text !== line.text) this.#history.push(line);
    if (this.#history.length > HISTORY_MAX) this.#history.shift();
    this.#at = this.#history.length;
    this.#draft = { text: "", unit: null };
    this.#show(this.#draft);
  }

  /** @param {Line} line */
  #show({ text, unit }) {
    this.input.value = text;
    this.input.setSelectionRange(text.length, text.length);
    this.#written = unit;
    this.keepUnit();
  }
}

/** @param {import("../main.js").App} app */
export function mdiLine(app) {
  const field = new LineField((text) => app.toast(text));
  const { input } = field;
  const run = button({ type: "submit" }, icon("play"), t("mdi.run"));
  const codes = h("span", { class: "row" });
  const carried = h("div", { class: "row mdi-carried", role: "status", "data-tone": "attention" }, h("span", {}, t("mdi.in_force")), codes);
  const findings = h("ol", { id: "mdi-findings", class: "list mdi-findings", "aria-live": "polite" });
  const name = h("span", { class: "label" });
  const element = h("form", { class: "mdi" }, h("div", { class: "row" }, name, input, run), carried, findings);
  let shown = "";

  element.addEventListener("submit", (event) => {
    event.preventDefault();
    const { line } = field;
    // Enter submits even if the button is disabled
    if (line.text === "" || run.disabled) return;
    const settled = app.accepted(async (onAccepted) => {
      fill(findings);
      field.isSent = true;
      try {
        await app.commandAsSeen("mdi", { text: line.text }, onAccepted);
      } catch (error) {
        fill(findings, ...diagnosticsOf(error).map(finding));
        return;
      } finally {
        field.isSent = false;
      }
      field.done(line);
    });
    showPending(run, settled);
  });
  /** @param {string | null} whyNot */
  const render = (whyNot) => {
    disableFor(run, whyNot);
    const { current } = app.model;
    // during a run the unit of the next line is unknown
    if (current?.state?.run_kind === null && current.state.transition === null) field.unit = manualUnitOf(current);
    setText(name, field.unit === null ? t("mdi.unit_unknown") : t("mdi.mdi", { unit: lengthScale(field.unit).unit }));
    field.keepUnit();
    const inForce = current?.modal?.mdi ?? [];
    const key = inForce.join(" ");
    if (key !== shown) fill(codes, ...inForce.map(explained));
    shown = key;
    setAttr(carried, "hidden", inForce.length === 0);
    setAttr(input, "aria-invalid", findings.childElementCount > 0);
  };
  return { element, render };
}
