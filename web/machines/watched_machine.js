// One machine of the page: its messages, and the reason if it is silent.

import { MACHINE_TOPICS, Model } from "../machine/model.js";
import { Refusal, Tandem } from "../tandem.js";
import { keepToken, tokenOf } from "./addresses.js";

/** Interval of requests for the reason of a missing connection, ms, and their time limit. */
const LOOK_MS = 3000;
const ANSWER_MS = 4000;
const CS_TOPICS = ["state", "program", "m_code/pending", "input/interlock/state", "time_left", "start_conditions"];

/**
 * `silent`: its presence has expired; `unreachable`: it does not answer; `refused`: it answers, but this page may not
 * read it; `login`: it requires a login; `insecure`: a page over TLS may not use an address without TLS; `offline`: it
 * has announced its end; `unheard`: no messages of the machines at the broker arrive.
 * @typedef {"connecting" | "online" | "silent" | "unreachable" | "refused" | "login" | "insecure" | "offline" | "unheard"} LinkState
 */

export class WatchedMachine {
  /** @type {LinkState} */
  link = "connecting";
  model = new Model();
  address;
  #tandem;
  #changed;
  #timer;
  /** Time at which its presence expires, on the clock of `performance`. */
  #presentUntil = Number.POSITIVE_INFINITY;
  #isOpen = false;
  #isLooking = false;

  /** @param {string} address @param {() => void} changed */
  constructor(address, changed) {
    this.address = address;
    this.#changed = changed;
    this.#tandem = new Tandem({ url: address, token: () => tokenOf(address), name: "machines" });
    /** @type {Set<string>} */
    const topics = new Set();
    const subscribe = (/** @type {string[]} */ wanted) => {
      for (const topic of wanted) if (!topics.has(topic)) this.#tandem.on(/** @type {any} */ (topic), take);
      for (const topic of wanted) topics.add(topic);
    };
    const take = (/** @type {any} */ message, /** @type {string} */ topic) => {
      this.model.apply(topic, message);
      if (topic === "presence") this.#presentUntil = message.online && message.expires_ms ? performance.now() + message.expires_ms : Number.POSITIVE_INFINITY;
      if (topic === "birth") subscribe([...this.model.systems.keys()].flatMap((cs) => CS_TOPICS.map((of) => `cs/${cs}/${of}`)));
      changed();
    };
    subscribe(MACHINE_TOPICS);
    this.#tandem.onLink(({ online }) => this.#onLink(online));
    this.#timer = setInterval(() => void this.look(), LOOK_MS);
    void this.look();
  }

  /** Name of the machine; null until it is published. */
  get name() {
    return this.model.birth?.machine ?? null;
  }

  get systems() {
    return this.model.systems;
  }

  get alarms() {
    return this.model.alarms;
  }

  get alarmCount() {
    return this.model.alarms.length;
  }

  get birth() {
    return this.model.birth;
  }

  /** Age of the tile's data in ms; 0 if current. */
  get staleMs() {
    return this.model.staleMs;
  }

  get ageMs() {
    return (/** @type {string} */ ts) => this.model.ageMs(ts);
  }

  /**
   * Returns the other machines that the runtime of this machine knows; null without an answer.
   * @returns {Promise<import("../types.d.ts").MachineList | null>}
   */
  async peerMachines() {
    return this.link === "online" ? this.#tandem.get("/machines").catch(() => null) : null;
  }

  /** Removes the machine from the page. */
  close() {
    clearInterval(this.#timer);
    this.#tandem.close();
  }

  /** Logs in, with a name and a PIN or with a token; a refusal is thrown. @param {{user: string, pin: string, token: string}} given */
  async logIn({ user, pin, token }) {
    if (token === "") {
      const answer = await this.#tandem.request("POST", "/login", { body: { user, pin } });
      keepToken(this.address, (await answer.json()).token);
    } else keepToken(this.address, token);
    await this.look();
    this.#tandem.retryNow();
  }

  /** Finds the reason of the missing connection, and connects if that is possible. */
  async look() {
    if (this.link === "online" || this.#isLooking) return;
    this.#isLooking = true;
    const found = await this.#find();
    this.#isLooking = false;
    if (found === "connecting" && !this.#isOpen) {
      this.#isOpen = true;
      this.#tandem.connect();
    }
    const isOnline = /** @type {LinkState} */ (this.link) === "online";
    if (!isOnline && !(found === "connecting" && this.link === "silent")) this.#be(found);
  }

  /** @returns {Promise<LinkState>} */
  async #find() {
    if (location.protocol === "https:" && !this.address.startsWith("https:")) return "insecure";
    if (!(await answers(this.address))) return "unreachable";
    try {
      await this.#tandem.request("GET", "/machine", { timeoutMs: ANSWER_MS });
      return "connecting";
    } catch (error) {
      if (!(error instanceof Refusal)) throw error;
      return error.problem.code === "unauthorized" ? "login" : "refused";
    }
  }

  /** @param {boolean} online */
  #onLink(online) {
    if (online) return this.#be("online");
    this.model.disconnected();
    if (this.link === "online") this.#be(performance.now() > this.#presentUntil ? "silent" : "unreachable");
  }

  /** @param {LinkState} link */
  #be(link) {
    this.link = link;
    this.model.online = link === "online";
    this.#changed();
  }
}

/** Returns whether a server answers, even if this page may not read the answer. @param {string} address */
async function answers(address) {
  try {
    await fetch(`${address}/api/v1/health`, { mode: "no-cors", cache: "no-store", signal: AbortSignal.timeout(ANSWER_MS) });
    return true;
  } catch {
    return false;
  }
}
