// The connection to a machine. It is restored after each loss, and unanswered requests are sent again.

import { randomBytes } from "node:crypto";

import { parseAddress } from "./address.js";
import { Bell, sleep } from "./bell.js";
import { ConnectError, NoAnswer, NotConnected, RequestRefused, sentence } from "./errors.js";
import { Hub } from "./hub.js";
import { limits, Link } from "./link.js";
import { checkMaySend } from "./output.js";
import { FILTERS, numberAt, patternOf, whatIsWrong } from "./topics.js";

export const ANSWER_TIMEOUT_MS = 5_000;
export const PRESENT_TIMEOUT_MS = 10_000;
/** Maximum number of unfinished requests; further ones are refused. */
export const OUTBOX_MAX = 1_024;

/** Characters of the user name at the start of the client id, because a client id has at most 64 characters. */
const USER_MAX = 46;
/** Topics that handlers publish to without their name in the payload. */
const SET_BY_HANDLERS = /^(cs\/\d+\/(tool|spindle|variable)\/(get|set)|alarm\/raise)$/;

const BACKOFF_FIRST_MS = 100;
const BACKOFF_MAX_MS = 5_000;

/**
 * Log of a program; `console` by default.
 * @typedef {{debug: (...said: any[]) => void, warn: (...said: any[]) => void, error: (...said: any[]) => void}} Log
 */

/**
 * @typedef {object} ConnectOptions
 * @property {string} [user] if the address does not contain it
 * @property {string} [password]
 * @property {import("./link.js").Tls} [tls] certificates of an `mqtts://` address
 * @property {number} [timeoutMs] time limit for the first contact with the machine, 10 s; later losses have no time
 * limit
 * @property {Log} [log] receives warnings and errors; `console` by default
 */

/**
 * The request that a result answers.
 * @typedef {{path: string, seq: number, handlerId: string, kind: "claim" | "reset"}} ResultOf
 */

/**
 * A message whose arrival is not confirmed; it is sent again on each new connection.
 * @typedef {object} Request
 * @property {string} path
 * @property {string} topic
 * @property {string} payload
 * @property {boolean} retain
 * @property {string | undefined} commandId the request ends with the reply to this command
 * @property {ResultOf | undefined} resultOf the request ends with this result
 * @property {string | null} bootId of a command: the boot to which it was first sent; it is never sent to another boot
 * @property {boolean} wasSent
 * @property {boolean} isSent on the current connection
 * @property {(answer: any) => void} resolve
 * @property {(error: Error) => void} reject
 */

/** Keeps a connection to one machine, and transfers requests and messages. */
export class Connection {
  hub = new Hub();
  /** Distinguishes this process from others with the same handler id; unchanged over all connections. */
  instance = randomBytes(16).toString("hex");
  /** The client id. It begins with the user, because access rules of a broker bind the topics of a client to its user. */
  clientId;
  /** The client in topics: the user, or the client id if there is no user. */
  #topicId;
  /** Payload of the handler's last will, published if the connection is lost. @type {string | null} */
  will = null;
  /**
   * Receives each message of the machine before the followers of its topic do.
   * @type {(path: string, pattern: string, message: any) => void}
   */
  onMessage = () => {};
  /** Called on each new connection and at each boot, before requests are sent again. */
  onConnected = () => {};
  /** Number of connections so far. */
  connections = 0;
  #options;
  /** @type {Link | null} */
  #link = null;
  #isPresent = false;
  /** @type {string | null} */
  #toldBoot = null;
  /** @type {Set<Request>} */
  #requests = new Set();
  #stopped = new AbortController();
  #isClosing = false;
  #trouble = "no broker has answered";
  #refused = new Bell();
  #news = new Set();
  /** Time of the last presence message, in ms; restarted with each connection. */
  #heardAt = 0;
  /** True if no presence arrived within `expires_ms`. */
  #isMissed = false;
  #mustReconnect = false;

