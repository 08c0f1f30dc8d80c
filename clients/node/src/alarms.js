// Alarms that a program declares: text, remedy, languages.

import { Alarm, CODE_MAX, ProgramError, TEXT_MAX } from "./errors.js";

const LANGUAGES_MAX = 8;
/** Maximum number of alarms that one program may declare. */
export const ALARMS_MAX = 256;
const TAG = /^[A-Za-z0-9-]{2,16}$/;

/**
 * Text of the alarm and its remedy, 1 to 1000 characters each.
 * @typedef {import("./messages.d.ts").AlarmWords} AlarmWords
 */

/**
 * An alarm with text, remedy and languages, for a constant: `program.alarms(NO_AIR)`, and `throw NO_AIR.alarm("2.1
 * bar")`. Throws a `ProgramError` if the code is not 0 to 9999, a text is empty or too long, or there are more than 8
 * languages.
 */
export class UserAlarm {
  /**
   * @param {number} code the machine shows 10000 + code @param {string} text description of the fault for the operator
   * @param {{remedy?: string, languages?: Record<string, AlarmWords>}} [options] the remedy, and text and remedy in
   * other languages by language tag, such as `de` or `pt-BR`
   */
  constructor(code, text, { remedy, languages = {} } = {}) {
    const mistake = (/** @type {string} */ why) => new ProgramError(`alarm ${code}: ${why}`);
    if (!Number.isInteger(code) || code < 0 || code > CODE_MAX) throw mistake(`write 0 to ${CODE_MAX}`);
    const tags = Object.keys(languages);
    if (tags.length > LANGUAGES_MAX) throw mistake(`${tags.length} languages: write up to ${LANGUAGES_MAX}`);
    const wrong = tags.find((tag) => !TAG.test(tag));
    if (wrong !== undefined) throw mistake(`language ${JSON.stringify(wrong)}: write a tag such as "de" or "pt-BR"`);
    const words = [{ text, remedy }, ...Object.values(languages)];
    if (words.some((one) => !isText(one.text) || !(one.remedy === undefined || isText(one.remedy)))) {
      throw mistake(`text and remedy: write 1 to ${TEXT_MAX} characters`);
    }
    this.code = code;
    this.text = text;
    this.remedy = remedy;
    this.languages = languages;
  }

  /** Returns the alarm to throw, with details appended to its text. @param {unknown} [detail] */
  alarm(detail) {
    return new Alarm(this.code, detail === undefined ? this.text : `${this.text}: ${detail}`);
  }

  /** Returns the declaration as the presence message carries it. @returns {import("./messages.d.ts").AlarmText} */
  toJSON() {
    const { code, text, remedy, languages } = this;
    return { code, text, ...(remedy === undefined ? {} : { remedy }), languages };
  }
}

/** @param {unknown} text */
function isText(text) {
  return typeof text === "string" && text !== "" && [...text].length <= TEXT_MAX;
}
