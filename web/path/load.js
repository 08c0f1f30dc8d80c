// Reads the planned path of a program: first the coarsest level, then finer levels of the chunks that become visible.

import { readPath } from "./bytes.js";

/** Chunks of one request: less than a megabyte. */
const CHUNKS_AT_ONCE = 8;
/** Number of chunks up to which a path is read as a whole. */
const CHUNKS_OF_SHORT = 8;
/** Request interval for an incomplete plan, ms. */
const AGAIN_MS = 400;
/** Request interval for a complete path, which is planned again when its inputs change. */
const STILL_MS = 2000;
const COARSEST_MM = 0.64;

/** @typedef {import("./bytes.js").Answer} Answer */
/** @typedef {import("./bytes.js").Chunk} Chunk */

export class PathLoader {
  /** @type {Answer | null} */
  path = null;
  /** Reason why no path exists. */
  error = "";
  /** Whether this path belongs to the current run and text; if not, a newer one is requested often. */
  isCurrent = true;
  /** Incremented when another path, or more of it, has arrived. */
  revision = 0;
  #program = 0;
  #cs = 0;
  #tag = "";
  #timer = 0;
  /** Number of the newest request; answers to earlier ones are discarded. */
  #turn = 0;
  /** @type {Set<number>} chunks whose finer levels are requested */
  #asked = new Set();
  /** @type {() => void} */
  #changed;
  #tandem;

  /** @param {import("../tandem.js").Tandem} tandem @param {() => void} changed */
  constructor(tandem, changed) {
    this.#tandem = tandem;
    this.#changed = changed;
  }

  /** Selects the program whose path is read; 0: none. @param {number} program @param {number} cs */
  show(program, cs) {
    if (program === this.#program && cs === this.#cs) return;
    this.#program = program;
    this.#cs = cs;
    this.#forget();
    this.error = "";
    void this.#read();
  }

  /** Requests the plan at once, because an input has changed. */
  again() {
    void this.#read();
  }

  /** Requests finer levels of a chunk. @param {number} index */
  refine(index) {
    const { path } = this;
    if (!path?.complete || this.#asked.has(index)) return;
    const from = index - (index % CHUNKS_AT_ONCE);
    for (let i = from; i < from + CHUNKS_AT_ONCE; i += 1) this.#asked.add(i);
    void this.#fetch(`from=${from}&count=${CHUNKS_AT_ONCE}`, "").then((answer) => {
      if (!answer || this.path !== path || identity(answer.tag) !== identity(this.#tag)) return;
      this.#copyChunks(readPath(answer.bytes), path);
      this.revision += 1;
      this.#changed();
    }).catch(() => {
      for (let i = from; i < from + CHUNKS_AT_ONCE; i += 1) this.#asked.delete(i);
    });
  }

  #forget() {
    this.path = null;
    this.#tag = "";
    this.#asked.clear();
    this.revision += 1;
    this.#changed();
  }

  async #read() {
    clearTimeout(this.#timer);
    this.#turn += 1;
    const turn = this.#turn;
    if (!this.#program) return;
    try {
      const known = this.path && !this.path.complete ? this.path.chunks.length : 0;
      const answer = await this.#fetch(`tolerance=${COARSEST_MM}&from=${known}`, this.#tag);
      if (turn !== this.#turn) return;
      this.error = "";
      if (answer) this.#accept(answer, known);
    } catch (error) {
      if (turn !== this.#turn) return;
      const text = error instanceof Error ? error.message : String(error);
      if (this.error !== text || this.path) {
        this.#forget();
        this.error = text;
        this.#changed();
      }
    }
    const isWaited = !this.isCurrent || (this.path && !this.path.complete);
    this.#timer = setTimeout(() => void this.#read(), isWaited ? AGAIN_MS : STILL_MS);
  }

  /** @param {{bytes: ArrayBuffer, tag: string}} answer @param {number} known chunks that were not requested again */
  #accept({ bytes, tag }, known) {
    const path = readPath(bytes);
    const isSame = identity(tag) === identity(this.#tag);
    if (!isSame && known > 0) {
      // another plan has begun: read all of it
      this.#tag = "";
      this.path = null;
      void this.#read();
      return;
    }
    if (isSame && this.path) this.#copyChunks(this.path, path);
    if (!isSame) this.#asked.clear();
    this.#tag = tag;
    this.path = path;
    this.revision += 1;
    this.#changed();
    if (path.complete && path.chunks.length <= CHUNKS_OF_SHORT) this.refine(0);
  }

  /** Copies the chunks of one answer into another. @param {Answer} from @param {Answer} to */
  #copyChunks(from, to) {
    from.chunks.forEach((chunk, i) => {
      const known = to.chunks[i];
      if (!known || known.to < chunk.to) return;
      chunk.levels.forEach((piece, level) => {
        if (piece) known.levels[level] ??= piece;
      });
    });
  }

  /** Returns null if the answer is unchanged since the tag. @param {string} query @param {string} tag @returns {Promise<{bytes: ArrayBuffer, tag: string} | null>} */
  async #fetch(query, tag) {
    const headers = tag === "" ? undefined : { "If-None-Match": tag };
    const response = await this.#tandem.request("GET", `/programs/${this.#program}/path?cs=${this.#cs}&${query}`, { headers });
    if (response.status === 304) return null;
    return { bytes: await response.arrayBuffer(), tag: response.headers.get("ETag") ?? "" };
  }
}

/** Returns the identity of a plan's inputs, without its progress. @param {string} tag */
function identity(tag) {
  return tag.replaceAll('"', "").split("-").slice(0, 2).join("-");
}
