// Axis motion of the last minute, as recorded by the servo: the first request returns all, later ones the new part.

/** Most samples that are drawn, which is the number that the machine keeps. */
export const SAMPLES_MAX = 6000;
/** Samples that are further apart are not joined by a line, ms. */
export const GAP_MS = 100;

/** @typedef {"error" | "position" | "velocity" | "acceleration" | "feedrate" | "spindle"} Quantity */
/** @typedef {import("../types.d.ts").Trace} Answer */
/**
 * Names of an axis's values in the machine's messages.
 * @type {Record<string, keyof import("../types.d.ts").TraceAxis>}
 */
const OF_AXIS = { error: "following_error", position: "position", velocity: "velocity", acceleration: "acceleration" };
/** Velocities are shown per minute. */
const FACTORS = { velocity: 60 };

export class Trace {
  /** Time of each sample, ms since 1970 by the machine's clock. @type {number[]} */
  times = [];
  /** Values by quantity and axis, such as `velocity X`, and values of the coordinate system, such as `feedrate`. @type {Map<string, number[]>} */
  #columns = new Map();
  #next = 0;
  #cs = 0;

  /** Number of the next requested sample. */
  get next() {
    return this.#next;
  }

  /** Selects the coordinate system. @param {number} cs */
  show(cs) {
    if (cs === this.#cs) return;
    this.#cs = cs;
    this.#forget();
  }

  /**
   * Adds an answer. Returns false if the machine has restarted, so that everything must be requested again.
   * @param {Answer} answer
   */
  addAnswer(answer) {
    if (answer.cs !== this.#cs) return true;
    if (answer.next < this.#next) {
      this.#forget();
      return false;
    }
    this.#next = answer.next;
    const now = Date.parse(answer.now);
    append(this.times, answer.time_s.map((time) => now - (answer.now_s - time) * 1000));
    this.#add("feedrate", answer.feedrate);
    this.#add("spindle", answer.spindle_rpm);
    for (const [axis, values] of Object.entries(answer.axes)) {
      for (const [quantity, name] of Object.entries(OF_AXIS)) this.#add(`${quantity} ${axis}`, values[name].map((value) => value * (FACTORS[/** @type {keyof typeof FACTORS} */ (quantity)] ?? 1)));
    }
    return true;
  }

  /** Values of a curve, one for each time. @param {Quantity} quantity @param {string} axis */
  of(quantity, axis) {
    return this.#columns.get(quantity in OF_AXIS ? `${quantity} ${axis}` : quantity) ?? [];
  }

  #forget() {
    this.times = [];
    this.#columns.clear();
    this.#next = 0;
  }

  /** @param {string} name @param {number[]} values */
  #add(name, values) {
    const column = this.#columns.get(name) ?? [];
    this.#columns.set(name, column);
    append(column, values);
  }
}

/** Appends values. Removes the oldest in blocks, because each removal moves all of them. @param {number[]} column @param {number[]} values */
function append(column, values) {
  column.push(...values);
  if (column.length > SAMPLES_MAX * 1.1) column.splice(0, column.length - SAMPLES_MAX);
}

/**
 * Returns a table of the drawn curves for other programs: decimal point, times in seconds since the first.
 * @param {number[]} times ms @param {{name: string, values: number[]}[]} curves
 */
export function csvOf(times, curves) {
  const first = times[0] ?? 0;
  const written = (/** @type {number | undefined} */ value) => (value === undefined || !Number.isFinite(value) ? "" : String(Math.round(value * 1e6) / 1e6));
  const head = ["time_s", ...curves.map(({ name }) => name)].join();
  return `${[head, ...times.map((time, at) => [written((time - first) / 1000), ...curves.map(({ values }) => written(values[at]))].join())].join("\n")}\n`;
}

/** Returns the points of a curve: if several samples share a pixel, their lowest and highest value. @param {number[]} xs @param {number[]} values @returns {number[]} their places */
export function drawn(xs, values) {
  if (xs.length < 2 || xs.length < 3 * ((xs.at(-1) ?? 0) - (xs[0] ?? 0))) return values.map((_, at) => at);
  /** @type {number[]} */
  const places = [];
  for (let from = 0; from < xs.length; ) {
    let to = from;
    let [least, most] = [from, from];
    for (; to < xs.length && Math.floor(xs[to] ?? 0) === Math.floor(xs[from] ?? 0); to += 1) {
      if ((values[to] ?? 0) < (values[least] ?? 0)) least = to;
      if ((values[to] ?? 0) > (values[most] ?? 0)) most = to;
    }
    places.push(...new Set([from, Math.min(least, most), Math.max(least, most), to - 1].sort((a, b) => a - b)));
    from = to;
  }
  return places;
}
