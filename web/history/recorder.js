// The positions of each coordinate system over the last minutes, as this page has heard them.

/** Samples kept of each coordinate system: 5 minutes at 10 a second. */
export const SAMPLES_MAX = 3000;
/** Samples that are further apart are not joined by a line, ms. */
export const GAP_MS = 1000;

/**
 * @typedef {object} Sample
 * @property {number} at ms since 1970, by the machine's clock
 * @property {number} feedrate
 * @property {number} spindle
 * @property {Record<string, number>} position
 * @property {Record<string, number>} error
 */

/** @typedef {"error" | "position" | "velocity" | "feedrate" | "spindle"} Quantity */

export class Recorder {
  /** @type {Map<number, Sample[]>} */
  #samples = new Map();

  /** @param {number} cs @param {import("../types.d.ts").PositionMessage} message */
  add(cs, { ts, feedrate, spindle_rpm, work, following_error }) {
    const samples = this.#samples.get(cs) ?? [];
    this.#samples.set(cs, samples);
    const at = Date.parse(ts);
    const last = samples.at(-1);
    if (!Number.isFinite(at) || (last && at <= last.at)) return;
    samples.push({ at, feedrate, spindle: spindle_rpm, position: work, error: following_error });
    // not at each sample, since that moves all of them
    if (samples.length > SAMPLES_MAX * 1.1) samples.splice(0, samples.length - SAMPLES_MAX);
  }

  /** Of a coordinate system, in the order of time. @param {number} cs */
  of(cs) {
    return this.#samples.get(cs) ?? [];
  }

  forget() {
    this.#samples.clear();
  }
}

/**
 * What is drawn: a value for each sample, NaN where there is none.
 * @param {Sample[]} samples @param {Quantity} quantity @param {string} axis
 */
export function valuesOf(samples, quantity, axis) {
  return samples.map((sample, at) => {
    if (quantity === "feedrate" || quantity === "spindle") return sample[quantity];
    if (quantity !== "velocity") return sample[quantity][axis] ?? Number.NaN;
    const before = samples[at - 1];
    const passed = before ? sample.at - before.at : 0;
    if (!before || passed <= 0 || passed > GAP_MS) return Number.NaN;
    return (((sample.position[axis] ?? Number.NaN) - (before.position[axis] ?? Number.NaN)) / passed) * 60_000;
  });
}
