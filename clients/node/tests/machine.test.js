// Handlers, commands and inputs against a real machine: cases that the list of behaviours (tests/it/clients) does not
// cover.

import assert from "node:assert/strict";
import { after, before, beforeEach, test } from "node:test";
import { setTimeout as delay } from "node:timers/promises";

import { Alarm, CommandFailed, ConnectError, NoAnswer, NotConnected, OutputEnded, Plc, RequestRefused, SequenceProgram, stopSignal, TakenOver, UserAlarm } from "../src/index.js";
import { limits } from "../src/output.js";
import { Machine } from "../src/testing.js";

/** @typedef {import("../src/index.js").Output} Output */

const quiet = { debug: () => {}, warn: () => {}, error: () => {} };
const pocket = (/** @type {import("../src/index.js").Params} */ params) => params.whole("A", 1, 24, "the pocket");

/** @type {Machine} */
let machine;
before(async () => {
  machine = await Machine.start();
});
after(() => machine.close());
beforeEach(() => machine.rest("POST", "/cs/1/reset?wait=1"));

/** Serves a program while a function runs. @param {SequenceProgram} program @param {(plc: Plc) => Promise<unknown>} work */
async function serving(program, work) {
  const served = await program.serve(machine.mqtt, { log: quiet });
  try {
    await work(served.plc);
  } finally {
    await served.close();
  }
  await served.ended;
}

/** Waits until a condition holds. @param {() => Promise<unknown>} holds */
async function until(holds) {
  while (!(await holds())) await delay(10);
}

/** Waits until the machine knows that the program is offline (the broker knows it earlier), and returns its record. */
async function cellHasGone() {
  const cell = async () => (await machine.rest("GET", "/handlers")).handlers.cell;
  await until(async () => !(await cell())?.online);
  return cell();
}

/** Runs a function with a connection. @param {(plc: Plc) => Promise<unknown>} work */
async function connected(work) {
  const plc = await Plc.connect(machine.mqtt, { log: quiet });
  try {
    await work(plc);
  } finally {
    await plc.close();
  }
}

test("the program goes on when the handler has returned, with what it has set", async () => {
  /** @type {unknown[]} */
  const seen = [];
  const program = new SequenceProgram("changer").on(
    6,
    async ({ params, cs, line }, plc) => {
      seen.push([pocket(params), plc.cs(cs).state.execution, line, params.B]);
      await plc.cs(cs).selectTool(pocket(params));
    },
    { validate: pocket },
  );
  await serving(program, async () => {
    assert.ok((await machine.run("M06 VA5\nG01 X1 F3000\nM06 VA6 VB-0.5\nM30")).completed);
    await assert.rejects(machine.run("G01 X0 F3000\nM06 VA99\nM30"), /line 2: E0190.*VA is 99.*1 to 24/);
  });
  assert.deepEqual(seen, [[5, "WAIT", 1, undefined], [6, "WAIT", 3, -0.5]]);
  assert.equal((await machine.rest("GET", "/cs/1/tool")).id, 6);
});

test("a program with parameters that are not declared is not loaded, and an alarm where they are known late", async () => {
  /** @type {unknown[]} */
  const seen = [];
  const params = { A: { name: "force", unit: "kN", min: 1, max: 20 }, B: { whole: true, min: 1, max: 2, optional: true } };
  const program = new SequenceProgram("clamp").on(12, (output) => seen.push([output.params.A, output.params.B]), { name: "clamp", params });
  await serving(program, async () => {
    await assert.rejects(machine.run("M12 VA50\nM30"), /line 1: E0191 M12 clamp: VA \(force\) is 50 kN; write 1 to 20 kN/);
    await assert.rejects(machine.run("M12\nM30"), /E0191 M12 clamp needs VA \(force, 1 to 20 kN\)/);
    assert.ok((await machine.run("M12 VA5\nM12 VA20 VB2\nM30")).completed);
    assert.deepEqual((await machine.run("P3 = 50\nM12 VA[P3]\nM30")).alarms, ["A word's value is out of its range: M12 clamp: VA (force) is 50 kN; write 1 to 20 kN (declared by handler clamp)"]);
    const { serves } = await machine.rest("GET", "/machine");
    const expected = { m: 12, cs: [1], handler_id: "clamp", name: "clamp", params };
    assert.deepEqual(serves.filter((/** @type {any} */ one) => one.handler_id === "clamp"), [expected]);
  });
  assert.deepEqual(seen, [[5, undefined], [20, 2]]);
});

