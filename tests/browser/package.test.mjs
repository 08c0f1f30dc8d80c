// The package for third-party pages: it contains all that it imports, and its declarations describe the topics.

import assert from "node:assert/strict";
import { execFile } from "node:child_process";
import { mkdtemp, readdir, readFile, rm, writeFile } from "node:fs/promises";
import { tmpdir } from "node:os";
import { dirname, join } from "node:path";
import { after, before, test } from "node:test";
import { pathToFileURL } from "node:url";
import { promisify } from "node:util";
import ts from "typescript";

const PACKAGE = new URL("../../clients/js/", import.meta.url).pathname;
const run = promisify(execFile);

let folder;
before(async () => {
  folder = await mkdtemp(join(tmpdir(), "tandem-package-"));
  await run("npm", ["pack", "--silent", "--pack-destination", folder], { cwd: PACKAGE });
  const [name] = await readdir(folder);
  await run("tar", ["-xzf", join(folder, name), "-C", folder]);
});
after(() => rm(folder, { recursive: true, force: true }));

test("every module of the package needs what is in it alone", async () => {
  const files = (await readdir(join(folder, "package/dist"), { recursive: true })).filter((name) => name.endsWith(".js"));
  assert.ok(files.includes("tandem.js") && files.includes(join("tandem", "elements.js")), files.join());
  const there = new Set(files);
  for (const file of files) {
    const text = await readFile(join(folder, "package/dist", file), "utf8");
    for (const [, from] of text.matchAll(/(?:from |new URL\()"(\.[^"]*)"/g)) assert.ok(there.has(join(dirname(file), from)), `${file} needs ${from}`);
  }
  const { Tandem, Refusal } = await import(pathToFileURL(join(folder, "package/dist/tandem.js")));
  const nobody = new Tandem({ url: "http://127.0.0.1:9" });
  await assert.rejects(nobody.get("/health"), (error) => error instanceof Refusal && /did not answer/.test(error.message));
});

test("its declarations know the messages of topics, and verbs", async () => {
  const page = join(folder, "page.ts");
  await writeFile(page, `import { Tandem } from "./package/dist/tandem.js";
const machine = new Tandem();
machine.on("cs/1/state", (state) => state.execution === "READY");
void machine.command(1, "start");
// @ts-expect-error: a state has no such member
machine.on("cs/1/state", (state) => state.nothing);
// @ts-expect-error: there is no such verb
void machine.command(1, "begin");
`);
  const options = { strict: true, noEmit: true, types: [], moduleResolution: ts.ModuleResolutionKind.Bundler, module: ts.ModuleKind.ES2022, target: ts.ScriptTarget.ES2022 };
  const found = ts.getPreEmitDiagnostics(ts.createProgram([page], options));
  assert.deepEqual(found.map(({ messageText }) => ts.flattenDiagnosticMessageText(messageText, " ")), []);
});
