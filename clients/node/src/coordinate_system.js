// One coordinate system of a machine: commands, inputs and readings.

import { CommandFailed, NotConnected, RequestRefused } from "./errors.js";
import { lockLevel } from "./levels.js";
import { changesOf } from "./changes.js";

/** Time limit of a command that does not move axes. */
const COMMAND_TIMEOUT_MS = 5_000;
const MDI_TIMEOUT_MS = 3_600_000;
const MOTION_TIMEOUT_MS = 600_000;

/**
 * @typedef {object} CommandOptions
 * @property {string} [commandId] names the command: a command repeated with the id of a `NoAnswer` is not executed
 * twice
 * @property {number} [timeoutMs] time limit for its effect
 */

/** @typedef {import("./messages.d.ts").StateMessage} State */
/** @typedef {import("./messages.d.ts").PendingOutput} PendingOutput */
/** @typedef {import("./messages.d.ts").CommandReplyMessage} CommandReply */

/**
 * One coordinate system of a machine. Commands return after their effect. All throw `RequestRefused` (nothing has
 * changed), `CommandFailed` (the command was accepted, but could not take effect), `NotConnected` (nothing was sent) or
 * `NoAnswer` (the effect is unknown).
 */
export class CoordinateSystem {
  #plc;

  /** @param {import("./plc.js").Plc} plc @param {number} number */
  constructor(plc, number) {
    this.#plc = plc;
    this.number = number;
  }

  // --- commands

  /** Loads a program of the store, 1 to 9999: READY. @param {number} program @param {CommandOptions} [options] */
  async load(program, options) {
    return this.command("load", { program }, options);
  }

  /** Starts the loaded program at line 1: ACTIVE. @param {CommandOptions} [options] */
  async start(options) {
    return this.command("start", {}, options);
  }

  /** Feed hold: FEED_HOLD once the axes are stationary. @param {CommandOptions} [options] */
  async hold(options) {
    return this.command("hold", {}, options);
  }

  /** Resumes after a pause. @param {CommandOptions} [options] */
  async resume(options) {
    return this.command("resume", {}, options);
  }

  /** Decelerates on the path and ends the run; pending outputs are cancelled. @param {CommandOptions} [options] */
  async stop(options) {
    return this.command("stop", {}, options);
  }

  /** Brakes each motor at once and ends the run; pending outputs are cancelled. @param {CommandOptions} [options] */
  async abort(options) {
    return this.command("abort", {}, options);
  }

  /** Ends the run, cancels pending outputs, and clears alarms. @param {CommandOptions} [options] */
  async reset(options) {
    return this.command("reset", {}, options);
  }

  /** Moves back along the passed path in a feed hold with G500, or forward again. @param {boolean} on @param {CommandOptions} [options] */
  async backTrace(on, options) {
    return this.command("back_trace", { on }, options);
  }

  /**
   * Runs lines of NC text to their end, then READY; 1 h is the limit.
   * @param {string} text
   * @param {CommandOptions & {macro?: boolean}} [options] macro: for a text that a program generates. It starts
   * with the configured unit and absolute positions (G90) in force. At its end, also after an alarm or a stop, the machine
   * restores the modal state, the feedrate and the selected offsets that were in force before
   */
  async mdi(text, { macro = false, ...options } = {}) {
    return this.command("mdi", macro ? { text, macro } : { text }, { timeoutMs: MDI_TIMEOUT_MS, ...options });
  }

  /**
   * Moves axes to their first reference points, then READY; without names, all axes.
   * @param {string[]} [axes] @param {CommandOptions} [options]
   */
  async home(axes = [], options = {}) {
    return this.command("home", axes.length > 0 ? { axes } : {}, { timeoutMs: MOTION_TIMEOUT_MS, ...options });
  }

