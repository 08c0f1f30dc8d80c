// A sequence program: handlers by M code, and its alarms, locks and tasks.

import { ALARMS_MAX } from "./alarms.js";
import { Bell } from "./bell.js";
import { Connection } from "./connection.js";
import { ProgramError } from "./errors.js";
import { MCodeDeclaration } from "./m_code_declaration.js";
import { Plc } from "./plc.js";
import { lockLevel } from "./levels.js";
import { checkReturnsWithin, handlerKey, RETURNS_WITHIN_MS, Runner } from "./runner.js";

const M_CODE_MAX = 191;
/** M codes that the runtime handles itself; they never reach a handler. */
const RUNTIME_M_CODES = [0, 1, 2, 30, 98, 99];
const REDELIVERIES = ["ask", "redo", "verify"];

/** @typedef {import("./output.js").Output} Output */
/** @typedef {import("./params.js").Params} Params */
/** @typedef {import("./levels.js").LockTarget} LockTarget */
/** @typedef {import("./messages.d.ts").Redelivery} Redelivery */
/** @typedef {import("./alarms.js").UserAlarm} UserAlarm */

/** M numbers: `6`, or `[20, 21]`. @typedef {number | Iterable<number>} Codes */

/** The NC program waits until it returns. @callback Handler @param {Output} output @param {Plc} plc @returns {unknown} */

/** Throws an `Alarm` for invalid parameters; its return value is ignored. @callback Check @param {Params} params @returns {unknown} */

/**
 * Runs in parallel to the handlers until the signal is aborted.
 * @callback Task @param {Plc} plc @param {AbortSignal} signal @returns {unknown}
 */

/**
 * @typedef {object} HandlerOptions
 * @property {number} [cs] the coordinate system; by default all that have no separate handler for the M code
 * @property {Check} [validate] checks parameters when an NC program is loaded; if it throws an `Alarm`, the program is not loaded
 * @property {Redelivery} [redelivery] treatment of outputs on which this program may have worked before it was lost: `ask`
 * (an operator decides), `redo` (the handler runs again), `verify` (it runs with `output.redelivered` true); by
 * default, the setting of the program
 * @property {string} [name] function of the M codes, such as "clamp", for alarms and panels
 * @property {Partial<Record<import("./params.js").Letter, import("./m_code_declaration.js").Param>>} [params] their
 * parameters, such as `{ A: { name: "force", unit: "kN", min: 1, max: 20 } }`. A program with other parameters is not
 * loaded, and the handler is not started with them. `{}`: no parameters
 */

/**
 * @typedef {object} ServeOptions
 * @property {boolean} [takeOver] replace another process of the same name, which ends; by default this process is refused
 */

/**
 * @typedef {object} LeaveOptions
 * @property {number} [returnsWithinMs] time within which the program returns, up to 1 h, 1 minute by default; 0: it
 * does not return
 * @property {number} [endsWithinMs] time limit for running handlers, none by default. After it, the signals of running
 * handlers are aborted and their outputs are lost: `redelivery` decides how they are treated
 */

/** A source of an interlock or start lock that belongs to the program. */
export class Level {
  #changed = (/** @type {Level} */ _level) => {};

  /** @param {LockTarget} at @param {string} text @param {boolean} value */
  constructor(at, text, value) {
    this.place = at;
    this.text = text;
    this.value = value;
  }

  /**
   * Sets the level. It is sent once the machine is connected, and again on each connection and at each boot.
   * @param {boolean} value @param {string} [text]
   */
  set(value, text = this.text) {
    this.value = value;
    this.text = text;
    this.#changed(this);
  }

  /** Calls a function with the current level and each later level. @internal @param {(level: Level) => void} changed */
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
    /** Resolves when this is closed; rejects when a task of the program fails, or the machine refuses the program. */
    this.ended = ended;
    this.#runner = runner;
    this.#close = close;
  }

  /**
   * Accepts no further output, and closes when all running handlers have ended. Tasks run until then. The machine is
   * notified that the program will return. Until the return its M codes are treated as served, and NC programs wait at
   * them. Throws the error that ended the program in the meantime.
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

  /** Ends all handlers, notifies the machine that they are offline, and ends the connection. */
  async close() {
    await this.#close();
  }
}

/**
 * A sequence program: serves M codes of a machine under one name:
 * `new SequenceProgram("changer").on(6, async (output, plc) => { .. }).run("mqtt://127.0.0.1:1883/mill-1")`.
 *
 * If a handler returns, its output is reset and the NC program continues. If it throws an `Alarm`, the NC program stops
 * with the text of the alarm; any other exception also stops it with an alarm.
 */
