// Declaration of an M code, from the sequence program or else from the configuration: its name and parameters.

import { params, plain } from "./format.js";

/** @typedef {import("../types.d.ts").BirthMessage} BirthMessage */

/** Returns the declaration of an M code. @param {BirthMessage | null} birth @param {number} cs @param {number} m */
export function declared(birth, cs, m) {
  const served = birth?.serves?.find((one) => one.m === m && one.cs.includes(cs) && (one.name || one.params));
  return served ?? birth?.m_codes[m];
}

/**
 * Parameters with their declared names and units, `force 5 kN`; undeclared ones as in the program.
 * @param {import("../types.d.ts").Params} given @param {NonNullable<import("../types.d.ts").MCodeDeclaration["params"]>} [said]
 * @returns {string[]}
 */
export function inWords(given, said = {}) {
  return Object.entries(given).map(([letter, value]) => {
    const { name, unit } = said[/** @type {keyof typeof said} */ (letter)] ?? {};
    const number = name ? `${name} ${plain(value)}` : params({ [letter]: value });
    return unit ? `${number}\u00a0${unit}` : number;
  });
}
