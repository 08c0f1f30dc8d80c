// One connection to a broker.

import { connect } from "mqtt";

import { ConnectError } from "./errors.js";

const CONNECT_TIMEOUT_MS = 5_000;
const CLOSE_TIMEOUT_MS = 500;
const KEEP_ALIVE_S = 5;
export const limits = {
  /**
   * Time limit for acknowledgements: if messages wait and the broker acknowledges none, the client connects to the next
   * node. A node that has lost its cluster may accept messages and never acknowledge them, even after it has rejoined.
   */
  silenceMs: 10_000,
  /** Interval of the checks of the machine's presence and of missing acknowledgements. */
  lookMs: 1_000,
};
/** Maximum bytes of one message; longer messages are not read. */
const PAYLOAD_MAX = 1 << 20;
/** Maximum number of unacknowledged messages; further messages are refused. */
const UNACKNOWLEDGED_MAX = 2_048;
/** CONNACK codes: client identifier refused, wrong password, or user not permitted. */
const REFUSED_FOR_GOOD = [2, 4, 5];

/**
 * Certificates and keys, as PEM or as `node:tls` takes them.
 * @typedef {object} Tls
 * @property {string | Buffer} [ca] certificate authority of the broker, if the system does not know it
 * @property {string | Buffer} [cert] of this client
 * @property {string | Buffer} [key]
 * @property {string} [passphrase] of the key
 * @property {string} [servername] the broker's name in its certificate, if it differs from the address
 */

/**
 * @typedef {object} LinkOptions
 * @property {string} clientId
 * @property {string | undefined} user
 * @property {string | undefined} password
 * @property {Tls | null} tls
 * @property {{topic: string, payload: string} | null} will the last will, retained
 */

/** A connection from `open` to its loss, which `lost` reports. A link is not reused. */
export class Link {
  #options;
  #onMessage;
  /** @type {import("mqtt").MqttClient | null} */
  #client = null;
  #unacknowledged = 0;
  /** Time since when unacknowledged messages wait without any acknowledgement, in ms. */
  #silentSince = 0;
  #why = "the connection was lost";
  #end = (/** @type {string} */ _why) => {};
  /** Reason for the end of the connection, once it has ended. @type {Promise<string>} */
  lost;

  /** @param {LinkOptions} options @param {(topic: string, payload: Buffer, isRetained: boolean) => void} onMessage */
  constructor(options, onMessage) {
    this.#options = options;
    this.#onMessage = onMessage;
    this.lost = new Promise((resolve) => {
      this.#end = resolve;
    });
  }

  /**
   * Connects, and waits until the broker has accepted; throws a `ConnectError` if the broker refuses permanently.
   * @param {string} host @param {number} port
   */
  async open(host, port) {
    const { clientId, user, password, tls, will } = this.#options;
    const client = connect({
      ...(tls ?? {}),
      protocol: tls === null ? "mqtt" : "mqtts",
      host,
      port,
      clientId,
      clean: true,
      protocolVersion: 4,
      keepalive: KEEP_ALIVE_S,
      connectTimeout: CONNECT_TIMEOUT_MS,
      reconnectPeriod: 0,
      resubscribe: false,
      ...(user === undefined ? {} : { username: user }),
      ...(password === undefined ? {} : { password }),
      ...(will === null ? {} : { will: { topic: will.topic, payload: Buffer.from(will.payload), qos: 1, retain: true } }),
    });
    this.#client = client;
    client.on("message", (topic, payload, { retain }) => {
      if (payload.length <= PAYLOAD_MAX) this.#onMessage(topic, payload, retain);
    });
    await new Promise((/** @type {(_: void) => void} */ resolve, reject) => {
      client.on("connect", () => {
        // small messages must not wait for each other
        if ("setNoDelay" in client.stream && typeof client.stream.setNoDelay === "function") client.stream.setNoDelay(true);
        resolve();
      });
      client.on("error", (error) => {
        this.#why = error.message;
        const code = "code" in error ? error.code : undefined;
        reject(REFUSED_FOR_GOOD.some((known) => known === code) ? new ConnectError(`the broker refuses this client: ${this.#why}`) : error);
      });
      client.on("close", () => {
        reject(new Error(this.#why));
        this.#end(this.#why);
      });
    });
  }

  /** Subscribes with quality of service 1. @param {string[]} filters */
  subscribe(filters) {
    const acknowledged = this.#awaitsAcknowledgement();
    this.#client?.subscribe(filters, { qos: 1 }, acknowledged);
  }

  /** Counts a message as unacknowledged; returns the function to call when its acknowledgement arrives. */
  #awaitsAcknowledgement() {
    if (this.#unacknowledged === 0) this.#silentSince = performance.now();
    this.#unacknowledged += 1;
    return () => {
      this.#unacknowledged -= 1;
      this.#silentSince = performance.now();
    };
  }

  /** Leaves a broker that acknowledges nothing; called about once a second. */
  lookAtSilence() {
    if (this.#unacknowledged === 0 || performance.now() - this.#silentSince < limits.silenceMs) return;
    this.#end(`the broker has acknowledged nothing for ${limits.silenceMs / 1000} s`);
    this.abandon();
  }

  /**
   * Sends a message with quality of service 1; returns false if it cannot be accepted.
   * @param {string} topic @param {string} payload @param {boolean} retain @param {() => void} [acknowledged]
   */
  publish(topic, payload, retain, acknowledged) {
    const client = this.#client;
    if (client === null || !client.connected || this.#unacknowledged >= UNACKNOWLEDGED_MAX) return false;
    const hasCome = this.#awaitsAcknowledgement();
    client.publish(topic, payload, { qos: 1, retain }, (error) => {
      hasCome();
      if (!error) acknowledged?.();
    });
    return true;
  }

  /** Sends waiting messages, disconnects, and closes. */
  async close(reason = "closed here") {
    const client = this.#client;
    if (client?.connected) {
      const force = setTimeout(() => this.abandon(), CLOSE_TIMEOUT_MS);
      this.#why = reason;
      await client.endAsync().catch(() => {});
      clearTimeout(force);
    }
    this.abandon();
  }

  /** Closes without a disconnect message: the broker publishes the will. */
  abandon() {
    this.#client?.end(true);
    this.#end("closed here");
  }
}
