// The editor of stored programs: a text, typed or from a file, is stored under a number and then checked.

import { openDialog } from "./dialog.js";
import { button, fill, h, setText } from "./dom.js";
import { finding, summary } from "./findings.js";
import { programName, shortHash } from "./format.js";

/** Longer texts are stored unchanged: such a text field would make the browser slow. */
const EDITABLE_CHARS = 1_000_000;
/** Findings shown. */
const SHOWN_MAX = 50;
const NUMBER_MAX = 9999;

/**
 * Opens the editor.
 * @param {import("./main.js").App} app
 * @param {number} number
 * @param {string} text
 * @param {string} [hash] of the program of this number that was read; it is not stored over another one
 * @param {string} [dialect] of the text; that of the coordinate system shown
 */
export function openEditor(app, number, text, hash = "", dialect = app.model.current?.info.dialect ?? "") {
  const editable = text.length <= EDITABLE_CHARS;
  const name = h("input", { type: "number", class: "input editor-number", min: 1, max: NUMBER_MAX, step: 1, value: number, required: true });
  const area = h("textarea", { class: "input editor-text", "aria-label": "Program text", spellcheck: "false", wrap: "off", autofocus: true, hidden: !editable });
  if (editable) area.value = text;
  const note = h("p", { class: "muted note", role: "status" });
  const findings = h("ol", { class: "list", "aria-label": "Findings" });
  const close = button({ onclick: () => dialog.close() }, "Close");
  const store = button({ type: "submit" }, "Store");
  const form = h(
    "form",
    { class: "editor-form" },
    h("label", { class: "row" }, h("span", { class: "label" }, "Number"), name),
    area,
    note,
    findings,
    h("div", { class: "row end" }, close, store),
  );
  // otherwise a text field with the focus shows its end
  area.setSelectionRange(0, 0);
  const dialog = openDialog("editor", "Program", [form]);

  const describe = () => {
    const there = app.model.programs?.some((program) => program.number === Number(name.value));
    const long = editable ? "" : `${text.length} characters: too long to be edited here, and stored as it is. `;
    setText(note, `${long}${programName(Number(name.value))} ${there ? "is in the store and will be replaced" : "is new"}.`);
  };
  name.addEventListener("input", describe);
  let stored = area.value;
  // Escape, pressed by accident, must not discard what was written
  form.addEventListener("keydown", (event) => {
    if (event.key !== "Escape" || area.value === stored) return;
    event.stopPropagation();
    setText(note, "Not stored yet. Store keeps the changes, Close drops them.");
  });
  describe();

  form.addEventListener("submit", (event) => {
    event.preventDefault();
    const chosen = Number(name.value);
    void app.attempt(async () => {
      const sent = area.value;
      const { diagnostics = [], hash: now, unchanged } = await app.api.storeProgram(chosen, editable ? sent : text, chosen === number ? hash : "", dialect);
      stored = sent;
      if (chosen === number) hash = now;
      setText(note, `${programName(chosen)} ${unchanged ? "has not changed" : "is stored"}: ${summary(diagnostics) || "nothing to complain of"}. Hash ${shortHash(now)}.`);
      fill(findings, ...diagnostics.slice(0, SHOWN_MAX).map((one) => entry(one, area)));
      await app.readPrograms();
    });
  });
}

/** A finding; a press goes to its line. @param {import("./types.d.ts").ProgramDiagnostic} one @param {HTMLTextAreaElement} area */
function entry(one, area) {
  const item = finding(one);
  item.append(button({ class: "button small", "aria-label": `Go to line ${one.line}`, onclick: () => select(area, one.line) }, "Go to"));
  return item;
}

/** Selects a line and brings it into view. @param {HTMLTextAreaElement} area @param {number} line from 1 */
function select(area, line) {
  const lines = area.value.split("\n");
  const begin = lines.slice(0, line - 1).reduce((sum, text) => sum + text.length + 1, 0);
  area.focus();
  area.setSelectionRange(begin, begin + (lines[line - 1]?.length ?? 0));
  area.scrollTop = (line - 3) * Number.parseFloat(getComputedStyle(area).lineHeight);
}

/**
 * The number in a file's name, such as 1001.nc or O0007.txt, otherwise the first free number.
 * @param {string} name
 * @param {import("./types.d.ts").ProgramInfo[]} known
 */
export function numberFor(name, known) {
  const said = Number(/^O?(\d{1,4})\b/i.exec(name)?.[1] ?? 0);
  if (said > 0) return said;
  const taken = new Set(known.map((program) => program.number));
  return Array.from({ length: NUMBER_MAX }, (_, i) => i + 1).find((number) => !taken.has(number)) ?? NUMBER_MAX;
}
