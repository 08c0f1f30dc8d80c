// The picture of a path: orders a drawing when something has changed, and in each frame only while the tool moves.

import { t } from "../text/language.js";
import { wordOf } from "./bytes.js";
import { Camera } from "./camera.js";
import { findWord, finest, pick } from "./find.js";
import { RenderQueue } from "./render_queue.js";
import { Backdrop, boxLines, toolLines, trailLines, zeroLines } from "./static_layer.js";

/** @typedef {[number, number, number]} Point */
/** @typedef {import("./bytes.js").Answer} Answer */
/** @typedef {import("./renderer.js").PlacedLines} PlacedLines */
/** @typedef {import("./renderer.js").Report} Report */
/** @typedef {import("./vertex.js").Piece} Piece */

/** Distance from a click within which a line is selected, px. */
const CLICK_PX = 12;
/** Largest error of a level in the picture, px. */
const ERROR_PX = 0.7;

/**
 * The content to show.
 * @typedef {object} PictureContent
 * @property {Answer | null} path
 * @property {number} now the path up to this time is done, s
 * @property {Point} tool
 * @property {number} radius of the tool, mm
 * @property {Point} zero of the work coordinates
 * @property {[Point, Point] | null} limits
 * @property {import("../machine/trail.js").Trail | null} trail drawn if there is no plan
 * @property {number} selected place of a word, 0: none
 */

export class Picture {
  camera = new Camera();
  element;
  /** Reason why nothing is drawn; empty if the path is drawn. */
  trouble = "";
  /** Script time of the last order, ms. */
  tookMs = 0;
  #back;
  #canvas;
  #renderQueue;
  #changed;
  /** @type {Report} */
  #report = { trouble: null, frames: 0, calls: 0, lines: 0, uploaded: 0, kept: 0 };
  /** Size of the canvas. @type {[number, number]} */
  #size = [1, 1];
  /** @type {Record<string, string>} */
  #colours = {};
  /** @type {Record<string, number[]>} */
  #numbers = {};
  /** Own lines, with the key of their inputs. @type {Map<string, {key: string, bytes: ArrayBuffer}>} */
  #own = new Map();
  /** Ids of the vertices that the renderer has. @type {Map<ArrayBuffer, number>} */
  #known = new Map();
  #lastId = 0;
  /**
   * Vertices that the next order adds or removes.
   * @type {{added: {id: number, bytes: ArrayBuffer}[], forgotten: number[]}}
   */
  #news = { added: [], forgotten: [] };
  /** Pieces of the last order. @type {{wanted: Piece[], coarse: Piece[]}} */
  #pieces = { wanted: [], coarse: [] };

  /** @param {HTMLCanvasElement} canvas @param {HTMLCanvasElement} back @param {HTMLElement} box @param {() => void}
   * changed called when a problem appears or disappears */
  constructor(canvas, back, box, changed) {
    this.#canvas = canvas;
    this.element = box;
    this.#changed = changed;
    this.#back = new Backdrop(back);
    this.#renderQueue = new RenderQueue(canvas, (report) => this.#on(report));
  }

  /** Stops drawing permanently. */
  stop() {
    this.#renderQueue.stop();
  }

