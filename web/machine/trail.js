// The recent path: a bounded number of machine positions.

/** Points kept, the newest. At ten per second about seven minutes of motion. */
export const POINTS_MAX = 4096;
/** Points closer than this to the last one are dropped, mm. */
const NEAR_MM = 0.005;

/** @typedef {{at: Record<string, number>, rapid: boolean}} Point */

export class Trail {
  /** @type {Point[]} oldest first */
  points = [];
  /** Increases with each change, so that a drawing can check whether it is current. */
  revision = 0;
  /** @type {string | null} */
  #runId = null;
  #wasRapid = false;

  /** Clears the trail at a new run. @param {string | null} runId */
  run(runId) {
    if (runId === this.#runId) return;
    this.#runId = runId;
    if (runId !== null) this.clear();
  }

  /** Clears the trail; it begins again at the position of the tool. */
  clear() {
    this.points = this.points.slice(-1);
    this.revision += 1;
  }

  /**
   * A step with a rapid at one end is classified as rapid: in 0.1 s a rapid moves far, a feed does not.
   * @param {Record<string, number>} at machine positions
   * @param {boolean} isRapid whether G00 is in force now
   */
  add(at, isRapid) {
    const rapid = isRapid || this.#wasRapid;
    this.#wasRapid = isRapid;
    const last = this.points.at(-1);
    if (last && Object.keys(at).every((axis) => Math.abs((at[axis] ?? 0) - (last.at[axis] ?? 0)) < NEAR_MM)) return;
    this.points.push({ at, rapid });
    // removes a quarter at once, so that not every point shifts the array
    if (this.points.length > POINTS_MAX) this.points.splice(0, POINTS_MAX / 4);
    this.revision += 1;
  }
}
