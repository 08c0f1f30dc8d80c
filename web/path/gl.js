// Lines on the graphics card. Each line is a rectangle made of two vertices as the runtime sent them; its width depends
// on its kind. The shader determines the done, selected and run-time dependent parts, so nothing is uploaded while the
// machine moves. The shader reads vertices from a texture, because software renderers need one call for each instance
// of a rectangle.

import { PLACE_MASK, VERTEX_WORDS } from "./vertex.js";

/** Words of 4 bytes in a row of the texture of an answer: 2 to the power of `ROW_BITS`. */
const ROW_BITS = 12;
const ROW_WORDS = 2 ** ROW_BITS;
/** Corners of the two triangles of a rectangle. */
const CORNERS = 6;

const VERTEX = `#version 300 es
precision highp float; precision highp int; precision highp usampler2D;
uniform usampler2D words; uniform int first;
uniform mat4 matrix; uniform vec3 shift; uniform vec2 size; uniform vec4 widths; uniform float now; uniform uint selected;
out float time; out float side; out float along; flat out uint place;
uint word(int i) { return texelFetch(words, ivec2(i & ${ROW_WORDS - 1}, i >> ${ROW_BITS}), 0).r; }
float number(int i) { return uintBitsToFloat(word(i)); }
vec4 seen(int i) { return matrix * vec4(vec3(number(i), number(i + 1), number(i + 2)) + shift, 1.0); }
void main() {
  int line = gl_VertexID / ${CORNERS}; int corner = gl_VertexID - line * ${CORNERS}; if (corner > 2) corner -= 2;
  int from = first + line * ${VERTEX_WORDS}; int to = from + ${VERTEX_WORDS};
  vec4 a = seen(from); vec4 b = seen(to);
  float fromTime = number(from + 4); place = word(to + 3);
  bool isRapid = (place >> 31) == 1u; bool isPicked = (place & 0x7fffffffu) == selected;
  float halfWidth = (isPicked ? widths.w : isRapid ? widths.z : fromTime <= now ? widths.x : widths.y) + 1.0;
  vec2 way = (b.xy - a.xy) * size * 0.5; float length_ = length(way);
  vec2 ahead = length_ > 0.0 ? way / length_ : vec2(1.0, 0.0);
  float end = float(corner >> 1); float left = float(corner & 1) * 2.0 - 1.0;
  vec2 beside = vec2(-ahead.y, ahead.x) * left * halfWidth + ahead * (end * 2.0 - 1.0) * 0.5;
  gl_Position = mix(a, b, end) + vec4(beside * 2.0 / size, 0.0, 0.0);
  time = mix(fromTime, number(to + 4), end); side = left * halfWidth; along = end * length_;
}`;

const FRAGMENT = `#version 300 es
precision highp float; precision highp int;
in float time; in float side; in float along; flat in uint place;
uniform float now; uniform float since; uniform float dependsAt; uniform uint selected;
uniform vec4 done; uniform vec4 rest; uniform vec4 rapid; uniform vec4 picked; uniform vec4 widths;
out vec4 colour;
void main() {
  bool isRapid = (place >> 31) == 1u; bool isPicked = (place & 0x7fffffffu) == selected;
  if (time <= since || (since >= 0.0 && time > now)) discard;
  bool isDone = time <= now; float off = abs(side);
  float width = isPicked ? widths.w : isRapid ? widths.z : isDone ? widths.x : widths.y;
  if (off > width + 0.5) discard;
  if (isRapid && mod(along, 9.0) > 5.0) discard;
  if (!isRapid && !isDone && time > dependsAt && mod(along, 6.0) > 3.5) discard;
  vec4 own = isPicked ? picked : isRapid ? rapid : isDone ? done : rest;
  colour = isRapid && !isDone && !isPicked ? vec4(own.rgb, own.a * 0.75) : own;
  colour.a *= clamp(width - off + 0.5, 0.0, 1.0); colour.rgb *= colour.a;
}`;

/** Half widths of lines, px: done, to come, rapid, selected. */
const WIDTHS = [1.5, 0.8, 0.7, 2.6];

/**
 * The view of the picture.
 * @typedef {object} View
 * @property {Float32Array} matrix
 * @property {number} scale px per mm
 * @property {number} ratio pixels of the canvas per px
 */

/**
 * @typedef {object} Look
 * @property {number} dependsAt s
 * @property {number} selected place of a word; 0: none
 * @property {Record<"done" | "rest" | "rapid" | "picked", number[]>} colours
 */

/** Reason why the card draws nothing: no WebGL, no shader object, or refused shaders. @typedef {{of: "webgl" | "shader" | "shaders", log: string}} Trouble */

const UNIFORMS = /** @type {const} */ (["matrix", "shift", "size", "words", "first", "now", "since", "dependsAt", "selected", "done", "rest", "rapid", "picked", "widths"]);

export class Lines {
  /** Counts of the last frame, and all bytes uploaded so far. */
  drawn = { calls: 0, lines: 0 };
  uploaded = 0;
  #gl;
  /** @type {Look | null} */
  #look = null;
  /** @type {Record<string, WebGLUniformLocation | null>} */
  #at = {};
  /** @type {WeakMap<ArrayBuffer, WebGLTexture>} */
  #textures = new WeakMap();
  #kept = 0;

