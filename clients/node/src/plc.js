// A machine: its coordinate systems, alarms, and variables.

import { ANSWER_TIMEOUT_MS, Connection } from "./connection.js";
import { CoordinateSystem } from "./coordinate_system.js";
import { RequestRefused } from "./errors.js";
import { Io } from "./io.js";
import { Levels } from "./levels.js";
import { NOT_AFTER_MS, PersonLevels, personConnection } from "./person.js";
import { changesOf, numberOf } from "./changes.js";

/** @typedef {import("./messages.d.ts").CommandReplyMessage} CommandReply */
/** @typedef {import("./messages.d.ts").AlarmRecord} AlarmRecord */
/** @typedef {import("./messages.d.ts").ToolData} ToolData */

/** One machine on a broker: `const plc = await Plc.connect("mqtt://127.0.0.1:1883/mill-1"); await
 * plc.cs(1).start()`. */
export class Plc {
  /** @internal */
  connection;
  /** @internal */
  levels;
  /** Numbers of the control leases of this connection, by coordinate system. @internal @type {Map<number, number>} */
  fences = new Map();
  /** Counters of commands, shared with a person's handle. */
  #ids = { commands: 0 };

  /** @param {Connection} connection */
  constructor(connection) {
    this.connection = connection;
    this.levels = new Levels(connection);
  }

  /**
   * Connects to a machine. If the address names several nodes, the first one that answers is used until it is lost. Throws an
   * `AddressError`, or a `ConnectError` if no broker answers, the broker refuses the user, or no machine of that name
   * is online.
   * @param {string} address `mqtt://[user:password@]host[:port][,host[:port]..]/[prefix/]machine`, `mqtts://` with TLS
   * @param {import("./connection.js").ConnectOptions} [options]
   */
  static async connect(address, options) {
    const connection = new Connection(address, options);
    await connection.start();
    return new Plc(connection);
  }

  /** Ends the connection. */
  async close() {
    await this.connection.stop();
  }

  /**
   * Returns a handle for a request that a person makes at this moment, such as by pressing a button. Requests of this
   * handle expire 1 s after the newest heartbeat that this connection has received: the machine then rejects them as
   * `expired`. Take a new handle for each press of a button. Sequence programs do not need such a handle, because an
   * output causes their requests.
   * Throws `NotConnected` if no heartbeat has been received.
   * @param {{withinMs?: number}} [options] at most 60,000
   */
  forPerson({ withinMs = NOT_AFTER_MS } = {}) {
    const connection = personConnection(this.connection, withinMs);
    const person = new Plc(connection);
    person.levels = /** @type {any} */ (new PersonLevels(connection));
    person.fences = this.fences;
    person.#ids = this.#ids;
    return person;
  }

  /**
   * Returns a coordinate system by its number, from 1. If it does not exist, each call on it fails.
   * @param {number} number
   */
  cs(number) {
    return new CoordinateSystem(this, number);
  }

  /** Returns an input of the plant by its name in the configuration (`[io.in.NAME]`). @param {string} name */
  ioIn(name) {
    return new Io(this, "in", name);
  }

  /** Returns an output of the plant by its name in the configuration (`[io.out.NAME]`). @param {string} name */
  ioOut(name) {
    return new Io(this, "out", name);
  }

  /** True while the machine can be reached. */
  get isConnected() {
    return this.connection.isConnected;
  }

  /** The boot of the runtime that is online; null while it is offline. */
  get bootId() {
    return this.connection.bootId;
  }

  /** Description of the machine. @returns {import("./messages.d.ts").BirthMessage | undefined} */
  get birth() {
    return this.connection.hub.last("birth");
  }

  /**
   * Waits until the received messages satisfy a condition, such as `() => plc.cs(1).interlock.value`.
   * @param {() => boolean} holds @param {{signal?: AbortSignal}} [options]
   */
  async until(holds, { signal } = {}) {
    await this.connection.until(holds, signal);
  }

