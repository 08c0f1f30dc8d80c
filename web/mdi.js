// Manual data input: a line of NC text with a history, and its diagnostics.

import { diagnosticsOf } from "./api.js";
import { button, fill, h, setAttr } from "./dom.js";
import { finding } from "./findings.js";
import { icon } from "./icons.js";
import { t } from "./language.js";
import { disableFor } from "./why_not.js";

/** Lines of the history. */
const HISTORY_MAX = 50;

/** @param {import("./main.js").App} app */
export function mdiLine(app) {
  const input = h("input", {
    type: "text", class: "mdi-input", "aria-label": t("mdi.nc_text_to_run_at"), placeholder: "G54 G00 X0 Y0",
    autocomplete: "off", autocapitalize: "characters", spellcheck: "false", "aria-describedby": "mdi-findings",
  });
  const run = button({ type: "submit" }, icon("play"), t("mdi.run"));
  const findings = h("ol", { id: "mdi-findings", class: "list mdi-findings", "aria-live": "polite" });
  const element = h("form", { class: "mdi" }, h("div", { class: "row" }, h("span", { class: "label" }, t("mdi.mdi")), input, run), findings);
  /** @type {string[]} */
  const history = [];
  /** Index in the history; its length means the line that is being typed. */
  let at = 0;
  let draft = "";

  input.addEventListener("keydown", (event) => {
    const step = { ArrowUp: -1, ArrowDown: 1 }[event.key] ?? 0;
    const next = at + step;
    if (step === 0 || next < 0 || next > history.length) return;
    event.preventDefault();
    if (at === history.length) draft = input.value;
    at = next;
    input.value = history[at] ?? draft;
    input.setSelectionRange(input.value.length, input.value.length);
  });
  element.addEventListener("submit", (event) => {
    event.preventDefault();
    const text = input.value.trim();
    // Enter submits even if the button is disabled
    if (text === "" || run.disabled) return;
    const cs = app.model.selected;
    void app.attempt(async () => {
      fill(findings);
      try {
        await app.api.command(cs, "mdi", { text });
      } catch (error) {
        fill(findings, ...diagnosticsOf(error).map(finding));
        return;
      }
      if (history.at(-1) !== text) history.push(text);
      if (history.length > HISTORY_MAX) history.shift();
      at = history.length;
      draft = "";
      input.value = "";
    });
  });
  /** @param {string | null} whyNot */
  const render = (whyNot) => {
    disableFor(run, whyNot);
    setAttr(input, "aria-invalid", findings.childElementCount > 0);
  };
  return { element, render };
}
