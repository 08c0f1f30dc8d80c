// Numbers and times on the screen: in the browser's locale; numbers of NC text with a decimal point.

import { decimal, locale, t } from "./language.js";

/** Millimetres or degrees, the units of the machine. */
const PLAIN_SCALE = { size: 1, decimals: 3 };

/**
 * Formats a position; a dash if it is unknown.
 * @param {number | null | undefined} value mm or degrees
 * @param {{size: number, decimals: number}} [scale] the unit, and its size in mm or degrees
 */
export function position(value, { size, decimals } = PLAIN_SCALE) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  return fixed(value / size, decimals);
}

/** Formats a number with a fixed number of decimals. @param {number} value @param {number} decimals */
export function fixed(value, decimals) {
  return decimal(value, decimals, decimals);
}

/** Formats a time in seconds with a fixed number of decimals. @param {number} value @param {number} decimals */
export function seconds(value, decimals) {
  return t("time.seconds", { s: fixed(value, decimals) });
}

/**
 * Reads a typed number, with a point or a comma; NaN if it is not a number.
 * @param {string} text
 */
export function readNumber(text) {
  const typed = text.trim().replace("\u2212", "-").replace(",", ".");
  return /^[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?$/i.test(typed) ? Number(typed) : Number.NaN;
}

/**
 * Formats a whole number with thin spaces between thousands.
 * @param {number | null | undefined} value
 */
export function whole(value) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  return String(Math.round(value) + 0).replace(/\B(?=(\d{3})+$)/g, "\u202f");
}

/**
 * Formats a number without trailing zeros.
 * @param {number} value
 */
export function plain(value) {
  return decimal(value, 0, 6);
}

/** Formats a number as NC text. @param {number} value */
function written(value) {
  return String(Math.round(value * 1e6) / 1e6);
}

/**
 * Returns a text in which numbers have at most three decimals.
 * @param {string} text
 */
export function rounded(text) {
  return text.replace(/\d+\.\d{4,}/g, (number) => Number(number).toFixed(3));
}

/**
 * Formats a duration in whole seconds: `7 s`, `3 min 07 s`, `2 h 05 min`.
 * @param {number} ms
 */
export function duration(ms) {
  const s = Math.max(0, Math.floor(ms / 1000));
  if (s < 60) return t("time.seconds", { s });
  const two = (/** @type {number} */ n) => String(n).padStart(2, "0");
  if (s < 3600) return t("time.minutes", { min: Math.floor(s / 60), s: two(s % 60) });
  return t("time.hours", { h: Math.floor(s / 3600), min: two(Math.floor((s % 3600) / 60)) });
}

/**
 * Formats parameters of an output as NC text: `VA=5 VB=0.25`.
 * @param {import("../types.d.ts").Params} params
 */
export function params(params) {
  return Object.entries(params).map(([name, value]) => `V${name}=${written(value)}`).join("  ");
}

/**
 * A program number as machine builders write it: `O0001`.
 * @param {number | null | undefined} number
 */
export function programName(number) {
  return number === null || number === undefined ? "–" : `O${String(number).padStart(4, "0")}`;
}

/**
 * Returns the beginning of a program's hash, which distinguishes programs for a person.
 * @param {string | null | undefined} hash
 */
export function shortHash(hash) {
  return (hash ?? "").slice(0, 8);
}

/** Formats of times of day, by their decimals of a second; always 24 hours, as at controls. @type {Intl.DateTimeFormat[]} */
const CLOCKS = [0, 1, 2, 3].map((decimals) => {
  const digits = decimals === 0 ? {} : { fractionalSecondDigits: /** @type {1 | 2 | 3} */ (decimals) };
  return new Intl.DateTimeFormat(locale, { hour: "2-digit", minute: "2-digit", second: "2-digit", hourCycle: "h23", numberingSystem: "latn", ...digits });
});
const DAY = new Intl.DateTimeFormat(locale, { year: "numeric", month: "2-digit", day: "2-digit", numberingSystem: "latn" });

/** Time of day in the viewer's zone. @param {Date} date @param {number} decimals of a second, up to 3 */
export function clockTime(date, decimals) {
  return CLOCKS[decimals]?.format(date) ?? "–";
}

/**
 * Time of day of an RFC 3339 time, in the viewer's zone.
 * @param {string} timestamp
 */
export function timeOfDay(timestamp) {
  const date = new Date(timestamp);
  return Number.isNaN(date.getTime()) ? "–" : clockTime(date, 0);
}

/** Day and time in the viewer's zone, to the millisecond. @param {string | null} timestamp */
export function dayAndTime(timestamp) {
  const date = new Date(timestamp ?? "");
  return Number.isNaN(date.getTime()) ? "–" : `${DAY.format(date)} ${clockTime(date, 3)}`;
}

/**
 * @param {number} bytes
 */
export function bytes(bytes) {
  if (bytes < 1024) return `${bytes} B`;
  if (bytes < 1024 * 1024) return `${fixed(bytes / 1024, 1)} KiB`;
  return `${fixed(bytes / 1024 / 1024, 1)} MiB`;
}
