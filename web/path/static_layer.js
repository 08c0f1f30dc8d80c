// The static layer of a picture, around a path: grid, soft limits, work zero, tool, the travelled path without a plan. Own lines in the
// runtime's format, created again only when they change.

import { fixed, plain } from "../text/format.js";
import { VERTEX_BYTES, VERTEX_WORDS } from "./vertex.js";

/** @typedef {[number, number, number]} Point */

/** Smallest distance between grid lines, px. */
const GRID_MIN_PX = 56;
/** Length of the axes of the work zero, px. */
const ZERO_PX = 22;
/** Radius of the sign of a tool without a diameter, px. */
const TOOL_PX = 6;
const CIRCLE = 48;
const RAPID_FLAG = 0x80000000;
/** A time after every run: a line with this time is never done, so it is thin. */
const THIN = 1e30;

/** A unit of lengths: its name, and its size in mm. @typedef {Pick<import("../text/units.js").Scale, "unit" | "size">} Lengths */

/** Returns 1, 2 or 5 times a power of ten, so that lines are at least GRID_MIN_PX apart. @param {number} scale px per unit of lengths */
export function gridStep(scale) {
  const least = GRID_MIN_PX / scale;
  const power = 10 ** Math.floor(Math.log10(least));
  return power * ([1, 2, 5, 10].find((n) => n * power >= least) ?? 10);
}

/** A circle of radius 1 in the plane of X and Y, and a cross. */
const TOOL = [
  ...Array.from({ length: CIRCLE + 1 }, (_, i) => [Math.cos((2 * Math.PI * i) / CIRCLE), Math.sin((2 * Math.PI * i) / CIRCLE)]),
  [-1, 0], [1, 0], [0, 0], [0, 1], [0, -1],
];

/**
 * Returns own lines in the format of the runtime.
 * @param {ArrayLike<number>[]} points x y z
 * @param {(i: number) => number} [word] of the line that ends there
 * @param {number} [time] time from which on the line is wide, s
 */
function ownLines(points, word = () => 0, time = 0) {
  const bytes = new ArrayBuffer(points.length * VERTEX_BYTES);
  const [floats, words] = [new Float32Array(bytes), new Uint32Array(bytes)];
  points.forEach((at, i) => {
    for (let k = 0; k < 3; k += 1) floats[VERTEX_WORDS * i + k] = at[k] ?? 0;
    words[VERTEX_WORDS * i + 3] = word(i);
    floats[VERTEX_WORDS * i + 4] = time;
  });
  return bytes;
}

/** Returns the edges of a box, in one sequence. @param {Point} low @param {Point} high */
export function boxLines(low, high) {
  const corner = (/** @type {number} */ n) => [0, 1, 2].map((i) => /** @type {number} */ ((n >> i) & 1 ? high[i] : low[i]));
  return ownLines([0, 1, 3, 2, 0, 4, 5, 7, 6, 4, 5, 1, 3, 7, 6, 2].map(corner), () => 0, THIN);
}

/** Returns the travelled path. @param {{at: Record<string, number>, rapid: boolean}[]} points */
export function trailLines(points) {
  const at = points.map(({ at: { X = 0, Y = 0, Z = 0 } }) => [X, Y, Z]);
  return ownLines(at, (i) => (points[i]?.rapid ? RAPID_FLAG : 0));
}

/** Returns a tool around the origin, of a radius in mm or of a size in the picture. @param {number} radius @param {import("./camera.js").Camera} camera */
export function toolLines(radius, camera) {
  const inPlane = radius > 0;
  const size = Math.max(radius, TOOL_PX / camera.scale);
  const [right, up] = inPlane && camera.tilt > 0.3 ? [[1, 0, 0], [0, 1, 0]] : camera.axes;
  return ownLines(TOOL.map(([x = 0, y = 0]) => [0, 1, 2].map((k) => size * (/** @type {number} */ (right[k]) * x + /** @type {number} */ (up[k]) * y))));
}

/** Axes of the work zero, around the origin. @param {import("./camera.js").Camera} camera */
export function zeroLines(camera) {
  const length = ZERO_PX / camera.scale;
  return ownLines([[length, 0, 0], [0, 0, 0], [0, length, 0], [0, 0, 0], [0, 0, length]]);
}

