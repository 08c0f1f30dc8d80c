// Orders a run of several parts: each further part begins when the part before is completed.

import { disableFor, whyNot } from "../access/why_not.js";
import { programName } from "../text/format.js";
import { t } from "../text/language.js";
import { openDialog } from "../ui/dialog.js";
import { button, h } from "../ui/dom.js";
import { acceptsRisks } from "./start_risks.js";

/** Most parts of one run. */
const PARTS_MAX = 1_000_000;

/** @param {import("../main.js").App} app @param {import("../types.d.ts").ProgramInfo} program */
export function orderParts(app, { number, title }) {
  const cs = app.model.selected;
  const name = programName(number);
  const field = h("input", { type: "number", class: "input editor-number", min: 1, max: PARTS_MAX, step: 1, value: 1, required: true, autofocus: true });
  const start = button({ type: "submit", class: "button primary" }, t("order.start"));
  const form = h(
    "form",
    {},
    h("p", {}, title || t("common.no_title")),
    h("label", { class: "row" }, h("span", { class: "label" }, t("order.parts")), field),
    h("p", { class: "muted note" }, t("order.about", { program: name, cs })),
    h("div", { class: "row end" }, button({ onclick: () => dialog.close() }, t("common.cancel")), start),
  );
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    const why = whyNot(app.model, "run");
    if (why) return app.toast(why, "error");
    dialog.close();
    void app.attempt(async () => {
      const isLoaded = number === app.model.current?.state?.program;
      if (isLoaded && !(await acceptsRisks(app))) return;
      await app.api.order(cs, number, Number(field.value));
    });
  });
  disableFor(start, whyNot(app.model, "run"));
  const dialog = openDialog("order", t("order.run", { program: name }), [form]);
}

/** Returns the progress of a run of several parts; empty for any other run. @param {import("../types.d.ts").Run | null | undefined} run */
export function partsSaid(run) {
  if (!run || run.end !== null || run.parts < 2) return "";
  const next = Math.min(run.parts_done + 1, run.parts);
  const told = { part: next, parts: run.parts };
  return run.waits_for ? t("order.part_waits", { ...told, text: run.waits_for }) : t("order.part", told);
}
