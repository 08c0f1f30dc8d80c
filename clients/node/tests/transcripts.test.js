// Transcripts of sequence programs, which all languages share: tests/transcripts/README.md.

import assert from "node:assert/strict";
import { test } from "node:test";
import { setTimeout as delay } from "node:timers/promises";

import { Alarm, OutputEnded, SequenceProgram, TakenOver } from "../src/index.js";
import { FakeBroker, PRESENCE, table } from "./fake_broker.js";

const STEP_MS = 5_000;
const SETTINGS = ["handlers", "redelivery", "take_over", "accepts", "returns_within_ms", "ends_within_ms"];
const HANDLER_SETTINGS = ["does", "redelivery", "refuses"];
const log = { debug: () => {}, warn: () => {}, error: () => {} };

/** @typedef {import("../src/index.js").Output} Output */

/** A sequence program of a case, its broker, and the steps. */
class Stage {
  /** Events of handlers: kind, M number, details. @type {[string, number, unknown][]} */
  events = [];
  /** Handlers that wait for a step, by M number. @type {[number, () => void][]} */
  waiting = [];
  /** @type {Map<string, unknown>} */
  names = new Map();
  /** How the program has ended: the error, or null. @type {unknown} */
  ended = undefined;

  /** @param {any} settings @param {FakeBroker} broker */
  constructor(settings, broker) {
    this.settings = settings;
    this.broker = broker;
  }

  // --- the program

  program() {
    assert.deepEqual(Object.keys(this.settings).filter((name) => !SETTINGS.includes(name)), []);
    const { redelivery, handlers } = this.settings;
    const program = new SequenceProgram("cell", redelivery === undefined ? {} : { redelivery });
    for (const [m, handler] of Object.entries(handlers)) {
      assert.deepEqual(Object.keys(handler).filter((name) => !HANDLER_SETTINGS.includes(name)), []);
      program.on(Number(m), (output) => this.handle(output, handler.does), handler.redelivery === undefined ? {} : { redelivery: handler.redelivery });
      const { refuses } = handler;
      if (refuses === undefined) continue;
      program.validate(Number(m), () => {
        throw new Alarm(refuses[0], refuses[1]);
      });
    }
    return program;
  }

  /** @param {Output} output @param {any[][]} actions */
  async handle(output, actions) {
    this.events.push(["begins", output.m, { redelivered: output.redelivered, checkpoint: output.lastCheckpoint }]);
    try {
      for (const [action, ...args] of actions) await actionOf(this, action)(output, ...args);
    } catch (error) {
      // an action that waits ends with the reason of the cancellation
      if (error instanceof OutputEnded) this.events.push(["cancelled", output.m, output.cancelled ? error.reason : "not cancelled"]);
      throw error;
    }
  }

  /** Waits for a step `continues`. @param {Output} output */
  async untilStep(output) {
    await new Promise((resolve, reject) => {
      const entry = /** @type {[number, () => void]} */ ([output.m, () => resolve(undefined)]);
      this.waiting.push(entry);
      output.signal.addEventListener("abort", () => {
        this.waiting = this.waiting.filter((other) => other !== entry);
        reject(output.signal.reason);
      });
    });
  }

  // --- the steps

  /** @param {any[][]} steps */
  async play(steps) {
    const { take_over: takeOver = false } = this.settings;
    this.serving = this.program().serve(`mqtt://${this.broker.node}/mill-1`, { takeOver, log });
    try {
      for (const [at, [step, ...args]] of steps.entries()) {
        await stepOf(this, step)(...args).catch((/** @type {Error} */ error) => {
          throw new Error(`step ${at}, ${JSON.stringify([step, ...args])}: ${error.message}`, { cause: error });
        });
      }
      this.skipPresences();
      assert.deepEqual([this.broker.heard, this.events], [[], []], "nothing is left");
    } finally {
      // a program whose presence was never accepted is still in `serve`: the broker accepts it now
      this.broker.accept();
      await (await this.serving).close();
    }
  }

  /** @param {string} topic @param {any} members */
  async publishes(topic, members) {
    for (;;) {
      const [said, payload] = await this.next();
      if (said === topic && this.fits(members, payload)) return;
      assert.equal(said, PRESENCE, `published ${said} ${JSON.stringify(payload)}`);
    }
  }

  /** @param {[string, any][]} messages */
  async publishesAll(messages) {
    const expected = [...messages];
    while (expected.length > 0) {
      const [said, payload] = await this.next();
      if (said === PRESENCE) continue;
      const at = expected.findIndex(([topic, members]) => topic === said && this.fits(members, payload));
      assert.ok(at >= 0, `published ${said} ${JSON.stringify(payload)}`);
      expected.splice(at, 1);
    }
  }

  /** @param {unknown[]} expected */
  async event(...expected) {
    await this.until(() => this.events.length > 0);
    const event = this.events.shift();
    assert.ok(this.fits(expected, event), JSON.stringify(event));
  }

