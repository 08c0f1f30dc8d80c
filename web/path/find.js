// Finds places on a path: by time, by a machine position, by a point of the picture, by a line of the program.

import { firstFrom, linesBetween, PLACE_MASK, timeOf, VERTEX_WORDS, wordAt } from "./vertex.js";

/** @typedef {import("./bytes.js").Answer} Answer */
/** @typedef {import("./vertex.js").Piece} Piece */
/** @typedef {[number, number, number]} Point */

/** Distance from the planned path within which a machine is on it, mm, in addition to the level's tolerance. */
const ON_PATH_MM = 0.05;

/** Returns the finest received level of a chunk. @param {import("./bytes.js").Chunk} chunk @returns {Piece | null} */
export function finest(chunk) {
  return chunk.levels.find((piece) => piece) ?? null;
}

/** @param {Piece} piece @param {number} i @returns {Point} */
function at(piece, i) {
  const k = piece.first + i * VERTEX_WORDS;
  return [piece.floats[k] ?? 0, piece.floats[k + 1] ?? 0, piece.floats[k + 2] ?? 0];
}

/** Returns the point of the path at a time, and the word of its line. @param {Answer} path @param {number} time @returns {{at: Point, word: number} | null} */
export function atTime(path, time) {
  const chunk = path.chunks.find((one) => one.to >= time) ?? path.chunks.at(-1);
  const piece = chunk && finest(chunk);
  if (!piece || piece.count === 0) return null;
  const to = Math.min(firstFrom(piece, time), piece.count - 1);
  if (to === 0) return { at: at(piece, 0), word: wordAt(piece, 0) };
  const [t0, t1] = [timeOf(piece, to - 1), timeOf(piece, to)];
  const share = t1 > t0 ? Math.min(1, Math.max(0, (time - t0) / (t1 - t0))) : 1;
  return { at: between(at(piece, to - 1), at(piece, to), share), word: wordAt(piece, to) };
}

/**
 * Returns the time at which the path passes a machine position: the first time from `after` on within the tolerance.
 * @param {Answer} path @param {ArrayLike<number>} point @param {number} from s @param {number} to s
 * @returns {number | null} null: it does not pass there
 */
export function passedAt(path, point, from, to) {
  let best = /** @type {{off: number, time: number} | null} */ (null);
  for (const chunk of path.chunks) {
    if (chunk.to < from) continue;
    if (chunk.from > to) break;
    const level = chunk.levels.findIndex((piece) => piece);
    const piece = chunk.levels[level];
    if (!piece) continue;
    const within = ON_PATH_MM + (path.tolerances[level] ?? 0);
    if (![0, 1, 2].every((i) => (point[i] ?? 0) >= /** @type {number} */ (chunk.low[i]) - within && (point[i] ?? 0) <= /** @type {number} */ (chunk.high[i]) + within)) continue;
    for (let i = Math.max(1, firstFrom(piece, from)); i < piece.count; i += 1) {
      const t0 = timeOf(piece, i - 1);
      if (t0 > to) break;
      const { off, share } = nearest(at(piece, i - 1), at(piece, i), point);
      const time = t0 + (timeOf(piece, i) - t0) * share;
      if (off > within || time < from - 1e-3) continue;
      if (best && time > best.time + 0.5) return best.time;
      if (!best || off < best.off) best = { off, time };
    }
  }
  return best?.time ?? null;
}

/**
 * Returns the word of the line nearest to a point of the picture, if one is near: first among the lines that are exact to the pixel,
 * then among the finer lines that these replace.
 * @param {Answer} path @param {import("./camera.js").Camera} camera @param {number} x px @param {number} y px @param {number} within px
 * @param {number} level that is exact to the pixel
 */