test("what a handler or check throws is said with its name, and others are served", async () => {
  const program = new SequenceProgram("coolant")
    .on(7, ({ params }) => {
      if (params.A === undefined) throw new TypeError("no such valve");
    })
    .on(8, () => {}, {
      validate: () => {
        throw new TypeError("a mistake");
      },
    })
    .on(9, () => {}, { validate: async () => Promise.reject(new Alarm(9, "it may not")) });
  await serving(program, async () => {
    assert.deepEqual((await machine.run("M07\nM30")).alarms, ["the handler of M7 has failed: TypeError: no such valve"]);
    await machine.rest("POST", "/cs/1/reset?wait=1");
    assert.ok((await machine.run("M07 VA1\nM30")).completed);
    await assert.rejects(machine.run("M08\nM30"), /the check of M8 has failed: TypeError: a mistake/);
    await assert.rejects(machine.run("M09\nM30"), /it may not/);
  });
});

test("questions are answered one after the other", async () => {
  /** @type {string[]} */
  const answers = [];
  const program = new SequenceProgram("inspection").on(80, async (output) => {
    output.progress("the part is at the window", 50);
    answers.push(...(await Promise.all([output.ask("Is it clean?", ["yes", "no"]), output.ask("And dry?", ["yes", "no"])])));
    await assert.rejects(output.ask("", ["yes"]), RangeError);
    await assert.rejects(output.ask("Twice?", ["yes", "yes"]), RangeError);
  });
  await serving(program, async () => {
    await machine.load("M80\nM30");
    const end = await machine.started();
    assert.equal(await machine.answer("no"), "Is it clean?");
    const state = await machine.waitFor(({ waiting_on: waiting }) => waiting?.question?.text === "And dry?");
    assert.deepEqual(state.waiting_on?.progress, { text: "the part is at the window", percent: 50 });
    await machine.answer("yes");
    assert.ok((await end()).completed);
  });
  assert.deepEqual(answers, ["no", "yes"]);
});

test("what a handler sends that works on after its cancel is refused here, once it has had time to clean up", async (t) => {
  const before = limits.cleanUpMs;
  t.after(() => (limits.cleanUpMs = before));
  limits.cleanUpMs = 200;
  /** @type {unknown} */
  let error;
  const program = new SequenceProgram("rinse").on(20, async (output, plc) => {
    output.progress("it rinses");
    while (!output.cancelled) await delay(10); // the handler passes the signal to no wait
    await plc.writeP(100, [1]); // the clean-up
    while (error === undefined) {
      await delay(10);
      await plc.writeP(101, [2]).catch((refused) => (error = refused));
    }
    await plc.writeP(102, [3]);
  });
  await serving(program, async (plc) => {
    await plc.writeP(100, [0, 0, 0]);
    await machine.load("M20\nM30");
    await machine.started();
    await machine.waitFor(({ waiting_on: waiting }) => waiting?.progress !== undefined);
    await machine.rest("POST", "/cs/1/stop?wait=1");
    await machine.waitFor(() => error !== undefined);
    assert.deepEqual(await plc.readP(100, 3), [1, 2, 0]);
  });
  assert.ok(error instanceof OutputEnded && error.reason === "stop", String(error));
  assert.match(error.message, /^M20 was cancelled 0.2 s ago and more; reason: stop; nothing was sent: its handler must end when/);
});

test("what a program owns is set from its first moment on and when it changes", async () => {
  const program = new SequenceProgram("cell");
  const door = program.interlock(1, "door", "the door is open");
  program.task(async (plc, signal) => {
    await plc.until(() => plc.cs(1).interlock.value, { signal });
    door.set(false);
  });
  await serving(program, async (plc) => {
    const mill = plc.cs(1);
    await plc.until(() => mill.interlock.sources.length > 0 && !mill.interlock.value);
    const [source] = mill.interlock.sources;
    assert.deepEqual([source?.source, source?.handler_id, source?.value], ["door", "cell", false]);
    door.set(true);
    await plc.until(() => mill.interlock.value);
    await connected(async (other) => {
      await other.cs(1).setInterlock(false, "", { source: "door" });
      await other.readP(100);
      assert.equal(mill.interlock.value, true, "its owner alone clears it");
    });
    door.set(false);
    await plc.until(() => !mill.interlock.value);
  });
});

test("a task that fails ends the program with its error", async () => {
  const program = new SequenceProgram("cell").task(async () => {
    throw new TypeError("a mistake");
  });
  await assert.rejects(program.run(machine.mqtt, { log: quiet }), /a mistake/);
  await cellHasGone();
});

test("a program runs until its signal, and the machine is told", async () => {
  const stop = new AbortController();
  const program = new SequenceProgram("cell").on(9, () => {}).task(() => stop.abort());
  await program.run(machine.mqtt, { signal: stop.signal, log: quiet });
  await cellHasGone();
});