  /**
   * Jogs one axis as long as this is called again with the same `refreshId` at least every 200 ms. The first call returns when the jog
   * has ended, the others at once. A distance up to `jog_step_max` of `[hmi]` (10 by default) needs one call only. A
   * `CommandFailed` contains the distance covered if the motion ended before the whole distance.
   * @param {string} axis letter of the axis @param {number} velocity mm/min or deg/min; the sign is the direction
   * @param {string} refreshId names the jog, 1 to 128 characters
   * @param {CommandOptions & {distance?: number}} [options] distance: length of the motion, mm or degrees; by default up to the soft limit
   */
  async jog(axis, velocity, refreshId, { distance, ...options } = {}) {
    const way = distance === undefined ? {} : { distance };
    return this.command("jog", { axis, velocity, refresh_id: refreshId, ...way }, { timeoutMs: MOTION_TIMEOUT_MS, ...options });
  }

  /** Ends the jog of this `refreshId` at once, and returns when the axis rests. @param {string} refreshId @param {CommandOptions} [options] */
  async jogEnd(refreshId, options) {
    return this.command("jog", { refresh_id: refreshId, end: true }, options);
  }

  /**
   * Records that a user has seen an alarm, with the name of the user; the alarm stays active until a reset.
   * @param {number} id @param {CommandOptions} [options]
   */
  async acknowledgeAlarm(id, options) {
    return this.command("alarm_acknowledge", { id }, options);
  }

  /**
   * Executes a command by its verb and arguments, and returns after its effect.
   * @param {import("./messages.d.ts").Verb} verb @param {object} [args] @param {CommandOptions} [options]
   */
  async command(verb, args = {}, { commandId, timeoutMs = COMMAND_TIMEOUT_MS } = {}) {
    const given = Object.keys(args).length > 0 ? { args } : {};
    const reply = await this.#plc.ask(`cs/${this.number}/command/${verb}`, { ...given, ...this.#fence() }, { commandId, timeoutMs });
    if (reply.status === "failed") throw new CommandFailed(verb, reply.code, reply.text, reply.moved);
    return reply;
  }

  /**
   * Loads a program if one is given, and runs it once for each part; returns the run. Each further part begins only
   * after PROGRAM_COMPLETED; the interlock and the start lock delay it.
   * @param {number | null} [program] null: the loaded program @param {{parts?: number} & CommandOptions} [options]
   */
  async run(program = null, { parts = 1, ...options } = {}) {
    const reply = await this.command("run", program === null ? { parts } : { program, parts }, options);
    return new Run(this.#plc, this.number, reply.run_id ?? "");
  }

  // --- the control lease

  /**
   * Takes or renews the control lease: until it ends, only commands of this connection start motion. Throws
   * `RequestRefused` while another client holds it. Returns the number of the lease, which this connection sends with
   * each of its commands.
   * @param {string} holder @param {{ttlMs?: number}} [options]
   */
  async takeLease(holder, { ttlMs = 5_000 } = {}) {
    const { lease } = await this.#plc.ask(`cs/${this.number}/lease/take`, { holder, ttl_ms: ttlMs, ...this.#fence() });
    if (lease === undefined) throw new RequestRefused("unavailable", "the answer of the machine does not contain the lease");
    this.#plc.fences.set(this.number, lease.fence);
    return lease.fence;
  }

  /** Releases the control lease; no effect if this connection has no lease. */
  async releaseLease() {
    const fence = this.#fence();
    this.#plc.fences.delete(this.number);
    if ("fence" in fence) await this.#plc.ask(`cs/${this.number}/lease/release`, fence);
  }

  #fence() {
    const fence = this.#plc.fences.get(this.number);
    return fence === undefined ? {} : { fence };
  }

  // --- inputs

  /** Sets one optional block skip input, 1 to 31. @param {number} number @param {boolean} value */
  async setOptionalSkip(number, value) {
    await this.#set("input/optional_skip/set", { set: { [number]: value } });
  }

  /** Sets the optional stop input (M01). @param {boolean} value */
  async setOptionalStop(value) {
    await this.#set("input/optional_stop/set", { value });
  }

  /** Sets single block: after each block the axes stop until a resume. @param {boolean} value */
  async setSingleBlock(value) {
    await this.#set("input/single_block/set", { value });
  }

