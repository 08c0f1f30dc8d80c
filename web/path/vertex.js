// Vertices of a path as the runtime sends them: their layout, and functions that read them.

/** Bytes of a vertex: x y z, word, time. */
export const VERTEX_BYTES = 20;
/** A vertex in words of 4 bytes. */
export const VERTEX_WORDS = VERTEX_BYTES / 4;
/** Line and program of a word, without the flag of a rapid. */
export const PLACE_MASK = 0x7fffffff;

/**
 * Vertices of one level of one chunk, in an answer.
 * @typedef {object} Piece
 * @property {ArrayBuffer} bytes
 * @property {number} offset byte of the first vertex
 * @property {number} count of vertices
 * @property {Float32Array} floats the answer from its first vertex on
 * @property {Uint32Array} words the same
 * @property {number} first index of the first vertex in both, in words of 4 bytes
 */

/** @param {Piece} piece @param {number} i */
export function timeOf(piece, i) {
  return piece.floats[piece.first + i * VERTEX_WORDS + 4] ?? 0;
}

/** @param {Piece} piece @param {number} i */
export function wordAt(piece, i) {
  return piece.words[piece.first + i * VERTEX_WORDS + 3] ?? 0;
}

/** Returns the first vertex that is reached at this time or later. @param {Piece} piece @param {number} time */
export function firstFrom(piece, time) {
  let [low, high] = [0, piece.count];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (timeOf(piece, middle) < time) low = middle + 1;
    else high = middle;
  }
  return low;
}

/** Returns the lines of a piece that are passed between two times. @param {Piece} piece @param {number} from s @param {number} to s */
export function linesBetween(piece, from, to) {
  const first = Math.max(0, firstFrom(piece, from) - 1);
  return { first, count: Math.min(firstFrom(piece, to), piece.count - 1) - first };
}

/** Lengths of pieces that were measured, mm. @type {WeakMap<Piece, number>} */
const lengths = new WeakMap();

/** Returns the length of the lines of a piece, mm. @param {Piece} piece */
export function lengthOf(piece) {
  const known = lengths.get(piece);
  if (known !== undefined) return known;
  const { floats, first, count } = piece;
  const off = (/** @type {number} */ k) => (floats[k] ?? 0) - (floats[k - VERTEX_WORDS] ?? 0);
  let length = 0;
  for (let i = 1, k = first + VERTEX_WORDS; i < count; i += 1, k += VERTEX_WORDS) length += Math.sqrt(off(k) ** 2 + off(k + 1) ** 2 + off(k + 2) ** 2);
  lengths.set(piece, length);
  return length;
}
