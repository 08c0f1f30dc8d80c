// A planned path as the runtime sends it: see "Planned path and rehearsal" in the book. Nothing is copied: vertices stay at their place
// in the answer, and are uploaded to the graphics card unchanged.

import { t } from "../text/language.js";
import { VERTEX_BYTES } from "./vertex.js";

const ENTRY_BYTES = 48;
const LINE_BITS = 26;
const LINE_MASK = 2 ** LINE_BITS - 1;

/** @typedef {import("./vertex.js").Piece} Piece */

/**
 * @typedef {object} Chunk
 * @property {[number, number, number]} low
 * @property {[number, number, number]} high
 * @property {number} from s
 * @property {number} to s
 * @property {(Piece | null)[]} levels the finest first; null: not received
 */

/**
 * @typedef {object} Answer
 * @property {boolean} complete
 * @property {boolean} cut
 * @property {string | null} runId the active run to which the plan belongs
 * @property {string | null} hash of the main program
 * @property {number[]} tolerances of the levels, mm
 * @property {number} first chunk whose lines were received
 * @property {number} count of these
 * @property {number} end planned time, s
 * @property {number} dependsAt s; Infinity: never
 * @property {number} dependsWord
 * @property {string} why
 * @property {number[]} programs
 * @property {Chunk[]} chunks all of them
 */

/** @param {ArrayBuffer} bytes @returns {Answer} */
export function readPath(bytes) {
  const view = new DataView(bytes);
  const u16 = (/** @type {number} */ at) => view.getUint16(at, true);
  const u32 = (/** @type {number} */ at) => view.getUint32(at, true);
  const f32 = (/** @type {number} */ at) => view.getFloat32(at, true);
  if (u32(0) !== 0x48545054 || u16(4) !== 1) throw new Error(t("path.the_machine_sent_a_path"));
  const [table, flags, count, levels] = [u16(6), u32(8), u32(20), u32(24)];
  const programs = Array.from({ length: u16(124) }, (_, i) => u16(128 + 2 * i));
  const why = new TextDecoder().decode(new Uint8Array(bytes, 128 + 2 * programs.length, u16(126)));
  const identityAt = (128 + 2 * programs.length + u16(126) + 3) & ~3;
  const identity = identityAt + 4 <= table ? JSON.parse(new TextDecoder().decode(new Uint8Array(bytes, identityAt + 4, u32(identityAt)))) : {};
  const corner = (/** @type {number} */ at) => /** @type {[number, number, number]} */ ([f32(at), f32(at + 4), f32(at + 8)]);
  const chunks = Array.from({ length: count }, (_, i) => {
    const at = table + i * ENTRY_BYTES;
    return { low: corner(at), high: corner(at + 12), from: f32(at + 24), to: f32(at + 28), levels: /** @type {(Piece | null)[]} */ (Array(levels).fill(null)) };
  });
  const [finest, first, included] = [u32(44), u32(48), u32(52)];
  const begin = table + count * ENTRY_BYTES;
  const floats = new Float32Array(bytes, begin);
  const words = new Uint32Array(bytes, begin);
  let offset = begin;
  for (let level = levels - 1; level >= finest; level -= 1) {
    for (let i = first; i < first + included; i += 1) {
      const vertices = u32(table + i * ENTRY_BYTES + 32 + 4 * level);
      const chunk = chunks[i];
      if (chunk) chunk.levels[level] = { bytes, offset, count: vertices, floats, words, first: (offset - begin) / 4 };
      offset += vertices * VERTEX_BYTES;
    }
  }
  return {
    complete: (flags & 1) !== 0, cut: (flags & 2) !== 0, runId: identity.run_id ?? null, hash: identity.hash ?? null, tolerances: Array.from({ length: levels }, (_, i) => f32(28 + 4 * i)),
    first, count: included, end: f32(56), dependsAt: f32(84), dependsWord: u32(88), why, programs, chunks,
  };
}

/** Returns the program and line of a word. @param {number} word @param {number[]} programs */
export function locateWord(word, programs) {
  return { program: programs[(word >>> LINE_BITS) & 31] ?? 0, line: word & LINE_MASK };
}

/** Returns the word of a program and line; -1 if the path has no line of this program. @param {number} program @param {number} line @param {number[]} programs */
export function wordOf(program, line, programs) {
  const place = programs.indexOf(program);
  return place < 0 ? -1 : ((place << LINE_BITS) | line) >>> 0;
}
