// Dialect dgshape: the NC code reference manual of DGSHAPE Corporation.

/** @type {import("./dialects.js").Dialect} */
export const dgshape = {
  name: "dgshape",
  // `/` without a number
  optionalSkips: 1,
  workOffsets: ["G54", "G55", "G56", "G57", "G58", "G59"],
  comments: { inLine: String.raw`\([^)]*\)?`, spansLines: false },
  editorComments: { block: { open: "(", close: ")" } },
  keywords: [],
  // the dialect has no data words; those in a text of another dialect are highlighted
  dataWords: "V[A-H]",
  hasProbeCycles: false,
  // `H` selects the length
  usesSpindleToolLength: false,
};
