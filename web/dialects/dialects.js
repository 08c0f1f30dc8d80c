// NC dialects, each described by the row in its file. Other modules use the properties of a row; no module outside of this
// folder contains the name of a dialect.

import { dgshape } from "./dgshape.js";
import { nj } from "./nj.js";

/**
 * Comments that the program view highlights.
 * @typedef {object} Comments
 * @property {string} inLine pattern of a comment within a line
 * @property {boolean} spansLines true if a comment from `/*` to its end sign may span lines, and `//` begins a line comment
 */

/**
 * Comment signs of the editor. The command that toggles comments uses `line` if it exists, otherwise `block`.
 * @typedef {object} EditorComments
 * @property {string} [line] sign of a comment to the end of the line
 * @property {{open: string, close: string}} block
 */

/**
 * Properties of a dialect.
 * @typedef {object} Dialect
 * @property {string} name
 * @property {number} optionalSkips number of block skips, at most `OPTIONAL_SKIPS_MAX`
 * @property {readonly string[]} workOffsets work offsets that the operator can set, in the order of the screen
 * @property {Comments} comments
 * @property {EditorComments} editorComments
 * @property {readonly string[]} keywords
 * @property {string} dataWords pattern of the address of a data word, highlighted like its M code
 * @property {boolean} hasProbeCycles true if G31 exists, by which a probe touches
 * @property {boolean} usesSpindleToolLength true if a length offset is that of the tool in the spindle; false if a
 * separate number selects it
 */

/** Largest number of block skips of a dialect. */
export const OPTIONAL_SKIPS_MAX = 9;

/** Row for a name without a dialect, for example while no coordinate system is known. @type {Dialect} */
const NEUTRAL = {
  name: "",
  optionalSkips: OPTIONAL_SKIPS_MAX,
  workOffsets: ["G54", "G55", "G56", "G57", "G58", "G59"],
  comments: { inLine: "(?!)", spansLines: false },
  editorComments: { block: { open: "(", close: ")" } },
  keywords: [],
  dataWords: "V[A-H]",
  hasProbeCycles: false,
  usesSpindleToolLength: false,
};

const ROWS = new Map([nj, dgshape].map((row) => [row.name, row]));

/** Returns the row of a dialect; a neutral row if the name is unknown. @param {string | undefined} name @returns {Dialect} */
export function dialect(name) {
  return ROWS.get(name ?? "") ?? NEUTRAL;
}
