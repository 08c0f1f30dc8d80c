// Programs of the store.

import { Refusal } from "../api.js";
import { card, fill, h, setAttr, setText } from "../dom.js";
import { numberFor, openEditor } from "../editor.js";
import { count, showFindings } from "../findings.js";
import { bytes, programName } from "../format.js";
import { icon } from "../icons.js";

const LOADABLE = new Set(["READY", "PROGRAM_COMPLETED", "STOPPED"]);

/** @type {import("../main.js").View} */
export const programs = {
  place: "right",
  create(app) {
    const again = h("button", { type: "button", class: "button small", "aria-label": "Read again", title: "Read again" }, icon("reset"));
    again.addEventListener("click", () => void app.readPrograms());
    const picker = h("input", { type: "file", accept: ".nc,.txt,.cnc,.ngc,.tap,text/plain", hidden: true, "aria-label": "NC program file" });
    picker.addEventListener("change", () => void openFile(app, picker));
    const file = h("button", { type: "button", class: "button small", title: "Store an NC program of this computer" }, icon("file"), "Open file");
    file.addEventListener("click", () => picker.click());
    const list = h("ul", { class: "list", "aria-label": "Programs of the store" });
    const empty = h("p", { class: "empty" });
    let shown = "";
    const render = () => {
      const { model } = app;
      const { programs: known, current } = model;
      setText(empty, known === null ? "" : "The store is empty.");
      setAttr(empty, "hidden", known === null || known.length > 0);
      const key = JSON.stringify(known);
      if (key !== shown) {
        shown = key;
        fill(list, ...(known ?? []).map((program) => entry(app, program)));
      }
      for (const item of list.children) {
        const number = Number(/** @type {HTMLElement} */ (item).dataset.number);
        const loaded = number === current?.state?.program;
        setAttr(item, "data-loaded", loaded);
        const button = /** @type {HTMLButtonElement | null} */ (item.querySelector("button.load"));
        const usable = model.online && LOADABLE.has(current?.state?.execution ?? "") && !current?.state?.transition;
        if (button) button.disabled = !usable;
      }
    };
    return { element: card("programs-card", "Programs", [file, again, picker], list, empty), render };
  },
};

/** @param {import("../main.js").App} app @param {import("../types.d.ts").ProgramInfo} program */
function entry(app, program) {
  const load = h("button", { type: "button", class: "button load", "aria-label": `Load ${programName(program.number)}` }, icon("load"), "Load");
  load.addEventListener("click", () => {
    const cs = app.model.selected;
    void app.attempt(async () => {
      try {
        await app.api.command(cs, "load", { program: program.number });
      } catch (error) {
        const diagnostics = error instanceof Refusal ? error.problem.diagnostics : undefined;
        if (!diagnostics?.length) throw error;
        showFindings(program.number, diagnostics);
      }
    });
  });
  const edit = h("button", { type: "button", class: "icon-button", "aria-label": `Edit ${programName(program.number)}`, title: "Edit" }, icon("edit"));
  edit.addEventListener("click", () => void app.attempt(async () => openEditor(app, program.number, await app.api.programText(program.number))));
  const found = [count(program.errors, "error"), count(program.warnings, "warning")].filter((text) => text !== "").join(", ");
  const findings = h(
    "button",
    { type: "button", class: "chip-button", "aria-label": `${found} in ${programName(program.number)}: show` },
    h("span", { class: "chip", "data-tone": program.errors > 0 ? "alarm" : "attention" }, found),
  );
  findings.addEventListener("click", () => void app.attempt(async () => showFindings(program.number, await app.api.check(program.number))));
  return h(
    "li",
    { class: "stored", "data-number": program.number },
    h(
      "div",
      { class: "grow" },
      h("div", { class: "row" }, h("strong", {}, programName(program.number)), h("span", { class: "chip loaded-chip" }, "loaded"), found !== "" && findings),
      h("p", { class: "muted title", title: program.title }, program.title || bytes(program.bytes)),
    ),
    edit,
    load,
  );
}

/** A file of this computer into the editor. @param {import("../main.js").App} app @param {HTMLInputElement} picker */
async function openFile(app, picker) {
  const file = picker.files?.[0];
  // the same file may be chosen again
  picker.value = "";
  if (!file) return;
  try {
    openEditor(app, numberFor(file.name, app.model.programs ?? []), await file.text());
  } catch {
    app.toast(`${file.name} cannot be read.`, "error");
  }
}
