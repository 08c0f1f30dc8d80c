// Declarations of a program's M codes: their names, and the meaning of VA to VH.

import { Alarm, CODE_OF_PARAMETER, ProgramError } from "./errors.js";
import { LETTERS, WHOLE_WITHIN } from "./params.js";

const NAME_MAX = 40;
const UNIT_MAX = 16;

/** @typedef {import("./messages.d.ts").ParamDeclaration} Param */
/** @typedef {import("./params.js").Letter} Letter */

/** The declaration of a handler's M codes. */
export class MCodeDeclaration {
  /** @param {string | undefined} name @param {Partial<Record<Letter, Param>> | undefined} params */
  constructor(name, params) {
    this.name = name;
    this.params = params;
    checkLength("name", name, NAME_MAX);
    for (const [letter, param] of Object.entries(params ?? {})) {
      if (!LETTERS.some((known) => known === letter)) throw new ProgramError(`${JSON.stringify(letter)} is not a parameter; write "A" to "H"`);
      checkLength(`V${letter}: name`, param.name, NAME_MAX);
      checkLength(`V${letter}: unit`, param.unit, UNIT_MAX);
      const { min, max } = param;
      if (min !== undefined && max !== undefined && min > max) throw new ProgramError(`V${letter}: min ${min} is above max ${max}`);
    }
  }

  /**
   * Returns the declaration as the presence message carries it.
   * @param {number} m @param {number | undefined} cs @returns {import("./messages.d.ts").MCodeDeclaration}
   */
  toJson(m, cs) {
    const { name, params } = this;
    return { m, ...(cs === undefined ? {} : { cs }), ...(name === undefined ? {} : { name }), ...(params === undefined ? {} : { params }) };
  }

  /**
   * Throws an `Alarm` if the parameters of an output do not match the declaration.
   * @param {number} m @param {import("./params.js").Params} given
   */
  check(m, given) {
    const { params } = this;
    if (params === undefined) return;
    const number = `M${String(m).padStart(2, "0")}`;
    const title = this.name === undefined ? number : `${number} ${this.name}`;
    for (const letter of LETTERS) {
      const wrong = whatIsWrong(title, letter, given[letter], params);
      if (wrong !== null) throw new Alarm(CODE_OF_PARAMETER, wrong);
    }
  }
}

/**
 * @param {string} title @param {Letter} letter @param {number | undefined} value @param {Partial<Record<Letter, Param>>} params
 * @returns {string | null}
 */
function whatIsWrong(title, letter, value, params) {
  const param = params[letter];
  if (param === undefined) {
    if (value === undefined) return null;
    const takes = Object.entries(params).map(([other, one]) => `V${other} (${text(one)})`);
    return `${title} takes no V${letter}; it takes ${takes.join(", ") || "no parameters"}`;
  }
  if (value === undefined) return param.optional ? null : `${title} needs V${letter} (${text(param)})`;
  if (takes(param, value)) return null;
  const named = param.name ? ` (${param.name})` : "";
  const unit = param.unit ? ` ${param.unit}` : "";
  return `${title}: V${letter}${named} is ${value}${unit}; write ${range(param)}`;
}

/** @param {string} what @param {string | undefined} text @param {number} most */
function checkLength(what, text, most) {
  if (text === undefined || (text.length >= 1 && text.length <= most)) return;
  throw new ProgramError(`${what} ${JSON.stringify(text)}: write 1 to ${most} characters`);
}

/** Accepts a whole number with the rounding error of a calculation. @param {Param} param @param {number} value */
function takes({ min = -Infinity, max = Infinity, whole }, value) {
  const meant = whole ? Math.round(value) : value;
  return Number.isFinite(value) && Math.abs(value - meant) <= WHOLE_WITHIN && meant >= min && meant <= max;
}

/** Returns the permitted values, such as `1 to 20 kN`. @param {Param} param */
function range({ min, max, whole, unit: named }) {
  const unit = named ? ` ${named}` : "";
  if (min === undefined && max === undefined) return `${whole ? "a whole number" : "a number"}${named ? ` in ${named}` : ""}`;
  const limits = min !== undefined && max !== undefined ? `${min} to ${max}${unit}` : min !== undefined ? `${min}${unit} or more` : `${max}${unit} or less`;
  return whole ? `a whole number, ${limits}` : limits;
}

/** Returns the name and the range of a parameter. @param {Param} param */
function text(param) {
  return [param.name, range(param)].filter(Boolean).join(", ") + (param.optional ? "; may be left out" : "");
}
