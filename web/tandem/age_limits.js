// Age limits of requests. The machine measures an age by its own clock, from a heartbeat that the page names. The page names the
// newest heartbeat that it had received when the person acted. Without a connection it reads one heartbeat over HTTP.

/** Heartbeats that are kept, the newest last: those of 3 s, longer than a press may wait in the page. */
const HEARTBEATS_MAX = 30;

/**
 * Limits the age of a request: the machine rejects it as `expired` when it would take effect later.
 * @typedef {{boot_id: string, heartbeat: number, within_ms: number}} NotAfter
 */

export class AgeLimits {
  /** The newest heartbeats of the machine, and the times at which they arrived. @type {{boot_id: string, cycle: number, at: number}[]} */
  #heartbeats = [];
  #now;

  /** @param {() => number} [now] the clock of the page, ms */
  constructor(now = () => performance.now()) {
    this.#now = now;
  }

  /** Stores a heartbeat that arrives over the connection. @param {{boot_id: string, cycle: number}} heartbeat */
  receive({ boot_id, cycle }) {
    this.#heartbeats.push({ boot_id, cycle, at: this.#now() });
    if (this.#heartbeats.length > HEARTBEATS_MAX) this.#heartbeats.shift();
  }

  /** Discards all heartbeats, because the connection is lost. */
  clear() {
    this.#heartbeats = [];
  }

  /**
   * Returns the limit of a request that a person made `lateMs` ago; null while no heartbeat is known.
   * @param {number} lateMs @param {number} withinMs
   * @returns {NotAfter | null}
   */
  received(lateMs, withinMs) {
    const actedAt = this.#now() - lateMs;
    const newest = this.#heartbeats.findLast(({ at }) => at <= actedAt) ?? this.#heartbeats[0];
    return newest ? { boot_id: newest.boot_id, heartbeat: newest.cycle, within_ms: withinMs } : null;
  }

  /**
   * Returns the limit of a request that a person made `lateMs` ago, from a heartbeat that is read now. The machine sent this
   * heartbeat before it arrived here, so the time until its arrival is subtracted from the limit. Null if the limit has passed.
   * @param {number} lateMs @param {number} withinMs @param {() => Promise<{boot_id: string, cycle: number}>} read
   * @returns {Promise<NotAfter | null>}
   */
  async read(lateMs, withinMs, read) {
    const actedAt = this.#now() - lateMs;
    const { boot_id, cycle } = await read();
    const within_ms = Math.floor(withinMs - (this.#now() - actedAt));
    return within_ms >= 1 ? { boot_id, heartbeat: cycle, within_ms } : null;
  }
}
