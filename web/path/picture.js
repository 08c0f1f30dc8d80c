// The picture of a path: draws when something has changed, and each frame only while the tool moves.

import { t } from "../language.js";
import { finest, wordOf } from "./bytes.js";
import { Camera } from "./camera.js";
import { findPlace, pick } from "./find.js";
import { Lines } from "./gl.js";
import { Layers } from "./layers.js";
import { Backdrop, boxLines, toolLines, trailLines, zeroLines } from "./scenery.js";

/** @typedef {[number, number, number]} Point */
/** @typedef {import("./bytes.js").Answer} Answer */
/** @typedef {import("./bytes.js").Piece} Piece */

/** How near a click is to a line that it means, px. */
const CLICK_PX = 12;
/** Largest error of a level in the picture, px. */
const ERROR_PX = 0.7;

/**
 * What is shown.
 * @typedef {object} Shown
 * @property {Answer | null} path
 * @property {number} now what is reached by then is done, s
 * @property {Point} tool
 * @property {number} radius of the tool, mm
 * @property {Point} zero of the work coordinates
 * @property {[Point, Point] | null} limits
 * @property {import("../trail.js").Trail | null} trail drawn where there is no plan
 * @property {number} selected place of a word, 0: none
 */

export class Picture {
  camera = new Camera();
  element;
  /** Why nothing is drawn; empty: it is. */
  trouble = "";
  /** Frames drawn, and milliseconds of script that the last one took. */
  frames = 0;
  tookMs = 0;
  #back;
  #canvas;
  /** @type {Lines | null} */
  #lines = null;
  /** @type {Layers | null} */
  #layers = null;
  /** @type {Record<string, string>} */
  #colours = {};
  /** @type {Record<string, number[]>} */
  #numbers = {};
  /** Own lines by what they were made of. @type {Map<string, {key: string, lines: ReturnType<typeof boxLines>}>} */
  #own = new Map();