export function pick(path, camera, x, y, within, level) {
  /** @type {{off: number, chunk: import("./bytes.js").Chunk, piece: Piece, line: number, share: number} | null} */
  let best = null;
  for (const chunk of path.chunks) {
    const { left, right, top, bottom } = camera.boxOf(chunk.low, chunk.high);
    if (x < left - within || x > right + within || y < top - within || y > bottom + within) continue;
    const piece = chunk.levels[level] ?? chunk.levels.findLast((one) => one);
    const found = piece && nearestSeen(piece, 0, piece.count - 1, camera, x, y);
    if (found && found.off < (best?.off ?? within)) best = { ...found, chunk, piece };
  }
  const exact = best && finest(best.chunk);
  if (!best || !exact) return null;
  const { first, count } = linesBetween(exact, timeOf(best.piece, best.line), timeOf(best.piece, best.line + 1));
  const { line, share } = nearestSeen(exact, first, count, camera, x, y);
  return { off: best.off, word: wordAt(exact, line + 1) & PLACE_MASK, time: timeOf(exact, line) * (1 - share) + timeOf(exact, line + 1) * share };
}

/**
 * Returns the line of a piece nearest to a point of the picture. Ten thousands are compared, so no point becomes an object.
 * @param {Piece} piece @param {number} from @param {number} count of lines @param {import("./camera.js").Camera} camera @param {number} x px @param {number} y px
 */
function nearestSeen(piece, from, count, camera, x, y) {
  const best = { off: Infinity, line: from, share: 0 };
  const [[rx, ry, rz], [ux, uy, uz]] = camera.axes;
  const [left, top] = camera.project([0, 0, 0]);
  const { scale } = camera;
  const { floats } = piece;
  let ax = 0;
  let ay = 0;
  for (let line = from - 1, k = piece.first + from * VERTEX_WORDS; line < from + count; line += 1, k += VERTEX_WORDS) {
    const px = floats[k] ?? 0;
    const py = floats[k + 1] ?? 0;
    const pz = floats[k + 2] ?? 0;
    const bx = left + (px * rx + py * ry + pz * rz) * scale - x;
    const by = top - (px * ux + py * uy + pz * uz) * scale - y;
    if (line >= from) {
      const wx = bx - ax;
      const wy = by - ay;
      const length = wx * wx + wy * wy;
      const share = length > 0 ? Math.min(1, Math.max(0, -(ax * wx + ay * wy) / length)) : 0;
      const off = Math.sqrt((ax + wx * share) ** 2 + (ay + wy * share) ** 2);
      if (off < best.off) {
        best.off = off;
        best.line = line;
        best.share = share;
      }
    }
    ax = bx;
    ay = by;
  }
  return best;
}

/** Returns the first time of a line of this block, and its box; null if the path has no such line. @param {Answer} path @param {number} word */
export function findWord(path, word) {
  for (const chunk of path.chunks) {
    const piece = finest(chunk);
    if (!piece) continue;
    for (let i = 1; i < piece.count; i += 1) {
      if ((wordAt(piece, i) & PLACE_MASK) === word) return { time: timeOf(piece, i - 1), at: at(piece, i) };
    }
  }
  return null;
}

/** @param {Point} a @param {Point} b @param {number} share @returns {Point} */
function between(a, b, share) {
  return [a[0] + (b[0] - a[0]) * share, a[1] + (b[1] - a[1]) * share, a[2] + (b[2] - a[2]) * share];
}

/** Returns the distance of a point from a line, and the nearest position on the line. @param {Point} from @param {Point} to @param {ArrayLike<number>} point */
function nearest(from, to, point) {
  const [wx, wy, wz] = [to[0] - from[0], to[1] - from[1], to[2] - from[2]];
  const [x, y, z] = [(point[0] ?? 0) - from[0], (point[1] ?? 0) - from[1], (point[2] ?? 0) - from[2]];
  const length = wx * wx + wy * wy + wz * wz;
  const share = length > 0 ? Math.min(1, Math.max(0, (x * wx + y * wy + z * wz) / length)) : 0;
  return { off: Math.hypot(x - wx * share, y - wy * share, z - wz * share), share };
}
