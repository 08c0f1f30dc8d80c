// The packed package: its modules can be imported, its declarations are right, and the examples of the page work.

import assert from "node:assert/strict";
import { execFile } from "node:child_process";
import { mkdir, mkdtemp, readdir, readFile, rm, symlink, writeFile } from "node:fs/promises";
import { tmpdir } from "node:os";
import { join, resolve } from "node:path";
import { after, before, test } from "node:test";
import { fileURLToPath, pathToFileURL } from "node:url";
import { promisify } from "node:util";
import ts from "typescript";

const PACKAGE = fileURLToPath(new URL("..", import.meta.url));
const PAGE = new URL("../../../docs/src/how-to/node.md", import.meta.url);
const run = promisify(execFile);

/** @type {string} */
let folder;
before(async () => {
  folder = await mkdtemp(join(tmpdir(), "tandem-package-"));
  await run("npm", ["pack", "--silent", "--pack-destination", folder], { cwd: PACKAGE });
  const [name = ""] = await readdir(folder);
  const installed = join(folder, "node_modules/tandem-plc");
  await mkdir(installed, { recursive: true });
  await run("tar", ["-xzf", join(folder, name), "--strip-components=1", "-C", installed]);
  for (const library of ["mqtt", "@types"]) await symlink(join(PACKAGE, "node_modules", library), join(folder, "node_modules", library));
});
after(() => rm(folder, { recursive: true, force: true }));

test("its declarations know programs, outputs, states and messages", async () => {
  const program = join(folder, "program.ts");
  await writeFile(program, `import { Alarm, Output, Plc, SequenceProgram } from "tandem-plc";
import type { StateMessage } from "tandem-plc/messages";
import { Machine } from "tandem-plc/testing";
import { Tandem } from "tandem-plc/http";

export const program = new SequenceProgram("cell")
  .on([6, 7], async (output: Output, plc: Plc) => {
    const answer: "yes" | "no" = await output.ask("Go on?", ["yes", "no"]);
    if (answer === "no") throw new Alarm(1, "no");
    const state: StateMessage = await plc.cs(output.cs).waitFor(({ execution }) => execution === "WAIT");
    return state.waiting_on?.m;
  }, { redelivery: "verify", params: { A: { min: 1, unit: "kN" } } })
  .task(async (_plc, signal) => signal.throwIfAborted());
export const how = async (plc: Plc) => (await (await plc.cs(1).run(1, { parts: 3 })).ended()).end.how === "completed";
export const machine: () => Promise<Machine> = () => Machine.start();
export const rest = new Tandem({ url: "http://127.0.0.1:8080" });
// @ts-expect-error: there is no such redelivery
program.on(8, () => {}, { redelivery: "twice" });
// @ts-expect-error: there is no such parameter
program.on(8, ({ params }) => params.J);
// @ts-expect-error: internal members are not declared
export const connection = (plc: Plc) => plc.connection;
`);
  const { NodeNext } = ts.ModuleKind;
  const options = { strict: true, noEmit: true, types: ["node"], typeRoots: [join(folder, "node_modules/@types")], module: NodeNext, target: ts.ScriptTarget.ES2022 };
  const found = ts.getPreEmitDiagnostics(ts.createProgram([program], options));
  assert.deepEqual(found.map(({ messageText, file }) => `${file?.fileName}: ${ts.flattenDiagnosticMessageText(messageText, " ")}`), []);
});

test("the programs of the page are right, and its tests pass", async () => {
  const page = await readFile(PAGE, "utf8");
  const files = [...page.matchAll(/```js,file=(\S+)\n(.*?)```/gs)];
  assert.deepEqual(files.map(([, name]) => name), ["changer.mjs", "changer.test.mjs", "cell.mjs", "line.mjs", "store.mjs"]);
  for (const [, name = "", text = ""] of files) await writeFile(join(folder, name), text);
  const written = (/** @type {string} */ name) => import(pathToFileURL(join(folder, name)).href);

  const { NODE_TEST_CONTEXT: _, TANDEM_BIN = "", ...rest } = process.env;
  const env = { ...rest, TANDEM_BIN: TANDEM_BIN && resolve(TANDEM_BIN) };
  const { stdout } = await run(process.execPath, ["--test", "--test-reporter=tap"], { cwd: folder, env });
  assert.match(stdout, /^# pass 3$/m);

  const { Machine } = await import(pathToFileURL(join(folder, "node_modules/tandem-plc/dist/testing.js")).href);
  const machine = await Machine.start();
  try {
    const { store } = await written("store.mjs");
    const { programs } = await store(machine.http, 7, "G01 X1 F6000\nM30");
    assert.deepEqual(programs.map((/** @type {any} */ { number }) => number), [7]);
    const { make } = await written("line.mjs");
    assert.deepEqual([(await make(machine.mqtt, 7)).parts_done, (await written("cell.mjs")).program.handlerId], [3, "cell"]);
  } finally {
    await machine.close();
  }
});