  /** @param {Report} report */
  #on(report) {
    this.#report = report;
    const trouble = report.trouble ? TROUBLES[report.trouble.of](report.trouble.log) : "";
    if (trouble === this.trouble) return;
    this.trouble = trouble;
    this.#changed();
  }

  /** Returns the draw calls of the last frame, visible lines, bytes uploaded so far, data kept on the card, and the
   * view. */
  get statistics() {
    const { scale, turn, tilt, centre, view } = this.camera;
    return { ...this.#report, seen: { scale, turn, tilt, centre, view }, tookMs: this.tookMs };
  }

  /** Reads the size of the box and the colours of the scheme. Returns true if the size is not zero. */
  measure() {
    const ratio = Math.min(devicePixelRatio || 1, 2);
    const [width, height] = [this.element.clientWidth, this.element.clientHeight];
    this.#size = [Math.max(1, Math.round(width * ratio)), Math.max(1, Math.round(height * ratio))];
    const { canvas } = this.#back;
    if (canvas.width !== this.#size[0] || canvas.height !== this.#size[1]) [canvas.width, canvas.height] = this.#size;
    [this.camera.width, this.camera.height] = [Math.max(1, width), Math.max(1, height)];
    const style = getComputedStyle(this.#canvas);
    const of = (/** @type {string} */ name) => style.getPropertyValue(name).trim();
    this.#colours = { grid: of("--grid"), axis: of("--grid-axis"), text: of("--muted"), font: style.fontFamily };
    const names = { done: "--accent", rest: "--accent", rapid: "--rapid", picked: "--tool", tool: "--tool", zero: "--text", limits: "--grid-axis" };
    this.#numbers = Object.fromEntries(Object.entries(names).map(([name, css]) => [name, numbers(of(css))]));
    return width > 0 && height > 0;
  }

  /** Orders a drawing; a slow one is coarse at first. @param {PictureContent} shown @param {(chunk: number) => void} refine asks for finer levels */
  draw(shown, refine) {
    if (this.trouble) return;
    const began = performance.now();
    const { path, limits } = shown;
    const zero = shown.zero.map((value) => Math.round(value * 1e4) / 1e4);
    const view = { matrix: this.camera.matrix, scale: this.camera.scale, ratio: this.#size[0] / Math.max(1, this.element.clientWidth) };
    const look = {
      dependsAt: path?.dependsAt ?? Infinity, selected: shown.selected || 0x7fffffff,
      colours: /** @type {import("./gl.js").Look["colours"]} */ (this.#numbers),
    };
    const key = JSON.stringify([look.dependsAt, look.selected, look.colours, limits, zero]);
    const seen = this.#seen(path, view.ratio, refine);
    const [behind, over] = [this.#staticLayer(limits, zero), this.#over(shown)];
    const isOther = !isSame(seen.wanted, this.#pieces.wanted) || !isSame(seen.coarse, this.#pieces.coarse);
    const pieces = isOther ? { wanted: this.#numbersOf(seen.wanted), coarse: this.#numbersOf(seen.coarse) } : null;
    this.#pieces = seen;
    this.#renderQueue.enqueue({ size: this.#size, ...this.#news, pieces, key, view, look, now: shown.now, behind, over });
    this.#news = { added: [], forgotten: [] };
    this.tookMs = performance.now() - began;
  }

  /**
   * Returns the coarsest level that is exact to the pixel.
   * @param {Answer} path @param {number} ratio pixels of the canvas per px
   */
  #level({ tolerances }, ratio) {
    let level = 0;
    while (level + 1 < tolerances.length && (tolerances[level + 1] ?? 0) * this.camera.scale * ratio < ERROR_PX) level += 1;
    return level;
  }

  /**
   * Returns the visible pieces of a path, exact to the pixel and coarse.
   * @param {Answer | null} path @param {number} ratio @param {(chunk: number) => void} refine
   */
  #seen(path, ratio, refine) {
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

  /** @param {PictureContent["limits"]} limits @param {number[]} zero @returns {PlacedLines[]} */
  #staticLayer(limits, zero) {
    const placed = [{ id: this.#ownLinesId("zero", String(this.camera.scale), () => zeroLines(this.camera)), at: zero, colour: this.#numbers.zero }];
    if (limits) placed.unshift({ id: this.#ownLinesId("limits", limits.flat().join(), () => boxLines(limits[0], limits[1])), at: [0, 0, 0], colour: this.#numbers.limits });
    return placed;
  }

  /**
   * Returns the overlay of the path: the trail if there is no plan, and the tool.
   * @param {PictureContent} shown @returns {PlacedLines[]}
   */
  #over({ trail, tool, radius }) {
    const { camera } = this;
    const placed = [{ id: this.#ownLinesId("tool", [radius, camera.scale, camera.turn, camera.tilt].join(), () => toolLines(radius, camera)), at: tool, colour: this.#numbers.tool }];
    if (trail && trail.points.length > 1) {
      placed.unshift({ id: this.#ownLinesId("trail", String(trail.revision), () => trailLines(trail.points)), at: [0, 0, 0], colour: this.#numbers.done });
    }
    return placed;
  }

  /** Returns the id of own lines. @param {string} name @param {string} key @param {() => ArrayBuffer} make */
  #ownLinesId(name, key, make) {
    const known = this.#own.get(name);
    if (known?.key === key) return this.#idOf(known.bytes);
    if (known) this.#forget(known.bytes);
    const bytes = make();
    this.#own.set(name, { key, bytes });
    return this.#idOf(bytes);
  }

  /** @param {ArrayBuffer} bytes */
  #idOf(bytes) {
    const known = this.#known.get(bytes);
    if (known !== undefined) return known;
    this.#lastId += 1;
    this.#known.set(bytes, this.#lastId);
    this.#news.added.push({ id: this.#lastId, bytes });
    return this.#lastId;
  }

  /** @param {ArrayBuffer} bytes */
  #forget(bytes) {
    const id = this.#known.get(bytes);
    if (id !== undefined) this.#news.forgotten.push(id);
    this.#known.delete(bytes);
  }

  /** @param {Piece[]} pieces */
  #numbersOf(pieces) {
    return Uint32Array.from(pieces.flatMap(({ bytes, offset, count }) => [this.#idOf(bytes), offset, count]));
  }

  /** Releases data that is no longer shown. @param {Answer | null} path */
  tidy(path) {
    const used = new Set([...this.#own.values()].map(({ bytes }) => bytes));
    for (const chunk of path?.chunks ?? []) for (const piece of chunk.levels) if (piece) used.add(piece.bytes);
    for (const bytes of this.#known.keys()) if (!used.has(bytes)) this.#forget(bytes);
  }

  /** @param {import("./static_layer.js").Lengths} lengths the unit that it names */
  drawBackdrop(lengths) {
    this.#back.draw(this.camera, this.#back.canvas.width / Math.max(1, this.element.clientWidth), this.#colours, lengths);
  }

  /**
   * Returns the word index of the line at a point of the picture.
   * @param {Answer | null} path @param {number} x @param {number} y
   */
  pick(path, x, y) {
    return path && pick(path, this.camera, x, y, CLICK_PX, this.#level(path, 1));
  }

  /**
   * Returns the word index of a block on the path; 0 if it has none.
   * @param {Answer} path @param {number} program @param {number} line
   */
  wordIndexOf(path, program, line) {
    const word = wordOf(program, line, path.programs);
    return word > 0 && findWord(path, word) ? word : 0;
  }
}

/** Messages for each trouble. @type {Record<import("./gl.js").Trouble["of"], (log: string) => string>} */
const TROUBLES = {
  webgl: () => t("path.this_browser_has_no_webgl"),
  shader: () => t("path.webgl_gives_no_shader"),
  shaders: (log) => t("path.webgl_refused_shaders", { log }),
};

/** @template T @param {T[]} one @param {T[]} other */
function isSame(one, other) {
  return one.length === other.length && one.every((value, i) => value === other[i]);
}

/** Converts a colour of the style sheet, `#rrggbb`, to numbers. @param {string} text */
function numbers(text) {
  const digits = /^#([0-9a-f]{6})$/i.exec(text)?.[1] ?? "808080";
  return [...[0, 2, 4].map((i) => parseInt(digits.slice(i, i + 2), 16) / 255), 1];
}
