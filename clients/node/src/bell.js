// Waiting: for what another part of the program says, for a time, for what ends it.

/** Rung by one part of the program, heard by another; it stays rung until it is muted. */
export class Bell {
  #isRung = false;
  /** @type {Set<() => void>} */
  #waiting = new Set();

  get isRung() {
    return this.#isRung;
  }

  ring() {
    this.#isRung = true;
    const waiting = [...this.#waiting];
    this.#waiting.clear();
    waiting.forEach((heard) => heard());
  }

  mute() {
    this.#isRung = false;
  }

  /** Waits until it is rung; false: the time is over, or the signal has come before. @param {{timeoutMs?: number, signal?: AbortSignal}} [until] */
  async rung({ timeoutMs, signal } = {}) {
    if (this.#isRung || signal?.aborted) return this.#isRung;
    return new Promise((/** @type {(isRung: boolean) => void} */ resolve) => {
      const end = () => {
        clearTimeout(timer);
        this.#waiting.delete(end);
        signal?.removeEventListener("abort", end);
        resolve(this.#isRung);
      };
      const timer = timeoutMs === undefined ? undefined : setTimeout(end, timeoutMs);
      this.#waiting.add(end);
      signal?.addEventListener("abort", end);
    });
  }
}

/** Waits for a time, or until the signal. @param {number} ms @param {AbortSignal} [signal] */
export async function sleep(ms, signal) {
  await new Bell().rung({ timeoutMs: ms, signal });
}
