// Probe cycles as NC text: pure functions of the position of the tool and the operator's inputs. Each touch is a G31, which ends
// when the skip input turns on. Motions between touches use the feedrate and incremental distances, so that no work offset has an effect.

/** @typedef {"X" | "Y" | "Z"} Letter */
/** @typedef {Record<Letter, number>} Place */
/** @typedef {"edge" | "corner" | "bore" | "boss" | "surface" | "length"} Kind */

/**
 * Inputs of a cycle, mm and mm/min.
 * @typedef {object} Asked
 * @property {Letter} axis of an edge
 * @property {1 | -1} x direction of the part, seen from the tool
 * @property {1 | -1} y the same
 * @property {number} distance the longest path of a touch
 * @property {number} feed of the paths in between
 * @property {number} ball diameter of the ball of the probe
 * @property {number} clearance next to a boss, and distance past a corner; 0: the corner of a pocket
 * @property {number} size about, of a boss
 * @property {number} depth to which the probe moves down next to a boss
 * @property {number} tip of Z: length of the probe, or machine position of the tool setter
 */

/**
 * A cycle.
 * @typedef {object} Cycle
 * @property {string} text
 * @property {string} whole the text as if each touch went its full path, for planning
 * @property {{axis: Letter, line: number, sign: 1 | -1, from: number}[]} touches in their order: line, direction, and start
 */

/** A motion that ends nearer to its target than this had no touch; a touch within this distance was present before, mm. */
export const NEAR_MM = 0.0005;
/** Start of a cycle: millimetres and incremental distances, and no rotation, scaling, mirroring or compensation. */
const HEAD = ["G21 G17 G40 G49", "G50 G50.1 G69 G91"];

/** A line of the text, and whether it is only for a missing touch. @typedef {{text: string, isGuard: boolean}} Line */

/** Formats a number as NC text. @param {number} value */
const written = (value) => String(Math.round(value * 1e6) / 1e6);

class Writer {
  /** @type {Line[]} */
  #lines = HEAD.map((text) => ({ text, isGuard: false }));
  /** @type {Cycle["touches"]} */
  touches = [];
  #feed;
  #numbers;
  #at;

  /** @param {Place} start @param {Partial<Record<Letter, number>>} numbers of captured positions by axis @param {number} feed */
  constructor(start, numbers, feed) {
    this.#at = { ...start };
    this.#numbers = numbers;
    this.#feed = written(feed);
  }