  /** Sets dry run: blocks move at the dry run feedrate instead of F. @param {boolean} value */
  async setDryRun(value) {
    await this.#set("input/dry_run/set", { value });
  }

  /**
   * Sets a source of the interlock: while any source is on, no motion runs or starts; the text is the reason. A
   * program that serves the machine owns its sources: they are written again on each connection and at each boot, and
   * no other client can clear them. If the machine is offline, the program waits for it. Throws `RequestRefused` if
   * another handler owns the source.
   * @param {boolean} value @param {string} [text] @param {{source?: string}} [options]
   */
  async setInterlock(value, text = "", { source = "default" } = {}) {
    await this.#plc.levels.set(lockLevel({ cs: this.number, kind: "interlock", source }, value, text));
  }

  /**
   * Sets a source of the start lock, as `setInterlock`: while any source is on, no program starts.
   * @param {boolean} value @param {string} [text] @param {{source?: string}} [options]
   */
  async setStartLock(value, text = "", { source = "default" } = {}) {
    await this.#plc.levels.set(lockLevel({ cs: this.number, kind: "start_lock", source }, value, text));
  }

  /**
   * Sets overrides, percent: feed and spindle 0 to 200, rapid 0 to 100; omitted ones stay unchanged.
   * @param {{feed?: number, rapid?: number, spindle?: number}} percent
   */
  async setOverrides(percent) {
    await this.#set("override/set", percent);
  }

  /** Sets the number of the tool in the spindle; 0 means that the spindle is empty. @param {number} id */
  async selectTool(id) {
    await this.#set("tool/set", { id });
  }

  /** Commands the spindle; r/min with `cw` and `ccw`. @param {import("./messages.d.ts").SpindleDirection} direction @param {number} [rpm] */
  async setSpindle(direction, rpm) {
    await this.#set("spindle/set", rpm === undefined ? { direction } : { direction, rpm });
  }

  /**
   * Raises an alarm that stops this coordinate system and cancels its pending outputs.
   * @param {import("./errors.js").Alarm} alarm
   */
  async raiseAlarm(alarm) {
    await this.#plc.raiseAlarm(alarm, { cs: this.number });
  }

  /** Reads up to 1024 Q variables, all from one moment. @param {number} first @param {number} [count] */
  async readQ(first, count = 1) {
    return this.#plc.readVariables(this.number, "Q", first, count);
  }

  /** Writes up to 1024 Q variables, all or none. @param {number} first @param {readonly number[]} values */
  async writeQ(first, values) {
    await this.#plc.writeVariables(this.number, "Q", first, values);
  }

  /**
   * Answers the question of a pending output, as an operator does.
   * @param {PendingOutput} output @param {string} choice
   */
  async answer({ m, seq, question }, choice) {
    if (question === undefined) throw new RequestRefused("not_found", `M${m} has no question`);
    const { bootId, connection } = this.#plc;
    const answer = { boot_id: bootId, seq, question_id: question.id, choice, client_id: connection.clientId };
    await this.#set(`m_code/${m}/answer`, answer);
  }

