// The lines of a program, and their words for highlighting. This is not a parser: the runtime decides about validity.

import { dialect } from "../dialects/dialects.js";

/** @typedef {{kind: "comment" | "g" | "m" | "n" | "axis" | "", text: string}} Part */

const [NEWLINE, SLASH, STAR] = [10, 47, 42];
/** Bytes are kept in pieces of this size. */
const PIECE_BYTES = 2 ** 20;
/** Initial capacity for line starts; it is doubled when full. */
const STARTS_FIRST = 1024;
/** Longest time without a pause while a text arrives, ms. */
const PAUSE_AFTER_MS = 8;

/** Returns the pattern of `/n` and `N`, `G`, `M` and its data words, axis words. @param {string} dataWords */
const wordsWith = (dataWords) => String.raw`(?<n>N\d+|^\s*\/\d*)|(?<g>G\d+(?:\.\d+)?)|(?<m>M\d+|(?<![A-Z])(?:${dataWords})(?=\s*[-+.\d=\[(]))|(?<axis>(?<![A-Z])[XYZABCUVWIJK](?=\s*[-+.\d=\[(]))`;
/** Longest line that is highlighted, characters. */
const COLOURED_MAX = 400;

/** A text as bytes, which arrives in parts; a line becomes a string when it is requested. */
export class NcText {
  #words;
  #spansLines;
  /** @type {Uint8Array[]} */
  #pieces = [];
  #length = 0;
  /** Start of each line. */
  #starts = new Uint32Array(STARTS_FIRST);
  #lines = 1;
  /** @type {[number, number][]} comments over more than one line, ascending */
  #blocks = [];
  /** Context of the previous byte. @type {"code" | "line" | "block"} */
  #within = "code";
  #before = 0;
  /** Start of the open comment, and its line. */
  #block = { at: 0, line: 0 };

  /** @param {string} name of the dialect */
  constructor(name) {
    const { comments, dataWords } = dialect(name);
    this.#spansLines = comments.spansLines;
    this.#words = new RegExp(`(?<comment>${comments.inLine})|${wordsWith(dataWords)}`, "gi");
  }

  /** Reads the whole text of an answer, without blocking the page. @param {ReadableStream<Uint8Array>} stream @param {string} name of the dialect */
  static async read(stream, name) {
    const text = new NcText(name);
    const reader = stream.getReader();
    let began = performance.now();
    for (let part = await reader.read(); !part.done; part = await reader.read()) {
      for (let at = 0; at < part.value.length; at += PIECE_BYTES) {
        text.add(part.value.subarray(at, at + PIECE_BYTES));
        if (performance.now() - began < PAUSE_AFTER_MS) continue;
        await new Promise((resolve) => setTimeout(resolve));
        began = performance.now();
      }
    }
    return text;
  }

  /** Appends bytes. @param {Uint8Array} bytes */
  add(bytes) {
    for (let at = 0; at < bytes.length; ) {
      const used = this.#length % PIECE_BYTES;
      if (used === 0) this.#pieces.push(new Uint8Array(PIECE_BYTES));
      const part = bytes.subarray(at, at + PIECE_BYTES - used);
      this.#pieces.at(-1)?.set(part, used);
      this.#scan(part, this.#length);
      this.#length += part.length;
      at += part.length;
    }
  }

  /** Finds the ends of lines, and the comments over them. @param {Uint8Array} part @param {number} offset */
  #scan(part, offset) {
    for (let i = 0; i < part.length; i += 1) {
      const byte = part[i] ?? 0;
      if (byte === NEWLINE) {
        if (this.#within === "line") this.#within = "code";
        this.#startAt(offset + i + 1);
      }
      const isSign = this.#spansLines && (byte === SLASH || byte === STAR) && this.#comment(byte, offset + i);
      // a byte belongs to one comment sign only
      this.#before = isSign ? 0 : byte;
    }
  }

  /** Returns true if a comment begins or ends here. @param {number} byte @param {number} at */
  #comment(byte, at) {
    if (this.#within === "code" && this.#before === SLASH) {
      this.#within = byte === SLASH ? "line" : "block";
      this.#block = { at: at - 1, line: this.#lines };
    } else if (this.#within === "block" && byte === SLASH && this.#before === STAR) {
      this.#within = "code";
      if (this.#block.line < this.#lines) this.#blocks.push([this.#block.at, at + 1]);
    } else return false;
    return true;
  }

  /** @param {number} at */
  #startAt(at) {
    if (this.#lines === this.#starts.length) {
      const more = new Uint32Array(2 * this.#lines);
      more.set(this.#starts);
      this.#starts = more;
    }
    this.#starts[this.#lines] = at;
    this.#lines += 1;
  }

  /** Number of lines; a final line end begins no further line. */
  get lines() {
    return this.#lines > 1 && this.#starts[this.#lines - 1] === this.#length ? this.#lines - 1 : this.#lines;
  }

  /** Text of a line, from 1. @param {number} number */
  line(number) {
    if (number < 1 || number > this.lines) return "";
    const end = number < this.#lines ? (this.#starts[number] ?? 0) : this.#length;
    return this.#decode(this.#starts[number - 1] ?? 0, end).replace(/\r?\n$/, "");
  }

  /** @param {number} from @param {number} to */
  #decode(from, to) {
    const decoder = new TextDecoder();
    let text = "";
    for (let at = from; at < to; ) {
      const [piece, first] = [Math.floor(at / PIECE_BYTES), at % PIECE_BYTES];
      const part = this.#pieces[piece]?.subarray(first, Math.min(PIECE_BYTES, first + to - at)) ?? new Uint8Array();
      text += decoder.decode(part, { stream: true });
      at += Math.max(1, part.length);
    }
    return text + decoder.decode();
  }

  /** Returns a line, split for highlighting. @param {number} number @returns {Part[]} */
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
    const [from, to] = this.#blocks[low] ?? (this.#within === "block" ? [this.#block.at, this.#length] : [start, start]);
    return from < start ? Math.min(this.#decode(start, Math.min(to, this.#starts[number] || to)).length, length) : 0;
  }
}
