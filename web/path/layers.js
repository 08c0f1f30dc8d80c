// The picture of a path, kept while the tool moves over it. New parts are drawn in a hidden layer, in each frame only
// as much as the graphics card completes in time: first the coarse lines, then the lines that are exact to the pixel.
// The page never waits for the card.

import { lengthOf, linesBetween } from "./vertex.js";

/** @typedef {import("./vertex.js").Piece} Piece */
/** @typedef {import("./gl.js").View} View */

/** Cost limits of one frame, in lines of zero length: initial, lowest, highest. */
const BUDGET = { first: 4_000, least: 1_000, most: 4_000_000 };
/** A card that needs less than `FAST_MS` for a frame gets more work; above `SLOW_MS` it gets less. */
const FAST_MS = 26;
const SLOW_MS = 40;
/** Time after which a card without a response is no longer queried, ms. */
const SILENT_MS = 2_000;
/** Length in canvas pixels that costs as much as a line of zero length: a line costs 1 + length / this. */
const PX_OF_A_LINE = 25;

/**
 * The content to draw.
 * @typedef {object} Scene
 * @property {string} key of everything in the scene except the members below
 * @property {View} view
 * @property {Piece[]} wanted exact to the pixel
 * @property {Piece[]} coarse the same chunks with the fewest lines available
 * @property {number} now the path up to this time is done, s
 * @property {() => void} staticLayer draws the static content behind the path
 */

/**
 * A scene that is drawn, or is being drawn.
 * @typedef {object} Drawn
 * @property {Scene} scene
 * @property {boolean} isFine a coarse picture of the scene is shown, so this drawing is abandoned when another scene is needed
 * @property {Piece[]} pieces
 * @property {number} piece index of the next piece, and
 * @property {number} line of its next line
 * @property {number} lines drawn so far
 */

export class Layers {
  /** @type {Drawn | null} the shown scene */
  shown = null;
  /** @type {Drawn | null} the scene being drawn in the hidden layer */
  #drawing = null;
  #budget = BUDGET.first;
  /** Work that the card has not finished yet. @type {{fence: WebGLSync, at: number, cost: number} | null} */
  #asked = null;
  #spent = 0;
  /** Size of the canvas. */
  #size = "";
  /** Number of lines over the path. */
  #over = 0;
  #gl;
  #lines;
  /** The shown layer and the hidden one. */
  /** @type {Layer} */
  #front;
  /** @type {Layer} */
  #back;

