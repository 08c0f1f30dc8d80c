// Follows variables and tools as they change, at a real machine.

import assert from "node:assert/strict";
import { after, before, test } from "node:test";

import { Plc, RequestRefused } from "../src/index.js";
import { Machine, DEFAULT_CONFIG } from "../src/testing.js";

const PUBLISHED = '\n[[variables.published]]\nfrom = "P200"\ncount = 4\n[[variables.published]]\nfrom = "Q7"\n';
const quiet = { debug: () => {}, warn: () => {}, error: () => {} };

/** @type {Machine} */
let machine;
/** @type {Plc} */
let plc;
before(async () => {
  machine = await Machine.start({ config: DEFAULT_CONFIG + PUBLISHED });
  plc = await Plc.connect(machine.mqtt, { log: quiet });
});
after(async () => {
  await plc.close();
  await machine.close();
});

test("what is written is published once, whoever writes it", async () => {
  const other = await Plc.connect(machine.mqtt, { log: quiet });
  const changes = plc.pChanges(200, 2);
  assert.deepEqual((await changes.next()).value, [0, 0]);
  await other.writeP(202, [5]); // another variable
  await other.writeP(200, [1.5]);
  assert.deepEqual((await changes.next()).value, [1.5, 0]);
  await other.writeP(201, [NaN]);
  assert.deepEqual((await changes.next()).value, [1.5, NaN]);
  await machine.run("P200=3\nM30");
  assert.deepEqual((await changes.next()).value, [3, NaN]);
  const q = plc.cs(1).qChanges(7);
  assert.deepEqual((await q.next()).value, [0]);
  await other.cs(1).writeQ(7, [2]);
  assert.deepEqual((await q.next()).value, [2]);
  await changes.return();
  await other.close();
});

test("variables that are not published are refused with what to write", async () => {
  const isRefused = (/** @type {RegExp} */ words) => (/** @type {unknown} */ error) => error instanceof RequestRefused && words.test(error.message);
  await assert.rejects(plc.pChanges(203, 2).next(), isRefused(/^2 variables from P203 on are not published.*from = "P203", count = 2$/));
  await assert.rejects(plc.cs(1).qChanges(8).next(), isRefused(/^Q8 is not published/));
  for (const count of [0, 1025, 1.5]) await assert.rejects(plc.pChanges(200, count).next(), isRefused(/not published/));
});

test("tools and work offsets are published when they change", async () => {
  const [tools, offsets] = [plc.toolChanges(), plc.cs(1).workOffsetChanges()];
  assert.deepEqual((await tools.next()).value, []);
  assert.deepEqual((await offsets.next()).value?.G54, { X: 0, Y: 0, Z: 0 });
  const tool = { id: 3, radius: 2, length: 41.25 };
  await machine.rest("PUT", "/tools", { tools: [tool] });
  assert.deepEqual((await tools.next()).value, [tool]);
  await machine.rest("PUT", "/cs/1/work_offsets", { work_offsets: { G55: { X: 12.5 } } });
  assert.equal((await offsets.next()).value?.G55?.X, 12.5);
});
