// Inputs and outputs of the plant against a real machine.

import assert from "node:assert/strict";
import { after, before, test } from "node:test";

import { Plc, RequestRefused, SequenceProgram } from "../src/index.js";
import { Machine, DEFAULT_CONFIG } from "../src/testing.js";

const PLANT = '\n[io.in.flows]\n[io.in.level]\nkind = "number"\nunit = "l"\nmin = 0\nmax = 60\n[io.out.valve]\n';
const quiet = { debug: () => {}, warn: () => {}, error: () => {} };

/** @type {Machine} */
let machine;
before(async () => {
  machine = await Machine.start({ config: DEFAULT_CONFIG + PLANT });
});
after(() => machine.close());

/** Runs a function with a connection. @param {(plc: Plc) => Promise<unknown>} work */
async function connected(work) {
  const plc = await Plc.connect(machine.mqtt, { log: quiet });
  try {
    await work(plc);
  } finally {
    await plc.close();
  }
}

test("a handler opens a valve and waits for the input; the valve is its, and safe without it", async () => {
  const cell = new SequenceProgram("cell").on(8, async (_output, plc) => {
    await plc.ioOut("valve").set(true);
    await plc.ioIn("flows").waitUntil();
  });
  const served = await cell.serve(machine.mqtt, { log: quiet });
  await connected(async (plc) => {
    const ran = machine.run("M08\nM30");
    await plc.ioOut("valve").waitUntil();
    assert.equal(plc.ioOut("valve").state.owner, "cell");
    await assert.rejects(plc.ioOut("valve").set(false), /handler cell owns it/);
    await plc.ioIn("flows").set(true);
    assert.ok((await ran).completed);
    await served.close();
    await plc.until(() => plc.ioOut("valve").state.lost);
    assert.equal(plc.ioOut("valve").value, false);
  });
});

test("a value is followed, forced and released, and what it cannot be is refused in words", async () => {
  await connected(async (plc) => {
    const level = plc.ioIn("level");
    const values = level.values();
    assert.equal((await values.next()).value, 0);
    await level.set(12.5);
    assert.equal((await values.next()).value, 12.5);
    await level.force(3);
    assert.equal((await values.next()).value, 3);
    assert.equal(level.state.written, 12.5);
    await level.release();
    assert.equal((await values.next()).value, 12.5);
    for (const wrong of [61, -1, NaN, true]) await assert.rejects(level.set(wrong), RequestRefused);
    await assert.rejects(plc.ioIn("vent").set(true), /no \[io\.in\.vent\]; there are flows, level/);
    assert.throws(() => plc.ioIn("vent").value, RequestRefused);
  });
});
