// Programs of the store: found, sorted, loaded, edited, downloaded, deleted; files are dropped anywhere on the screen.

import { diagnosticsOf } from "../api.js";
import { button, fill, h, setAttr, setText } from "../dom.js";
import { numberFor, openEditor } from "../editor/dialog.js";
import { rename } from "../editor/rename.js";
import { counts, showFindings } from "../findings.js";
import { bytes, programName, shortHash } from "../format.js";
import { icon } from "../icons.js";
import { orderParts } from "../order.js";
import { disableFor, whyNot, whyNotNow } from "../why_not.js";

/** @typedef {import("../types.d.ts").ProgramInfo} ProgramInfo */

/** @type {Record<string, string>} */
const SIGNATURES = { valid: "signed", missing: "not signed", wrong: "wrong signature" };

/** @type {Record<string, (a: ProgramInfo, b: ProgramInfo) => number>} */
const ORDERS = {
  "by number": (a, b) => a.number - b.number,
  "by title": (a, b) => a.title.localeCompare(b.title),
  "largest first": (a, b) => b.bytes - a.bytes,
  "with findings first": (a, b) => b.errors - a.errors || b.warnings - a.warnings,
};

/** @type {import("../main.js").View} */
export const programs = {
  place: "right",
  panel: { name: "programs", title: "Programs" },
  create(app) {
    const again = button({ class: "icon-button", "aria-label": "Read again", title: "Read again", onclick: () => void app.readPrograms() }, icon("reset"));
    const picker = h("input", { type: "file", accept: ".nc,.txt,.cnc,.ngc,.tap,text/plain", hidden: true, "aria-label": "NC program file" });
    picker.addEventListener("change", () => {
      const file = picker.files?.[0];
      // the same file may be chosen again
      picker.value = "";
      if (file) void openFile(app, file);
    });
    const file = button({ title: "Store an NC program of this computer, or drop it anywhere", onclick: () => picker.click() }, icon("file"), "Open file");
    const search = h("input", { type: "search", class: "input grow", "aria-label": "Search programs", placeholder: "Search" });
    const order = h("select", { class: "input", "aria-label": "Order of programs" }, ...Object.keys(ORDERS).map((name) => h("option", { value: name }, name)));
    for (const one of [search, order]) one.addEventListener("input", () => app.invalidate());
    const list = h("ul", { class: "list", "aria-label": "Programs of the store" });
    const empty = h("p", { class: "empty" });
    takeDrops(app);
    let shown = "";
    const render = () => {
      const { model } = app;
      const { programs: known, current } = model;
      const found = [...(known ?? [])].filter((program) => isFound(program, search.value)).sort(ORDERS[order.value]);
      setText(empty, known === null ? "" : known.length === 0 ? "The store is empty." : `No program is called “${search.value}”.`);
      setAttr(empty, "hidden", known === null || found.length > 0);
      const key = JSON.stringify([found, current?.info.dialect]);
      if (key !== shown) {
        shown = key;
        fill(list, ...found.map((program) => entry(app, program)));
      }
      const why = whyNot(model, "load");
      for (const item of list.children) {
        const number = Number(/** @type {HTMLElement} */ (item).dataset.number);
        setAttr(item, "data-loaded", number === current?.state?.program);
        const load = /** @type {HTMLButtonElement | null} */ (item.querySelector("button.load"));
        if (load) disableFor(load, why);
      }
      disableFor(file, whyNotNow(model, "administrate"), "Store an NC program of this computer, or drop it anywhere");
    };
    const tools = h("div", { class: "programs-tools" }, search, order, file, again, picker);
    return { element: h("div", { class: "programs-card" }, tools, list, empty), render };
  },
};

/** @param {ProgramInfo} program @param {string} wanted */
function isFound({ number, title }, wanted) {
  const words = wanted.toLowerCase().split(/\s+/);
  const text = `${programName(number)} ${title}`.toLowerCase();
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
  const load = button({ class: "button load", "aria-label": `Load ${name}`, onclick: onLoad }, icon("load"), "Load");
  const tool = (/** @type {string} */ says, /** @type {string} */ sign, /** @type {() => void} */ onclick) =>
    button({ class: "icon-button", "aria-label": `${says} ${name}`, title: says, onclick }, icon(sign));
  const found = counts(program.errors, program.warnings);
  const findings = button(
    { class: "chip-button", "aria-label": `${found} in ${name}: show`, onclick: onFindings },
    h("span", { class: "chip", "data-tone": program.errors > 0 ? "alarm" : "attention" }, found),
  );
  const facts = [o === null || o === undefined ? "" : `O${o} in its text`, program.dialect === app.model.current?.info.dialect ? "" : program.dialect, bytes(program.bytes), shortHash(program.hash), SIGNATURES[program.signature ?? ""]];
  return h(
    "li",
    { class: "stored", "data-number": number },
    h("div", { class: "row" }, h("strong", {}, name), h("span", { class: "chip loaded-chip" }, "loaded"), found !== "" && findings),
    h("p", { class: "muted title", title: program.title }, program.title || "no title"),
    h("p", { class: "muted title", title: `SHA-256 ${program.hash}` }, facts.filter(Boolean).join(" · ")),
    h("div", { class: "row stored-tools" }, tool("Run parts of", "play", () => orderParts(app, program)), tool("Edit", "edit", onEdit), tool("Rename", "rename", () => rename(app, program)), tool("Save a copy of", "save", () => void download(app, number)), tool("Delete", "trash", () => void remove(app, program)), h("span", { class: "spring" }), load),
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
    title: `Delete ${name}?`,
    text: `${name}${title ? ` (${title})` : ""} is taken out of the store for good. Download it first if it is wanted again.`,
    yes: `Delete ${name}`,
    no: "Keep it",
  });
  if (!sure) return;
  await app.attempt(() => app.api.removeProgram(number, hash));
  await app.readPrograms();
}

/** A file of this computer into the editor. @param {import("../main.js").App} app @param {File} file */
async function openFile(app, file) {
  try {
    await openEditor(app, { number: numberFor(file.name, app.model.programs ?? []), text: await file.text() });
  } catch {
    app.toast(`${file.name} cannot be read.`, "error");
  }
}

/** One file that is dropped is opened; several are stored, each under its number. @param {import("../main.js").App} app */
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
  if (twice) return app.toast("Two of these files have the same number, or none. Open them one by one.", "error");
  if (taken.length > 0) {
    const sure = await app.confirm({
      title: `Replace ${taken.length} program${taken.length === 1 ? "" : "s"}?`,
      text: `${taken.map(({ number }) => programName(number)).join(", ")} ${taken.length === 1 ? "is" : "are"} in the store already.`,
      yes: "Replace",
      no: "Store nothing",
    });
    if (!sure) return;
  }
  for (const { file, number } of planned) {
    await app.attempt(async () => {
      await app.api.storeProgram(number, await file.text(), "", app.model.current?.info.dialect ?? "");
      app.toast(`${file.name} is stored as ${programName(number)}.`);
    });
  }
  await app.readPrograms();
}
