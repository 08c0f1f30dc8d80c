// The third-party code of the HMI equals the output of its build.

import assert from "node:assert/strict";
import { readFile } from "node:fs/promises";
import { test } from "node:test";

import { VENDORED, vendored } from "./vendor.mjs";

test("what is vendored is what the build makes of the pinned packages: npm run vendor", async () => {
  for (const [name, text] of Object.entries(await vendored())) {
    const there = await readFile(new URL(name, VENDORED), "utf8");
    assert.ok(there === text, `web/vendor/${name} is another one`);
  }
});
