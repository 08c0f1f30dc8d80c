// Inputs and outputs of the plant: sensor values, and the commands of sequence programs to actuators.

import { NotConnected, RequestRefused } from "./errors.js";

/** @typedef {import("./messages.d.ts").IoStateMessage} IoState */
/** @typedef {import("./messages.d.ts").IoValue} IoValue */

/** Maximum number of names in the text of a refusal. */
const NAMED_MAX = 20;

/** One input or output, by its name in the configuration: `plc.ioIn("door_closed")`, `plc.ioOut("lamp")`. */
export class Io {
  #plc;

  /** @param {import("./plc.js").Plc} plc @param {"in" | "out"} side @param {string} name */
  constructor(plc, side, name) {
    this.#plc = plc;
    this.side = side;
    this.name = name;
  }

  /** Topic of the input or output, below the machine's root. */
  get path() {
    return `io/${this.side}/${this.name}`;
  }

  /**
   * State: the value, the owner, and whether the value is forced. Throws `RequestRefused` if the configuration does not
   * declare the input or output, or the machine has not published it yet.
   * @returns {IoState}
   */
  get state() {
    const state = this.#latestState();
    if (state !== undefined) return state;
    this.#check();
    throw new RequestRefused("not_found", `${this.path}: the machine has not published its state yet`);
  }

  /** Current value: the forced value, otherwise the value that the owner has written, otherwise the safe value. @returns {IoValue} */
  get value() {
    return this.state.value;
  }

  /**
   * Yields the current value, then each changed value, until the connection ends.
   * @returns {AsyncGenerator<IoValue, void>}
   */
  async *values() {
    /** @type {IoValue | undefined} */
    let last;
    for await (const { value } of this.#plc.connection.hub.follow(this.path)) {
      if (value === last) continue;
      last = value;
      yield value;
    }
  }

  /**
   * Waits for a value for which `fits` is true, such as `(value) => value > 12.5`, and returns it; by default until the
   * value is on.
   * @param {(value: IoValue) => boolean} [fits] @param {{signal?: AbortSignal}} [options] @returns {Promise<IoValue>}
   */
  async waitUntil(fits = (value) => value === true, { signal } = {}) {
    this.#check();
    const { hub } = this.#plc.connection;
    const found = await hub.find(this.path, (/** @type {IoState} */ { value }) => (fits(value) ? value : undefined), signal);
    if (found === undefined) throw new NotConnected("the connection was closed here");
    return found;
  }

  /**
   * Writes a value. A program that serves the machine owns each output that it writes: the value is written again on
   * each connection and at each boot, and no other client writes it while the program is online. After that the output
   * gets its safe value. If the machine is offline, the program waits for it. A client without handlers writes outputs that no
   * handler owns.
   *
   * Throws `RequestRefused` if the output is not declared, the value has the wrong kind or range, or another handler owns
   * the output.
   * @param {IoValue} value
   */
  async set(value) {
    this.#check(value);
    if (this.#plc.isConnected) this.#checkOwner();
    await this.#plc.levels.set({ name: this.path, topic: `${this.path}/set`, payload: { value } });
  }

  /** Replaces the written value, as an operator does, until `release`. @param {IoValue} value */
  async force(value) {
    this.#check(value);
    await this.#sendForce(value);
  }

  /** Removes the forced value: the value that the owner has written applies again. */
  async release() {
    this.#check();
    await this.#sendForce(null);
  }

  /** @param {IoValue | null} value */
  async #sendForce(value) {
    const { connection, levels } = this.#plc;
    await connection.request(`${this.path}/force`, { value, by: levels.owner ?? connection.clientId });
  }

  /** @returns {IoState | undefined} */
  #latestState() {
    return this.#plc.connection.hub.last(this.path);
  }

  /**
   * Validates a write against the machine's messages, because the broker does not report a refused write.
   * @param {IoValue} [value]
   */
  #check(value) {
    const { birth } = this.#plc;
    if (birth === undefined) return;
    const declared = birth.io?.[this.side] ?? {};
    const own = Object.hasOwn(declared, this.name) ? declared[this.name] : undefined;
    if (own === undefined) {
      const there = Object.keys(declared).slice(0, NAMED_MAX).join(", ") || "none";
      throw new RequestRefused("not_found", `the configuration has no [io.${this.side}.${this.name}]; there are ${there}`);
    }
    const wrong = value === undefined ? null : whatIsWrong(own, value);
    if (wrong !== null) throw new RequestRefused("invalid", `${this.path}: ${wrong}`);
  }

  #checkOwner() {
    const state = this.#latestState();
    const { owner } = this.#plc.levels;
    if (state === undefined || state.owner === null || state.owner === owner || (state.lost && owner !== null)) return;
    const whose = state.lost ? `it waits for handler ${state.owner}` : `handler ${state.owner} owns it`;
    throw new RequestRefused("not_allowed", `${this.path}: ${whose}; an operator can force a value`);
  }
}

/**
 * Returns why the input or output cannot have a value; null if it can.
 * @param {import("./messages.d.ts").IoDeclaration} declared @param {IoValue} value
 */
function whatIsWrong({ kind, min = -Infinity, max = Infinity }, value) {
  if (kind === "bool") return typeof value === "boolean" ? null : `${value}: write true or false`;
  if (typeof value !== "number" || !Number.isFinite(value)) return `${value}: write a finite number`;
  return min <= value && value <= max ? null : `${value}: write ${min} to ${max}`;
}
