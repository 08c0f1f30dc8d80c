// Dialect nj: the NJ/NY-series manual O031.

/** @type {import("./dialects.js").Dialect} */
export const nj = {
  name: "nj",
  // `/1` to `/9`
  optionalSkips: 9,
  workOffsets: ["G54", "G55", "G56", "G57", "G58", "G59"],
  comments: { inLine: String.raw`\/\*.*?(?:\*\/|$)|\/\/.*`, spansLines: true },
  editorComments: { line: "//", block: { open: "/*", close: "*/" } },
  keywords: ["if", "else", "switch", "case", "default", "break", "while", "do"],
  // `VA` to `VH`
  dataWords: "V[A-H]",
  hasProbeCycles: true,
  usesSpindleToolLength: true,
};
