// Position of a run on its planned path. Between two servo positions the tool follows the path, so it is drawn at
// display rate and no corners are cut off; the picture is one message late. Off the plan it is drawn at the machine
// position.

import { atTime, passedAt } from "./find.js";

/** Time ahead of the last place in which the path is searched first, s. */
const AHEAD_S = 3;
/** Longest time between two messages that is bridged, ms. */
const BRIDGE_MS = 400;

export class Live {
  /** @type {string | null} */
  #run = null;
  /** Planned times of the last two positions; null: off the plan. @type {[number | null, number | null]} */
  #times = [null, null];
  /** Time of the last position, and time since the position before, ms. */
  #came = 0;
  #interval = 100;
  /** @type {unknown} */
  #message = null;

  /** True while the machine is on the plan. */
  get onPlan() {
    return this.#times[1] !== null;
  }

  /**
   * Adds a position of a run of the planned program.
   * @param {import("./bytes.js").Answer | null} path @param {string | null} run null: no run is active
   * @param {unknown} message id of the message, so that each position is used once @param {[number, number, number]} at @param {number} now ms
   */
  addPosition(path, run, message, at, now) {
    if (run !== this.#run) {
      this.#run = run;
      this.#times = [null, null];
    }
    if (!path || run === null) {
      this.#times = [null, null];
      return;
    }
    if (message === this.#message) return;
    this.#message = message;
    const last = this.#times[1];
    const from = last ?? 0;
    const time = (last === null ? null : passedAt(path, at, from, from + AHEAD_S)) ?? passedAt(path, at, from, Infinity);
    this.#interval = Math.min(BRIDGE_MS, Math.max(20, now - this.#came));
    this.#came = now;
    this.#times = [last, time];
  }

  /** The planned time that is drawn now; null: off the plan. @param {number} now ms */
  time(now) {
    const [from, to] = this.#times;
    if (to === null) return null;
    if (from === null) return to;
    return from + (to - from) * Math.min(1, (now - this.#came) / this.#interval);
  }

  /** Returns true until the drawn place has reached the last position. @param {number} now ms */
  isMoving(now) {
    const [from, to] = this.#times;
    return from !== null && to !== null && to > from && now - this.#came < this.#interval + 50;
  }

  /** Returns the drawn position of the tool; null off the plan. @param {import("./bytes.js").Answer} path @param {number} now ms */
  at(path, now) {
    const time = this.time(now);
    return time === null ? null : (atTime(path, time)?.at ?? null);
  }
}
