// The editor of stored programs: a text, typed or from a file, is stored under a number and then checked. A text that
// is too long for the editor is only shown, and stored unchanged.

import { disableFor, whyNotNow } from "../access/why_not.js";
import { meaning } from "../machine/explain.js";
import { tipOf } from "../machine/explain_tip.js";
import { finding, summary } from "../programs/findings.js";
import { programName, shortHash, whole } from "../text/format.js";
import { sentences, t } from "../text/language.js";
import { openDialog } from "../ui/dialog.js";
import { button, fill, h, setAttr, setText } from "../ui/dom.js";
import { icon } from "../ui/icons.js";
import { Checks } from "./checks.js";
import { Code, codeMirror } from "./code.js";

/** Longer texts are only shown, and stored unchanged: to change them in a browser would need too much memory. */
const EDITABLE_CHARS = 4_000_000;
/** Findings listed. */
const SHOWN_MAX = 50;
const NUMBER_MAX = 9999;

/** @typedef {import("../types.d.ts").ProgramDiagnostic} ProgramDiagnostic */

/**
 * @typedef {object} Opened
 * @property {number} number
 * @property {string} text
 * @property {string} [hash] of the program that was read; the editor does not replace a program with another hash
 * @property {string} [dialect] of the text; that of the coordinate system shown
 * @property {ProgramDiagnostic[]} [found] known findings of the text
 */

/** @param {import("../main.js").App} app @param {Opened} opened */
export async function openEditor(app, opened) {
  const cm = await codeMirror();
  new Editor(app, cm, opened);
}

class Editor {
  #app;
  #opened;
  #code;
  #isEditable;
  #text;
  /** Whether there are unsaved changes. */
  #isChanged = false;
  /** Whether the text was edited; otherwise it is stored byte for byte unchanged. */
  #isTouched = false;
  /** Findings during typing. */
  #said = "";
  #checks = new Checks(() => this.#check(), (found) => this.#mark(found));
  #dialog;
  #number;
  #note = h("p", { class: "muted note grow", role: "status" });
  #more = h("div", { class: "meaning", hidden: true, tabindex: 0, role: "region", "aria-label": t("editor.meaning") });
  #findings = h("ol", { class: "list", "aria-label": t("editor.findings"), tabindex: 0, hidden: true });
  #compare;
  #steps;
  #store = button({ type: "submit", class: "button primary" }, t("editor.store"));