  /** Yields whether the runtime is online: now, and after each change. @returns {AsyncIterableIterator<import("./messages.d.ts").PresenceMessage>} */
  presences() {
    return this.connection.hub.follow("presence");
  }

  /** Alarms and warnings that are active, ascending by id. @returns {readonly AlarmRecord[]} */
  get alarms() {
    return this.connection.hub.last("alarm/active")?.alarms ?? [];
  }

  /** Yields each alarm that is raised, acknowledged or cleared. @returns {AsyncIterableIterator<AlarmRecord>} */
  alarmEvents() {
    return this.connection.hub.follow("alarm/event");
  }

  /**
   * Raises an alarm that belongs to no output, such as low air pressure; it stops one coordinate system or all.
   * @param {import("./errors.js").Alarm} alarm @param {{cs?: number}} [options]
   */
  async raiseAlarm({ code, text }, { cs } = {}) {
    await this.connection.request("alarm/raise", { code, text, ...(cs === undefined ? {} : { cs }) });
  }

  /**
   * Sets the skip input of a motor (G31). Not real time: the position is captured when the servo receives the message.
   * @param {number} motor @param {boolean} value
   */
  async setSkipInput(motor, value) {
    await this.connection.request(`motor/${motor}/skip_input/set`, { value });
  }

  /** Reads up to 1024 P variables, all from one moment. @param {number} first @param {number} [count] */
  async readP(first, count = 1) {
    return this.readVariables(1, "P", first, count);
  }

  /** Writes up to 1024 P variables, all or none. @param {number} first @param {readonly number[]} values */
  async writeP(first, values) {
    await this.writeVariables(1, "P", first, values);
  }

  /**
   * Yields P variables: their current values, then after each change by any writer. A machine publishes the variables
   * listed in `[[variables.published]]` of its configuration, at most 10 times a second; if values change faster,
   * only the latest. An NC program writes a variable when the block is interpreted, ahead of the motion. Throws
   * `RequestRefused` if not all of them are published.
   * @param {number} first @param {number} [count] @returns {AsyncGenerator<number[], void>}
   */
  pChanges(first, count = 1) {
    return changesOf(this, "variables", "P", first, count);
  }

  /** Yields the tool table, ascending by number: the current table, then each changed table. @returns {AsyncGenerator<ToolData[], void>} */
  async *toolChanges() {
    for await (const { tools } of this.connection.hub.follow("tools")) yield tools;
  }

  /** @internal @param {number} cs @param {"P" | "Q"} kind @param {number} first @param {number} count @returns {Promise<number[]>} */
  async readVariables(cs, kind, first, count) {
    const { variables } = await this.ask(`cs/${cs}/variable/get`, { kind, from: first, count });
    const values = variables?.values;
    if (!Array.isArray(values) || values.length !== count) throw new RequestRefused("unavailable", `the machine did not answer with ${count} values`);
    return values.map(numberOf);
  }

  /** @internal @param {number} cs @param {"P" | "Q"} kind @param {number} first @param {readonly number[]} values */
  async writeVariables(cs, kind, first, values) {
    const written = values.map((value) => (Number.isFinite(value) ? value : Number.isNaN(value) ? "NaN" : value > 0 ? "inf" : "-inf"));
    await this.ask(`cs/${cs}/variable/set`, { kind, from: first, values: written });
  }

  /**
   * Sends a command, and waits for its final reply.
   * @internal
   * @param {string} path @param {object} payload @param {{commandId?: string | undefined, timeoutMs?: number | undefined}} [options]
   * @returns {Promise<CommandReply>}
   */
  async ask(path, payload, { commandId, timeoutMs = ANSWER_TIMEOUT_MS } = {}) {
    const { clientId } = this.connection;
    this.#ids.commands += 1;
    const id = commandId ?? `${clientId}-${this.#ids.commands}`;
    return this.connection.request(path, { ...payload, command_id: id, client_id: clientId }, { commandId: id, timeoutMs });
  }
}