  /** @param {HTMLCanvasElement} canvas @param {HTMLCanvasElement} back @param {HTMLElement} box */
  constructor(canvas, back, box) {
    this.#canvas = canvas;
    this.element = box;
    this.#back = new Backdrop(back);
    canvas.addEventListener("webglcontextlost", (event) => {
      event.preventDefault();
      [this.#lines, this.#layers] = [null, null];
    });
    canvas.addEventListener("webglcontextrestored", () => this.#begin());
    this.#begin();
  }

  #begin() {
    const gl = this.#canvas.getContext("webgl2", { antialias: false, alpha: true, premultipliedAlpha: true });
    if (!gl) {
      this.trouble = t("path.this_browser_has_no_webgl");
      return;
    }
    try {
      this.#lines = new Lines(gl);
      this.#layers = new Layers(gl, this.#lines);
    } catch (error) {
      this.trouble = error instanceof Error ? error.message : String(error);
    }
  }

  /** Draw calls of the last frame, lines that are seen, bytes uploaded so far, what is kept on the card, and from where the path is seen. */
  get statistics() {
    const { scale, turn, tilt, centre, view } = this.camera;
    return {
      seen: { scale, turn, tilt, centre, view }, calls: this.#lines?.drawn.calls ?? 0, lines: this.#layers?.lines ?? 0,
      uploaded: this.#lines?.uploaded ?? 0, kept: this.#lines?.kept ?? 0, frames: this.frames, tookMs: this.tookMs,
    };
  }

  /** Takes the size of the box and the colours of the scheme. True: it has a size. */
  measure() {
    const ratio = Math.min(devicePixelRatio || 1, 2);
    const [width, height] = [this.element.clientWidth, this.element.clientHeight];
    for (const canvas of [this.#canvas, this.#back.canvas]) {
      if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
        canvas.width = Math.round(width * ratio);
        canvas.height = Math.round(height * ratio);
      }
    }
    [this.camera.width, this.camera.height] = [Math.max(1, width), Math.max(1, height)];
    const style = getComputedStyle(this.#canvas);
    const of = (/** @type {string} */ name) => style.getPropertyValue(name).trim();
    this.#colours = { grid: of("--grid"), axis: of("--grid-axis"), text: of("--muted"), font: style.fontFamily };
    const names = { done: "--accent", rest: "--accent", rapid: "--rapid", picked: "--tool", tool: "--tool", zero: "--text", limits: "--grid-axis" };
    this.#numbers = Object.fromEntries(Object.entries(names).map(([name, css]) => [name, numbers(of(css))]));
    return width > 0 && height > 0;
  }

  /** True: there is more to draw in a further frame. @param {Shown} shown @param {(chunk: number) => void} refine asks for finer levels */
  draw(shown, refine) {
    const [lines, layers] = [this.#lines, this.#layers];
    if (!lines || !layers) return false;
    const began = performance.now();
    const { camera } = this;
    const { path, limits } = shown;
    const zero = shown.zero.map((value) => Math.round(value * 1e4) / 1e4);
    const view = { matrix: camera.matrix, scale: camera.scale, ratio: this.#canvas.width / Math.max(1, this.element.clientWidth) };
    const look = {
      dependsAt: path?.dependsAt ?? Infinity, selected: shown.selected || 0x7fffffff,
      colours: /** @type {import("./gl.js").Look["colours"]} */ (this.#numbers),
    };
    lines.drawn = { calls: 0, lines: 0 };
    lines.look = look;
    const key = JSON.stringify([look.dependsAt, look.selected, look.colours, limits, zero]);
    const isMore = layers.draw(
      { key, view, now: shown.now, ...this.#pieces(path, view.ratio, refine), scenery: () => this.#scenery(lines, limits, zero) },
      () => this.#over(lines, shown),
    );
    this.frames += 1;
    this.tookMs = performance.now() - began;
    return isMore;
  }

  /** The coarsest level that is exact to the pixel. @param {Answer} path @param {number} ratio pixels of the canvas per px */
  #level({ tolerances }, ratio) {
    let level = 0;
    while (level + 1 < tolerances.length && (tolerances[level + 1] ?? 0) * this.camera.scale * ratio < ERROR_PX) level += 1;
    return level;
  }

  /** What is seen of a path, exact to the pixel and coarse. @param {Answer | null} path @param {number} ratio @param {(chunk: number) => void} refine */
  #pieces(path, ratio, refine) {
    /** @type {{wanted: Piece[], coarse: Piece[]}} */
    const pieces = { wanted: [], coarse: [] };
    if (!path) return pieces;
    const { camera } = this;
    const level = this.#level(path, ratio);
    path.chunks.forEach((chunk, i) => {
      if (!camera.sees(chunk.low, chunk.high)) return;
      const piece = chunk.levels[level] ?? chunk.levels.find((one, other) => other > level && one) ?? finest(chunk);
      if (!chunk.levels.slice(0, level + 1).some((one) => one)) refine(i);
      if (!piece) return;
      pieces.wanted.push(piece);
      pieces.coarse.push(chunk.levels.findLast((one) => one) ?? piece);
    });
    return pieces;
  }

  /** @param {Lines} lines @param {Shown["limits"]} limits @param {number[]} zero */
  #scenery(lines, limits, zero) {
    if (limits) {
      lines.place([0, 0, 0], this.#numbers.limits);
      lines.draw(this.#made("limits", limits.flat().join(), () => boxLines(limits[0], limits[1])));
    }
    lines.place(zero, this.#numbers.zero);
    lines.draw(this.#made("zero", String(this.camera.scale), () => zeroLines(this.camera)));
  }

  /** What is over the path: where the tool has been without a plan, and the tool. @param {Lines} lines @param {Shown} shown */
  #over(lines, { trail, tool, radius }) {
    const { camera } = this;
    if (trail && trail.points.length > 1) {
      lines.place([0, 0, 0], this.#numbers.done);
      lines.draw(this.#made("trail", String(trail.revision), () => trailLines(trail.points)));
    }
    lines.place(tool, this.#numbers.tool);
    lines.draw(this.#made("tool", [radius, camera.scale, camera.turn, camera.tilt].join(), () => toolLines(radius, camera)));
  }

  /** @param {string} name @param {string} key @param {() => ReturnType<typeof boxLines>} make */
  #made(name, key, make) {
    const known = this.#own.get(name);
    if (known?.key === key) return known.lines;
    if (known) this.#lines?.forget(known.lines.bytes);
    const lines = make();
    this.#own.set(name, { key, lines });
    return lines;
  }

  /** Gives back what no longer is shown. @param {Answer | null} path */
  tidy(path) {
    const used = new Set([...this.#own.values()].map(({ lines }) => lines.bytes));
    for (const chunk of path?.chunks ?? []) for (const piece of chunk.levels) if (piece) used.add(piece.bytes);
    this.#lines?.keepOnly(used);
  }

  drawBackdrop() {
    this.#back.draw(this.camera, this.#back.canvas.width / Math.max(1, this.element.clientWidth), this.#colours);
  }

  /** The place of the line at a point of the picture. @param {Answer | null} path @param {number} x @param {number} y */
  pick(path, x, y) {
    return path && pick(path, this.camera, x, y, CLICK_PX, this.#level(path, 1));
  }

  /** The place of a block on the path; 0: it has none. @param {Answer} path @param {number} program @param {number} line */
  placeOf(path, program, line) {
    const word = wordOf(program, line, path.programs);
    return word > 0 && findPlace(path, word) ? word : 0;
  }
}

/** A colour of the style sheet, `#rrggbb`, as numbers. @param {string} text */
function numbers(text) {
  const digits = /^#([0-9a-f]{6})$/i.exec(text)?.[1] ?? "808080";
  return [...[0, 2, 4].map((i) => parseInt(digits.slice(i, i + 2), 16) / 255), 1];
}
