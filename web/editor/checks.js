// Findings during typing: the runtime checks the text after a pause of the keys, one check after the other.

/** Pause of the keys after which a text is checked, ms. */
const REST_MS = 400;
/** The pause is at least this multiple of the duration of the last check: a long text is checked less often. */
const REST_FACTOR = 2;
/** The longest pause, ms: findings appear soon, also after a single slow check. */
const REST_MAX_MS = 3000;

/** @typedef {import("../types.d.ts").ProgramDiagnostic} ProgramDiagnostic */

export class Checks {
  #timer = 0;
  #tookMs = 0;
  /** Incremented by each change: findings of an earlier text are discarded. */
  #turn = 0;
  #isAsked = false;
  #check;
  #found;

  /** @param {() => Promise<ProgramDiagnostic[] | null>} check null: no result @param {(found: ProgramDiagnostic[]) => void} found */
  constructor(check, found) {
    this.#check = check;
    this.#found = found;
  }

  /** The text has changed. */
  changed() {
    this.#turn += 1;
    this.#wait();
  }

  /** Discards earlier findings, and stops checking. */
  stop() {
    this.#turn += 1;
    clearTimeout(this.#timer);
  }

  #wait() {
    clearTimeout(this.#timer);
    this.#timer = setTimeout(() => void this.#look(), Math.min(REST_MAX_MS, Math.max(REST_MS, REST_FACTOR * this.#tookMs)));
  }

  async #look() {
    if (this.#isAsked) return this.#wait();
    const turn = this.#turn;
    const began = performance.now();
    this.#isAsked = true;
    const found = await this.#check().finally(() => {
      this.#isAsked = false;
      this.#tookMs = performance.now() - began;
    });
    if (found && turn === this.#turn) this.#found(found);
  }
}
