// A simulated machine for tests: the command `tandem` as a process, on free ports, in a folder of its own.

import { spawn } from "node:child_process";
import { once } from "node:events";
import { mkdtemp, rm, writeFile } from "node:fs/promises";
import { tmpdir } from "node:os";
import { join, resolve } from "node:path";
import { createInterface } from "node:readline";
import { setTimeout as delay } from "node:timers/promises";

import { RequestRefused } from "./errors.js";

/** X, Y and Z in one coordinate system, without a spindle. */
export const DEFAULT_CONFIG = `
[machine]
name = "mill-1"
${[1, 2, 3]
  .map((number) => `
[[motor]]
number = ${number}
kind = "linear"
max_velocity = 500.0
max_acceleration = 5000.0
`)
  .join("")}
[[coordinate_system]]
number = 1
axes = { X = 1, Y = 2, Z = 3 }
max_feedrate = 30000.0
`;

const FREE_PORTS = '\n[http]\nlisten = "127.0.0.1:0"\n\n[mqtt]\nlisten = "127.0.0.1:0"\n';
const START_TIMEOUT_MS = 20_000;
const END_TIMEOUT_MS = 5_000;
const WAIT_TIMEOUT_MS = 20_000;
const RUN_TIMEOUT_MS = 60_000;
const REST_TIMEOUT_MS = 30_000;
const POLL_MS = 10;
const SAID_MAX = 100_000;
/** Number under which `run` stores its text; the number of the coordinate system is added. */
const PROGRAM = 9_000;

/** @typedef {import("./messages.d.ts").StateMessage} State */

/**
 * A run that has ended.
 * @typedef {object} EndedProgram
 * @property {boolean} completed true if the program has reached its end
 * @property {string} execution `PROGRAM_COMPLETED` or `STOPPED`
 * @property {string | null} reason
 * @property {string[]} alarms texts of the active alarms at its end
 */

/** A running machine: `const machine = await Machine.start(); .. await machine.close()`. */
export class Machine {
  /** `http://host:port` */
  http = "";
  /** `mqtt://host:port/machine`, as `SequenceProgram.run` takes it. */
  mqtt = "";
  #folder;
  /** @type {import("node:child_process").ChildProcess | null} */
  #process = null;

  /** @private @param {string} folder */
  constructor(folder) {
    this.#folder = folder;
  }

