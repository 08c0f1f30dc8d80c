// Splits NC text into words for the colours of the editor. This is not a parser: the runtime decides about validity.

/** @typedef {{comment: number}} State `comment`: depth 1 inside of a comment over several lines */

/** Keywords of dialect nj; dgshape has none. */
const KEYWORDS = /^(?:if|else|switch|case|default|break|while|do)\b/i;

/** Words by kind, tried in this order. @type {[string, RegExp][]} */
const WORDS = [
  ["n", /^N\d+/i],
  ["g", /^G\d+(?:\.\d+)?/i],
  ["m", /^M\d+|^V[A-H](?=\s*[-+.\d=[(])/i],
  ["axis", /^[XYZABCUVWIJK](?=\s*[-+.\d=[(])/i],
  ["variable", /^[PQL]\d+|^_CNC_\w+/i],
  ["other", /^[A-Z](?=\s*[-+.\d=[(])/i],
  ["number", /^\d+\.?\d*|^\.\d+/],
];

/**
 * A stream parser.
 * @param {string} dialect
 * @returns {import("@codemirror/language").StreamParser<State>}
 */
export function ncParser(dialect) {
  return {
    name: `nc-${dialect}`,
    startState: () => ({ comment: 0 }),
    copyState: (state) => ({ ...state }),
    token: (stream, state) => token(stream, state, dialect),
    languageData: { commentTokens: dialect === "nj" ? { line: "//" } : { block: { open: "(", close: ")" } } },
  };
}

/** @param {import("@codemirror/language").StringStream} stream @param {State} state @param {string} dialect */
function token(stream, state, dialect) {
  if (state.comment > 0) return blockComment(stream, state);
  if (stream.sol() && stream.match(/^\s*\/(?![/*])\d*/)) return "n";
  if (stream.eatSpace()) return null;
  if (dialect === "nj" && stream.match("//")) {
    stream.skipToEnd();
    return "comment";
  }
  if (dialect === "nj" && stream.match("/*")) {
    state.comment = 1;
    return blockComment(stream, state);
  }
  if (dialect !== "nj" && stream.match(/^\([^)]*\)?/)) return "comment";
  if (dialect === "nj" && stream.match(KEYWORDS)) return "keyword";
  for (const [kind, word] of WORDS) if (stream.match(word)) return kind;
  // a name as a whole, such as a function
  if (!stream.match(/^[A-Z_]\w*/i)) stream.next();
  return null;
}

/** @param {import("@codemirror/language").StringStream} stream @param {State} state */
function blockComment(stream, state) {
  if (stream.match(/^.*?\*\//)) state.comment = 0;
  else stream.skipToEnd();
  return "comment";
}
