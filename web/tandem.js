// A machine, for third-party pages and for the HMI itself: states as they change, commands with their answers. The page "Use the
// HMI, or write one" of the book describes it. No other module is needed; `tandem/elements.js` has elements that show a machine.

import { AgeLimits } from "./tandem/age_limits.js";
import { latenessMs } from "./tandem/lateness.js";
import { Link } from "./tandem/link.js";
import { ageLimitMs, answerLimitMs, asSentence, isLimited, NOT_AFTER_MS, PERSON_TIMEOUT_MS, randomName, Refusal, request, TIMEOUT_MS } from "./tandem/requests.js";
import { t } from "./text/language.js";

export { Refusal, TIMEOUT_MS };

/** Names of commands with an age limit. @type {Record<string, string>} */
const VERBS = {
  load: t("requests.verb.load"), start: t("requests.verb.start"), resume: t("requests.verb.resume"), reset: t("requests.verb.reset"), mdi: t("requests.verb.mdi"),
  jog: t("requests.verb.jog"), home: t("requests.verb.home"), back_trace: t("requests.verb.back_trace"), run: t("requests.verb.run"),
};

/** Where the HMI keeps the token of its user, until the window is closed. */
const TOKEN_KEY = "tandem-token";

/**
 * The state that the operator has seen; if it has changed, the machine refuses.
 * @typedef {{boot_id?: string | null, state_rev?: number | undefined}} Expected
 */

/**
 * @typedef {object} Options
 * @property {string} [url] of the machine, such as `http://mill-1:8080`; without it, the server of this page
 * @property {() => string | null} [token] the user's token; without it, that of the HMI in this window
 * @property {string} [name] beginning of the ids of commands
 */

/**
 * @typedef {object} CommandOptions
 * @property {Expected} [expect] state that the command requires
 * @property {number} [fence] number of the control lease under which it is sent
 * @property {string} [id] of the command: the machine answers a known id with the stored reply; without it, a new id
 * @property {import("./tandem/age_limits.js").NotAfter | null} [notAfter] the age limit of the command; without it, 1 s from now, for `load` 5 s; null: no limit
 * @property {() => void} [onAccepted] called when the machine has accepted it
 */

/**
 * @typedef {import("./tandem/requests.js").Asked & {notAfter?: import("./tandem/age_limits.js").NotAfter | null}} AskedWithAge
 */

/**
 * @template {string} Topic
 * @typedef {(message: import("./types.d.ts").MessageOf<Topic>, topic: string) => void} Listener
 */

export class Tandem {
  /** True while the machine is connected. */
  online = false;
  /** Time of the next try to connect, ms of the local clock; null: no try is planned. @type {number | null} */
  retryAt = null;
  #url;
  #token;
  #name;
  #link;
  /** @type {Map<string, Set<Listener<any>>>} */
  #listeners = new Map();
  /** @type {Set<(tandem: Tandem) => void>} */
  #onLink = new Set();
  /** @type {Set<(text: string) => void>} */
  #onRefused = new Set();
  #ages = new AgeLimits();

