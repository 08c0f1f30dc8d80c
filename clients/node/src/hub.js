// Last message of each topic, and the followers of each topic.

/** Maximum number of stored topics; the topic without messages for the longest time is evicted. */
export const TOPICS_MAX = 4_096;
/** Maximum number of messages that wait for one follower; the oldest are dropped. */
export const BACKLOG_MAX = 256;

/** @typedef {{push: (message: any) => void, close: () => void}} Listener */

/** Messages of the machine, by path below its root. */
export class Hub {
  /** @type {Map<string, any>} */
  #last = new Map();
  /** @type {Map<string, Set<Listener>>} */
  #listeners = new Map();
  #isClosed = false;

  /**
   * Stores a message as the last one of its topic, and passes it to the followers.
   * @param {string} path @param {any} message
   */
  publish(path, message) {
    this.#last.delete(path);
    this.#last.set(path, message);
    if (this.#last.size > TOPICS_MAX) this.forget(/** @type {string} */ (this.#last.keys().next().value));
    for (const listener of [...(this.#listeners.get(path) ?? [])]) listener.push(message);
  }

  /** Drops the last message of a topic. @param {string} path */
  forget(path) {
    this.#last.delete(path);
  }

  /** Returns the last message of a topic; undefined before the first. @param {string} path */
  last(path) {
    return this.#last.get(path);
  }

  /** Ends all followers. */
  close() {
    this.#isClosed = true;
    for (const listeners of this.#listeners.values()) [...listeners].forEach((listener) => listener.close());
    this.#listeners.clear();
  }

  /**
   * Passes the last message of a topic and each later message to a listener; the returned function ends this.
   * @param {string} path @param {Listener} listener
   */
  listen(path, listener) {
    const known = this.#listeners.get(path) ?? new Set();
    this.#listeners.set(path, known.add(listener));
    const last = this.#last.get(path);
    if (last !== undefined) listener.push(last);
    if (this.#isClosed) listener.close();
    return () => {
      known.delete(listener);
      if (known.size === 0 && this.#listeners.get(path) === known) this.#listeners.delete(path);
    };
  }

  /**
   * Returns the first defined result of a function over a topic's messages; undefined if the topic ends first.
   * @template T @param {string} path @param {(message: any) => T | undefined} fits @param {AbortSignal} [signal]
   * @returns {Promise<T | undefined>}
   */
  async find(path, fits, signal) {
    signal?.throwIfAborted();
    const messages = this.follow(path);
    const end = () => void messages.return?.();
    signal?.addEventListener("abort", end);
    try {
      for await (const message of messages) {
        const found = fits(message);
        if (found !== undefined) return found;
      }
      signal?.throwIfAborted();
      return undefined;
    } finally {
      signal?.removeEventListener("abort", end);
    }
  }

  /**
   * Yields the last message of a topic, then each later message, until the connection ends. If messages arrive faster than
   * they are read, the oldest are dropped.
   * @param {string} path @returns {AsyncIterableIterator<any>}
   */
  follow(path) {
    /** @type {any[]} */
    const backlog = [];
    /** @type {((result: IteratorResult<any>) => void)[]} */
    const waiting = [];
    let isClosed = false;
    const close = () => {
      isClosed = true;
      waiting.splice(0).forEach((resolve) => resolve({ done: true, value: undefined }));
    };
    const push = (/** @type {any} */ message) => {
      const resolve = waiting.shift();
      if (resolve !== undefined) return resolve({ done: false, value: message });
      backlog.push(message);
      if (backlog.length > BACKLOG_MAX) backlog.shift();
    };
    const off = this.listen(path, { push, close });
    return {
      [Symbol.asyncIterator]() {
        return this;
      },
      next: async () => {
        if (backlog.length > 0) return { done: false, value: backlog.shift() };
        if (isClosed) return { done: true, value: undefined };
        return new Promise((resolve) => waiting.push(resolve));
      },
      return: async () => {
        off();
        backlog.length = 0;
        close();
        return { done: true, value: undefined };
      },
    };
  }
}
