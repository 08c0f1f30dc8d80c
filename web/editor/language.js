// Splits NC text into words for the colours of the editor. This is not a parser: the runtime decides about validity.

import { dialect } from "../dialects/dialects.js";

/** @typedef {{comment: number}} State `comment`: depth 1 inside of a comment over several lines */

/**
 * Patterns of a dialect.
 * @typedef {object} Patterns
 * @property {RegExp | null} line begin of a comment to the end of the line
 * @property {RegExp} block begin of a comment over several lines, or a whole comment if comments end with their line
 * @property {RegExp} blockEnd
 * @property {boolean} spansLines
 * @property {[string, RegExp][]} words by kind, tried in this order
 */

/** Escapes the signs of a pattern. @param {string} text */
const escaped = (text) => text.replace(/[\\^$.*+?()[\]{}|/]/g, String.raw`\$&`);

/** @param {import("../dialects/dialects.js").Dialect} row @returns {Patterns} */
function patternsOf({ comments: { spansLines }, editorComments: { line, block }, keywords, dataWords }) {
  const [open, close] = [escaped(block.open), escaped(block.close)];
  /** @type {[string, RegExp][]} */
  const ofKeywords = keywords.length > 0 ? [["keyword", new RegExp(String.raw`^(?:${keywords.join("|")})\b`, "i")]] : [];
  return {
    line: line ? new RegExp(`^${escaped(line)}`) : null,
    block: new RegExp(spansLines ? `^${open}` : `^${open}[^]*?(?:${close}|$)`),
    blockEnd: new RegExp(`^.*?${close}`),
    spansLines,
    words: [
      ...ofKeywords,
      ["n", /^N\d+/i],
      ["g", /^G\d+(?:\.\d+)?/i],
      ["m", new RegExp(String.raw`^M\d+|^(?:${dataWords})(?=\s*[-+.\d=[(])`, "i")],
      ["axis", /^[XYZABCUVWIJK](?=\s*[-+.\d=[(])/i],
      ["variable", /^[PQL]\d+|^_CNC_\w+/i],
      ["other", /^[A-Z](?=\s*[-+.\d=[(])/i],
      ["number", /^\d+\.?\d*|^\.\d+/],
    ],
  };
}

/**
 * A stream parser.
 * @param {string} name of the dialect
 * @returns {import("@codemirror/language").StreamParser<State>}
 */
export function ncParser(name) {
  const row = dialect(name);
  const patterns = patternsOf(row);
  const { line, block } = row.editorComments;
  return {
    name: `nc-${name}`,
    startState: () => ({ comment: 0 }),
    copyState: (state) => ({ ...state }),
    token: (stream, state) => token(stream, state, patterns),
    languageData: { commentTokens: line ? { line } : { block } },
  };
}

/** @param {import("@codemirror/language").StringStream} stream @param {State} state @param {Patterns} patterns */
function token(stream, state, { line, block, blockEnd, spansLines, words }) {
  if (state.comment > 0) return blockComment(stream, state, blockEnd);
  if (stream.sol() && stream.match(/^\s*\/(?![/*])\d*/)) return "n";
  if (stream.eatSpace()) return null;
  if (line && stream.match(line)) {
    stream.skipToEnd();
    return "comment";
  }
  if (stream.match(block)) {
    if (!spansLines) return "comment";
    state.comment = 1;
    return blockComment(stream, state, blockEnd);
  }
  for (const [kind, word] of words) if (stream.match(word)) return kind;
  // a name as a whole, such as a function
  if (!stream.match(/^[A-Z_]\w*/i)) stream.next();
  return null;
}

/** @param {import("@codemirror/language").StringStream} stream @param {State} state @param {RegExp} end */
function blockComment(stream, state, end) {
  if (stream.match(end)) state.comment = 0;
  else stream.skipToEnd();
  return "comment";
}
