// The lines of a program, and their words for highlighting. This is no parser: the runtime decides what is valid.

/** @typedef {{kind: "comment" | "g" | "m" | "n" | "axis" | "", text: string}} Part */

/**
 * Comments of each dialect: within a line, and over the whole text.
 * @type {Record<string, {inLine: string, all: RegExp}>}
 */
const COMMENTS = {
  nj: { inLine: String.raw`\/\*.*?(?:\*\/|$)|\/\/.*`, all: /\/\/.*|\/\*[^]*?(?:\*\/|$)/g },
  dgshape: { inLine: String.raw`\([^)]*\)?`, all: /\([^)\n]*\)?/g },
};
/** `/n` and `N`, `G`, `M` and its parameters, axis words. */
const WORDS = String.raw`(?<n>N\d+|^\s*\/\d*)|(?<g>G\d+(?:\.\d+)?)|(?<m>M\d+|(?<![A-Z])V[A-H](?=\s*[-+.\d=\[(]))|(?<axis>(?<![A-Z])[XYZABCUVWIJK](?=\s*[-+.\d=\[(]))`;
/** A longer line is not highlighted. */
const COLOURED_MAX = 400;

export class NcText {
  #text;
  #words;
  /** @type {number[]} start of each line */
  #starts = [0];
  /** @type {[number, number][]} comments over more than one line, ascending */
  #blocks = [];

  /** @param {string} text @param {string} dialect */
  constructor(text, dialect) {
    const comments = COMMENTS[dialect] ?? { inLine: "(?!)", all: /(?!)/g };
    this.#text = text;
    this.#words = new RegExp(`(?<comment>${comments.inLine})|${WORDS}`, "gi");
    for (let at = text.indexOf("\n"); at >= 0; at = text.indexOf("\n", at + 1)) this.#starts.push(at + 1);
    if (this.#starts.length > 1 && this.#starts.at(-1) === text.length) this.#starts.pop();
    for (const match of text.matchAll(comments.all)) {
      if (match[0].includes("\n")) this.#blocks.push([match.index, match.index + match[0].length]);
    }
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

  /** The same line, split for highlighting. @param {number} number @returns {Part[]} */
  parts(number) {
    const line = this.line(number);
    const within = this.#commentFromBefore(number, line.length);
    /** @type {Part[]} */
    const parts = within > 0 ? [{ kind: "comment", text: line.slice(0, within) }] : [];
    const rest = line.slice(within);
    if (line.length > COLOURED_MAX) return [...parts, { kind: "", text: rest }];
    let end = 0;
    for (const match of rest.matchAll(this.#words)) {
      if (match.index > end) parts.push({ kind: "", text: rest.slice(end, match.index) });
      const kind = Object.entries(match.groups ?? {}).find(([, text]) => text !== undefined)?.[0] ?? "";
      parts.push({ kind: /** @type {Part["kind"]} */ (kind), text: match[0] });
      end = match.index + match[0].length;
    }
    if (end < rest.length) parts.push({ kind: "", text: rest.slice(end) });
    return parts;
  }

  /** Number of characters of the line that belong to a comment of an earlier line. @param {number} number @param {number} length */
  #commentFromBefore(number, length) {
    const start = this.#starts[number - 1] ?? 0;
    let low = 0;
    for (let high = this.#blocks.length; low < high; ) {
      const middle = (low + high) >> 1;
      if ((this.#blocks[middle]?.[1] ?? 0) <= start) low = middle + 1;
      else high = middle;
    }
    const [from, to] = this.#blocks[low] ?? [start, start];
    return from < start ? Math.min(to - start, length) : 0;
  }
}
