// Folders of programs: lists are grouped by them, and programs are moved by a dialog or by dragging them onto a folder.

import { whyNotNow } from "../access/why_not.js";
import { programName } from "../text/format.js";
import { t } from "../text/language.js";
import { openDialog } from "../ui/dialog.js";
import { button, h, setAttr } from "../ui/dom.js";
import { icon } from "../ui/icons.js";

/** @typedef {import("../types.d.ts").ProgramInfo} ProgramInfo */

/** Data type of a dragged program. */
const DRAGGED = "application/x-tandem-program";

/** Folders that are closed. @type {Set<string>} */
const closed = new Set();

/** Returns programs by folder, in the order of the names; programs without a folder are last. @param {ProgramInfo[]} programs @returns {[string, ProgramInfo[]][]} */
function grouped(programs) {
  /** @type {Map<string, ProgramInfo[]>} */
  const groups = new Map();
  for (const program of programs) groups.set(program.folder, [...(groups.get(program.folder) ?? []), program]);
  return [...groups].sort(([a], [b]) => Number(a === "") - Number(b === "") || a.localeCompare(b));
}

/**
 * Returns entries of programs, below the heads of their folders; without folders, the entries only.
 * @param {import("../main.js").App} app @param {ProgramInfo[]} programs @param {(program: ProgramInfo) => HTMLElement} entry @param {boolean} all closed folders are open, too
 */
export function inFolders(app, programs, entry, all) {
  const groups = grouped(programs);
  if (groups.every(([folder]) => folder === "")) return programs.map((program) => draggable(app, program, entry(program)));
  return groups.flatMap(([folder, members]) => {
    const isOpen = all || !closed.has(folder);
    return [head(app, folder, members.length, isOpen), ...(isOpen ? members.map((program) => draggable(app, program, entry(program))) : [])];
  });
}

/** Returns a key of the list's inputs other than the programs. */
export function foldersKey() {
  return [...closed].join("\n");
}

/** @param {import("../main.js").App} app @param {string} folder @param {number} count @param {boolean} isOpen */
function head(app, folder, count, isOpen) {
  const name = folder || t("folders.none");
  const toggle = () => {
    if (!closed.delete(folder)) closed.add(folder);
    app.invalidate();
  };
  const one = button({ class: "folder-head", "aria-expanded": String(isOpen), onclick: toggle }, icon("folder"), h("span", { class: "grow" }, name), h("span", { class: "muted" }, String(count)));
  const item = h("li", { class: "folder", "data-folder": folder }, one);
  const isProgram = (/** @type {DragEvent} */ event) => event.dataTransfer?.types.includes(DRAGGED) ?? false;
  item.addEventListener("dragover", (event) => {
    if (!isProgram(event)) return;
    event.preventDefault();
    setAttr(item, "data-drop", true);
  });
  item.addEventListener("dragleave", () => setAttr(item, "data-drop", false));
  item.addEventListener("drop", (event) => {
    if (!isProgram(event)) return;
    event.preventDefault();
    void move(app, Number(event.dataTransfer?.getData(DRAGGED)), folder);
  });
  return item;
}

/** @param {import("../main.js").App} app @param {ProgramInfo} program @param {HTMLElement} item */
function draggable(app, { number }, item) {
  if (whyNotNow(app.model, "administrate") !== null) return item;
  item.draggable = true;
  item.addEventListener("dragstart", (event) => event.dataTransfer?.setData(DRAGGED, String(number)));
  return item;
}

/** @param {import("../main.js").App} app @param {number} number @param {string} folder */
async function move(app, number, folder) {
  await app.attempt(() => app.api.moveToFolder(number, folder));
  await app.readPrograms();
}

/** Asks for the folder of a program. @param {import("../main.js").App} app @param {ProgramInfo} program */
export function askForFolder(app, { number, title, folder }) {
  const why = whyNotNow(app.model, "administrate");
  if (why) return app.toast(why, "error");
  const known = [...new Set((app.model.programs ?? []).map((program) => program.folder))].filter(Boolean).sort();
  const field = h("input", { type: "text", class: "input grow", value: folder, maxlength: 120, list: "known-folders", autocomplete: "off", autofocus: true, placeholder: t("folders.none") });
  const form = h(
    "form",
    {},
    h("p", {}, title || t("common.no_title")),
    h("label", { class: "row" }, h("span", { class: "label" }, t("folders.folder")), field),
    h("datalist", { id: "known-folders" }, ...known.map((name) => h("option", { value: name }))),
    h("p", { class: "muted note" }, t("folders.about")),
    h("div", { class: "row end" }, button({ onclick: () => dialog.close() }, t("common.cancel")), button({ type: "submit", class: "button primary" }, t("folders.move"))),
  );
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    void app.attempt(async () => {
      await app.api.moveToFolder(number, field.value.trim());
      dialog.close();
    }).then(() => app.readPrograms());
  });
  const dialog = openDialog("folder", t("folders.title", { program: programName(number) }), [form]);
}
