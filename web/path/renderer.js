// Draws the pictures that are ordered: in a worker, so that the page never waits for the card, or in the page if the browser
// has no such worker. It keeps received vertices under their id.

import { Lines, trouble } from "./gl.js";
import { Layers } from "./layers.js";
import { VERTEX_BYTES } from "./vertex.js";

/** @typedef {import("./gl.js").Look} Look */
/** @typedef {import("./gl.js").Trouble} Trouble */
/** @typedef {import("./vertex.js").Piece} Piece */

/** Numbers of a piece in a list of pieces: of its bytes, of the byte where it begins, of its vertices. */
const PIECE_NUMBERS = 3;

/**
 * Lines that the page makes, in addition to the path.
 * @typedef {object} PlacedLines
 * @property {number} id of their vertices
 * @property {ArrayLike<number>} at their origin, mm
 * @property {number[] | undefined} colour
 */

/**
 * A drawing to make, with the necessary data.
 * @typedef {object} Order
 * @property {[number, number]} size of the canvas
 * @property {{id: number, bytes: ArrayBuffer}[]} added vertices that are sent for the first time
 * @property {number[]} forgotten vertices that are no longer needed
 * @property {{wanted: Uint32Array, coarse: Uint32Array} | null} pieces see `Scene` of the layers, in triples of numbers; null: as before
 * @property {string} key see `Scene` of the layers
 * @property {import("./gl.js").View} view
 * @property {Look} look
 * @property {number} now s
 * @property {PlacedLines[]} behind the path
 * @property {PlacedLines[]} over the path
 */

/**
 * Result of a drawing: totals since the start, except the values of the last frame.
 * @typedef {object} Report
 * @property {Trouble | null} trouble
 * @property {number} frames
 * @property {number} calls of the last frame
 * @property {number} lines that are visible
 * @property {number} uploaded bytes
 * @property {number} kept sets of vertices on the card
 */

export class Renderer {
  #canvas;
  #report;
  /** @type {Lines | null} */
  #lines = null;
  /** @type {Layers | null} */
  #layers = null;
  /** @type {Map<number, Vertices>} */
  #vertices = new Map();
  /** @type {Order | null} */
  #order = null;
  /** @type {{wanted: Piece[], coarse: Piece[]}} */
  #pieces = { wanted: [], coarse: [] };
  #frame = 0;
  #frames = 0;

  /** @param {HTMLCanvasElement | OffscreenCanvas} canvas @param {(report: Report) => void} report after each frame */
  constructor(canvas, report) {
    this.#canvas = canvas;
    this.#report = report;
    canvas.addEventListener("webglcontextlost", (event) => {
      event.preventDefault();
      [this.#lines, this.#layers] = [null, null];
    });
    canvas.addEventListener("webglcontextrestored", () => this.#begin());
    this.#begin();
  }

  #begin() {
    const gl = /** @type {WebGL2RenderingContext | null} */ (this.#canvas.getContext("webgl2", { antialias: false, alpha: true, premultipliedAlpha: true }));
    try {
      if (!gl) throw trouble("webgl");
      this.#lines = new Lines(gl);
      this.#layers = new Layers(gl, this.#lines);
    } catch (error) {
      this.#reportFrame(/** @type {Trouble} */ (error));
    }
    this.#request();
  }

  /** Draws an order from the next frame on. @param {Order} order */
  setOrder(order) {
    for (const { id, bytes } of order.added) this.#vertices.set(id, new Vertices(bytes));
    if (order.pieces) this.#pieces = { wanted: this.#piecesOf(order.pieces.wanted), coarse: this.#piecesOf(order.pieces.coarse) };
    for (const id of order.forgotten) {
      const known = this.#vertices.get(id);
      if (known) this.#lines?.forget(known.bytes);
      this.#vertices.delete(id);
    }
    this.#order = order;
    this.#request();
  }

  /** @param {Uint32Array} numbers */
  #piecesOf(numbers) {
    /** @type {Piece[]} */
    const pieces = [];
    for (let i = 0; i < numbers.length; i += PIECE_NUMBERS) {
      const [id = 0, offset = 0, count = 0] = numbers.subarray(i, i + PIECE_NUMBERS);
      const piece = this.#vertices.get(id)?.piece(offset, count);
      if (piece) pieces.push(piece);
    }
    return pieces;
  }

  #request() {
    this.#frame ||= requestAnimationFrame(() => {
      this.#frame = 0;
      this.#draw();
    });
  }

  #draw() {
    const [lines, layers, order] = [this.#lines, this.#layers, this.#order];
    if (!lines || !layers || !order) return;
    const [width, height] = order.size;
    if (this.#canvas.width !== width || this.#canvas.height !== height) [this.#canvas.width, this.#canvas.height] = [width, height];
    const { key, view, now, behind, over } = order;
    lines.drawn = { calls: 0, lines: 0 };
    lines.look = order.look;
    const isMore = layers.draw({ key, view, now, ...this.#pieces, staticLayer: () => this.#drawPlaced(lines, behind) }, () => this.#drawPlaced(lines, over));
    this.#frames += 1;
    this.#reportFrame(null);
    if (isMore) this.#request();
  }

  /** @param {Lines} lines @param {PlacedLines[]} placed */
  #drawPlaced(lines, placed) {
    for (const { id, at, colour } of placed) {
      const known = this.#vertices.get(id);
      if (!known) continue;
      lines.place(at, colour);
      lines.draw(known.piece(0, known.bytes.byteLength / VERTEX_BYTES));
    }
  }

  /** @param {Trouble | null} trouble */
  #reportFrame(trouble) {
    this.#report({
      trouble, frames: this.#frames, calls: this.#lines?.drawn.calls ?? 0, lines: this.#layers?.lines ?? 0,
      uploaded: this.#lines?.uploaded ?? 0, kept: this.#lines?.kept ?? 0,
    });
  }
}

/** Vertices of one answer, and their requested pieces. */
class Vertices {
  /** @type {Map<number, Piece>} by their first byte */
  #pieces = new Map();

  /** @param {ArrayBuffer} bytes */
  constructor(bytes) {
    this.bytes = bytes;
    this.floats = new Float32Array(bytes);
    this.words = new Uint32Array(bytes);
  }

  /** Returns a piece, the same object for the same place. @param {number} offset byte @param {number} count of vertices @returns {Piece} */
  piece(offset, count) {
    const known = this.#pieces.get(offset);
    if (known) return known;
    const { bytes, floats, words } = this;
    const piece = { bytes, offset, count, floats, words, first: offset / 4 };
    this.#pieces.set(offset, piece);
    return piece;
  }
}
