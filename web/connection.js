// The WebSocket: subscribes, passes on every message, detects silence, and reconnects by itself.

import { protocols } from "./token.js";

/** Topics of the machine as a whole. */
export const MACHINE_TOPICS = ["presence", "birth", "alarm/active"];

/** Delay before the next attempt: doubles from the first to the longest, with jitter so that screens do not reconnect at once. */
const RETRY_FIRST_MS = 250;
const RETRY_LONGEST_MS = 5000;
/** Silence after which the machine is probed, and how long the answer may take. */
const SILENCE_MS = 4000;
const PROBE_MS = 3000;

/**
 * @typedef {object} Listener
 * @property {(topic: string, message: any) => void} message a message of the machine
 * @property {(text: string) => void} refused the machine did not understand what this screen asked
 * @property {(online: boolean, retryAt: number | null) => void} phase connected, or not and when the next try is (ms, local clock)
 */

export class Connection {
  /** @type {WebSocket | null} */
  #socket = null;
  #topics = new Set(MACHINE_TOPICS);
  #retryMs = RETRY_FIRST_MS;
  #retryTimer = 0;
  #heardAt = 0;
  #probing = false;

  /** @param {Listener} listener */
  constructor(listener) {
    this.listener = listener;
    setInterval(() => this.#watch(), 1000);
    addEventListener("online", () => this.retryNow());
    document.addEventListener("visibilitychange", () => {
      if (!document.hidden) this.retryNow();
    });
  }

  /** Opens the socket. */
  open() {
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    const socket = new WebSocket(`${scheme}://${location.host}/api/v1/ws`, protocols());
    this.#socket = socket;
    this.#heardAt = Date.now();
    socket.onopen = () => {
      this.#send([...this.#topics]);
      this.#heardAt = Date.now();
    };
    socket.onmessage = (event) => {
      if (this.#socket !== socket) return;
      this.#heardAt = Date.now();
      const message = parse(event.data);
      if (typeof message?.error === "string") this.listener.refused(message.error);
      if (typeof message?.topic !== "string") return;
      this.#retryMs = RETRY_FIRST_MS;
      this.listener.message(message.topic, message);
      this.listener.phase(true, null);
    };
    socket.onclose = () => {
      if (this.#socket === socket) this.#lost();
    };
  }

  /** Subscribes to more topics, now and after each new connection. @param {string[]} topics */
  subscribe(topics) {
    const added = topics.filter((topic) => !this.#topics.has(topic));
    if (added.length === 0) return;
    for (const topic of added) this.#topics.add(topic);
    this.#send([...this.#topics]);
  }

  /** Tries at once. */
  retryNow() {
    if (this.#socket) return;
    clearTimeout(this.#retryTimer);
    this.open();
  }

  /** @param {string[]} topics */
  #send(topics) {
    if (this.#socket?.readyState === WebSocket.OPEN) this.#socket.send(JSON.stringify({ subscribe: topics }));
  }

  #lost() {
    this.#socket = null;
    const wait = this.#retryMs * (0.75 + Math.random() / 2);
    this.#retryMs = Math.min(this.#retryMs * 2, RETRY_LONGEST_MS);
    this.listener.phase(false, Date.now() + wait);
    this.#retryTimer = window.setTimeout(() => this.open(), wait);
  }

  // An unplugged cable closes no socket: there is only silence. But a machine at rest may be silent, too, so it is probed.
  async #watch() {
    const socket = this.#socket;
    if (!socket || this.#probing || Date.now() - this.#heardAt < SILENCE_MS) return;
    this.#probing = true;
    const alive = socket.readyState === WebSocket.OPEN && (await answers());
    this.#probing = false;
    if (this.#socket !== socket) return;
    if (alive) this.#heardAt = Date.now();
    else {
      socket.close();
      this.#lost();
    }
  }
}

/** Whether the server answers, with any HTTP status. */
async function answers() {
  try {
    await fetch("/api/v1/health", { cache: "no-store", signal: AbortSignal.timeout(PROBE_MS) });
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
