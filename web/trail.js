// The path travelled lately: machine positions as they arrive, a bounded number of them.

/** Points kept. At ten a second, about seven minutes of motion; the oldest go first. */
export const POINTS_MAX = 4096;
/** Points nearer to the last one than this are not kept, mm. */
const NEAR_MM = 0.005;

/** @typedef {{at: Record<string, number>, rapid: boolean}} Point */

export class Trail {
  /** @type {Point[]} oldest first */
  points = [];
  /** Grows with each change, so that a drawing knows whether it is still true. */
  revision = 0;
  /** @type {string | null} */
  #runId = null;
  #wasRapid = false;

  /** Begins anew with a new run. @param {string | null} runId */
  run(runId) {
    if (runId === this.#runId) return;
    this.#runId = runId;
    if (runId !== null) this.clear();
  }

  /** Keeps where the tool is, and begins anew from there. */
  clear() {
    this.points = this.points.slice(-1);
    this.revision += 1;
  }

  /**
   * A way that is rapid at one of its ends counts as rapid: within a tenth of a second a rapid goes far, a feed does not.
   * @param {Record<string, number>} at machine positions
   * @param {boolean} isRapid whether G00 is in force now
   */
  add(at, isRapid) {
    const rapid = isRapid || this.#wasRapid;
    this.#wasRapid = isRapid;
    const last = this.points.at(-1);
    if (last && Object.keys(at).every((axis) => Math.abs((at[axis] ?? 0) - (last.at[axis] ?? 0)) < NEAR_MM)) return;
    this.points.push({ at, rapid });
    // a quarter at once, so that the array is not shifted with every point
    if (this.points.length > POINTS_MAX) this.points.splice(0, POINTS_MAX / 4);
    this.revision += 1;
  }
}