test("a task that fails while the program is stopped ends it", async () => {
  const stop = new AbortController();
  const program = new SequenceProgram("cell").on(20, ({ signal }) => delay(1_000_000, undefined, { signal })).task(async () => {
    await machine.load("M20\nM30");
    await machine.started();
    stop.abort();
    throw new TypeError("a mistake");
  });
  await assert.rejects(program.runUntil(machine.mqtt, stop.signal, { log: quiet }), /a mistake/);
});

test("a time in which no program comes back is a mistake", async () => {
  for (const returnsWithinMs of [-1, 3_600_001, NaN]) {
    const runs = new SequenceProgram("cell").runUntil("mqtt://127.0.0.1:9/none", AbortSignal.abort(), { returnsWithinMs });
    await assert.rejects(runs, /returnsWithinMs .*: write 0 to 3600000/);
  }
});

test("a signal of the system stops a program, and the next one ends it", async () => {
  const before = process.listenerCount("SIGTERM");
  const stop = stopSignal();
  process.kill(process.pid, "SIGTERM");
  await until(async () => stop.aborted);
  assert.equal(process.listenerCount("SIGTERM"), before);
});

test("an alarm is shown with its remedy and languages", async () => {
  const languages = { de: { text: "der Luftdruck ist zu niedrig", remedy: "Hauptventil öffnen." } };
  const air = new UserAlarm(12, "the air pressure is low", { remedy: "Open the main valve.", languages });
  const program = new SequenceProgram("clamp").alarms(air).on(10, () => {
    throw air.alarm("2.1 bar");
  });
  await serving(program, async (plc) => {
    assert.deepEqual((await machine.run("M10\nM30")).alarms, ["the air pressure is low: 2.1 bar"]);
    await plc.until(() => plc.alarms.length > 0);
    const [shown] = plc.alarms;
    assert.deepEqual([shown?.number, shown?.remedy, shown?.languages], [10_012, "Open the main valve.", languages]);
  });
});

test("a process that takes the place of another ends it", async () => {
  const first = await new SequenceProgram("cell").on(9, () => {}).serve(machine.mqtt, { log: quiet });
  const second = await new SequenceProgram("cell").on(9, () => {}).serve(machine.mqtt, { log: quiet, takeOver: true });
  await assert.rejects(first.ended, TakenOver);
  assert.ok((await machine.run("M09\nM30")).completed);
  await first.close();
  assert.ok((await machine.run("M09\nM30")).completed, "the end of the first says nothing of the second");
  await second.close();
});

test("a run ends with all its parts, and says how", async () => {
  await machine.rest("PUT", "/programs/1", "G01 X10 F6000\nM30");
  await connected(async (plc) => {
    const mill = plc.cs(1);
    const run = await mill.run(1, { parts: 2 });
    const { end, parts_done: parts } = await run.ended();
    assert.deepEqual([end.how, parts], ["completed", 2]);
    const again = await mill.run();
    assert.notEqual(again.id, run.id);
    assert.equal((await again.ended()).end.how, "completed");
    assert.deepEqual(plc.birth?.coordinate_systems[0]?.axes, { X: 1, Y: 2, Z: 3 });
  });
});

test("a refusal says why, and what has failed says so", async () => {
  await connected(async (plc) => {
    const mill = plc.cs(1);
    const refused = (/** @type {string} */ code) => (/** @type {unknown} */ error) => error instanceof RequestRefused && error.code === code;
    await assert.rejects(mill.load(999), refused("not_found"));
    await assert.rejects(mill.mdi("G01 X1 F"), refused("program_has_errors"));
    assert.throws(() => plc.cs(7).state, refused("not_found"));
    // a new connection receives its first position after the state
    const x = async () => {
      for (;;) {
        try {
          return mill.position.machine.X;
        } catch (error) {
          if (!(error instanceof RequestRefused)) throw error;
          await delay(10);
        }
      }
    };
    const from = await x();
    const moves = assert.rejects(mill.mdi("G01 X400 F600"), (error) => error instanceof CommandFailed && error.verb === "mdi" && error.code === "stop" && (error.moved.X ?? 0) > 0);
    await mill.waitUntil("ACTIVE");
    while ((await x()) === from) await delay(10);
    await mill.stop();
    await moves;
  });
});