  /** @param {import("../main.js").App} app @param {import("./code.js").CodeMirror} cm @param {Opened} opened */
  constructor(app, cm, opened) {
    const { number, text, dialect = app.model.current?.info.dialect ?? "", found = [] } = opened;
    this.#app = app;
    this.#opened = { hash: "", ...opened, dialect };
    this.#text = text;
    this.#isEditable = text.length <= EDITABLE_CHARS;
    this.#code = new Code(cm, { text, dialect, label: t("editor.program_text"), readOnly: !this.#isEditable, changed: () => this.#changed(), explain: (word) => void this.#explain(word), tip: tipOf });
    this.#number = h("input", { type: "number", class: "input editor-number", min: 1, max: NUMBER_MAX, step: 1, value: number, required: true });
    this.#number.addEventListener("input", () => this.#describe());
    this.#compare = button({ class: "button", "aria-pressed": "false", onclick: () => void this.#toggleCompare() }, t("editor.compare"));
    this.#steps = h("span", { class: "row", hidden: true }, this.#step(t("editor.previous_difference"), false), this.#step(t("editor.next_difference"), true));
    const find = button({ onclick: () => this.#code.search() }, icon("search"), t("editor.find"));
    const explained = button({ title: t("editor.what_the_word_at_the"), onclick: () => void this.#explain(this.#code.word()) }, icon("info"), t("common.explain"));
    const close = button({ onclick: () => this.#dialog.close() }, t("common.close"));
    const form = h(
      "form",
      { class: "editor-form" },
      h("div", { class: "row wrap editor-tools" }, h("label", { class: "row" }, h("span", { class: "label" }, t("editor.number")), this.#number), h("span", { class: "spring" }), find, explained, this.#compare, this.#steps),
      this.#code.element,
      this.#more,
      this.#findings,
      h("div", { class: "row editor-foot" }, this.#note, close, this.#store),
    );
    this.#dialog = openDialog("editor", t("editor.program"), [form], () => {
      this.#checks.stop();
      this.#code.destroy();
    });
    // Escape, pressed by accident, must not discard the text
    form.addEventListener("keydown", (event) => {
      if (event.key !== "Escape" || event.defaultPrevented || !this.#isChanged) return;
      event.stopPropagation();
      setText(this.#note, t("editor.not_stored_yet_store_keeps"));
    });
    form.addEventListener("submit", (event) => {
      event.preventDefault();
      void app.attempt(() => this.#keep());
    });
    this.#show(found);
    this.#describe();
    this.#code.focus();
  }

  /** @param {string} says @param {boolean} forward */
  #step(says, forward) {
    return button({ class: "icon-button", "aria-label": says, title: says, onclick: () => this.#code.nextDifference(forward) }, forward ? "↓" : "↑");
  }

  #changed() {
    this.#isTouched = true;
    this.#checks.changed();
    if (this.#isChanged) return;
    this.#isChanged = true;
    this.#describe();
  }

  #describe() {
    const number = Number(this.#number.value);
    const there = this.#app.model.programs?.some((program) => program.number === number);
    const long = this.#isEditable ? "" : t("editor.too_long", { characters: whole(this.#text.length) });
    const program = programName(number);
    const isOwn = number === this.#opened.number && this.#opened.hash !== "";
    const stored = isOwn ? t(this.#isChanged ? "editor.is_changed" : "editor.is_as_stored", { program }) : t(there ? "editor.will_be_replaced" : "editor.is_new", { program });
    setText(this.#note, sentences(long, stored, this.#said));
    disableFor(this.#store, whyNotNow(this.#app.model, "administrate"));
    setAttr(this.#compare, "disabled", !there);
  }

  /** Returns the runtime's findings; null if it does not answer. */
  async #check() {
    const number = Number(this.#number.value) || this.#opened.number;
    return this.#app.api.checkText(number, await this.#code.blob(), this.#opened.dialect ?? "").catch(() => null);
  }

  /** Marks findings during typing, and updates a list that is shown. @param {ProgramDiagnostic[]} found */
  #mark(found) {
    this.#said = t("editor.checked", { found: summary(found) || t("findings.none") });
    if (this.#findings.hidden) this.#code.mark(found);
    else this.#show(found);
    this.#describe();
  }

  async #keep() {
    this.#checks.stop();
    this.#said = "";
    const { number, hash = "", dialect = "" } = this.#opened;
    const chosen = Number(this.#number.value);
    const sent = this.#isTouched ? this.#code.blob() : new Blob([this.#text]);
    this.#isChanged = false;
    try {
      const { diagnostics = [], hash: now, unchanged } = await this.#app.api.storeProgram(chosen, await sent, chosen === number ? hash : "", dialect);
      if (chosen === number) this.#opened.hash = now;
      await this.#app.readPrograms();
      this.#show(diagnostics);
      const told = { program: programName(chosen), found: summary(diagnostics) || t("findings.none"), hash: shortHash(now) };
      if (!this.#isChanged) setText(this.#note, t(unchanged ? "editor.unchanged" : "editor.stored", told));
      setAttr(this.#compare, "disabled", false);
    } catch (error) {
      this.#isChanged = true;
      throw error;
    }
  }

  /** Lists findings below the text, and marks them in its margin. @param {ProgramDiagnostic[]} found */
  #show(found) {
    this.#code.mark(found);
    fill(this.#findings, ...found.slice(0, SHOWN_MAX).map((one) => {
      const item = finding(one);
      item.append(button({ class: "button small", "aria-label": t("editor.go_to_line", { line: one.line }), onclick: () => this.#code.goTo(one.line) }, t("editor.go_to")));
      return item;
    }));
    setAttr(this.#findings, "hidden", found.length === 0);
  }

  /** @param {string} word */
  async #explain(word) {
    if (word === "") return setText(this.#note, t("editor.put_the_cursor_on_a"));
    const { title, parts } = await meaning(word);
    const close = button({ class: "icon-button", "aria-label": t("editor.close_the_meaning"), onclick: () => setAttr(this.#more, "hidden", true) }, icon("close"));
    fill(this.#more, h("div", { class: "row" }, h("strong", { class: "grow" }, title), close), ...parts);
    setAttr(this.#more, "hidden", false);
    this.#more.scrollTop = 0;
  }

  /** Shows or hides the differences from the program in the store. */
  async #toggleCompare() {
    const isOn = this.#compare.getAttribute("aria-pressed") !== "true";
    await this.#app.attempt(async () => {
      const number = Number(this.#number.value);
      this.#code.compare(isOn ? (await this.#app.api.program(number)).text : null);
      setAttr(this.#compare, "aria-pressed", String(isOn));
      setAttr(this.#steps, "hidden", !isOn);
      if (!isOn) return this.#describe();
      const count = this.#code.differences;
      setText(this.#note, count === 0 ? t("editor.is_same", { program: programName(number) }) : t("editor.differs", { count, program: programName(number) }));
    });
  }
}

/**
 * The number in a file's name, such as 1001.nc or O0007.txt, otherwise the first free number.
 * @param {string} name
 * @param {import("../types.d.ts").ProgramInfo[]} known
 */
export function numberFor(name, known) {
  const said = Number(/^O?(\d{1,4})\b/i.exec(name)?.[1] ?? 0);
  if (said > 0) return said;
  const taken = new Set(known.map((program) => program.number));
  return Array.from({ length: NUMBER_MAX }, (_, i) => i + 1).find((number) => !taken.has(number)) ?? NUMBER_MAX;
}
