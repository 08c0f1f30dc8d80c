// Programs of the store: search, sort, load, edit, download, delete; files can be dropped anywhere on the screen.

import { disableFor, whyNot, whyNotNow } from "../access/why_not.js";
import { numberFor, openEditor } from "../editor/dialog.js";
import { rename } from "../editor/rename.js";
import { diagnosticsOf } from "../machine/api.js";
import { counts, showFindings } from "../programs/findings.js";
import { askForFolder, foldersKey, inFolders } from "../programs/folders.js";
import { orderParts } from "../programs/order.js";
import { bytes, programName, shortHash } from "../text/format.js";
import { listed, t } from "../text/language.js";
import { button, fill, h, setAttr, setText } from "../ui/dom.js";
import { icon } from "../ui/icons.js";

/** @typedef {import("../types.d.ts").ProgramInfo} ProgramInfo */

/** @type {Record<string, string>} */
const SIGNATURES = { valid: t("programs.signed"), missing: t("programs.not_signed"), wrong: t("programs.wrong_signature") };

/** @type {Record<string, (a: ProgramInfo, b: ProgramInfo) => number>} */
const ORDERS = {
  number: (a, b) => a.number - b.number,
  title: (a, b) => a.title.localeCompare(b.title),
  size: (a, b) => b.bytes - a.bytes,
  findings: (a, b) => b.errors - a.errors || b.warnings - a.warnings,
};
const ORDER_NAMES = { number: t("programs.by_number"), title: t("programs.by_title"), size: t("programs.largest_first"), findings: t("programs.findings_first") };

/** @type {import("../main.js").View} */
export const programs = {
  place: "right",
  panel: { name: "programs", title: t("programs.programs") },
  create(app) {
    const again = button({ class: "icon-button", "aria-label": t("common.read_again"), title: t("common.read_again"), onclick: () => void app.readPrograms() }, icon("reset"));
    const picker = h("input", { type: "file", accept: ".nc,.txt,.cnc,.ngc,.tap,text/plain", hidden: true, "aria-label": t("programs.nc_program_file") });
    picker.addEventListener("change", () => {
      const file = picker.files?.[0];
      // the same file may be chosen again
      picker.value = "";
      if (file) void openFile(app, file);
    });
    const file = button({ title: t("programs.store_an_nc_program_of"), onclick: () => picker.click() }, icon("file"), t("programs.open_file"));
    const search = h("input", { type: "search", class: "input grow", "aria-label": t("programs.search_programs"), placeholder: t("programs.search") });
    const order = h("select", { class: "input", "aria-label": t("programs.order_of_programs") }, ...Object.entries(ORDER_NAMES).map(([value, name]) => h("option", { value }, name)));
    for (const one of [search, order]) one.addEventListener("input", () => app.invalidate());
    const list = h("ul", { class: "list", "aria-label": t("programs.programs_of_the_store") });
    const empty = h("p", { class: "empty" });
    takeDrops(app);
    let shown = "";
    const render = () => {
      const { model } = app;
      const { programs: known, current } = model;
      const found = [...(known ?? [])].filter((program) => isFound(program, search.value)).sort(ORDERS[order.value]);
      setText(empty, known === null ? "" : known.length === 0 ? t("programs.the_store_is_empty") : t("programs.none_called", { search: search.value }));
      setAttr(empty, "hidden", known === null || found.length > 0);
      const key = JSON.stringify([found, current?.info.dialect, foldersKey(), search.value !== "", whyNotNow(model, "administrate")]);
      if (key !== shown) {
        shown = key;
        fill(list, ...inFolders(app, found, (program) => entry(app, program), search.value !== ""));
      }
      const why = whyNot(model, "load");
      for (const item of list.children) {
        const number = Number(/** @type {HTMLElement} */ (item).dataset.number);
        setAttr(item, "data-loaded", number === current?.state?.program);
        const load = /** @type {HTMLButtonElement | null} */ (item.querySelector("button.load"));
        if (load) disableFor(load, why);
      }
      disableFor(file, whyNotNow(model, "administrate"), t("programs.store_an_nc_program_of"));
    };
    const tools = h("div", { class: "programs-tools" }, search, again, order, file, picker);
    return { element: h("div", { class: "programs-card" }, tools, list, empty), render };
  },
};

/** @param {ProgramInfo} program @param {string} wanted */
function isFound({ number, title, folder }, wanted) {
  const words = wanted.toLowerCase().split(/\s+/);
  const text = `${programName(number)} ${title} ${folder}`.toLowerCase();
  return words.every((word) => text.includes(word));
}

