// Variables, each time the machine publishes a change.

import { RequestRefused } from "./errors.js";

const COUNT_MAX = 1_024;

/** Numbers that JSON cannot represent. */
export const WORDS = new Map([
  ["NaN", NaN],
  ["inf", Infinity],
  ["-inf", -Infinity],
]);

/** Converts a number from its JSON form. @param {unknown} value @returns {number} */
export function numberOf(value) {
  return typeof value === "number" ? value : (WORDS.get(/** @type {string} */ (value)) ?? NaN);
}

/** @typedef {{variables: readonly {from: number, values: readonly unknown[]}[]}} Published */

/**
 * Returns the values of variables, or undefined if not all of them are published.
 * @param {Published} published @param {number} first @param {number} count
 */
export function valuesOf({ variables }, first, count) {
  const values = [];
  for (let number = first; number < first + count; number += 1) {
    const row = variables.find(({ from, values: numbers }) => from <= number && number < from + numbers.length);
    if (row === undefined) return undefined;
    values.push(numberOf(row.values[number - row.from]));
  }
  return values;
}

/**
 * Yields the values of variables published on a topic: first the current values, then all values after each change.
 * @param {import("./plc.js").Plc} plc @param {string} path @param {"P" | "Q"} kind @param {number} first @param {number} count
 * @returns {AsyncGenerator<number[], void>}
 */
export async function* changesOf(plc, path, kind, first, count) {
  if (!Number.isInteger(count) || count < 1 || count > COUNT_MAX) throw refused(kind, first, count);
  /** @type {number[] | undefined} */
  let last;
  for await (const message of plc.connection.hub.follow(path)) {
    const values = valuesOf(message, first, count);
    if (values === undefined) throw refused(kind, first, count);
    if (values.every((value, at) => Object.is(value, last?.[at]))) continue;
    last = values;
    yield values;
  }
}

/** @param {"P" | "Q"} kind @param {number} first @param {number} count */
function refused(kind, first, count) {
  const which = count === 1 ? `${kind}${first} is` : `${count} variables from ${kind}${first} on are`;
  const toWrite = `[[variables.published]] from = "${kind}${first}", count = ${count}`;
  return new RequestRefused("not_found", `${which} not published by this machine: name them in its configuration, such as ${toWrite}`);
}
