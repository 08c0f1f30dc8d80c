// A scripted broker with a machine; the test decides what it publishes, accepts and acknowledges.

import { once } from "node:events";
import { readFile } from "node:fs/promises";
import { createServer } from "node:net";
import { createRequire } from "node:module";

const packets = createRequire(createRequire(import.meta.url).resolve("mqtt"))("mqtt-packet");
const MACHINE = "tandem/v1/mill-1/";
export const PRESENCE = "handler/cell/presence";
/** The transcripts, with the members that messages of the machine have. */
export const table = JSON.parse(await readFile(new URL("../../../tests/transcripts/handshake.json", import.meta.url), "utf8"));

/** Returns a message of the machine with these members; the table has the other ones. @param {string} topic @param {any} members */
function message(topic, members) {
  const levels = topic.split("/").map((level, at) => ((at === 1 || at === 3) && level !== "pending" ? "+" : level));
  const whole = { ...(table.messages[topic] ?? table.messages[levels.join("/")]), ...members };
  if (whole.outputs !== undefined) whole.outputs = whole.outputs.map((/** @type {any} */ output) => ({ ...table.output, ...output }));
  return whole;
}

/** Accepts connections, keeps retained messages, and answers for a machine that is online. */
export class FakeBroker {
  /** Received messages: topic below the machine, payload. @type {[string, any][]} */
  heard = [];
  connections = 0;
  goodbyes = 0;
  /** New connections are closed at once. */
  isDown = false;
  /** Last will of the newest connection. @type {any} */
  will = null;
  /** Instance of the handler that has published a presence. @type {string | null} */
  instance = null;
  #server = createServer((socket) => this.#serve(socket));
  /** @type {Set<import("node:net").Socket>} */
  #lines = new Set();
  /** @type {Map<string, any>} */
  #retained = new Map(["birth", "presence"].map((topic) => [topic, message(topic, {})]));

  /**
   * @typedef {object} Does
   * @property {boolean} [acknowledges]
   * @property {boolean} [accepts] the machine accepts a handler as soon as it registers
   */

  /** @param {Does} does */
  constructor({ acknowledges = true, accepts = true } = {}) {
    this.does = { acknowledges, accepts };
  }

  /** Listens. @param {Does} [does] */
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

  /** Topics of the received messages. */
  get topics() {
    return this.heard.map(([topic]) => topic);
  }

  close() {
    this.#server.close();
    this.cut();
  }

  /** Publishes a message of the machine; states stay for later connections. @param {string} topic @param {any} members */
  publish(topic, members) {
    const whole = message(topic, members);
    if (whole.instance === "$instance") whole.instance = this.instance;
    if (this.#retained.has(topic) || topic.endsWith("/pending")) this.#retained.set(topic, whole);
    this.#lines.forEach((line) => publish(line, topic, whole));
  }

  /** Publishes that the machine has accepted the registered handler. */
  accept() {
    this.publish("handler/cell/result", {});
  }

  /** Breaks all connections; the broker publishes the last will. */
  cut() {
    if (this.will !== null) this.#retained.set(PRESENCE, this.will);
    this.#lines.forEach((line) => line.destroy());
  }

  /** @param {import("node:net").Socket} line */
  #serve(line) {
    line.on("error", () => {});
    line.on("close", () => this.#lines.delete(line));
    if (this.isDown) return line.destroy();
    const parser = packets.parser();
    parser.on("packet", (/** @type {any} */ packet) => this.#answer(line, packet));
    return line.on("data", (data) => parser.parse(data));
  }

  /** @param {import("node:net").Socket} line @param {any} packet */
  #answer(line, { cmd, messageId, subscriptions, topic, payload, will }) {
    if (cmd === "connect") {
      this.connections += 1;
      this.will = will === undefined ? null : JSON.parse(will.payload.toString());
      send(line, { cmd: "connack", returnCode: 0, sessionPresent: false });
    } else if (cmd === "disconnect") this.goodbyes += 1;
    else if (cmd === "pingreq") send(line, { cmd: "pingresp" });
    else if (cmd === "subscribe") {
      send(line, { cmd: "suback", messageId, granted: subscriptions.map(() => 1) });
      this.#lines.add(line);
      this.#retained.forEach((retained, at) => publish(line, at, retained, true));
    } else if (cmd === "publish") {
      const path = topic.slice(MACHINE.length);
      const said = JSON.parse(payload.toString());
      if (this.does.acknowledges) send(line, { cmd: "puback", messageId });
      if (path === PRESENCE) this.#onPresence(said);
      this.heard.push([path, said]);
    }
  }

  /** @param {any} presence */
  #onPresence(presence) {
    this.instance = presence.instance;
    this.#retained.set(PRESENCE, presence);
    this.#lines.forEach((line) => publish(line, PRESENCE, presence));
    if (presence.online && this.does.accepts) this.accept();
  }
}

/** @param {import("node:net").Socket} line @param {string} path @param {object} message @param {boolean} [retain] */
function publish(line, path, message, retain = false) {
  send(line, { cmd: "publish", topic: MACHINE + path, payload: JSON.stringify(message), qos: 0, retain, dup: false });
}

/** @param {import("node:net").Socket} line @param {object} packet */
function send(line, packet) {
  line.write(packets.generate(packet));
}
