// Renames a program: stores it under the new number only if that is free, then deletes the old number.

import { whyNotNow } from "../access/why_not.js";
import { programName } from "../text/format.js";
import { sentences, t } from "../text/language.js";
import { openDialog } from "../ui/dialog.js";
import { button, h } from "../ui/dom.js";
import { numberFor } from "./dialog.js";

/** @param {import("../main.js").App} app @param {import("../types.d.ts").ProgramInfo} program */
export function rename(app, program) {
  const { number, title, signature } = program;
  const why = whyNotNow(app.model, "administrate") ?? whyLoaded(app.model, number);
  if (why) return app.toast(why, "error");
  const name = programName(number);
  const field = h("input", { type: "number", class: "input editor-number", min: 1, max: 9999, step: 1, value: numberFor("", app.model.programs ?? []), required: true, autofocus: true });
  const form = h(
    "form",
    {},
    h("p", {}, title || t("common.no_title")),
    h("label", { class: "row" }, h("span", { class: "label" }, t("rename.new_number")), field),
    h("p", { class: "muted note" }, sentences(t("rename.callers", { number }), signature === "valid" && t("rename.signature"))),
    h("div", { class: "row end" }, button({ onclick: () => dialog.close() }, t("common.cancel")), button({ type: "submit", class: "button primary" }, t("rename.rename"))),
  );
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    void app.attempt(async () => {
      const { text, hash } = await app.api.program(number);
      await app.api.storeProgram(Number(field.value), new Blob([text]), null, program.dialect);
      if (program.folder !== "") await app.api.moveToFolder(Number(field.value), program.folder);
      await app.api.removeProgram(number, hash);
      dialog.close();
      app.toast(t("rename.is_now", { program: name, to: programName(Number(field.value)) }));
    }).then(() => app.readPrograms());
  });
  const dialog = openDialog("rename", t("rename.title", { program: name }), [form]);
}

/** @param {import("../machine/model.js").Model} model @param {number} number */
function whyLoaded({ systems }, number) {
  const [cs] = [...systems].find(([, { state }]) => state?.program === number) ?? [];
  return cs === undefined ? null : t("rename.is_loaded", { program: programName(number), cs });
}