  /** @param {WebGL2RenderingContext} gl */
  constructor(gl) {
    this.#gl = gl;
    const program = link(gl);
    gl.useProgram(program);
    for (const name of UNIFORMS) this.#at[name] = gl.getUniformLocation(program, name);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.uniform1i(this.#at.words ?? null, 0);
  }

  /** Sets the look of the following frames. @param {Look} look */
  set look(look) {
    const at = (/** @type {string} */ name) => this.#at[name] ?? null;
    this.#gl.uniform1f(at("dependsAt"), look.dependsAt);
    this.#gl.uniform1ui(at("selected"), (look.selected & PLACE_MASK) >>> 0);
    this.#gl.uniform4fv(at("picked"), look.colours.picked);
    this.#look = look;
  }

  /**
   * Sets the view and time of the following drawing; the done part is drawn from `since` on only.
   * @param {View} view @param {number} now s @param {number} [since] s
   */
  begin({ matrix, ratio }, now, since = -1) {
    const gl = this.#gl;
    const at = (/** @type {string} */ name) => this.#at[name] ?? null;
    gl.viewport(0, 0, gl.drawingBufferWidth, gl.drawingBufferHeight);
    gl.uniformMatrix4fv(at("matrix"), false, matrix);
    gl.uniform2f(at("size"), gl.drawingBufferWidth, gl.drawingBufferHeight);
    gl.uniform4fv(at("widths"), WIDTHS.map((width) => width * ratio));
    gl.uniform1f(at("now"), now);
    gl.uniform1f(at("since"), since);
    this.colours();
  }

  clear() {
    this.#gl.clearColor(0, 0, 0, 0);
    this.#gl.clear(this.#gl.COLOR_BUFFER_BIT);
  }

  /** Draws the following lines at their own position, in the colours of the path. */
  colours() {
    this.place([0, 0, 0]);
    for (const name of /** @type {const} */ (["done", "rest", "rapid"])) this.#gl.uniform4fv(this.#at[name] ?? null, this.#look?.colours[name] ?? [0, 0, 0, 1]);
  }

  /**
   * Moves the following lines by a shift, and sets their colour if one is given.
   * @param {ArrayLike<number>} shift @param {number[]} [colour]
   */
  place(shift, colour) {
    const gl = this.#gl;
    gl.uniform3f(this.#at.shift ?? null, shift[0] ?? 0, shift[1] ?? 0, shift[2] ?? 0);
    if (!colour) return;
    for (const name of ["done", "rest", "rapid"]) gl.uniform4fv(this.#at[name] ?? null, colour);
  }

  /** Draws lines of a piece, by default all. @param {{bytes: ArrayBuffer, offset: number, count: number}} piece @param {number} [line] the first one @param {number} [lines] */
  draw({ bytes, offset, count }, line = 0, lines = count - 1) {
    if (lines < 1) return;
    const gl = this.#gl;
    gl.bindTexture(gl.TEXTURE_2D, this.#texture(bytes));
    gl.uniform1i(this.#at.first ?? null, offset / 4 + line * VERTEX_WORDS);
    gl.drawArrays(gl.TRIANGLES, 0, CORNERS * lines);
    this.drawn.calls += 1;
    this.drawn.lines += lines;
  }

  /** Number of answers on the card. */
  get kept() {
    return this.#kept;
  }

  /** Releases data that is no longer shown. @param {ArrayBuffer} bytes */
  forget(bytes) {
    const texture = this.#textures.get(bytes);
    if (!texture) return;
    this.#gl.deleteTexture(texture);
    this.#textures.delete(bytes);
    this.#kept -= 1;
  }

  /** Uploads each answer once, unchanged. @param {ArrayBuffer} bytes */
  #texture(bytes) {
    const known = this.#textures.get(bytes);
    if (known) return known;
    const gl = this.#gl;
    const texture = gl.createTexture();
    const words = new Uint32Array(bytes);
    const [rows, rest] = [Math.floor(words.length / ROW_WORDS), words.length % ROW_WORDS];
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.R32UI, rows > 0 ? ROW_WORDS : rest, rows + (rest > 0 ? 1 : 0));
    const put = (/** @type {number} */ row, /** @type {number} */ wide, /** @type {number} */ high) => {
      if (wide > 0 && high > 0) gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, row, wide, high, gl.RED_INTEGER, gl.UNSIGNED_INT, words, row * ROW_WORDS);
    };
    put(0, ROW_WORDS, rows);
    put(rows, rest, 1);
    this.uploaded += bytes.byteLength;
    this.#textures.set(bytes, texture);
    this.#kept += 1;
    return texture;
  }
}

/** Throws a `Trouble`. @param {WebGL2RenderingContext} gl */
function link(gl) {
  const program = gl.createProgram();
  for (const [type, source] of /** @type {const} */ ([[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]])) {
    const shader = gl.createShader(type);
    if (!shader) throw trouble("shader");
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) {
    const logs = (gl.getAttachedShaders(program) ?? []).map((shader) => gl.getShaderInfoLog(shader));
    throw trouble("shaders", [...logs, gl.getProgramInfoLog(program)].join(" "));
  }
  return program;
}

/** @param {Trouble["of"]} of @param {string} [log] @returns {Trouble} */
export function trouble(of, log = "") {
  return { of, log };
}