export class SequenceProgram {
  /** @type {Map<string, import("./runner.js").HandlerEntry>} */
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
   * @param {string} handlerId 1 to 64 characters without `/ + #`, always the same, so that the machine recognizes it
   * @param {{redelivery?: Redelivery}} [options] treatment of outputs on which this program may have worked
   * before it was lost, unless `on` sets it. The stricter of this and the machine's configuration applies; if neither is set, an
   * operator decides
   */
  constructor(handlerId, { redelivery } = {}) {
    if (!/^[^/+#\0]{1,64}$/s.test(handlerId)) {
      throw new ProgramError(`handler id ${JSON.stringify(handlerId)}: write 1 to 64 characters without / + #`);
    }
    checkRedelivery(redelivery);
    this.handlerId = handlerId;
    this.#redelivery = redelivery;
  }

  // --- declarations

  /**
   * Registers a handler. Throws a `ProgramError` for two handlers of one M code, or an invalid declaration.
   * @param {Codes} codes @param {Handler} handler @param {HandlerOptions} [options]
   */
  on(codes, handler, { cs, validate, redelivery = this.#redelivery, name, params } = {}) {
    const numbers = numbersOf(codes);
    if (typeof handler !== "function") throw new ProgramError(`M${numbers[0]}: the handler is not a function; write async (output, plc) => {}`);
    checkRedelivery(redelivery);
    const declared = new MCodeDeclaration(name, params);
    for (const m of numbers) {
      if (this.#handlers.has(handlerKey(cs, m))) throw new ProgramError(`M${m}${of(cs)} has two handlers`);
      this.#handlers.set(handlerKey(cs, m), { m, cs, call: handler, redelivery, declared });
    }
    if (validate !== undefined) this.validate(numbers, validate, { cs });
    return this;
  }

  /** Registers a check of parameters; it runs when a program is loaded. @param {Codes} codes @param {Check} check @param {{cs?: number | undefined}} [options] */
  validate(codes, check, { cs } = {}) {
    for (const m of numbersOf(codes)) {
      if (this.#checks.has(handlerKey(cs, m))) throw new ProgramError(`M${m}${of(cs)} is validated twice`);
      this.#checks.set(handlerKey(cs, m), { cs, m, check });
    }
    return this;
  }

  /**
   * Declares remedies and translations of alarms; the machine shows them when an alarm is raised. `[alarm.N]` of the
   * machine's configuration takes precedence. Throws a `ProgramError` if two different alarms have one code, or there
   * are more than 256.
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
   * Owns a source of the interlock, which holds motion, such as a door or the air pressure.
   * @param {number} cs @param {string} source name of the source, such as one that `[input.interlock.source.NAME]` declares
   * @param {string} text the reason for the operator @param {{value?: boolean}} [options] level until the program sets it; on by default
   */
  interlock(cs, source, text, { value = true } = {}) {
    return this.#addLevel(new Level({ cs, kind: "interlock", source }, text, value));
  }

  /**
   * Owns a source of the start lock, which refuses starts; see `interlock`.
   * @param {number} cs @param {string} source @param {string} text @param {{value?: boolean}} [options]
   */
  startLock(cs, source, text, { value = true } = {}) {
    return this.#addLevel(new Level({ cs, kind: "start_lock", source }, text, value));
  }

  /** @param {Level} level */
  #addLevel(level) {
    const { cs, kind, source } = level.place;
    const isThere = this.#levels.some(({ place: other }) => other.cs === cs && other.kind === kind && other.source === source);
    if (isThere) throw new ProgramError(`${kind} ${source} of coordinate system ${cs} is declared twice`);
    this.#levels.push(level);
    return level;
  }

  /**
   * Registers a task that runs in parallel to the handlers. The task begins after the machine has accepted the handlers,
   * so that it may start a program, and continues after losses of the connection. If it throws, the program ends with that
   * error.
   * @param {Task} task
   */
  task(task) {
    this.#tasks.push(task);
    return this;
  }

  /**
   * Returns the declarations of the program as a file for `[machine] served` of a configuration, so that `tandem check`,
   * `tandem explain` and editors know the M codes while the program does not run:
   * `await writeFile("served.json", program.served())`.
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

  // --- running

  /**
   * Serves the machine at an address, across all losses of the connection, until the signal is aborted. Throws
   * `TakenOver`, `AddressError`, `ConnectError` (no machine online within 10 s, or the broker refuses this client),
   * `ProgramError`, or the error of a task.
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
   * Serves like `run` until a signal, without losing work; see `Serving.leave`.
   * `await program.runUntil("mqtt://127.0.0.1:1883/mill-1", stopSignal())`
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
   * Serves the machine, and returns once it has accepted or refused the handlers; after a refusal, `ended` of the
   * result rejects with the reason. Throws like `run`.
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
    // a caller that does not await `ended` calls `close`
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
    // the task stopped waiting because the program ended
    if (!signal.aborted) throw error;
  }
}

/**
 * Returns a signal that Ctrl-C or SIGTERM (such as from systemd) aborts; the next such signal ends the process at once.
 * @returns {AbortSignal}
 */
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
    if (RUNTIME_M_CODES.includes(m)) throw new ProgramError(`M${m}: the runtime handles this M code itself; remove it`);
  }
  if (numbers.length === 0) throw new ProgramError("no M code is named");
  return numbers;
}