  /** @param {string} address @param {ConnectOptions} [options] @param {string | null} [handlerId] */
  constructor(address, options = {}, handlerId = null) {
    this.address = parseAddress(address);
    this.handlerId = handlerId;
    this.#options = options;
    const user = options.user ?? this.address.user;
    const isNamed = typeof user === "string" && user.length > 0 && user.length <= USER_MAX && !/[/+#\0]/.test(user);
    this.clientId = `${isNamed ? `${user}-` : ""}js-${randomBytes(6).toString("hex")}`;
    this.#topicId = isNamed ? user : this.clientId;
    /** @type {Log} */
    this.log = options.log ?? { debug: () => {}, warn: console.warn, error: console.error };
  }

  /** The boot of the runtime that is online; null while it is offline. @returns {string | null} */
  get bootId() {
    const presence = this.hub.last("presence");
    return presence?.online ? presence.boot_id : null;
  }

  /** True while the machine can be reached. */
  get isConnected() {
    return this.#isPresent && this.bootId !== null;
  }

  /** A signal that is aborted when this connection is closed. @returns {AbortSignal} */
  get stopped() {
    return this.#stopped.signal;
  }

  /** Connects, and waits for the machine. Throws a `ConnectError` if the machine is not online in time or the broker refuses this
   * client. */
  async start() {
    const timeoutMs = this.#options.timeoutMs ?? PRESENT_TIMEOUT_MS;
    void this.#keepConnected();
    const isThere = () => this.isConnected && this.hub.last("birth") !== undefined;
    await this.until(() => isThere() || this.#refused.isRung, AbortSignal.timeout(timeoutMs)).catch(() => {});
    if (isThere()) return;
    const why = this.#link === null ? this.#trouble : "the broker answers, but no machine of this name is online";
    await this.stop();
    throw new ConnectError(this.#refused.isRung ? why : `no connection to ${this.address.shown}: ${why}`);
  }

  /**
   * Waits until a condition holds; checked after each message and each loss of the connection.
   * @param {() => boolean} holds @param {AbortSignal} [signal]
   */
  async until(holds, signal) {
    const news = new Bell();
    this.#news.add(news);
    try {
      while (!holds()) {
        news.mute();
        await news.rung(signal === undefined ? {} : { signal });
        signal?.throwIfAborted();
        if (this.stopped.aborted) throw new NotConnected("the connection was closed here");
      }
    } finally {
      this.#news.delete(news);
    }
  }

  /** Closes the connection; pending requests get no answer. */
  async stop() {
    this.#isClosing = true;
    await this.#link?.close();
    this.#stopped.abort();
    this.#isPresent = false;
    for (const request of this.#requests) request.reject(new NotConnected(`${request.path}: the connection was closed here`));
    this.hub.close();
    this.#ringBells();
  }

  #ringBells() {
    this.#news.forEach((news) => news.ring());
  }

  async #keepConnected() {
    const { nodes } = this.address;
    let waitMs = BACKOFF_FIRST_MS;
    // tries one node after the other, with a wait after each round and each connection
    for (let tries = 1, at = 0; !this.stopped.aborted; tries += 1, at = (at + 1) % nodes.length) {
      const wasConnected = await this.#oneConnection(/** @type {{host: string, port: number}} */ (nodes[at]));
      if (wasConnected) {
        waitMs = BACKOFF_FIRST_MS;
        tries = 0;
      }
      if (tries % nodes.length !== 0) continue;
      await sleep(waitMs * (0.5 + Math.random() / 2), this.stopped);
      waitMs = Math.min(waitMs * 2, BACKOFF_MAX_MS);
    }
  }

  /**
   * Serves one connection until it ends; returns whether it was established.
   * @param {{host: string, port: number}} node
   */
  async #oneConnection({ host, port }) {
    const link = new Link(this.#linkOptions(), (topic, payload, isRetained) => this.#received(topic, payload, isRetained));
    const abandon = () => link.abandon();
    this.stopped.addEventListener("abort", abandon);
    for (const request of this.#requests) {
      request.isSent = false;
      // the handler's registration was lost with the connection, so the machine would refuse the claim
      if (request.resultOf?.kind === "claim") request.reject(new NotConnected("the connection was lost; register, then claim again"));
    }
    let age;
    try {
      await link.open(host, port);
      this.#link = link;
      this.connections += 1;
      this.#heardAt = performance.now();
      this.#isMissed = this.#mustReconnect = false;
      link.subscribe(this.#filters().map((path) => `${this.address.root}/${path}`));
      age = setInterval(() => {
        if (this.#mustReconnect) void link.close("the presence of the machine had expired, and is received again");
        link.lookAtSilence();
        this.#lookAtAge();
      }, limits.lookMs);
      this.#trouble = await link.lost;
      if (!this.#isClosing) this.log.warn(`${host}:${port}: ${this.#trouble}`);
      return true;
    } catch (error) {
      this.#trouble = error instanceof ConnectError ? error.message : `${host}:${port}: ${error instanceof Error ? error.message : error}`;
      if (error instanceof ConnectError) this.#refused.ring();
      return false;
    } finally {
      clearInterval(age);
      this.stopped.removeEventListener("abort", abandon);
      link.abandon();
      this.#link = null;
      this.#isPresent = false;
      this.#ringBells();
    }
  }

  /** @returns {import("./link.js").LinkOptions} */
  #linkOptions() {
    const { address, handlerId, will } = this;
    const { user = address.user, password = address.password, tls } = this.#options;
    const topic = `${address.root}/handler/${handlerId}/presence`;
    return {
      clientId: this.clientId,
      user,
      password,
      tls: address.tls ? (tls ?? {}) : null,
      will: will === null || handlerId === null ? null : { topic, payload: will },
    };
  }

  #filters() {
    const own = this.handlerId === null ? [] : [`handler/${this.handlerId}/presence`, `handler/${this.handlerId}/result`];
    return [...FILTERS, `reply/${this.clientId}`, ...own];
  }

  // --- incoming messages

  /** Sets the machine offline if its presence has expired: a last will may not arrive. */
  #lookAtAge() {
    const presence = this.hub.last("presence");
    if (!presence?.online || typeof presence.expires_ms !== "number") return;
    if (performance.now() - this.#heardAt < presence.expires_ms) return;
    this.log.warn("the machine has not renewed its presence in time: it is treated as offline");
    this.#isMissed = true;
    this.#take("presence", "presence", { ...presence, online: false });
  }

  /** @param {string} topic @param {Buffer} payload @param {boolean} isRetained */
  #received(topic, payload, isRetained) {
    const path = topic.slice(this.address.root.length + 1);
    const pattern = patternOf(path);
    if (pattern === undefined) return;
    if (payload.length === 0) {
      this.hub.forget(path);
      return;
    }
    let message;
    let wrong;
    try {
      message = JSON.parse(payload.toString("utf8"));
      wrong = whatIsWrong(pattern, message);
    } catch (error) {
      wrong = sentence(error);
    }
    if (wrong !== null) {
      this.log.warn(`a message on ${topic} does not have the form of its topic: ${wrong}`);
      return;
    }
    if (pattern === "presence" && !isRetained) {
      this.#heardAt = performance.now();
      // a separated part of a cluster may have missed messages, so connect, read and publish everything again
      this.#mustReconnect = this.#isMissed;
    }
    this.#take(path, pattern, message);
  }

  /** @param {string} path @param {string} pattern @param {any} message */
  #take(path, pattern, message) {
    this.hub.publish(path, message);
    if (pattern === "cs/+/m_code/+/result") this.#onResult(path, message);
    else if (pattern === "reply/+") this.#onReply(message);
    else if (pattern === "presence") this.#onPresence();
    this.onMessage(path, pattern, message);
    this.#ringBells();
  }

  #onPresence() {
    const { bootId } = this;
    if (bootId === null || this.#link === null) {
      this.#isPresent = false;
      return;
    }
    if (!this.#isPresent || bootId !== this.#toldBoot) {
      this.#isPresent = true;
      this.#toldBoot = bootId;
      this.onConnected();
    }
    for (const request of this.#requests) if (!request.isSent) this.#send(request);
  }

  /** @param {string} path @param {import("./messages.d.ts").HandshakeResultMessage} result */
  #onResult(path, result) {
    for (const request of this.#requests) {
      const asked = request.resultOf;
      if (asked === undefined || asked.path !== path || asked.seq !== result.seq || asked.handlerId !== result.handler_id) continue;
      if ((result.of ?? asked.kind) !== asked.kind || (result.instance ?? this.instance) !== this.instance) continue;
      // a late answer to a claim, from a machine without `of` in its results; an output that is reset leaves `pending`
      // first
      if (result.of === undefined && asked.kind === "reset" && result.status === "accepted" && this.#isOpen(path, result.seq)) continue;
      if (result.status === "refused") request.reject(new RequestRefused("invalid", result.text ?? "invalid message"));
      else request.resolve(result);
    }
  }

  /** @param {string} path @param {number} seq */
  #isOpen(path, seq) {
    const pending = this.hub.last(`cs/${numberAt(path, 1)}/m_code/pending`);
    return pending?.outputs.some((/** @type {any} */ output) => output.seq === seq) ?? false;
  }