  /** @param {number} m */
  async continues(m) {
    await this.until(() => this.waiting.some(([of]) => of === m));
    const [[, resume] = assert.fail()] = this.waiting.splice(this.waiting.findIndex(([of]) => of === m), 1);
    resume();
  }

  async leaves() {
    const { returns_within_ms: returnsWithinMs, ends_within_ms: endsWithinMs } = this.settings;
    const serving = await /** @type {Promise<import("../src/index.js").Serving>} */ (this.serving);
    serving.leave({ returnsWithinMs, endsWithinMs }).then(() => (this.ended = null), (error) => (this.ended = error));
  }

  /** @param {string} how */
  async ends(how) {
    if (how === "taken_over") {
      const serving = await /** @type {Promise<import("../src/index.js").Serving>} */ (this.serving);
      serving.ended.catch((error) => (this.ended = error));
    }
    await this.until(() => this.ended !== undefined);
    assert.ok(how === "left" ? this.ended === null : how === "taken_over" && this.ended instanceof TakenOver, String(this.ended));
  }

  // --- comparison

  /** @param {() => boolean} holds */
  async until(holds) {
    const end = performance.now() + STEP_MS;
    while (!holds()) {
      assert.ok(performance.now() < end, `not within ${STEP_MS} ms; events ${JSON.stringify(this.events)}`);
      await delay(2);
    }
  }

  /** Waits for the next message of the program. */
  async next() {
    await this.until(() => this.broker.heard.length > 0);
    return /** @type {[string, any]} */ (this.broker.heard.shift());
  }

  skipPresences() {
    this.broker.heard = this.broker.heard.filter(([topic]) => topic !== PRESENCE);
  }

  /** Returns a value with the names replaced. @param {any} value @returns {any} */
  filled(value) {
    if (Array.isArray(value)) return value.map((item) => this.filled(item));
    if (value === "$instance") return this.broker.instance;
    if (typeof value === "string") return value.startsWith("$") ? this.names.get(value) : value;
    if (value === null || typeof value !== "object") return value;
    return Object.fromEntries(Object.entries(value).map(([name, member]) => [name, this.filled(member)]));
  }

  /** @param {any} expected @param {any} value @returns {boolean} */
  fits(expected, value) {
    if (Array.isArray(expected)) return Array.isArray(value) && value.length === expected.length && expected.every((one, at) => this.fits(one, value[at]));
    if (expected !== null && typeof expected === "object") return Object.entries(expected).every(([name, one]) => this.fits(one, value?.[name]));
    if (expected === "$instance") return value === this.broker.instance;
    if (typeof expected === "string" && expected.startsWith("$")) {
      if (!this.names.has(expected)) this.names.set(expected, value);
      return this.names.get(expected) === value;
    }
    return (value ?? null) === expected || (expected === false && value === undefined);
  }
}

/** @param {Stage} stage @param {string} name @returns {(output: Output, ...args: any[]) => unknown} */
function actionOf(stage, name) {
  /** @type {Record<string, (output: Output, ...args: any[]) => unknown>} */
  const actions = {
    wait: (output) => stage.untilStep(output),
    progress: (output, text, percent) => output.progress(text, percent ?? undefined),
    checkpoint: (output, value) => output.checkpoint(value),
    ask: async (output, text, choices) => stage.events.push(["answered", output.m, await output.ask(text, choices)]),
    fault: (_output, code, text) => {
      throw new Alarm(code, text);
    },
  };
  return actions[name] ?? assert.fail(`unknown action ${name}`);
}

/** @param {Stage} stage @param {string} name @returns {(...args: any[]) => Promise<unknown>} */
function stepOf(stage, name) {
  const { broker } = stage;
  /** @type {Record<string, (...args: any[]) => Promise<unknown>>} */
  const steps = {
    receives: async (topic, members) => broker.publish(topic, stage.filled(members)),
    publishes: (topic, members) => stage.publishes(topic, members),
    publishes_all: (messages) => stage.publishesAll(messages),
    registers: (members) => stage.publishes(PRESENCE, { online: true, ...members }),
    nothing: async (ms) => {
      await delay(ms);
      stage.skipPresences();
      assert.deepEqual([broker.heard, stage.events], [[], []]);
    },
    begins: (m, members) => stage.event("begins", m, members),
    answered: (m, choice) => stage.event("answered", m, choice),
    cancelled: (m, reason) => stage.event("cancelled", m, reason),
    continues: (m) => stage.continues(m),
    cuts: async (will) => {
      assert.ok(stage.fits(will, broker.will), `last will ${JSON.stringify(broker.will)}`);
      broker.isDown = true;
      broker.cut();
    },
    restores: async () => {
      stage.skipPresences();
      broker.isDown = false;
    },
    leaves: () => stage.leaves(),
    ends: (how) => stage.ends(how),
  };
  return steps[name] ?? assert.fail(`unknown step ${name}`);
}

for (const { name, program, steps } of table.cases) {
  test(name, async () => {
    const broker = await FakeBroker.open({ accepts: program.accepts ?? true });
    try {
      await new Stage(program, broker).play(steps);
    } finally {
      broker.close();
    }
  });
}