  /** @param {WebGL2RenderingContext} gl @param {import("./gl.js").Lines} lines */
  constructor(gl, lines) {
    this.#gl = gl;
    this.#lines = lines;
    [this.#front, this.#back] = [new Layer(gl), new Layer(gl)];
  }

  /**
   * Draws a part of the scene, and its overlay. Returns true if more remains to be drawn.
   * @param {Scene} scene @param {() => void} over
   */
  draw(scene, over) {
    if (this.#isBusy()) return true;
    this.#spent = 0;
    const size = `${this.#gl.drawingBufferWidth} ${this.#gl.drawingBufferHeight}`;
    if (size !== this.#size) [this.shown, this.#drawing, this.#size] = [null, null, size];
    if (this.#drawing?.isFine && !goesOn(this.#drawing.scene, scene)) this.#drawing = null;
    if (!this.#drawing) {
      const isShown = this.shown !== null && goesOn(this.shown.scene, scene);
      const isExact = isShown && isSame(this.shown?.pieces, scene.wanted);
      if (!isExact || !this.#goOn(scene)) this.#begin(scene, isShown && !isExact);
    }
    if (this.#drawing) this.#work(this.#drawing);
    this.#show(this.shown?.scene ?? scene, over);
    this.#ask();
    return this.#drawing !== null || !isSame(this.shown?.pieces, scene.wanted);
  }

  /** Number of lines that are shown. */
  get lines() {
    return (this.shown?.lines ?? 0) + this.#over;
  }

  /** @param {Scene} scene @param {boolean} isFine whether a coarse picture of the scene is shown */
  #begin(scene, isFine) {
    this.#spent = 0;
    const isCheap = isFine || scene.wanted.reduce((sum, piece) => sum + costOf(piece, scene.view), 0) <= this.#budget;
    const isOne = isCheap || isSame(scene.wanted, scene.coarse);
    this.#drawing = { scene, isFine, pieces: isOne ? scene.wanted : scene.coarse, piece: 0, line: 0, lines: 0 };
    this.#back.begin();
    this.#lines.begin(scene.view, scene.now);
    this.#lines.clear();
    const { lines } = this.#lines.drawn;
    scene.staticLayer();
    this.#drawing.lines = this.#lines.drawn.lines - lines;
  }

  /** Draws as much as the card completes in time, and shows a complete picture. @param {Drawn} drawing */
  #work(drawing) {
    this.#back.begin();
    this.#lines.begin(drawing.scene.view, drawing.scene.now);
    for (let piece = drawing.pieces[drawing.piece]; piece; piece = drawing.pieces[drawing.piece]) {
      const most = Math.max(1, piece.count - 1);
      const each = costOf(piece, drawing.scene.view) / most;
      const count = Math.min(most - drawing.line, Math.max(1, Math.floor((this.#budget - this.#spent) / each)));
      this.#lines.draw(piece, drawing.line, count);
      this.#spent += count * each;
      drawing.lines += count;
      drawing.line += count;
      if (drawing.line >= most) [drawing.piece, drawing.line] = [drawing.piece + 1, 0];
      if (this.#spent >= this.#budget) break;
    }
    if (drawing.piece < drawing.pieces.length) return;
    [this.#front, this.#back] = [this.#back, this.#front];
    [this.shown, this.#drawing] = [drawing, null];
  }

  /**
   * Draws the newly done part over the part to come. Returns false if that is too much for one frame.
   * @param {Scene} scene
   */
  #goOn(scene) {
    const { shown } = this;
    const from = shown?.scene.now ?? scene.now;
    if (!shown || scene.now === from) return true;
    const since = shown.pieces.map((piece) => ({ piece, ...linesBetween(piece, from, scene.now) })).filter(({ count }) => count > 0);
    this.#spent = since.reduce((sum, { piece, count }) => sum + (costOf(piece, scene.view) * count) / piece.count, 0);
    if (this.#spent > this.#budget) return false;
    this.#front.begin();
    this.#lines.begin(scene.view, scene.now, Math.max(0, from));
    for (const { piece, first, count } of since) this.#lines.draw(piece, first, count);
    shown.scene = scene;
    return true;
  }

  /** @param {Scene} scene @param {() => void} over */
  #show({ view, now }, over) {
    const gl = this.#gl;
    gl.bindFramebuffer(gl.DRAW_FRAMEBUFFER, null);
    // the browser clears the shown buffer before a drawing, but not before a copy
    this.#lines.clear();
    if (this.shown) this.#front.copy();
    this.#lines.begin(view, now);
    const { lines } = this.#lines.drawn;
    over();
    this.#over = this.#lines.drawn.lines - lines;
  }

  /** Inserts a fence that reports when the card has drawn this. */
  #ask() {
    const gl = this.#gl;
    const fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    gl.flush();
    this.#asked = fence && { fence, at: performance.now(), cost: this.#spent };
  }

  /** Returns true while the card draws; the time taken sets the next budget. */
  #isBusy() {
    const gl = this.#gl;
    if (!this.#asked) return false;
    const { fence, at, cost } = this.#asked;
    const took = performance.now() - at;
    if (gl.getSyncParameter(fence, gl.SYNC_STATUS) !== gl.SIGNALED && took < SILENT_MS) return true;
    gl.deleteSync(fence);
    this.#asked = null;
    if (cost < this.#budget / 2) return false;
    if (took < FAST_MS) this.#budget = Math.min(BUDGET.most, this.#budget * 1.5);
    else if (took > SLOW_MS) this.#budget = Math.max(BUDGET.least, (this.#budget * FAST_MS) / took);
    return false;
  }
}

/** An off-screen picture. */
class Layer {
  size = "";
  #gl;
  #frame;
  /** @type {WebGLRenderbuffer | null} */
  #buffer = null;

  /** @param {WebGL2RenderingContext} gl */
  constructor(gl) {
    this.#gl = gl;
    this.#frame = gl.createFramebuffer();
  }

  /** Directs the following drawing into this layer. */
  begin() {
    const gl = this.#gl;
    const [width, height] = [gl.drawingBufferWidth, gl.drawingBufferHeight];
    gl.bindFramebuffer(gl.DRAW_FRAMEBUFFER, this.#frame);
    if (this.size === `${width} ${height}`) return;
    this.size = `${width} ${height}`;
    gl.deleteRenderbuffer(this.#buffer);
    this.#buffer = gl.createRenderbuffer();
    gl.bindRenderbuffer(gl.RENDERBUFFER, this.#buffer);
    gl.renderbufferStorage(gl.RENDERBUFFER, gl.RGBA8, width, height);
    gl.framebufferRenderbuffer(gl.DRAW_FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.RENDERBUFFER, this.#buffer);
  }

  /** Copies it to the current drawing target. */
  copy() {
    const gl = this.#gl;
    const [width, height] = [gl.drawingBufferWidth, gl.drawingBufferHeight];
    gl.bindFramebuffer(gl.READ_FRAMEBUFFER, this.#frame);
    gl.blitFramebuffer(0, 0, width, height, 0, 0, width, height, gl.COLOR_BUFFER_BIT, gl.NEAREST);
  }
}

/** Returns the cost of a piece, in lines of zero length. @param {Piece} piece @param {View} view */
function costOf(piece, { scale, ratio }) {
  return piece.count + (lengthOf(piece) * scale * ratio) / PX_OF_A_LINE;
}

/**
 * Returns true if the drawing of one scene is a part of the other one, which differs at most by a later time.
 * @param {Scene} one @param {Scene} other
 */
function goesOn(one, other) {
  return one.key === other.key && isSame(one.view.matrix, other.view.matrix) && isSame(one.wanted, other.wanted) && other.now >= one.now;
}

/** @template T @param {ArrayLike<T> | undefined} one @param {ArrayLike<T>} other */
function isSame(one, other) {
  if (one === other) return true;
  if (one?.length !== other.length) return false;
  for (let i = 0; i < other.length; i += 1) if (one[i] !== other[i]) return false;
  return true;
}