  /**
   * Starts `tandem serve`: the command in `TANDEM_BIN`, else `tandem` in PATH. If the command does not start, throws with
   * its output.
   * @param {{config?: string}} [options] a configuration; free ports are added if it sets no ports
   */
  static async start({ config = DEFAULT_CONFIG } = {}) {
    const machine = new Machine(await mkdtemp(join(tmpdir(), "tandem-")));
    try {
      const hasPorts = config.includes("[mqtt]") || config.includes("[http]");
      await writeFile(machine.#config, hasPorts ? config : config + FREE_PORTS);
      await machine.startAgain();
    } catch (error) {
      await machine.close();
      throw error;
    }
    return machine;
  }

  get #config() {
    return join(this.#folder, "tandem.toml");
  }

  // --- life

  /** Starts the process after `kill`; free ports are chosen again. */
  async startAgain() {
    const { TANDEM_BIN: named } = process.env;
    const command = named ? resolve(named) : "tandem";
    const child = spawn(command, ["serve", "--config", this.#config], { cwd: this.#folder, stdio: ["ignore", "pipe", "pipe"] });
    this.#process = child;
    let said = "";
    child.stderr.on("data", (text) => {
      if (said.length < SAID_MAX) said += text;
    });
    const failed = new Promise((_, reject) => {
      child.once("error", (error) => reject(new Error(`${command} does not start (${error.message}); install it, or set TANDEM_BIN to the built command`)));
      child.once("exit", () => reject(new Error(`tandem serve has not started:\n${said}`)));
    });
    const watchdog = setTimeout(() => child.kill("SIGKILL"), START_TIMEOUT_MS);
    try {
      await Promise.race([this.#readAddresses(child.stdout), failed]);
    } finally {
      clearTimeout(watchdog);
      failed.catch(() => {});
    }
  }

  /** @param {import("node:stream").Readable} output */
  async #readAddresses(output) {
    const lines = createInterface({ input: output });
    this.http = "";
    this.mqtt = "";
    await new Promise((/** @type {(_: void) => void} */ known) => {
      lines.on("line", (line) => {
        const [title = ""] = line.trim().split(/\s/);
        if (title === "REST") this.http = /http\S+?(?=\/api\/)/.exec(line)?.[0] ?? "";
        const [, broker, machine] = /(mqtt:\S+).*tandem\/v1\/(\S+)\/#/.exec(title === "MQTT" ? line : "") ?? [];
        if (broker !== undefined) this.mqtt = `${broker}/${machine}`;
        if (this.http !== "" && this.mqtt !== "") known();
      });
    });
  }

  /** Ends the process at once, as a power cut does; its data stays. */
  async kill() {
    await this.#end("SIGKILL");
  }

  /** Ends the machine, and deletes its data. */
  async close() {
    await this.#end("SIGTERM");
    await rm(this.#folder, { recursive: true, force: true });
  }

  /** @param {NodeJS.Signals} signal */
  async #end(signal) {
    const child = this.#process;
    this.#process = null;
    if (child === null || child.pid === undefined || child.exitCode !== null || child.signalCode !== null) return;
    const ended = once(child, "exit");
    child.kill(signal);
    const force = setTimeout(() => child.kill("SIGKILL"), END_TIMEOUT_MS);
    await ended;
    clearTimeout(force);
  }

  // --- programs

  /** Stores NC text, and loads it; throws `RequestRefused` with the line if the text has errors. @param {string} text @param {{cs?: number}} [options] */
  async load(text, { cs = 1 } = {}) {
    await this.rest("PUT", `/programs/${PROGRAM + cs}`, text);
    await this.rest("POST", `/cs/${cs}/load?wait=1`, { program: PROGRAM + cs });
  }

  /**
   * Starts the loaded program, and returns while it runs: call the result to wait for its end.
   * @param {{cs?: number}} [options] @returns {Promise<() => Promise<EndedProgram>>}
   */
  async started({ cs = 1 } = {}) {
    const { command_id: id } = await this.rest("POST", `/cs/${cs}/start?wait=1`);
    const { run_id: run } = await this.waitFor((state) => state.last_command_id === id, { cs });
    return async () => {
      const isOver = (/** @type {State} */ state) => ["PROGRAM_COMPLETED", "STOPPED"].includes(state.execution) || state.run_id !== run;
      const { execution, reason } = await this.waitFor(isOver, { cs, timeoutMs: RUN_TIMEOUT_MS });
      const { alarms } = await this.rest("GET", "/alarms");
      const texts = alarms.filter((/** @type {any} */ { severity }) => severity === "alarm").map((/** @type {any} */ { text }) => text);
      return { completed: execution === "PROGRAM_COMPLETED", execution, reason, alarms: texts };
    };
  }

  /** Stores NC text, loads it, starts it, and waits until it has ended. @param {string} text @param {{cs?: number}} [options] */
  async run(text, options) {
    await this.load(text, options);
    const end = await this.started(options);
    return end();
  }

  // --- actions and views of an operator

  /** State of a coordinate system. @param {number} [cs] @returns {Promise<State>} */
  async state(cs = 1) {
    return this.rest("GET", `/cs/${cs}/state`);
  }

  /**
   * Waits for a state for which `fits` is true, and returns it; throws with the last state after the time limit.
   * @param {(state: State) => boolean} fits @param {{cs?: number, timeoutMs?: number}} [options]
   */
  async waitFor(fits, { cs = 1, timeoutMs = WAIT_TIMEOUT_MS } = {}) {
    const end = performance.now() + timeoutMs;
    for (;;) {
      const state = await this.state(cs);
      if (fits(state)) return state;
      if (performance.now() > end) throw new Error(`not within ${timeoutMs / 1000} s; the last state is ${JSON.stringify(state)}`);
      await delay(POLL_MS);
    }
  }

  /** Waits for a question, answers it, and returns its text. @param {string} choice @param {{cs?: number}} [options] */
  async answer(choice, { cs = 1 } = {}) {
    const { boot_id: boot, waiting_on: waiting } = await this.waitFor((state) => isOpen(state.waiting_on?.question), { cs });
    const question = waiting?.question;
    await this.rest("POST", `/cs/${cs}/m_codes/${waiting?.seq}/answer`, { boot_id: boot, question_id: question?.id, choice });
    return question?.text ?? "";
  }

  /** Returns the machine's journal, up to its last 1000 lines. @returns {Promise<any[]>} */
  async journal() {
    return (await this.rest("GET", "/journal?count=1000")).lines;
  }

  /**
   * Sends a request below `/api/v1`: a text unchanged, anything else as JSON; returns the JSON of the answer. Throws
   * `RequestRefused`.
   * @param {string} method @param {string} path @param {unknown} [body] @returns {Promise<any>}
   */
  async rest(method, path, body) {
    const type = typeof body === "string" ? "text/plain" : "application/json";
    const content = body === undefined ? {} : { body: typeof body === "string" ? body : JSON.stringify(body) };
    const signal = AbortSignal.timeout(REST_TIMEOUT_MS);
    const answer = await fetch(`${this.http}/api/v1${path}`, { method, headers: { "Content-Type": type }, signal, ...content });
    const said = await answer.text();
    if (!answer.ok) throw refusal(answer.status, said);
    return said === "" ? undefined : JSON.parse(said);
  }
}

/** @param {import("./messages.d.ts").Question | undefined} question */
function isOpen(question) {
  return question !== undefined && question.answer === undefined;
}

/** @param {number} status @param {string} said */
function refusal(status, said) {
  try {
    const { code, detail, diagnostics = [] } = JSON.parse(said);
    const found = diagnostics.map((/** @type {any} */ one) => `line ${one.line}: ${one.code} ${one.message}`);
    return new RequestRefused(code, [detail, ...found].join("; "));
  } catch {
    return new RequestRefused(String(status), said);
  }
}
