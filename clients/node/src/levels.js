// Interlocks, start locks, inputs and outputs that a program has set: written again on each connection and at each
// boot.

import { Bell, sleep } from "./bell.js";
import { NoAnswer, NotConnected, OutputEnded, RequestRefused } from "./errors.js";

const RETRY_MS = 500;
const TIMEOUT_MS = 2_000;
/** Maximum number of sources, inputs and outputs that one program sets; a plant has up to 256 of each. */
export const LEVELS_MAX = 1_024;

/**
 * A source of a lock.
 * @typedef {{cs: number, kind: "interlock" | "start_lock", source: string}} LockTarget
 */

/**
 * A value to write: its name in the log, its topic, and its payload without the owner.
 * @typedef {{name: string, topic: string, payload: object}} Wanted
 */

/**
 * Returns the message that sets a source of a lock.
 * @param {LockTarget} target @param {boolean} value @param {string} text @returns {Wanted}
 */
export function lockLevel({ cs, kind, source }, value, text) {
  return { name: `${kind} ${source} of coordinate system ${cs}`, topic: `cs/${cs}/input/${kind}/set`, payload: { value, text, source } };
}

/** Values that the program has set, and their owner. */
export class Levels {
  #connection;
  /** @type {Map<string, Wanted>} */
  #wanted = new Map();
  /** @type {Set<string>} */
  #dirty = new Set();
  #announced = new Bell();
  #work = new Bell();
  /** The handler that owns the levels; it must be registered before they are written. @type {string | null} */
  owner = null;

  /** @param {import("./connection.js").Connection} connection */
  constructor(connection) {
    this.#connection = connection;
  }

  /**
   * Sets a level. Throws `RequestRefused`, for example if another handler owns it, and `NotConnected` or `NoAnswer`; a
   * program that serves the machine waits for a connection instead of these two.
   * @param {Wanted} wanted
   */
  async set(wanted) {
    const key = wanted.name;
    const before = this.#wanted.get(key);
    if (before === undefined && this.#wanted.size >= LEVELS_MAX) throw new RequestRefused("invalid", `one program sets at most ${LEVELS_MAX} levels`);
    this.#wanted.set(key, wanted);
    if (this.owner === null) return this.#write(key);
    const { stopped } = this.#connection;
    for (;;) {
      try {
        await this.#announced.rung({ signal: stopped });
        return await this.#write(key);
      } catch (error) {
        if (error instanceof RequestRefused || error instanceof OutputEnded) {
          if (before === undefined) this.#wanted.delete(key);
          else this.#wanted.set(key, before);
        }
        if (stopped.aborted || !isPassing(error)) throw error;
        this.#connection.log.warn(`${key} is not written yet: ${error.message}`);
        await sleep(RETRY_MS, stopped);
      }
    }
  }

  /** Sets a level without waiting; `keepWritten` writes it. @param {Wanted} wanted */
  want(wanted) {
    this.#wanted.set(wanted.name, wanted);
    this.#dirty.add(wanted.name);
    this.#work.ring();
  }

  /** Writes all values again after a new registration. @param {string} owner */
  onAnnounced(owner) {
    this.owner = owner;
    this.#announced.ring();
    for (const key of this.#wanted.keys()) this.#dirty.add(key);
    this.#work.ring();
  }

  /** Pauses writing: the machine no longer knows the owner. */
  onOffline() {
    this.#announced.mute();
  }

  /** Writes changed values until the connection is closed. */
  async keepWritten() {
    const { stopped, log } = this.#connection;
    while (!stopped.aborted) {
      await this.#work.rung({ signal: stopped });
      await this.#announced.rung({ signal: stopped });
      const [key] = this.#dirty;
      if (key === undefined) {
        this.#work.mute();
        continue;
      }
      this.#dirty.delete(key);
      try {
        await this.#write(key);
      } catch (error) {
        if (stopped.aborted) return;
        if (isPassing(error)) {
          this.#dirty.add(key);
          log.warn(`${key} is not written yet: ${error.message}`);
          await sleep(RETRY_MS, stopped);
        } else log.error(`${key}: ${error instanceof Error ? error.message : error}`);
      }
    }
  }

  /** @param {string} key */
  async #write(key) {
    const wanted = this.#wanted.get(key);
    if (wanted === undefined) return;
    const owner = this.owner === null ? {} : { handler_id: this.owner, instance: this.#connection.instance };
    await this.#connection.request(wanted.topic, { ...wanted.payload, ...owner }, { timeoutMs: TIMEOUT_MS });
  }
}

/** @param {unknown} error @returns {error is NotConnected | NoAnswer} */
function isPassing(error) {
  return error instanceof NotConnected || error instanceof NoAnswer;
}
