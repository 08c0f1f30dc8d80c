// Viewpoint of the path: a parallel projection, so that lengths are to scale in every view.

/** @typedef {[number, number, number]} Point */

/** Angles of the views, rad: around Z, and up from the plane of X and Y. */
const VIEWS = {
  XY: [0, Math.PI / 2],
  XZ: [0, 0],
  YZ: [Math.PI / 2, 0],
  ISO: [-Math.PI / 4, Math.asin(Math.tan(Math.PI / 6))],
};
/** @typedef {keyof typeof VIEWS} ViewName */

export const VIEW_NAMES = /** @type {ViewName[]} */ (Object.keys(VIEWS));

/** Scales, px per mm. */
const SCALE_MIN = 1e-3;
const SCALE_MAX = 1e4;
/** Margin around the fitted content, as a share of the picture. */
const MARGIN = 0.08;
/** Smallest size fitted in, mm. */
const SIZE_MIN = 10;

export class Camera {
  /** @type {Point} in the middle of the picture */
  centre = [0, 0, 0];
  /** px per mm */
  scale = 1;
  turn = 0;
  tilt = Math.PI / 2;
  width = 1;
  height = 1;
  /** @type {ViewName | ""} */
  view = "XY";
  /** True while the fitted content is shown, until the user moves the view. */
  isFitted = true;

  /** @param {ViewName} view */
  look(view) {
    this.view = view;
    [this.turn, this.tilt] = /** @type {[number, number]} */ (VIEWS[view]);
  }

  /** Directions of the picture: to the right, up, towards the eye. @returns {[Point, Point, Point]} */
  get axes() {
    const [ct, st, cp, sp] = [Math.cos(this.turn), Math.sin(this.turn), Math.cos(this.tilt), Math.sin(this.tilt)];
    return [[ct, st, 0], [-st * sp, ct * sp, cp], [st * cp, -ct * cp, sp]];
  }

  /** Returns a point in the picture, px from its upper left corner. @param {ArrayLike<number>} at @returns {[number, number]} */
  project(at) {
    const [right, up] = this.axes;
    const off = /** @type {Point} */ ([0, 1, 2].map((i) => (at[i] ?? 0) - /** @type {number} */ (this.centre[i])));
    return [this.width / 2 + dot(off, right) * this.scale, this.height / 2 - dot(off, up) * this.scale];
  }

  /** Returns the matrix of the projection, by columns. */
  get matrix() {
    const [right, up, eye] = this.axes;
    const [x, y] = [(2 * this.scale) / this.width, (2 * this.scale) / this.height];
    const z = 1e-5;
    const rows = [right.map((a) => a * x), up.map((a) => a * y), eye.map((a) => -a * z)];
    const shift = rows.map((row) => -dot(/** @type {Point} */ (row), this.centre));
    return new Float32Array([0, 1, 2].flatMap((i) => [...rows.map((row) => /** @type {number} */ (row[i])), 0]).concat([...shift, 1]));
  }

  /** Returns the bounds of a projected box, px. @param {Point} low @param {Point} high */
  boxOf(low, high) {
    const box = { left: Infinity, right: -Infinity, top: Infinity, bottom: -Infinity };
    for (let corner = 0; corner < 8; corner += 1) {
      const [x, y] = this.project([0, 1, 2].map((i) => /** @type {number} */ ((corner >> i) & 1 ? high[i] : low[i])));
      box.left = Math.min(box.left, x);
      box.right = Math.max(box.right, x);
      box.top = Math.min(box.top, y);
      box.bottom = Math.max(box.bottom, y);
    }
    return box;
  }

  /** Returns true if a part of the box is in the picture. @param {Point} low @param {Point} high */
  sees(low, high) {
    const { left, right, top, bottom } = this.boxOf(low, high);
    return right >= 0 && left <= this.width && bottom >= 0 && top <= this.height;
  }

  /** Shows the whole box. @param {Point} low @param {Point} high */
  fit(low, high) {
    if (!low.every(Number.isFinite) || !high.every(Number.isFinite)) return;
    this.centre = /** @type {Point} */ ([0, 1, 2].map((i) => (/** @type {number} */ (low[i]) + /** @type {number} */ (high[i])) / 2));
    this.scale = 1;
    this.isFitted = true;
    const { left, right, top, bottom } = this.boxOf(low, high);
    const free = 1 - 2 * MARGIN;
    const [width, height] = [Math.max(right - left, SIZE_MIN), Math.max(bottom - top, SIZE_MIN)];
    this.scale = clamp(Math.min((this.width * free) / width, (this.height * free) / height));
  }

  /** @param {number} dx px @param {number} dy px */
  orbit(dx, dy) {
    this.view = "";
    this.isFitted = false;
    this.turn -= dx * 0.008;
    this.tilt = Math.max(-Math.PI / 2, Math.min(Math.PI / 2, this.tilt + dy * 0.008));
  }

  /** @param {number} dx px @param {number} dy px */
  pan(dx, dy) {
    this.isFitted = false;
    const [right, up] = this.axes;
    this.centre = /** @type {Point} */ (this.centre.map((at, i) => at - (/** @type {number} */ (right[i]) * dx - /** @type {number} */ (up[i]) * dy) / this.scale));
  }

  /** Zooms about a point of the picture. @param {number} factor @param {number} x px @param {number} y px */
  zoom(factor, x, y) {
    const before = this.scale;
    this.scale = clamp(this.scale * factor);
    const share = 1 - before / this.scale;
    this.pan(-(x - this.width / 2) * share * (this.scale / before), -(y - this.height / 2) * share * (this.scale / before));
  }
}

/** @param {number} scale */
function clamp(scale) {
  return Math.max(SCALE_MIN, Math.min(SCALE_MAX, scale));
}

/** @param {Point} a @param {Point} b */
function dot(a, b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}
