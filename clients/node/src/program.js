// A sequence program: handlers by M code, and what is no M code beside them.

import { ALARMS_MAX } from "./alarms.js";
import { Bell } from "./bell.js";
import { Connection } from "./connection.js";
import { Declared } from "./declared.js";
import { ProgramError } from "./errors.js";
import { Plc } from "./plc.js";
import { lockLevel } from "./levels.js";
import { checkReturnsWithin, place, RETURNS_WITHIN_MS, Runner } from "./runner.js";

const M_CODE_MAX = 191;
/** M codes that the runtime handles itself; they never reach a handler. */
const RUNTIME_M_CODES = [0, 1, 2, 30, 98, 99];
const REDELIVERIES = ["ask", "redo", "verify"];

/** @typedef {import("./output.js").Output} Output */
/** @typedef {import("./params.js").Params} Params */
/** @typedef {import("./levels.js").Place} Place */
/** @typedef {import("./messages.d.ts").Redelivery} Redelivery */
/** @typedef {import("./alarms.js").UserAlarm} UserAlarm */

/** M numbers: `6`, or `[20, 21]`. @typedef {number | Iterable<number>} Codes */

/** The NC program waits until it returns. @callback Handler @param {Output} output @param {Plc} plc @returns {unknown} */

/** Throws an `Alarm` for parameters that are wrong; what it gives is passed over. @callback Check @param {Params} params @returns {unknown} */

/** What runs beside the handlers, until the signal. @callback Task @param {Plc} plc @param {AbortSignal} signal @returns {unknown} */

/**
 * @typedef {object} HandlerOptions
 * @property {number} [cs] its coordinate system; without it, all that have no handler of their own for the M code
 * @property {Check} [validate] checks parameters when a program is loaded: one for which it throws an `Alarm` is not loaded
 * @property {Redelivery} [redelivery] what is done with an output on which this program may have worked before it was lost: `ask` (an
 *   operator decides), `redo` (the handler runs again), `verify` (it runs with `output.redelivered` true); without it, what the program
 *   says of all
 * @property {string} [name] what the M codes do, such as "clamp", for alarms and panels
 * @property {Partial<Record<import("./params.js").Letter, import("./declared.js").Param>>} [params] what their parameters are, such as
 *   `{ A: { name: "force", unit: "kN", min: 1, max: 20 } }`. A program with others is not loaded, and the handler is not begun with
 *   others. `{}`: they take none
 */

/**
 * @typedef {object} ServeOptions
 * @property {boolean} [takeOver] take the place of another process of the same name, which ends; otherwise this one is refused
 */

/**
 * @typedef {object} LeaveOptions
 * @property {number} [returnsWithinMs] time in which the program is back, 1 minute without it, up to 1 h; 0: it does not come back
 * @property {number} [endsWithinMs] how long handlers may go on; without it, as long as they need. The signal of those that are still at
 *   work then is aborted, and their outputs are lost: `redelivery` says what becomes of them
 */

/** A source of an interlock or start lock that belongs to the program. */
export class Level {
  #changed = (/** @type {Level} */ _level) => {};

  /** @param {Place} at @param {string} text @param {boolean} value */
  constructor(at, text, value) {
    this.place = at;
    this.text = text;
    this.value = value;
  }

  /** Sets it; the machine is told as soon as it can be, and again on each connection and at each boot. @param {boolean} value @param {string} [text] */
  set(value, text = this.text) {
    this.value = value;
    this.text = text;
    this.#changed(this);
  }

  /** Tells of the level of now, and of each that comes. @internal @param {(level: Level) => void} changed */
  follow(changed) {
    this.#changed = changed;
    changed(this);
  }
}

/** A program that serves a machine. */
export class Serving {
  #runner;
  #close;

  /** @param {Plc} plc @param {Promise<void>} ended @param {Runner} runner @param {() => Promise<void>} close */
  constructor(plc, ended, runner, close) {
    /** The machine. */
    this.plc = plc;
    /** Ends when this is closed; rejects when a task of the program fails, or the machine refuses the program. */
    this.ended = ended;
    this.#runner = runner;
    this.#close = close;
  }