  /** @param {string} text @param {boolean} [isGuard] */
  #line(text, isGuard = false) {
    this.#lines.push({ text, isGuard });
  }

  /** A motion of known length. @param {Letter} axis @param {number} way */
  move(axis, way) {
    if (Math.abs(way) < NEAR_MM) return;
    this.#line(`G01 ${axis}${written(way)} F${this.#feed}`);
    this.#at[axis] += way;
  }

  /**
   * Touches, and returns to the start. Without a touch the cycle ends at the start, after the retract motions.
   * @param {Letter} axis @param {number} way @param {[Letter, number][]} [out]
   * @returns {string} the variable that keeps the captured position
   */
  touch(axis, way, out = []) {
    const captured = `_CNC_CapturedPosition${this.#numbers[axis]}`;
    const [kept, back] = [`L${this.touches.length + 1}`, `L${this.touches.length + 11}`];
    this.#line(`G31 ${axis}${written(way)}`);
    this.touches.push({ axis, line: this.#lines.length, sign: way > 0 ? 1 : -1, from: this.#at[axis] });
    this.#line(`${kept} = ${captured}`);
    this.#line(`${back} = ${written(this.#at[axis])} - ${kept}`);
    this.#line(`G01 ${axis}[${back}] F${this.#feed}`);
    this.#line(`if (abs(${kept} - ${written(this.#at[axis] + way)}) < ${NEAR_MM}) {`, true);
    for (const [letter, length] of out) this.#line(`G01 ${letter}${written(length)} F${this.#feed}`, true);
    this.#line("M30", true);
    this.#line("}", true);
    return kept;
  }

  /** A motion to the middle of two captured positions. @param {Letter} axis @param {string} one @param {string} other */
  toMiddle(axis, one, other) {
    const way = `L${this.touches.length + 20}`;
    this.#line(`${way} = (${one} + ${other}) / 2 - ${written(this.#at[axis])}`);
    this.#line(`G01 ${axis}[${way}] F${this.#feed}`);
  }

  /** @returns {Cycle} */
  end() {
    const joined = (/** @type {Line[]} */ lines) => lines.map(({ text }) => text).join("\n");
    return { text: joined(this.#lines), whole: joined(this.#lines.filter(({ isGuard }) => !isGuard)), touches: this.touches };
  }
}

/** @type {Record<Kind, (w: Writer, asked: Asked) => void>} */
const CYCLES = {
  edge(w, { axis, x, y, distance }) {
    w.touch(axis, (axis === "X" ? x : y) * distance);
  },
  corner(w, { x, y, distance, clearance }) {
    w.move("Y", y * clearance);
    w.touch("X", x * distance, [["Y", -y * clearance]]);
    w.move("Y", -y * clearance);
    w.move("X", x * clearance);
    w.touch("Y", y * distance, [["X", -x * clearance]]);
    w.move("X", -x * clearance);
  },
  bore(w, { distance }) {
    for (const axis of /** @type {Letter[]} */ (["X", "Y"])) w.toMiddle(axis, w.touch(axis, distance), w.touch(axis, -distance));
  },
  boss(w, { size, depth, clearance, distance }) {
    const beside = size / 2 + clearance;
    for (const axis of /** @type {Letter[]} */ (["X", "Y"])) {
      const [one, other] = [1, -1].map((side) => {
        w.move(axis, side * beside);
        w.move("Z", -depth);
        const kept = w.touch(axis, -side * (clearance + distance), [["Z", depth]]);
        w.move("Z", depth);
        w.move(axis, -side * beside);
        return kept;
      });
      w.toMiddle(axis, one ?? "", other ?? "");
    }
  },
  surface(w, { distance }) {
    w.touch("Z", -distance);
  },
  length(w, { distance }) {
    w.touch("Z", -distance);
  },
};

/** Axes that a cycle moves. @type {Record<Kind, Letter[]>} */
export const AXES = { edge: ["X", "Y"], corner: ["X", "Y"], bore: ["X", "Y"], boss: ["X", "Y", "Z"], surface: ["Z"], length: ["Z"] };

/**
 * The text of a cycle.
 * @param {Kind} kind @param {Place} start machine position of the tool @param {Asked} asked
 * @param {Partial<Record<Letter, number>>} numbers of captured positions by axis: indexes of their motors, ascending by number
 */
export function cycleOf(kind, start, asked, numbers) {
  const writer = new Writer(start, numbers, asked.feed);
  CYCLES[kind](writer, asked);
  return writer.end();
}

/**
 * Results: machine positions for zero, a diameter, the length of a tool.
 * @typedef {{zero: Partial<Place>, diameter?: number, length?: number}} Found
 */

/**
 * Calculates the results of a cycle's touches.
 * @param {Kind} kind @param {Asked} asked @param {Cycle["touches"]} touches @param {number[]} captured machine positions in their order
 * @returns {Found}
 */
export function foundBy(kind, asked, touches, captured) {
  const at = (/** @type {number} */ i) => captured[i] ?? Number.NaN;
  if (kind === "length") return { zero: {}, length: at(0) - asked.tip };
  if (kind === "surface") return { zero: { Z: at(0) - asked.tip } };
  if (kind === "bore" || kind === "boss") {
    const ball = kind === "bore" ? asked.ball : -asked.ball;
    return { zero: { X: (at(0) + at(1)) / 2, Y: (at(2) + at(3)) / 2 }, diameter: Math.abs(at(2) - at(3)) + ball };
  }
  return { zero: Object.fromEntries(touches.map(({ axis, sign }, i) => [axis, at(i) + (sign * asked.ball) / 2])) };
}
