// Finds places on a path: by time, by a machine position, by a point of the picture, by a line of the program.

import { finest, PLACE_MASK, VERTEX_WORDS } from "./bytes.js";

/** @typedef {import("./bytes.js").Answer} Answer */
/** @typedef {import("./bytes.js").Piece} Piece */
/** @typedef {[number, number, number]} Point */

/** How far a machine may be from the planned path and still be on it, mm, beside the level's tolerance. */
const ON_PATH_MM = 0.05;

/** @param {Piece} piece @param {number} i @returns {Point} */
function at(piece, i) {
  const k = piece.first + i * VERTEX_WORDS;
  return [piece.floats[k] ?? 0, piece.floats[k + 1] ?? 0, piece.floats[k + 2] ?? 0];
}

/** @param {Piece} piece @param {number} i */
function timeOf(piece, i) {
  return piece.floats[piece.first + i * VERTEX_WORDS + 4] ?? 0;
}

/** @param {Piece} piece @param {number} i */
export function wordAt(piece, i) {
  return piece.words[piece.first + i * VERTEX_WORDS + 3] ?? 0;
}

/** The first vertex that is reached at this time or later. @param {Piece} piece @param {number} time */
function firstFrom(piece, time) {
  let [low, high] = [0, piece.count];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (timeOf(piece, middle) < time) low = middle + 1;
    else high = middle;
  }
  return low;
}

/** Lines of a piece that are under way between two times. @param {Piece} piece @param {number} from s @param {number} to s */
export function linesBetween(piece, from, to) {
  const first = Math.max(0, firstFrom(piece, from) - 1);
  return { first, count: Math.min(firstFrom(piece, to), piece.count - 1) - first };
}

/** Where the path is at a time, and the word of that line. @param {Answer} path @param {number} time @returns {{at: Point, word: number} | null} */
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
 * When the path passes a machine position: of several times within the tolerance the first one from `after` on.
 * @param {Answer} path @param {ArrayLike<number>} point @param {number} from s @param {number} to s
 * @returns {number | null} null: it does not
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

/** The word of the line nearest to a point of the picture, if one is near. @param {Answer} path @param {import("./camera.js").Camera} camera @param {number} x px @param {number} y px @param {number} within px */
export function pick(path, camera, x, y, within) {
  let best = { off: within, word: -1, time: 0 };
  for (const chunk of path.chunks) {
    const { left, right, top, bottom } = camera.boxOf(chunk.low, chunk.high);
    if (x < left - within || x > right + within || y < top - within || y > bottom + within) continue;
    const piece = finest(chunk);
    if (!piece) continue;
    let before = camera.project(at(piece, 0));
    for (let i = 1; i < piece.count; i += 1) {
      const now = camera.project(at(piece, i));
      const { off, share } = nearest([before[0], before[1], 0], [now[0], now[1], 0], [x, y, 0]);
      if (off < best.off) best = { off, word: wordAt(piece, i) & PLACE_MASK, time: timeOf(piece, i - 1) * (1 - share) + timeOf(piece, i) * share };
      before = now;
    }
  }
  return best.word < 0 ? null : best;
}

/** When the path first has a line with this place, and its box; null: it has none. @param {Answer} path @param {number} place */
export function findPlace(path, place) {
  for (const chunk of path.chunks) {
    const piece = finest(chunk);
    if (!piece) continue;
    for (let i = 1; i < piece.count; i += 1) {
      if ((wordAt(piece, i) & PLACE_MASK) === place) return { time: timeOf(piece, i - 1), at: at(piece, i) };
    }
  }
  return null;
}

/** @param {Point} a @param {Point} b @param {number} share @returns {Point} */
function between(a, b, share) {
  return [a[0] + (b[0] - a[0]) * share, a[1] + (b[1] - a[1]) * share, a[2] + (b[2] - a[2]) * share];
}

/** Distance of a point from a line, and where on it is nearest. @param {Point} from @param {Point} to @param {ArrayLike<number>} point */
function nearest(from, to, point) {
  const way = [to[0] - from[0], to[1] - from[1], to[2] - from[2]];
  const off = [(point[0] ?? 0) - from[0], (point[1] ?? 0) - from[1], (point[2] ?? 0) - from[2]];
  const dot = (/** @type {number[]} */ a, /** @type {number[]} */ b) => a.reduce((sum, part, i) => sum + part * (b[i] ?? 0), 0);
  const length = dot(way, way);
  const share = length > 0 ? Math.min(1, Math.max(0, dot(off, way) / length)) : 0;
  return { off: Math.hypot(...off.map((part, i) => part - (way[i] ?? 0) * share)), share };
}