  /** @param {Options} [options] */
  constructor({ url = globalThis.location?.origin ?? "", token = storedToken, name = "page" } = {}) {
    this.#url = url.replace(/\/+$/, "");
    this.#token = token;
    this.#name = name;
    this.#link = new Link({
      address: () => ({ url: `${this.#url.replace(/^http/, "ws")}/api/v1/ws`, protocols: protocols(token()) }),
      health: `${this.#url}/api/v1/health`,
      message: (topic, message) => this.#receive(topic, message),
      refused: (text) => this.#onRefused.forEach((listener) => listener(text)),
      phase: (online, retryAt) => this.#phase(online, retryAt),
    });
  }

  /** Connects, and again whenever the connection is lost. */
  connect() {
    if (this.#url === "") throw new TypeError("new Tandem({ url }): write the address of the machine, such as http://mill-1:8080");
    this.#link.subscribe("heartbeat");
    this.#link.open();
    return this;
  }

  /** Ends the connection for good. */
  close() {
    this.#link.close();
  }

  /** Tries to connect without waiting. */
  retryNow() {
    this.#link.retryNow();
  }

  /**
   * Subscribes to a topic, such as `cs/1/state` or, with wildcards, `cs/+/state`: a state arrives at once and whenever it changes,
   * and again after each new connection. The returned function ends the subscription.
   * @template {string} Topic
   * @param {Topic} topic @param {Listener<Topic>} listener
   * @returns {() => void}
   */
  on(topic, listener) {
    const known = this.#listeners.get(topic) ?? new Set();
    this.#listeners.set(topic, known.add(listener));
    this.#link.subscribe(topic);
    return () => {
      if (!known.delete(listener) || known.size > 0) return;
      this.#listeners.delete(topic);
      this.#link.unsubscribe(topic);
    };
  }

  /** Calls the listener when `online` or `retryAt` change; the returned function ends this. @param {(tandem: Tandem) => void} listener */
  onLink(listener) {
    this.#onLink.add(listener);
    return () => this.#onLink.delete(listener);
  }

  /** Calls the listener with the reason of a refused subscription; the returned function ends this. @param {(text: string) => void} listener */
  onRefused(listener) {
    this.#onRefused.add(listener);
    return () => this.#onRefused.delete(listener);
  }

  /**
   * Returns the age limit of a request that a person makes now, or has made by a press that the page handles late. Null while no
   * heartbeat of the machine has arrived over the connection. All requests of one press carry the limit of that press.
   * @param {number} [withinMs] at most 60,000
   * @returns {import("./tandem/age_limits.js").NotAfter | null}
   */
  notAfter(withinMs = NOT_AFTER_MS) {
    return this.#ages.received(latenessMs(), withinMs);
  }

  /**
   * Sends a request, and returns the answer, or throws a `Refusal`. A request after which something can move, or other values
   * apply, carries an age limit of 1 s, or the given limit: an older request is rejected. `notAfter: null` sends it without a limit.
   * @param {string} method @param {string} path below `/api/v1`, such as `/tools` @param {AskedWithAge} [asked]
   */
  async request(method, path, { notAfter, ...asked } = {}) {
    const url = `${this.#url}/api/v1${path}`;
    const limit = isLimited(method, path) ? await this.#limit(path, notAfter) : null;
    if (limit === null) return request(url, this.#token(), method, asked);
    const body = { .../** @type {object} */ (asked.body), not_after: limit };
    const limited = { timeoutMs: answerLimitMs(limit), unanswered: notReached(path), ...asked, body };
    return request(url, this.#token(), method, limited).catch((error) => {
      if (error instanceof Refusal && error.problem.code === "expired") throw new Refusal(limited.unanswered, error.problem);
      throw error;
    });
  }

  /**
   * Returns the given age limit, else one that begins now; null: no limit.
   * @param {string} path @param {import("./tandem/age_limits.js").NotAfter | null | undefined} given
   */
  async #limit(path, given) {
    if (given !== undefined) return given;
    const withinMs = ageLimitMs(path);
    const limit = this.notAfter(withinMs) ?? (await this.#readLimit(path, withinMs));
    if (limit === null) throw new Refusal(notReached(path));
    return limit;
  }

  /** Returns an age limit from a heartbeat that is read over HTTP; null if the limit has passed. @param {string} path @param {number} withinMs */
  #readLimit(path, withinMs) {
    const asked = { timeoutMs: withinMs, unanswered: notReached(path) };
    return this.#ages.read(latenessMs(), withinMs, async () => (await request(`${this.#url}/api/v1/heartbeat`, this.#token(), "GET", asked)).json());
  }

  /** Returns the JSON of a route. @param {string} path below `/api/v1` @returns {Promise<any>} */
  async get(path) {
    return (await this.request("GET", path)).json();
  }

  /** Writes a value, such as `put("/cs/1/inputs/optional_stop", { value: true })`. @param {string} path @param {object | string} body */
  async put(path, body) {
    await this.request("PUT", path, { body });
  }

  /**
   * Commands a coordinate system, and waits until the command is done. The id prevents a second execution.
   * @param {number} cs @param {import("./types.d.ts").Verb} verb @param {object} [args] @param {CommandOptions} [options]
   * @returns {Promise<Partial<import("./types.d.ts").CommandReply>>}
   */
  async command(cs, verb, args = {}, { expect = {}, fence, id = `${this.#name}-${randomName()}`, notAfter, onAccepted = () => {} } = {}) {
    /** @type {Record<string, string>} */
    const headers = { "Idempotency-Key": id, ...expected(expect) };
    if (fence !== undefined) headers["Lease-Fence"] = String(fence);
    const path = `/cs/${cs}/${verb}`;
    const asked = { body: args, headers, notAfter: isLimited("POST", path) ? await this.#limit(path, notAfter) : null };
    if (asked.notAfter !== null) {
      await this.#untilAccepted(path, asked, id);
      onAccepted();
    }
    // the same request again: the machine answers when the command is done
    const response = await this.request("POST", `${path}?wait=1`, { ...asked, timeoutMs: TIMEOUT_MS, unanswered: t("requests.the_machine_did_not_answer") });
    const reply = await response.json().catch(() => ({}));
    if (reply.status === "rejected" || reply.status === "failed") throw new Refusal(asSentence(reply.text || `${verb} failed`), reply);
    return reply;
  }

  /**
   * Sends a command, and waits until the machine has accepted it. If no answer arrives, its result is looked up: the
   * age limit has passed by then, so a command without effect can no longer take effect.
   * @param {string} path @param {AskedWithAge} asked @param {string} id
   */
  async #untilAccepted(path, asked, id) {
    try {
      await this.request("POST", path, asked);
    } catch (error) {
      if (!(error instanceof Refusal) || Object.keys(error.problem).length > 0) throw error;
      const looked = this.request("GET", `/commands/${encodeURIComponent(id)}`, { timeoutMs: PERSON_TIMEOUT_MS });
      const isKnown = await looked.then(() => true, () => false);
      if (!isKnown) throw error;
    }
  }

  /** @param {string} topic @param {any} message */
  #receive(topic, message) {
    if (topic === "heartbeat") this.#ages.receive(message);
    for (const [pattern, listeners] of this.#listeners) {
      if (matches(pattern, topic)) listeners.forEach((listener) => listener(message, topic));
    }
  }

  /** @param {boolean} online @param {number | null} retryAt */
  #phase(online, retryAt) {
    if (online && this.online) return;
    if (!online) this.#ages.clear();
    this.online = online;
    this.retryAt = retryAt;
    this.#onLink.forEach((listener) => listener(this));
  }
}