/** Draws lines of the grid and names of the axes on the canvas that lies below the path. */
export class Backdrop {
  #context;
  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    this.canvas = canvas;
    this.#context = canvas.getContext("2d");
  }

  /** @param {import("./camera.js").Camera} camera @param {number} ratio @param {Record<string, string>} colours @param {Lengths} lengths */
  draw(camera, ratio, colours, lengths) {
    const c = this.#context;
    if (!c) return;
    const { width, height } = camera;
    c.setTransform(ratio, 0, 0, ratio, 0, 0);
    c.clearRect(0, 0, width, height);
    c.font = `11px ${colours.font}`;
    c.fillStyle = colours.text ?? "";
    const plane = { XY: [0, 1], XZ: [0, 2], YZ: [1, 2] }[/** @type {"XY"} */ (camera.view)];
    if (plane) this.#grid(camera, colours, lengths, /** @type {[number, number]} */ (plane));
    else this.#scale(camera, colours, lengths);
  }

  /** @param {import("./camera.js").Camera} camera @param {Record<string, string>} colours @param {Lengths} lengths @param {[number, number]} plane */
  #grid({ centre, scale, width, height }, colours, { unit, size }, [h, v]) {
    const c = /** @type {CanvasRenderingContext2D} */ (this.#context);
    const shown = gridStep(scale * size);
    const step = shown * size;
    const decimals = Math.max(0, -Math.floor(Math.log10(shown)));
    const label = (/** @type {number} */ n) => fixed(n * shown, decimals);
    const line = (/** @type {number} */ n, /** @type {number[]} */ [xa = 0, ya = 0, xb = 0, yb = 0]) => {
      c.strokeStyle = (n === 0 ? colours.axis : colours.grid) ?? "";
      c.beginPath();
      c.moveTo(xa, ya);
      c.lineTo(xb, yb);
      c.stroke();
    };
    c.lineWidth = 1;
    c.textAlign = "center";
    c.textBaseline = "bottom";
    const [left, low] = [(centre[h] ?? 0) - width / 2 / scale, (centre[v] ?? 0) - height / 2 / scale];
    for (let n = Math.ceil(left / step); n * step <= left + width / scale; n += 1) {
      const x = Math.round((n * step - left) * scale) + 0.5;
      line(n, [x, 0, x, height]);
      if (x > 44 && x < width - 60) c.fillText(label(n), x, height - 4);
    }
    c.textAlign = "left";
    c.textBaseline = "middle";
    for (let n = Math.ceil(low / step); n * step <= low + height / scale; n += 1) {
      const y = Math.round(height - (n * step - low) * scale) + 0.5;
      line(n, [0, y, width, y]);
      if (y > 60 && y < height - 24) c.fillText(label(n), 5, y - 7);
    }
    c.textBaseline = "bottom";
    c.textAlign = "right";
    c.fillText(`${"XYZ"[h]} ${unit}`, width - 6, height - 4);
  }

  /** Draws the axes and a scale in a view without a grid. @param {import("./camera.js").Camera} camera @param {Record<string, string>} colours @param {Lengths} lengths */
  #scale({ scale, height, axes: [right, up] }, colours, { unit, size }) {
    const c = /** @type {CanvasRenderingContext2D} */ (this.#context);
    const shown = gridStep(scale * size);
    const step = shown * size;
    c.strokeStyle = colours.text ?? "";
    c.lineWidth = 1.5;
    c.beginPath();
    c.moveTo(8, height - 12);
    c.lineTo(8, height - 8);
    c.lineTo(8 + step * scale, height - 8);
    c.lineTo(8 + step * scale, height - 12);
    c.stroke();
    c.textAlign = "left";
    c.textBaseline = "bottom";
    c.fillText(`${plain(shown)} ${unit}`, 12, height - 11);
    c.textAlign = "center";
    c.textBaseline = "middle";
    const [x, y, length] = [46, height - 66, 26];
    for (let i = 0; i < 3; i += 1) {
      const [dx, dy] = [/** @type {number} */ (right[i]) * length, -(/** @type {number} */ (up[i])) * length];
      c.beginPath();
      c.moveTo(x, y);
      c.lineTo(x + dx, y + dy);
      c.stroke();
      c.fillText("XYZ".charAt(i), x + dx * 1.35, y + dy * 1.35);
    }
  }
}
