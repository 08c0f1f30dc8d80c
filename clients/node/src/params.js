// Parameters VA to VH of an M code.

import { Alarm, CODE_OF_PARAMETER } from "./errors.js";

/** @typedef {"A" | "B" | "C" | "D" | "E" | "F" | "G" | "H"} Letter */

export const LETTERS = /** @type {const} */ (["A", "B", "C", "D", "E", "F", "G", "H"]);

/** NC text calculates in binary fractions: 0.1 * 30 must be accepted as 3. */
export const WHOLE_WITHIN = 1e-9;

/**
 * VA to VH as the program wrote them; undefined if omitted.
 *
 * A function that reads the parameters of an M code is used twice, in its handler and as its check when a program is
 * loaded:
 * `const pocket = (params) => params.whole("A", 1, 24, "the pocket")`.
 */
export class Params {
  /** @param {import("./messages.d.ts").Params} [given] */
  constructor(given = {}) {
    const { A, B, C, D, E, F, G, H } = given;
    this.A = A;
    this.B = B;
    this.C = C;
    this.D = D;
    this.E = E;
    this.F = F;
    this.G = G;
    this.H = H;
    Object.freeze(this);
  }

  /**
   * Returns a required parameter within a range, both ends included; otherwise throws an `Alarm`.
   * @param {Letter} letter @param {number} low @param {number} high
   * @param {string} what name with its unit, such as "the clamping force, kN": a part of the alarm's text
   */
  real(letter, low, high, what) {
    if (!LETTERS.includes(letter)) throw new RangeError(`${JSON.stringify(letter)} is not a parameter; write "A" to "H"`);
    const value = this[letter];
    if (value === undefined) throw new Alarm(CODE_OF_PARAMETER, `V${letter} is missing: write ${what}, ${low} to ${high}`);
    if (!(low <= value && value <= high)) throw new Alarm(CODE_OF_PARAMETER, `V${letter} is ${value}: write ${what}, ${low} to ${high}`);
    return value;
  }

  /**
   * Returns a whole number, with the checks of `real`.
   * @param {Letter} letter @param {number} low @param {number} high @param {string} what
   */
  whole(letter, low, high, what) {
    const value = this.real(letter, low, high, what);
    const nearest = Math.round(value);
    if (Math.abs(value - nearest) <= WHOLE_WITHIN) return nearest;
    throw new Alarm(CODE_OF_PARAMETER, `V${letter} is ${value}: write ${what}, a whole number from ${low} to ${high}`);
  }
}
