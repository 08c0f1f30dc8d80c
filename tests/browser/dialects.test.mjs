// The names of NC dialects are in web/dialects/ only; other modules of the HMI use the rows.

import assert from "node:assert/strict";
import { readdir, readFile } from "node:fs/promises";
import { basename } from "node:path";
import { test } from "node:test";

import { StringStream } from "@codemirror/language";

import { dialect } from "../../web/dialects/dialects.js";
import { ncParser } from "../../web/editor/language.js";

const WEB = new URL("../../web/", import.meta.url).pathname;
const names = (await readdir(`${WEB}dialects`)).map((file) => basename(file, ".js")).filter((name) => name !== "dialects");

/** Returns the lines of a text with the name of a dialect, also as a part of an identifier. */
function linesWithName(text) {
  const words = (line) => line.replace(/([a-z\d])([A-Z])/g, "$1 $2").toLowerCase().match(/[a-z]+/g) ?? [];
  return text.split("\n").flatMap((line, at) => (words(line).some((word) => names.includes(word)) ? [at + 1] : []));
}

test("no file outside of dialects/ contains the name of a dialect", async () => {
  const files = (await readdir(WEB, { recursive: true, withFileTypes: true })).filter((entry) => entry.isFile()).map(({ parentPath, name }) => `${parentPath}/${name}`.slice(WEB.length).replace(/^\//, ""));
  const others = files.filter((name) => !/^(dialects|vendor)\//.test(name) && name !== "types.d.ts");
  assert.ok(others.includes("editor/language.js"), others.join());
  const found = [];
  for (const name of others) found.push(...linesWithName(await readFile(WEB + name, "utf8")).map((line) => `${name}:${line}`));
  assert.deepEqual(found, []);
});

test("a planted name is found, and other words are not", () => {
  assert.deepEqual(names.toSorted(), ["dgshape", "nj"]);
  for (const name of names) {
    const large = name.toUpperCase();
    const planted = [`if (dialect === "${name}") {}`, `if (dialect === '${name}') {}`, `const SKIPS = { ${name}: 1 };`, `const ${large}_WORDS = 1;`, `// only ${name}`, `const is${name[0].toUpperCase()}${name.slice(1)} = true;`];
    for (const code of planted) assert.deepEqual(linesWithName(`\n${code}\n`), [2], code);
  }
  for (const code of ["inject(row)", "ninja", "const { dialect } = info;", "shape(1)"]) assert.deepEqual(linesWithName(code), [], code);
});

test("each file of dialects/ is the row of its name", async () => {
  for (const name of names) {
    const row = dialect(name);
    assert.deepEqual(Object.values(await import(`${WEB}dialects/${name}.js`)), [row], name);
    assert.equal(row.name, name);
    assert.ok(row.optionalSkips >= 1 && row.optionalSkips <= dialect("").optionalSkips, name);
    assert.ok(row.workOffsets.length > 0, name);
  }
});

test("an unknown name has a neutral row", () => {
  const neutral = dialect("");
  for (const name of [undefined, "other", "constructor"]) assert.equal(dialect(name), neutral, name);
  assert.deepEqual([neutral.name, neutral.optionalSkips, neutral.keywords, neutral.hasProbeCycles, neutral.usesSpindleToolLength], ["", 9, [], false, false]);
});

test("the editor colours comments and keywords of the dialect", () => {
  const line = "if X1 (Y2) // Z3";
  assert.deepEqual(coloured(line, "nj"), ["keyword:if", "axis:X", "number:1", "axis:Y", "number:2", "comment:// Z3"]);
  for (const name of ["dgshape", ""]) assert.deepEqual(coloured(line, name), ["axis:X", "number:1", "comment:(Y2)", "axis:Z", "number:3"], name);
  assert.deepEqual(coloured("X1 /* Y2\nZ3 */ X4", "nj"), ["axis:X", "number:1", "comment:/* Y2", "comment:Z3 */", "axis:X", "number:4"]);
});

/** Returns the words that the editor's parser colours. */
function coloured(text, name) {
  const parser = ncParser(name);
  const state = parser.startState(2);
  return text.split("\n").flatMap((string) => {
    const found = [];
    const stream = new StringStream(string, 2, 2);
    while (stream.pos < string.length) {
      stream.start = stream.pos;
      const kind = parser.token(stream, state);
      assert.ok(stream.pos > stream.start, `no progress in ${string}`);
      if (kind) found.push(`${kind}:${stream.current()}`);
    }
    return found;
  });
}
