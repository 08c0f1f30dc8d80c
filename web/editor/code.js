// A text field for NC programs, by CodeMirror: line numbers, colours, search, findings in the margin. It is in a shadow
// root, where its styles need no style element, which the content security policy forbids.

import { phrases } from "../text/language.js";
import { h } from "../ui/dom.js";
import { ncParser } from "./language.js";
import { coloursOf, themeOf } from "./look.js";

/** @typedef {import("../types.d.ts").ProgramDiagnostic} ProgramDiagnostic */
/** @typedef {import("../vendor/codemirror.js")} CodeMirror */

/** Findings marked in the margin. */
const MARKED_MAX = 1000;

/** A text is assembled in pieces of about this many characters; the page does other work in between. */
const PIECE_CHARS = 200_000;

/** Longest line in which words are searched, characters. */
const LONG_LINE = 2000;

/** CodeMirror, read when an editor is first opened. @returns {Promise<CodeMirror>} */
export function codeMirror() {
  return import("../vendor/codemirror.js");
}

/**
 * @typedef {object} CodeOptions
 * @property {string} text
 * @property {string} dialect
 * @property {string} label
 * @property {boolean} [readOnly]
 * @property {() => void} [changed]
 * @property {(word: string) => void} [explain] called to explain a word
 * @property {(word: string) => Promise<HTMLElement | null>} [tip] tooltip of the word below the pointer; null: none
 */

/** Returns whether all lines end with CR LF. @param {string} text */
function isCrLf(text) {
  return text.includes("\r\n") && !/(?:^|[^\r])\n|\r(?!\n)/.test(text);
}

export class Code {
  /** The element of the text field. */
  element = h("div", { class: "code" });
  #cm;
  #view;
  #compare;

  /** @param {CodeMirror} cm @param {CodeOptions} options */
  constructor(cm, { text, dialect, label, readOnly = false, changed = () => {}, explain = () => {}, tip = async () => null }) {
    this.#cm = cm;
    this.#compare = new cm.Compartment();
    const root = this.element.attachShadow({ mode: "open", delegatesFocus: true });
    const state = cm.EditorState.create({
      doc: text,
      extensions: [
        isCrLf(text) ? cm.EditorState.lineSeparator.of("\r\n") : [],
        cm.lineNumbers(),
        cm.highlightActiveLine(),
        cm.highlightActiveLineGutter(),
        cm.highlightSelectionMatches(),
        cm.history(),
        cm.search({ top: true }),
        cm.EditorState.phrases.of(phrases()),
        cm.lintGutter(),
        cm.StreamLanguage.define({ ...ncParser(dialect), tokenTable: coloursOf(cm) }).extension,
        themeOf(cm),
        cm.EditorView.contentAttributes.of({ "aria-label": label, spellcheck: "false", autocapitalize: "characters" }),
        cm.EditorState.readOnly.of(readOnly),
        cm.EditorView.updateListener.of((update) => {
          if (update.docChanged) changed();
        }),
        cm.keymap.of([{ key: "F1", run: () => (explain(this.word()), true) }, ...cm.searchKeymap, ...cm.lintKeymap, ...cm.historyKeymap, ...cm.defaultKeymap]),
        cm.hoverTooltip((_, at) => this.#tip(at, tip)),
        this.#compare.of([]),
      ],
    });
    this.#view = new cm.EditorView({ state, parent: root, root });
  }

  /** The whole text. */
  get text() {
    return this.#view.state.sliceDoc();
  }

  /**
   * Returns the whole current text, ready to send, in pieces, so that no single task blocks the page for long.
   * @returns {Promise<Blob>}
   */
  async blob() {
    const { doc, lineBreak } = this.#view.state;
    const pieces = [];
    for (let from = 0; from < doc.length; ) {
      if (from > 0) await new Promise((resolve) => setTimeout(resolve));
      const to = Math.min(doc.length, doc.lineAt(Math.min(doc.length, from + PIECE_CHARS)).to + 1);
      pieces.push(new Blob([doc.sliceString(from, to, lineBreak)]));
      from = to;
    }
    return new Blob(pieces);
  }

  get lines() {
    return this.#view.state.doc.lines;
  }

  focus() {
    this.#view.focus();
  }

  search() {
    this.#cm.openSearchPanel(this.#view);
  }

  /** Returns the word under the cursor, or the selected text. */
  word() {
    const { state } = this.#view;
    const { from, to, head } = state.selection.main;
    if (from < to) return state.sliceDoc(from, Math.min(to, from + 100)).trim();
    return this.#wordAt(head).word;
  }

  /** Returns a word and its position; empty if the place has no word. @param {number} place */
  #wordAt(place) {
    const line = this.#view.state.doc.lineAt(place);
    const at = place - line.from;
    const words = line.text.length > LONG_LINE ? [] : line.text.matchAll(/[A-Z_]+(?:\d+(?:\.\d+)?)?/gi);
    const found = [...words].find(({ index, 0: word }) => index <= at && at <= index + word.length);
    return { word: found?.[0] ?? "", from: line.from + (found?.index ?? at) };
  }

  /** @param {number} place @param {(word: string) => Promise<HTMLElement | null>} tip */
  async #tip(place, tip) {
    const { word, from } = this.#wordAt(place);
    const dom = await tip(word);
    return dom && { pos: from, end: from + word.length, create: () => ({ dom }) };
  }

  /** Selects a line and brings it into view. @param {number} number from 1 */
  goTo(number) {
    const { doc } = this.#view.state;
    const line = doc.line(Math.max(1, Math.min(number, doc.lines)));
    const effects = this.#cm.EditorView.scrollIntoView(line.from, { y: "center" });
    this.#view.dispatch({ selection: { anchor: line.from, head: line.to }, effects });
    this.#view.focus();
  }

  /** Marks findings in the margin, each with its help; they move with the text. @param {ProgramDiagnostic[]} found */
  mark(found) {
    const { doc } = this.#view.state;
    const place = (/** @type {number} */ number, /** @type {number} */ column) => {
      const line = doc.line(Math.max(1, Math.min(number, doc.lines)));
      return Math.min(line.to, line.from + Math.max(0, column - 1));
    };
    const marks = found.slice(0, MARKED_MAX).map((one) => {
      const from = place(one.line, one.column);
      const to = Math.max(from, place(one.end_line, one.end_column));
      return { from, to, severity: one.severity, source: one.code, message: one.help ? `${one.message}\n${one.help}` : one.message };
    });
    this.#view.dispatch(this.#cm.setDiagnostics(this.#view.state, marks));
  }

  /** Shows the differences from another text; null ends the comparison. @param {string | null} original */
  compare(original) {
    const { unifiedMergeView } = this.#cm;
    const shown = original === null ? [] : unifiedMergeView({ original, mergeControls: false, gutter: true, collapseUnchanged: { margin: 3, minSize: 8 }, diffConfig: { scanLimit: 500, timeout: 500 } });
    this.#view.dispatch({ effects: this.#compare.reconfigure(shown) });
  }

  /** Number of differences during a comparison. */
  get differences() {
    return this.#cm.getChunks(this.#view.state)?.chunks.length ?? 0;
  }

  /** Moves to the next difference, or to the previous one. @param {boolean} forward */
  nextDifference(forward) {
    (forward ? this.#cm.goToNextChunk : this.#cm.goToPreviousChunk)(this.#view);
    this.#view.focus();
  }

  destroy() {
    this.#view.destroy();
  }
}