test("a step is whole without refresh, and a macro leaves nothing behind", async () => {
  await connected(async (plc) => {
    const mill = plc.cs(1);
    const at = () => mill.position.machine.X ?? NaN;
    await mill.home();
    assert.equal((await mill.jog("X", 600, "step-1", { distance: 5 })).status, "done");
    await assert.rejects(mill.jog("X", 600, "step-2", { distance: 50 }), (error) => error instanceof CommandFailed && error.code === "not_refreshed" && (error.moved.X ?? 0) > 0);
    await mill.mdi("G90 G01 F6000");
    await mill.mdi("G91 G01 X1", { macro: true });
    await mill.mdi("X10");
    for (let tries = 0; tries < 50 && Math.abs(at() - 10) > 1e-6; tries += 1) await new Promise((resolve) => setTimeout(resolve, 20));
    assert.ok(Math.abs(at() - 10) < 1e-6, `${at()}`);
  });
});

test("variables are what was written", async () => {
  await connected(async (plc) => {
    await plc.writeP(100, [1.5, NaN, Infinity, -Infinity, 0.1]);
    assert.deepEqual(await plc.readP(100, 5), [1.5, NaN, Infinity, -Infinity, 0.1]);
    await plc.cs(1).writeQ(10, [7]);
    assert.deepEqual(await plc.cs(1).readQ(10), [7]);
    await assert.rejects(plc.readP(32_767, 2), RequestRefused);
  });
});

test("inputs are set and seen", async () => {
  await connected(async (plc) => {
    const mill = plc.cs(1);
    await mill.setOptionalSkip(3, true);
    await mill.setOptionalStop(true);
    await mill.setOverrides({ feed: 50 });
    await mill.waitFor((state) => state.optional_stop && state.optional_skip.join() === "3");
    await mill.setStartLock(true, "the pallet moves");
    await plc.until(() => mill.startLock.value && mill.overrides.feed === 50);
    assert.equal(mill.startLock.text, "the pallet moves");
    await mill.setStartLock(false);
    await mill.setOptionalStop(false);
    await mill.setOverrides({ feed: 100 });
    await plc.until(() => !mill.startLock.value);
  });
});

test("an alarm of no output stops the machine", async () => {
  await connected(async (plc) => {
    await plc.raiseAlarm(new Alarm(20, "the air pressure is low"));
    await plc.cs(1).waitUntil("STOPPED");
    await plc.until(() => plc.alarms.length > 0);
    assert.deepEqual(plc.alarms.map(({ number, text }) => [number, text]), [[10_020, "the air pressure is low"]]);
    await plc.cs(1).acknowledgeAlarm(plc.alarms[0]?.id ?? 0);
    await plc.cs(1).reset();
    await plc.until(() => plc.alarms.length === 0);
  });
});

test("a lease gives starts to its holder alone", async () => {
  await machine.rest("PUT", "/programs/1", "G01 X10 F6000\nM30");
  await connected((line) =>
    connected(async (panel) => {
      await line.cs(1).takeLease("line", { ttlMs: 10_000 });
      await assert.rejects(panel.cs(1).load(1), RequestRefused);
      assert.equal((await (await line.cs(1).run(1)).ended()).end.how, "completed");
      await line.cs(1).releaseLease();
      assert.equal((await (await panel.cs(1).run(1)).ended()).end.how, "completed");
    }),
  );
});

test("a command without an answer can be repeated by its id", async () => {
  await connected(async (plc) => {
    const text = "G01 X350 F24000";
    const unknown = await plc.cs(1).mdi(text, { timeoutMs: 100 }).catch((error) => error);
    assert.ok(unknown instanceof NoAnswer && unknown.commandId !== undefined, String(unknown));
    assert.equal((await plc.cs(1).mdi(text, { commandId: unknown.commandId })).status, "done");
  });
});

test("without a machine, connecting says what is not there", async () => {
  const nobody = Plc.connect("mqtt://user:secret@127.0.0.1:9/none", { timeoutMs: 200 });
  await assert.rejects(nobody, (error) => error instanceof ConnectError && /^no connection to mqtt:\/\/127\.0\.0\.1:9\/none: .*ECONNREFUSED/.test(error.message));
});

test("without a machine of that name, connecting says that the broker is there", async () => {
  const nobody = Plc.connect(`${machine.mqtt}0`, { timeoutMs: 300 });
  await assert.rejects(nobody, /mill-10: the broker answers, but no machine of this name is online/);
});

test("without a connection nothing is sent, and what waits ends when it is closed", async () => {
  const other = await Machine.start();
  const plc = await Plc.connect(other.mqtt, { log: quiet });
  await other.kill();
  await plc.until(() => !plc.isConnected);
  await assert.rejects(plc.cs(1).command("start", {}, { timeoutMs: 100 }), (error) => error instanceof NotConnected && /nothing was sent/.test(error.message));
  const waits = assert.rejects(plc.cs(1).waitUntil("ACTIVE"), NotConnected);
  await plc.close();
  await waits;
  await assert.rejects(plc.cs(1).start(), NotConnected);
  await other.close();
});