  /** @param {import("./messages.d.ts").CommandReplyMessage} reply */
  #onReply(reply) {
    if (reply.status === "accepted") return;
    for (const request of this.#requests) {
      if (request.commandId !== reply.command_id) continue;
      if (reply.status === "rejected") request.reject(new RequestRefused(reply.code, reply.text));
      else request.resolve(reply);
    }
  }

  // --- outgoing messages

  /**
   * Sends a message, and waits for its answer, or for the broker's acknowledgement if it has none. Throws
   * `RequestRefused`, `NotConnected` (no connection within the time limit, not sent), `NoAnswer` (sent, but not answered)
   * or `OutputEnded` (the sending handler was cancelled).
   * @param {string} path @param {object} payload
   * @param {{retain?: boolean, commandId?: string, resultOf?: ResultOf, timeoutMs?: number}} [options]
   * @returns {Promise<any>}
   */
  async request(path, payload, { retain = false, commandId, resultOf, timeoutMs = ANSWER_TIMEOUT_MS } = {}) {
    checkMaySend();
    if (this.stopped.aborted) throw new NotConnected(`${path}: the connection was closed here; nothing was sent`);
    if (this.#requests.size >= OUTBOX_MAX) throw new NotConnected(`${OUTBOX_MAX} requests wait for an answer already; nothing was sent`);
    /** @type {Request} */
    const request = { path, topic: this.#topicOf(path, payload), payload: JSON.stringify(payload), retain, commandId, resultOf, ...NEW };
    const answer = new Promise((resolve, reject) => {
      request.resolve = resolve;
      request.reject = reject;
    });
    const timer = setTimeout(() => {
      const nothing = `${path}: no connection to ${this.address.shown} within ${timeoutMs / 1000} s; nothing was sent`;
      request.reject(request.wasSent ? new NoAnswer(path, timeoutMs, commandId) : new NotConnected(nothing));
    }, timeoutMs);
    this.#requests.add(request);
    this.#send(request);
    try {
      return await answer;
    } finally {
      clearTimeout(timer);
      this.#requests.delete(request);
    }
  }

  /** Sends a message without waiting for its arrival; drops it if there is no connection. @param {string} path @param {object} payload */
  post(path, payload, retain = false) {
    if (this.isConnected) this.#link?.publish(this.#topicOf(path, payload), JSON.stringify(payload), retain);
  }

  /** Returns the topic of a request, which names its sender. @param {string} path @param {any} payload */
  #topicOf(path, payload) {
    const { root } = this.address;
    if (/^(handler|client)\//.test(path)) return `${root}/${path}`;
    const id = this.handlerId;
    const isOwn = payload.handler_id === undefined ? SET_BY_HANDLERS.test(path) : payload.handler_id === id && payload.force !== true;
    return id !== null && isOwn ? `${root}/handler/${id}/${path}` : `${root}/client/${this.#topicId}/${path}`;
  }

  /** @param {Request} request */
  #send(request) {
    const { bootId } = this;
    if (this.#link === null || !this.#isPresent || bootId === null) return;
    if (request.commandId !== undefined) {
      // another boot would not know the id, and would execute the command a second time
      if (request.bootId !== null && request.bootId !== bootId) return;
      request.bootId = bootId;
    }
    const acknowledged = () => {
      if (request.commandId === undefined && request.resultOf === undefined) request.resolve(undefined);
    };
    const { topic, payload, retain } = request;
    if (!this.#link.publish(topic, payload, retain, acknowledged)) return;
    request.isSent = true;
    request.wasSent = true;
  }
}

const NEW = { bootId: null, wasSent: false, isSent: false, resolve: () => {}, reject: () => {} };
