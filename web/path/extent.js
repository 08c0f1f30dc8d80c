// Extent of a path in the work area, used to fit the picture. Rapids to a tool change may leave it.

import { VERTEX_WORDS, wordAt } from "./vertex.js";

/** @typedef {[number, number, number]} Point */
/** @typedef {[Point, Point]} Box lowest and highest corner */

/** Flag of a rapid in a word. */
const RAPID = 0x80000000;

/** Boxes of pieces, cached. @type {WeakMap<import("./vertex.js").Piece, Box | null>} */
const known = new WeakMap();

/** Returns the bounds of the feed motion of a path; of its rapids if it has no feed motion. @param {import("./bytes.js").Answer} path @returns {Point[]} */
export function corners(path) {
  const feeds = path.chunks.flatMap((chunk) => {
    const piece = chunk.levels.findLast((one) => one);
    return piece ? (feedBox(piece) ?? []) : [chunk.low, chunk.high];
  });
  return feeds.length > 0 ? feeds : path.chunks.flatMap(({ low, high }) => [low, high]);
}

/** Returns the box of the lines of a piece that are no rapids; null without such lines. @param {import("./vertex.js").Piece} piece */
function feedBox(piece) {
  const found = known.get(piece);
  if (found !== undefined) return found;
  /** @type {Box} */
  const box = [[Infinity, Infinity, Infinity], [-Infinity, -Infinity, -Infinity]];
  for (let i = 1; i < piece.count; i += 1) {
    if ((wordAt(piece, i) & RAPID) !== 0 || rests(piece, i)) continue;
    for (const vertex of [i - 1, i]) include(box, piece, vertex);
  }
  const has = box[0][0] <= box[1][0] ? box : null;
  known.set(piece, has);
  return has;
}

/** A wait or a dwell is a line without length. @param {import("./vertex.js").Piece} piece @param {number} i */
function rests(piece, i) {
  const k = piece.first + i * VERTEX_WORDS;
  return [0, 1, 2].every((axis) => piece.floats[k + axis] === piece.floats[k + axis - VERTEX_WORDS]);
}

/** @param {Box} box @param {import("./vertex.js").Piece} piece @param {number} vertex */
function include([low, high], piece, vertex) {
  const k = piece.first + vertex * VERTEX_WORDS;
  for (let i = 0; i < 3; i += 1) {
    const value = piece.floats[k + i] ?? 0;
    low[i] = Math.min(low[i] ?? value, value);
    high[i] = Math.max(high[i] ?? value, value);
  }
}
