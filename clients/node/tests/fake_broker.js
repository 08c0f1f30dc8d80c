// A scripted broker with an online machine; the test decides whether messages are acknowledged.

import { once } from "node:events";
import { readFile } from "node:fs/promises";
import { createServer } from "node:net";
import { createRequire } from "node:module";

const packets = createRequire(createRequire(import.meta.url).resolve("mqtt"))("mqtt-packet");
const MACHINE = "tandem/v1/mill-1/";
const { channels } = JSON.parse(await readFile(new URL("../../../runtime/gateway/api/asyncapi.json", import.meta.url), "utf8"));

/** Returns the contract's example of a message. @param {string} address */
function example(address) {
  const channel = /** @type {any[]} */ (Object.values(channels)).find((one) => one.address === `tandem/v1/{machine}/${address}`);
  const [message] = /** @type {any[]} */ (Object.values(channel.messages));
  return message.examples[0].payload;
}

/** Accepts connections, and publishes to each that the machine is online. */
export class FakeBroker {
  /** Topics of received messages, below the machine. @type {string[]} */
  heard = [];
  connections = 0;
  goodbyes = 0;
  #server = createServer((socket) => this.#serve(socket));
  /** @type {Set<import("node:net").Socket>} */
  #lines = new Set();
  /** @type {string | null} */
  #instance = null;

  /**
   * @typedef {object} Does
   * @property {boolean} acknowledges
   * @property {boolean} accepts the machine accepts a handler as soon as it registers
   * @property {number} [expiresMs] validity of the machine's presence, which is not repeated automatically
   */

  /** @param {Does} does */
  constructor(does) {
    this.does = does;
  }

  /** Listens. @param {Does} does */
  static async open(does) {
    const broker = new FakeBroker(does);
    broker.#server.listen(0, "127.0.0.1");
    await once(broker.#server, "listening");
    return broker;
  }

  get node() {
    const address = /** @type {import("node:net").AddressInfo} */ (this.#server.address());
    return `127.0.0.1:${address.port}`;
  }

  close() {
    this.#server.close();
    this.#lines.forEach((line) => line.destroy());
  }

  /** Publishes that the machine has accepted the registered handler. */
  accept() {
    const result = { ...example("handler/{id}/result"), instance: this.#instance };
    this.#lines.forEach((line) => this.#publish(line, "handler/cell/result", result));
  }

  /** Publishes that the machine is online. */
  sayPresence() {
    const presence = { ...example("presence"), expires_ms: this.does.expiresMs ?? 30_000 };
    this.#lines.forEach((line) => this.#publish(line, "presence", presence));
  }

  /** Publishes a pending M code that no handler has claimed. @param {number} m */
  issueOutput(m) {
    const pending = example("cs/{cs}/m_code/pending");
    const output = { ...pending.outputs[0], m, state: "OUTPUT", handler_id: null, instance: null, progress: null, question: null };
    const message = { ...pending, outputs: [output] };
    this.#lines.forEach((line) => this.#publish(line, "cs/1/m_code/pending", message));
  }

  /** Breaks all connections. */
  cut() {
    this.#lines.forEach((line) => line.destroy());
  }

  /** @param {import("node:net").Socket} line */
  #serve(line) {
    this.#lines.add(line);
    const parser = packets.parser();
    parser.on("packet", (/** @type {any} */ packet) => this.#answer(line, packet));
    line.on("data", (data) => parser.parse(data));
    line.on("error", () => {});
    line.on("close", () => this.#lines.delete(line));
  }

  /** @param {import("node:net").Socket} line @param {any} packet */
  #answer(line, { cmd, messageId, subscriptions, topic, payload }) {
    if (cmd === "connect") {
      this.connections += 1;
      send(line, { cmd: "connack", returnCode: 0, sessionPresent: false });
    } else if (cmd === "disconnect") this.goodbyes += 1;
    else if (cmd === "pingreq") send(line, { cmd: "pingresp" });
    else if (cmd === "subscribe") {
      send(line, { cmd: "suback", messageId, granted: subscriptions.map(() => 1) });
      this.#publish(line, "birth", example("birth"));
      this.sayPresence();
    } else if (cmd === "publish") {
      const path = topic.slice(MACHINE.length);
      this.heard.push(path);
      if (this.does.acknowledges) send(line, { cmd: "puback", messageId });
      if (path === "handler/cell/presence") this.#onPresence(JSON.parse(payload.toString()));
    }
  }

  /** @param {any} presence */
  #onPresence({ online, instance }) {
    if (!online) return;
    this.#instance = instance;
    if (this.does.accepts) this.accept();
  }

  /** @param {import("node:net").Socket} line @param {string} path @param {object} message */
  #publish(line, path, message) {
    send(line, { cmd: "publish", topic: MACHINE + path, payload: JSON.stringify(message), qos: 0, retain: false, dup: false });
  }
}

/** @param {import("node:net").Socket} line @param {object} packet */
function send(line, packet) {
  line.write(packets.generate(packet));
}
