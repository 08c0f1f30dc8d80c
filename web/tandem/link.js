// The WebSocket: subscribes, forwards every message, detects silence, and reconnects automatically.

/** Delay before the next attempt: doubles from the first to the longest, with jitter so that screens do not reconnect at once. */
const RETRY_FIRST_MS = 250;
const RETRY_LONGEST_MS = 5000;
/** Silence after which the machine is probed, and time limit of the answer. */
const SILENCE_MS = 4000;
const PROBE_MS = 3000;
const WATCH_MS = 1000;

/**
 * @typedef {object} Ends
 * @property {() => {url: string, protocols: string[]}} address
 * @property {string} health a route that answers when the server is online
 * @property {(topic: string, message: any) => void} message a message of the machine
 * @property {(text: string) => void} refused the machine did not accept a frame of this page
 * @property {(online: boolean, retryAt: number | null) => void} phase whether the page is connected, and the time of the next try (ms, local clock)
 */

export class Link {
  /** @type {WebSocket | null} */
  #socket = null;
  /** @type {Set<string>} */
  #topics = new Set();
  /** Topics requested since the last frame. @type {Set<string>} */
  #asked = new Set();
  #retryMs = RETRY_FIRST_MS;
  /** @type {ReturnType<typeof setTimeout> | undefined} */
  #retryTimer;
  /** @type {ReturnType<typeof setInterval> | undefined} */
  #watchTimer;
  #receivedAt = 0;
  /** Time at which the machine's presence expires, on the clock of `performance`. */
  #presentUntil = Number.POSITIVE_INFINITY;
  #probing = false;
  #isOpen = false;
  #ends;
  #online = () => this.retryNow();
  #seen = () => {
    if (!document.hidden) this.retryNow();
  };

  /** @param {Ends} ends */
  constructor(ends) {
    this.#ends = ends;
  }

  /** Connects, and again whenever the connection is lost. */
  open() {
    if (this.#isOpen) return;
    this.#isOpen = true;
    this.#watchTimer = setInterval(() => void this.#watch(), WATCH_MS);
    // these exist in a browser only
    globalThis.addEventListener?.("online", this.#online);
    globalThis.document?.addEventListener("visibilitychange", this.#seen);
    this.#connect();
  }

  /** Ends the connection for good. */
  close() {
    this.#isOpen = false;
    clearInterval(this.#watchTimer);
    clearTimeout(this.#retryTimer);
    globalThis.removeEventListener?.("online", this.#online);
    globalThis.document?.removeEventListener("visibilitychange", this.#seen);
    const socket = this.#socket;
    this.#socket = null;
    socket?.close();
    this.#ends.phase(false, null);
  }

  /** Subscribes, now and after each new connection. The value of a state arrives at once, also if it is subscribed already. @param {string} topic */
  subscribe(topic) {
    this.#topics.add(topic);
    if (this.#asked.size === 0) {
      queueMicrotask(() => {
        this.#send({ subscribe: [...this.#asked] });
        this.#asked.clear();
      });
    }
    this.#asked.add(topic);
  }

  /** @param {string} topic */
  unsubscribe(topic) {
    this.#asked.delete(topic);
    if (this.#topics.delete(topic)) this.#send({ unsubscribe: [topic] });
  }

  /** Tries at once. */
  retryNow() {
    if (this.#socket || !this.#isOpen) return;
    clearTimeout(this.#retryTimer);
    this.#connect();
  }

  #connect() {
    const { url, protocols } = this.#ends.address();
    const socket = new WebSocket(url, protocols);
    this.#socket = socket;
    this.#receivedAt = Date.now();
    this.#presentUntil = Number.POSITIVE_INFINITY;
    socket.onopen = () => {
      this.#send({ subscribe: [...this.#topics] });
      this.#asked.clear();
      this.#receivedAt = Date.now();
    };
    socket.onmessage = (event) => {
      if (this.#socket !== socket) return;
      this.#receivedAt = Date.now();
      const message = parse(event.data);
      if (typeof message?.error === "string") this.#ends.refused(message.error);
      if (typeof message?.topic !== "string") return;
      this.#retryMs = RETRY_FIRST_MS;
      if (message.topic === "presence") this.#presentUntil = message.online && message.expires_ms ? performance.now() + message.expires_ms : Number.POSITIVE_INFINITY;
      this.#ends.message(message.topic, message);
      this.#ends.phase(true, null);
    };
    socket.onclose = () => {
      if (this.#socket === socket) this.#scheduleReconnect();
    };
  }

  /** @param {{subscribe?: string[], unsubscribe?: string[]}} frame */
  #send(frame) {
    if (Object.values(frame).every((topics) => topics.length === 0)) return;
    if (this.#socket?.readyState === WebSocket.OPEN) this.#socket.send(JSON.stringify(frame));
  }

  #scheduleReconnect() {
    this.#socket = null;
    const wait = this.#retryMs * (0.75 + Math.random() / 2);
    this.#retryMs = Math.min(this.#retryMs * 2, RETRY_LONGEST_MS);
    this.#ends.phase(false, Date.now() + wait);
    this.#retryTimer = setTimeout(() => this.#connect(), wait);
  }

  // An unplugged cable closes no socket, but messages stop. A machine at rest may also send nothing, so it is probed.
  async #watch() {
    const socket = this.#socket;
    if (socket && performance.now() > this.#presentUntil) {
      socket.close();
      return this.#scheduleReconnect();
    }
    if (!socket || this.#probing || Date.now() - this.#receivedAt < SILENCE_MS) return;
    this.#probing = true;
    const alive = socket.readyState === WebSocket.OPEN && (await answers(this.#ends.health));
    this.#probing = false;
    if (this.#socket !== socket) return;
    if (alive) this.#receivedAt = Date.now();
    else {
      socket.close();
      this.#scheduleReconnect();
    }
  }
}

/** Whether the server answers, with any HTTP status. @param {string} url */
async function answers(url) {
  try {
    await fetch(url, { cache: "no-store", signal: AbortSignal.timeout(PROBE_MS) });
    return true;
  } catch {
    return false;
  }
}

/** @param {unknown} text */
function parse(text) {
  try {
    return JSON.parse(String(text));
  } catch {
    return null;
  }
}