  /** @param {string} path @param {object} payload */
  async #set(path, payload) {
    await this.#plc.connection.request(`cs/${this.number}/${path}`, payload);
  }

  // --- readings

  /** State word, reason, and the output for which the program waits. @returns {State} */
  get state() {
    return this.#last("state");
  }

  /** Positions of the last servo cycle, at most 0.1 s old. @returns {import("./messages.d.ts").PositionMessage} */
  get position() {
    return this.#last("position");
  }

  /** Positions captured by the last G31. @returns {import("./messages.d.ts").CapturedPositionsMessage} */
  get captured() {
    return this.#last("captured");
  }

  /** The tool in the spindle. @returns {import("./messages.d.ts").ToolMessage} */
  get tool() {
    return this.#last("tool/state");
  }

  /** Overrides, percent. @returns {import("./messages.d.ts").OverridesMessage} */
  get overrides() {
    return this.#last("override/state");
  }

  /** The interlock, and why it is on. @returns {import("./messages.d.ts").LockMessage} */
  get interlock() {
    return this.#last("input/interlock/state");
  }

  /** The start lock, and why it is on. @returns {import("./messages.d.ts").LockMessage} */
  get startLock() {
    return this.#last("input/start_lock/state");
  }

  /** Optional block skip inputs. @returns {import("./messages.d.ts").OptionalSkipMessage} */
  get optionalSkip() {
    return this.#last("input/optional_skip/state");
  }

  /** Pending outputs. @returns {readonly PendingOutput[]} */
  get pending() {
    return this.#last("m_code/pending").outputs;
  }

  /** Yields the current state, then each new state. @returns {AsyncIterableIterator<State>} */
  states() {
    return this.#plc.connection.hub.follow(`cs/${this.number}/state`);
  }

  /** Q variables, as `Plc.pChanges`. @param {number} first @param {number} [count] @returns {AsyncGenerator<number[], void>} */
  qChanges(first, count = 1) {
    return changesOf(this.#plc, `cs/${this.number}/variables`, "Q", first, count);
  }

  /**
   * Yields the work offsets `G54` to `G59`, each by axis letter, mm or degrees: the current offsets, then all
   * offsets after each change.
   * @returns {AsyncGenerator<Record<string, Record<string, number>>, void>}
   */
  async *workOffsetChanges() {
    for await (const { work_offsets: offsets } of this.#plc.connection.hub.follow(`cs/${this.number}/work_offsets`)) yield offsets;
  }

  /**
   * Waits for a state word, and returns that state.
   * @param {import("./messages.d.ts").Execution} execution @param {{signal?: AbortSignal}} [options]
   */
  async waitUntil(execution, options) {
    return this.waitFor((state) => state.execution === execution, options);
  }

  /**
   * Waits for a state for which `fits` is true, and returns it.
   * @param {(state: State) => boolean} fits @param {{signal?: AbortSignal}} [options] @returns {Promise<State>}
   */
  async waitFor(fits, { signal } = {}) {
    const { hub } = this.#plc.connection;
    const found = await hub.find(`cs/${this.number}/state`, (/** @type {State} */ state) => (fits(state) ? state : undefined), signal);
    if (found === undefined) throw new NotConnected("the connection was closed here");
    return found;
  }

  /** @param {string} name @returns {any} */
  #last(name) {
    const message = this.#plc.connection.hub.last(`cs/${this.number}/${name}`);
    if (message === undefined) throw new RequestRefused("not_found", `coordinate system ${this.number} does not exist, or has not published its ${name} yet`);
    return message;
  }
}

/** A run of a program, from its start. */
export class Run {
  #plc;
  #cs;

  /** @param {import("./plc.js").Plc} plc @param {number} cs @param {string} id */
  constructor(plc, cs, id) {
    this.#plc = plc;
    this.#cs = cs;
    /** Identifies the run permanently. */
    this.id = id;
  }

  /**
   * Waits until all parts are completed or the run ends for another reason; `end.how` of the result is the reason. Throws a
   * `CommandFailed` if a later run replaced this one before its end was received.
   * @param {{signal?: AbortSignal}} [options] @returns {Promise<EndedRun>}
   */
  async ended({ signal } = {}) {
    let isSeen = false;
    const look = (/** @type {import("./messages.d.ts").RunStateMessage} */ { run }) => {
      const isIt = run?.id === this.id;
      if (isSeen && !isIt) throw new CommandFailed("run", "lost", `run ${this.id} is no longer the current run`);
      isSeen ||= isIt;
      return run && isIt && run.end ? /** @type {EndedRun} */ (run) : undefined;
    };
    const ended = await this.#plc.connection.hub.find(`cs/${this.#cs}/run`, look, signal);
    if (ended === undefined) throw new NotConnected("the connection was closed here");
    return ended;
  }
}

/** @typedef {import("./messages.d.ts").Run & {end: import("./messages.d.ts").RunEnded}} EndedRun */
