// Programs of the store.

import { diagnosticsOf } from "../api.js";
import { button, card, fill, h, setAttr, setText } from "../dom.js";
import { numberFor, openEditor } from "../editor.js";
import { counts, showFindings } from "../findings.js";
import { bytes, programName, shortHash } from "../format.js";
import { icon } from "../icons.js";

const LOADABLE = new Set(["READY", "PROGRAM_COMPLETED", "STOPPED"]);

/** @type {Record<string, string>} */
const SIGNATURES = { valid: "signed", missing: "not signed", wrong: "wrong signature" };

/** @type {import("../main.js").View} */
export const programs = {
  place: "right",
  create(app) {
    const again = button({ class: "button small", "aria-label": "Read again", title: "Read again", onclick: () => void app.readPrograms() }, icon("reset"));
    const picker = h("input", { type: "file", accept: ".nc,.txt,.cnc,.ngc,.tap,text/plain", hidden: true, "aria-label": "NC program file" });
    picker.addEventListener("change", () => void openFile(app, picker));
    const file = button({ class: "button small", title: "Store an NC program of this computer", onclick: () => picker.click() }, icon("file"), "Open file");
    const list = h("ul", { class: "list", "aria-label": "Programs of the store" });
    const empty = h("p", { class: "empty" });
    let shown = "";
    const render = () => {
      const { model } = app;
      const { programs: known, current } = model;
      setText(empty, known === null ? "" : "The store is empty.");
      setAttr(empty, "hidden", known === null || known.length > 0);
      const key = JSON.stringify([known, current?.info.dialect]);
      if (key !== shown) {
        shown = key;
        fill(list, ...(known ?? []).map((program) => entry(app, program)));
      }
      for (const item of list.children) {
        const number = Number(/** @type {HTMLElement} */ (item).dataset.number);
        const loaded = number === current?.state?.program;
        setAttr(item, "data-loaded", loaded);
        const load = /** @type {HTMLButtonElement | null} */ (item.querySelector("button.load"));
        const usable = model.online && LOADABLE.has(current?.state?.execution ?? "") && !current?.state?.transition;
        if (load) load.disabled = !usable;
      }
    };
    return { element: card("programs-card", "Programs", [file, again, picker], list, empty), render };
  },
};

/** @param {import("../main.js").App} app @param {import("../types.d.ts").ProgramInfo} program */
function entry(app, program) {
  const { number, o_number: o } = program;
  const name = programName(number);
  const onLoad = () => {
    const cs = app.model.selected;
    void app.attempt(() => app.api.command(cs, "load", { program: number }).catch((error) => showFindings(number, diagnosticsOf(error))));
  };
  const onEdit = () => void app.attempt(async () => {
    const { text, hash } = await app.api.program(number);
    openEditor(app, number, text, hash, program.dialect);
  });
  const onFindings = () => void app.attempt(async () => showFindings(number, await app.api.check(number)));
  const load = button({ class: "button load", "aria-label": `Load ${name}`, onclick: onLoad }, icon("load"), "Load");
  const edit = button({ class: "icon-button", "aria-label": `Edit ${name}`, title: "Edit", onclick: onEdit }, icon("edit"));
  const found = counts(program.errors, program.warnings);
  const findings = button(
    { class: "chip-button", "aria-label": `${found} in ${name}: show`, onclick: onFindings },
    h("span", { class: "chip", "data-tone": program.errors > 0 ? "alarm" : "attention" }, found),
  );
  return h(
    "li",
    { class: "stored", "data-number": number },
    h(
      "div",
      { class: "grow" },
      h("div", { class: "row" }, h("strong", {}, name), h("span", { class: "chip loaded-chip" }, "loaded"), found !== "" && findings),
      h("p", { class: "muted title", title: program.title }, program.title || bytes(program.bytes)),
      h("p", { class: "muted title", title: `SHA-256 ${program.hash}` }, [o === null || o === undefined ? "" : `O${o} in its text`, program.dialect === app.model.current?.info.dialect ? "" : program.dialect, shortHash(program.hash), SIGNATURES[program.signature ?? ""]].filter(Boolean).join(" · ")),
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