/** @param {import("../main.js").App} app @param {ProgramInfo} program */
function entry(app, program) {
  const { number, o_number: o } = program;
  const name = programName(number);
  const onLoad = () => {
    const cs = app.model.selected;
    void app.attempt(() => app.load(cs, number).catch((error) => showFindings(number, diagnosticsOf(error))));
  };
  const onEdit = () => void app.attempt(async () => {
    const isClean = program.errors + program.warnings === 0;
    const [{ text, hash }, found] = await Promise.all([app.api.program(number), isClean ? [] : app.api.check(number)]);
    await openEditor(app, { number, text, hash, dialect: program.dialect, found });
  });
  const onFindings = () => void app.attempt(async () => showFindings(number, await app.api.check(number)));
  const load = button({ class: "button load", "aria-label": t("programs.load", { program: name }), onclick: onLoad }, icon("load"), t("programs.load_2"));
  const tool = (/** @type {string} */ says, /** @type {string} */ sign, /** @type {() => void} */ onclick) =>
    button({ class: "icon-button", "aria-label": says, title: says, onclick }, icon(sign));
  const found = counts(program.errors, program.warnings);
  const findings = button(
    { class: "chip-button", "aria-label": t("programs.show_findings", { found, program: name }), onclick: onFindings },
    h("span", { class: "chip", "data-tone": program.errors > 0 ? "alarm" : "attention" }, found),
  );
  const facts = [o === null || o === undefined ? "" : t("programs.own_number", { o }), program.dialect === app.model.current?.info.dialect ? "" : program.dialect, bytes(program.bytes), shortHash(program.hash), SIGNATURES[program.signature ?? ""]];
  return h(
    "li",
    { class: "stored", "data-number": number },
    h("div", { class: "row" }, h("strong", {}, name), h("span", { class: "chip loaded-chip" }, t("programs.loaded")), found !== "" && findings, h("span", { class: "spring" }), tool(t("folders.move_program", { program: name }), "folder", () => askForFolder(app, program))),
    h("p", { class: "muted title", title: program.title }, program.title || t("common.no_title")),
    h("p", { class: "muted title", title: `SHA-256 ${program.hash}` }, facts.filter(Boolean).join(" · ")),
    h("div", { class: "row stored-tools" }, tool(t("programs.run_parts", { program: name }), "play", () => orderParts(app, program)), tool(t("programs.edit", { program: name }), "edit", onEdit), tool(t("programs.rename", { program: name }), "rename", () => rename(app, program)), tool(t("programs.save_copy", { program: name }), "save", () => void download(app, number)), tool(t("programs.delete", { program: name }), "trash", () => void remove(app, program)), h("span", { class: "spring" }), load),
  );
}

/** @param {import("../main.js").App} app @param {number} number */
async function download(app, number) {
  await app.attempt(async () => {
    const { text } = await app.api.program(number);
    const link = h("a", { href: URL.createObjectURL(new Blob([text], { type: "text/plain" })), download: `${programName(number)}.nc` });
    link.click();
    URL.revokeObjectURL(link.href);
  });
}

/** @param {import("../main.js").App} app @param {ProgramInfo} program */
async function remove(app, { number, title, hash }) {
  const why = whyNotNow(app.model, "administrate");
  if (why) return app.toast(why, "error");
  const name = programName(number);
  const sure = await app.confirm({
    title: t("programs.ask_to_delete", { program: name }),
    text: t("programs.delete_about", { program: title ? `${name} (${title})` : name }),
    yes: t("programs.delete", { program: name }),
    no: t("programs.keep_it"),
  });
  if (!sure) return;
  await app.attempt(() => app.api.removeProgram(number, hash));
  await app.readPrograms();
}

/** Opens a file of this computer in the editor. @param {import("../main.js").App} app @param {File} file */
async function openFile(app, file) {
  try {
    await openEditor(app, { number: numberFor(file.name, app.model.programs ?? []), text: await file.text() });
  } catch {
    app.toast(t("programs.cannot_be_read", { file: file.name }), "error");
  }
}

/** Opens a dropped file; stores several dropped files, each under its number. @param {import("../main.js").App} app */
function takeDrops(app) {
  const hasFiles = (/** @type {DragEvent} */ event) => event.dataTransfer?.types.includes("Files") ?? false;
  document.addEventListener("dragover", (event) => {
    if (!hasFiles(event)) return;
    event.preventDefault();
    setAttr(document.body, "data-drop", true);
  });
  for (const end of /** @type {const} */ (["dragleave", "drop"])) {
    document.addEventListener(end, (event) => {
      if (end === "drop" || event.relatedTarget === null) setAttr(document.body, "data-drop", false);
    });
  }
  document.addEventListener("drop", (event) => {
    if (!hasFiles(event)) return;
    event.preventDefault();
    const files = [...(event.dataTransfer?.files ?? [])];
    const why = whyNotNow(app.model, "administrate");
    if (why) app.toast(why, "error");
    else if (files.length === 1 && files[0]) void openFile(app, files[0]);
    else void storeAll(app, files);
  });
}

/** @param {import("../main.js").App} app @param {File[]} files */
async function storeAll(app, files) {
  const known = app.model.programs ?? [];
  const planned = files.map((file) => ({ file, number: numberFor(file.name, known) }));
  const taken = planned.filter(({ number }) => known.some((program) => program.number === number));
  const twice = new Set(planned.map(({ number }) => number)).size < planned.length;
  if (twice) return app.toast(t("programs.two_of_these_files_have"), "error");
  if (taken.length > 0) {
    const sure = await app.confirm({
      title: t("programs.replace", { count: taken.length }),
      text: t("programs.replace_about", { count: taken.length, programs: listed(taken.map(({ number }) => programName(number))) }),
      yes: t("programs.replace_2"),
      no: t("programs.store_nothing"),
    });
    if (!sure) return;
  }
  for (const { file, number } of planned) {
    await app.attempt(async () => {
      await app.api.storeProgram(number, new Blob([await file.text()]), "", app.model.current?.info.dialect ?? "");
      app.toast(t("programs.is_stored_as", { file: file.name, program: programName(number) }));
    });
  }
  await app.readPrograms();
}
