// A program's text by lines, and the words of a line apart for the eye. Not a parser: what is valid, the runtime says.

/** @typedef {{kind: "comment" | "g" | "m" | "n" | "axis" | "", text: string}} Part */

/** Comments, then words: `/n`, `N`, `G`, `M`, everything that moves. */
const WORDS = /(?<comment>\([^)]*\)?|\/\*.*?(?:\*\/|$)|\/\/.*|;.*)|(?<n>\bN\d+|^\s*\/\d?)|(?<g>G\d+(?:\.\d+)?)|(?<m>M\d+|V[A-H](?==|-|\d))|(?<axis>[XYZABCUVWIJK](?=[-+.\d=\[#(]))/gi;
/** A longer line is shown without its words apart. */
const COLOURED_MAX = 400;

export class NcText {
  #text;
  /** @type {number[]} where each line begins */
  #starts = [0];

  /** @param {string} text */
  constructor(text) {
    this.#text = text;
    for (let at = text.indexOf("\n"); at >= 0; at = text.indexOf("\n", at + 1)) this.#starts.push(at + 1);
    if (this.#starts.length > 1 && this.#starts.at(-1) === text.length) this.#starts.pop();
  }

  /** How many lines there are. */
  get lines() {
    return this.#starts.length;
  }

  /** Text of a line, from 1. @param {number} number */
  line(number) {
    const start = this.#starts[number - 1];
    if (start === undefined) return "";
    return this.#text.slice(start, this.#starts[number] ?? undefined).replace(/\r?\n$/, "");
  }

  /** The same in parts. @param {number} number @returns {Part[]} */
  parts(number) {
    const line = this.line(number);
    if (line.length > COLOURED_MAX) return [{ kind: "", text: line }];
    /** @type {Part[]} */
    const parts = [];
    let end = 0;
    for (const match of line.matchAll(WORDS)) {
      if (match.index > end) parts.push({ kind: "", text: line.slice(end, match.index) });
      const kind = Object.entries(match.groups ?? {}).find(([, text]) => text !== undefined)?.[0] ?? "";
      parts.push({ kind: /** @type {Part["kind"]} */ (kind), text: match[0] });
      end = match.index + match[0].length;
    }
    if (end < line.length) parts.push({ kind: "", text: line.slice(end) });
    return parts;
  }
}
