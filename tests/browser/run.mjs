// Runs the tests of this folder, two files at the same time. Tests that hold a button for a certain time, or measure
// times, run alone after them.
//   node run.mjs [together | alone]     only the first part, or only the second

import { readdirSync } from "node:fs";
import { run } from "node:test";
import { spec } from "node:test/reporters";

const ALONE = ["by_hand.test.mjs", "editor.test.mjs", "numbers.test.mjs"];
const FOLDER = new URL(".", import.meta.url).pathname;

function runs(names, concurrency) {
  const files = names.map((name) => `${FOLDER}${name}`);
  return new Promise((resolve) => {
    const tests = run({ files, concurrency });
    tests.on("test:fail", () => {
      process.exitCode = 1;
    });
    tests.on("end", resolve);
    tests.compose(spec).pipe(process.stdout);
  });
}

const all = readdirSync(FOLDER).filter((name) => name.endsWith(".test.mjs"));
const part = process.argv[2] ?? "all";
if (part !== "alone") await runs(all.filter((name) => !ALONE.includes(name)), 2);
if (part !== "together") await runs(ALONE, 1);