  /**
   * Takes no further output, and closes when the handlers that are at work have ended. What runs beside them goes on until then. The
   * machine is told that the program comes back: until then its M codes count as served, and NC programs wait at them. Throws what has
   * ended the program meanwhile.
   * @param {LeaveOptions} [options]
   */
  async leave({ returnsWithinMs = RETURNS_WITHIN_MS, endsWithinMs } = {}) {
    checkReturnsWithin(returnsWithinMs);
    this.#runner.returnsWithinMs = returnsWithinMs;
    try {
      await Promise.race([this.#runner.finish(endsWithinMs), this.ended]);
    } finally {
      await this.#close();
    }
  }

  /** Ends all handlers, tells the machine that they have gone, and ends the connection. */
  async close() {
    await this.#close();
  }
}

/**
 * What serves M codes of a machine, under one name:
 * `new SequenceProgram("changer").on(6, async (output, plc) => { .. }).run("mqtt://127.0.0.1:1883/mill-1")`.
 *
 * A handler that returns resets its output, and the NC program goes on. An `Alarm` stops it with its text, and so does any other
 * exception.
 */
export class SequenceProgram {
  /** @type {Map<string, import("./runner.js").Entry>} */
  #handlers = new Map();
  /** @type {Map<string, {cs: number | undefined, m: number, check: Check}>} */
  #checks = new Map();
  /** @type {Map<number, UserAlarm>} */
  #alarms = new Map();
  /** @type {Level[]} */
  #levels = [];
  /** @type {Task[]} */
  #tasks = [];
  #redelivery;

  /**
   * @param {string} handlerId 1 to 64 characters without `/ + #`, always the same, so that the machine knows it again
   * @param {{redelivery?: Redelivery}} [options] what is done with outputs on which this program may have worked before it was lost,
   *   where `on` says nothing else of them. The strictest counts of this and of the configuration; where neither says anything, an
   *   operator decides
   */
  constructor(handlerId, { redelivery } = {}) {
    if (!/^[^/+#\0]{1,64}$/s.test(handlerId)) {
      throw new ProgramError(`handler id ${JSON.stringify(handlerId)}: write 1 to 64 characters without / + #`);
    }
    checkRedelivery(redelivery);
    this.handlerId = handlerId;
    this.#redelivery = redelivery;
  }

  // --- what it consists of

  /**
   * Registers a handler. Throws a `ProgramError`: two handlers for one M code, or a declaration of what cannot be.
   * @param {Codes} codes @param {Handler} handler @param {HandlerOptions} [options]
   */
  on(codes, handler, { cs, validate, redelivery = this.#redelivery, name, params } = {}) {
    const numbers = numbersOf(codes);
    if (typeof handler !== "function") throw new ProgramError(`M${numbers[0]}: the handler is no function; write async (output, plc) => {}`);
    checkRedelivery(redelivery);
    const declared = new Declared(name, params);
    for (const m of numbers) {
      if (this.#handlers.has(place(cs, m))) throw new ProgramError(`M${m}${of(cs)} has two handlers`);
      this.#handlers.set(place(cs, m), { m, cs, call: handler, redelivery, declared });
    }
    if (validate !== undefined) this.validate(numbers, validate, { cs });
    return this;
  }

  /** Registers a check of parameters; it runs when a program is loaded. @param {Codes} codes @param {Check} check @param {{cs?: number | undefined}} [options] */
  validate(codes, check, { cs } = {}) {
    for (const m of numbersOf(codes)) {
      if (this.#checks.has(place(cs, m))) throw new ProgramError(`M${m}${of(cs)} is validated twice`);
      this.#checks.set(place(cs, m), { cs, m, check });
    }
    return this;
  }

  /**
   * Says what to do about alarms, and what they are in other languages; the machine shows it where one is raised. Its configuration may
   * say the same in `[alarm.N]`, which counts first. Throws a `ProgramError`: two different alarms have one code, or there are more
   * than 256.
   * @param {UserAlarm[]} alarms
   */
  alarms(...alarms) {
    for (const alarm of alarms) {
      const other = this.#alarms.get(alarm.code) ?? alarm;
      if (JSON.stringify(other) !== JSON.stringify(alarm)) {
        throw new ProgramError(`alarm ${alarm.code} has two texts: ${JSON.stringify(other.text)} and ${JSON.stringify(alarm.text)}`);
      }
      this.#alarms.set(alarm.code, alarm);
    }
    if (this.#alarms.size > ALARMS_MAX) throw new ProgramError(`${this.#alarms.size} alarms: write up to ${ALARMS_MAX}`);
    return this;
  }

  /**
   * Owns a source of the interlock, which holds motion: a door, the air pressure.
   * @param {number} cs @param {string} source its name, such as one of `[input.interlock.source.NAME]`
   * @param {string} text why it is on, in the operator's words @param {{value?: boolean}} [options] on until it is set
   */
  interlock(cs, source, text, { value = true } = {}) {
    return this.#addLevel(new Level({ cs, kind: "interlock", source }, text, value));
  }

  /** Owns a source of the start lock, which refuses starts; as `interlock`. @param {number} cs @param {string} source @param {string} text @param {{value?: boolean}} [options] */
  startLock(cs, source, text, { value = true } = {}) {
    return this.#addLevel(new Level({ cs, kind: "start_lock", source }, text, value));
  }

  /** @param {Level} level */
  #addLevel(level) {
    const { cs, kind, source } = level.place;
    const isThere = this.#levels.some(({ place: other }) => other.cs === cs && other.kind === kind && other.source === source);
    if (isThere) throw new ProgramError(`${kind} ${source} of coordinate system ${cs} stands twice`);
    this.#levels.push(level);
    return level;
  }

  /**
   * Registers what runs beside the handlers. It begins when the machine knows them, so that it may start a program, and runs through
   * losses of the connection. When it throws, the program ends with that.
   * @param {Task} task
   */
  task(task) {
    this.#tasks.push(task);
    return this;
  }

  /**
   * What it serves, as a file for `[machine] served` of a configuration: with it `tandem check`, `tandem explain` and editors know its M
   * codes without it. `await writeFile("served.json", program.served())`
   */
  served() {
    const entries = [...this.#handlers.values()].sort((one, other) => one.m - other.m || (one.cs ?? 0) - (other.cs ?? 0));
    const serves = entries.map(({ cs, m, declared }) => ({
      ...declared.toJson(m, undefined),
      cs: cs === undefined ? [] : [cs],
      handler_id: this.handlerId,
    }));
    return `${JSON.stringify({ serves }, null, 2)}\n`;
  }

  // --- what it does

  /**
   * Serves the machine at an address, through every loss of the connection, until the signal. Throws `TakenOver`, `AddressError`,
   * `ConnectError` (no machine is there within 10 s, or the broker refuses this client), `ProgramError`, or what a task has thrown.
   * @param {string} address as `Plc.connect` takes it
   * @param {ServeOptions & import("./connection.js").ConnectOptions & {signal?: AbortSignal}} [options]
   */
  async run(address, { signal, ...options } = {}) {
    const serving = await this.serve(address, options);
    const close = () => void serving.close();
    if (signal?.aborted) close();
    signal?.addEventListener("abort", close);
    try {
      await serving.ended;
    } finally {
      signal?.removeEventListener("abort", close);
      await serving.close();
    }
  }

  /**
   * Serves as `run` until a signal, and loses no work: as `Serving.leave`. `await program.runUntil("mqtt://127.0.0.1:1883/mill-1", stopSignal())`
   * @param {string} address as `Plc.connect` takes it @param {AbortSignal} stop such as `stopSignal()`
   * @param {ServeOptions & LeaveOptions & import("./connection.js").ConnectOptions} [options]
   */
  async runUntil(address, stop, { returnsWithinMs = RETURNS_WITHIN_MS, endsWithinMs, ...options } = {}) {
    checkReturnsWithin(returnsWithinMs);
    const serving = await this.serve(address, options);
    try {
      const stopped = new Bell();
      if (stop.aborted) stopped.ring();
      stop.addEventListener("abort", () => stopped.ring(), { once: true });
      await Promise.race([stopped.rung(), serving.ended]);
      await serving.leave({ returnsWithinMs, ...(endsWithinMs === undefined ? {} : { endsWithinMs }) });
    } finally {
      await serving.close();
    }
  }

  /**
   * Serves the machine from now on, when it knows the handlers; where it refuses them, `ended` of what this gives says why. Throws as
   * `run`.
   * @param {string} address @param {ServeOptions & import("./connection.js").ConnectOptions} [options]
   */
  async serve(address, { takeOver = false, ...options } = {}) {
    this.#look();
    const connection = new Connection(address, options, this.handlerId);
    const plc = new Plc(connection);
    const checks = new Map([...this.#checks].map(([at, { check }]) => [at, check]));
    const runner = new Runner(this.handlerId, this.#handlers, checks, [...this.#alarms.values()], plc, connection, takeOver);
    for (const level of this.#levels) level.follow(({ place: at, value, text }) => plc.levels.want(lockLevel(at, value, text)));
    await connection.start();
    const stopped = new AbortController();
    const announcing = runner.run();
    const jobs = [announcing, plc.levels.keepWritten()];
    await Promise.race([runner.announced.rung(), announcing]).catch(() => {});
    if (runner.announced.isRung) for (const task of this.#tasks) jobs.push(forever(task, plc, stopped.signal));
    const closed = new Bell();
    const ended = Promise.race([Promise.all(jobs), closed.rung()]).then(() => {});
    // whoever does not wait for it closes it
    ended.catch(() => {});
    /** @type {Promise<void> | null} */
    let closing = null;
    const close = async () => {
      stopped.abort();
      await runner.leave();
      await connection.stop();
      closed.ring();
    };
    return new Serving(plc, ended, runner, () => (closing ??= close()));
  }

  #look() {
    const handlers = [...this.#handlers.values()];
    for (const { cs, m } of this.#checks.values()) {
      const isServed = handlers.some((entry) => entry.m === m && (cs === undefined || entry.cs === undefined || entry.cs === cs));
      if (!isServed) throw new ProgramError(`M${m}${of(cs)} is validated and has no handler`);
    }
  }
}

/** @param {Task} task @param {Plc} plc @param {AbortSignal} signal */
async function forever(task, plc, signal) {
  try {
    await task(plc, signal);
  } catch (error) {
    // what it waited for has ended with the program
    if (!signal.aborted) throw error;
  }
}

/** Aborted by Ctrl-C, or by SIGTERM, by which systemd and others end a program; the next one ends it at once. @returns {AbortSignal} */
export function stopSignal() {
  const stop = new AbortController();
  const names = /** @type {const} */ (["SIGINT", "SIGTERM"]);
  const told = () => {
    for (const name of names) process.off(name, told);
    stop.abort();
  };
  for (const name of names) process.on(name, told);
  return stop.signal;
}

/** @param {Redelivery | undefined} redelivery */
function checkRedelivery(redelivery) {
  if (redelivery === undefined || REDELIVERIES.includes(redelivery)) return;
  throw new ProgramError(`redelivery ${JSON.stringify(redelivery)}: write ${REDELIVERIES.join(", ")}`);
}

/** @param {number | undefined} cs */
function of(cs) {
  return cs === undefined ? "" : ` in coordinate system ${cs}`;
}

/** @param {Codes} codes */
function numbersOf(codes) {
  const numbers = typeof codes === "number" ? [codes] : [...codes];
  for (const m of numbers) {
    if (!Number.isInteger(m) || m < 0 || m > M_CODE_MAX) throw new ProgramError(`M${m}: M codes are 0 to ${M_CODE_MAX}`);
    if (RUNTIME_M_CODES.includes(m)) throw new ProgramError(`M${m}: the runtime handles it itself, leave it out`);
  }
  if (numbers.length === 0) throw new ProgramError("no M code is named");
  return numbers;
}