/** Returns the text about a request that had no effect within its age limit. @param {string} path */
function notReached(path) {
  const verb = /\/runs$/.test(path) ? "run" : (/^\/cs\/\d+\/(\w+)/.exec(path)?.[1] ?? "");
  return t("requests.did_not_reach", { verb: VERBS[verb] ?? t("requests.verb.request") });
}

/** Returns the token of the HMI in this window. */
export function storedToken() {
  return globalThis.sessionStorage?.getItem(TOKEN_KEY) ?? null;
}

/** Stores a token for the pages of this window; null: no token. @param {string | null} token */
export function storeToken(token) {
  if (token === null) sessionStorage.removeItem(TOKEN_KEY);
  else sessionStorage.setItem(TOKEN_KEY, token);
}

/** Returns the sub-protocols of a WebSocket, which cannot have a header. @param {string | null} token @returns {string[]} */
function protocols(token) {
  return token === null ? [] : ["tandem.v1", `bearer.${token}`];
}

/** @param {Expected} expect @returns {Record<string, string>} */
function expected({ boot_id, state_rev }) {
  const tags = [state_rev === undefined ? "" : `"${state_rev}"`, boot_id ? `"boot:${boot_id}"` : ""].filter((tag) => tag !== "");
  return tags.length > 0 ? { "If-Match": tags.join(", ") } : {};
}

/** Returns whether a pattern matches a topic: `+` matches one level, a last `#` all levels below. @param {string} pattern @param {string} topic */
function matches(pattern, topic) {
  if (pattern === topic) return true;
  const levels = topic.split("/");
  const wanted = pattern.split("/");
  if (wanted.at(-1) === "#") return wanted.slice(0, -1).every((level, i) => level === "+" || level === levels[i]);
  return wanted.length === levels.length && wanted.every((level, i) => level === "+" || level === levels[i]);
}
