// Waiting for a signal from another part of the program, for a time, or for an abort.

/** A signal from one part of the program to another. The signal stays set until it is muted. */
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

  /**
   * Waits until the bell is rung; returns false if the time limit passes or the signal is aborted first.
   * @param {{timeoutMs?: number, signal?: AbortSignal}} [until]
   */
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

/** Waits for a time, or until the signal is aborted. @param {number} ms @param {AbortSignal} [signal] */
export async function sleep(ms, signal) {
  await new Bell().rung({ timeoutMs: ms, signal });
}
