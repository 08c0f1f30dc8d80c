// Numbers and times as the screen shows them.

/** Millimetres or degrees, as they come from the machine. */
const PLAIN_SCALE = { size: 1, decimals: 3 };

/**
 * A position; a dash where there is none.
 * @param {number | null | undefined} value mm or degrees
 * @param {{size: number, decimals: number}} [scale] its unit, mm or degrees in one of it
 */
export function position(value, { size, decimals } = PLAIN_SCALE) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  const text = (value / size).toFixed(decimals);
  return Number(text) === 0 ? text.replace("-", "") : text;
}

/**
 * A whole number with thin spaces between thousands.
 * @param {number | null | undefined} value
 */
export function whole(value) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  return String(Math.round(value) + 0).replace(/\B(?=(\d{3})+$)/g, "\u202f");
}

/**
 * A number without needless zeros.
 * @param {number} value
 */
export function plain(value) {
  return String(Math.round(value * 1e6) / 1e6);
}

/**
 * A text in which numbers have three decimals at most.
 * @param {string} text
 */
export function rounded(text) {
  return text.replace(/\d+\.\d{4,}/g, (number) => Number(number).toFixed(3));
}

/**
 * How long something has lasted: `0.4 s` never, `7 s`, `3 min 07 s`, `2 h 05 min`.
 * @param {number} ms
 */
export function duration(ms) {
  const s = Math.max(0, Math.floor(ms / 1000));
  if (s < 60) return `${s} s`;
  const two = (/** @type {number} */ n) => String(n).padStart(2, "0");
  if (s < 3600) return `${Math.floor(s / 60)} min ${two(s % 60)} s`;
  return `${Math.floor(s / 3600)} h ${two(Math.floor((s % 3600) / 60))} min`;
}

/**
 * Parameters of an output, as the program writes them: `VA=5 VB=0.25`.
 * @param {import("./types.d.ts").Params} params
 */
export function params(params) {
  return Object.entries(params).map(([name, value]) => `V${name}=${plain(value)}`).join("  ");
}

/**
 * A program number as machine builders write it: `O0001`.
 * @param {number | null | undefined} number
 */
export function programName(number) {
  return number === null || number === undefined ? "–" : `O${String(number).padStart(4, "0")}`;
}

/**
 * The beginning of a program's hash, by which a person tells two programs apart.
 * @param {string | null | undefined} hash
 */
export function shortHash(hash) {
  return (hash ?? "").slice(0, 8);
}

/**
 * Time of day of an RFC 3339 time, in the viewer's zone.
 * @param {string} timestamp
 */
export function timeOfDay(timestamp) {
  const date = new Date(timestamp);
  if (Number.isNaN(date.getTime())) return "–";
  return [date.getHours(), date.getMinutes(), date.getSeconds()].map((n) => String(n).padStart(2, "0")).join(":");
}

/**
 * @param {number} bytes
 */
export function bytes(bytes) {
  if (bytes < 1024) return `${bytes} B`;
  if (bytes < 1024 * 1024) return `${(bytes / 1024).toFixed(1)} KiB`;
  return `${(bytes / 1024 / 1024).toFixed(1)} MiB`;
}
