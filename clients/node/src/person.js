// Requests of a person: each carries an age limit, after which the machine rejects it.

import { NotConnected } from "./errors.js";

/** Time after the newest heartbeat within which a request of a person takes effect, ms. */
export const NOT_AFTER_MS = 1000;

/** Suffixes of topics whose messages cannot cause motion, or that carry their own time limit. */
const WITHOUT = ["variable/get", "lease/take", "lease/release", "alarm/raise"];

/**
 * A connection whose requests carry the age limit of one press.
 * @param {import("./connection.js").Connection} connection @param {number} withinMs
 * @returns {import("./connection.js").Connection}
 */
export function personConnection(connection, withinMs) {
  const heartbeat = connection.hub.last("heartbeat");
  if (heartbeat === undefined) throw new NotConnected("no heartbeat of the machine has been received; nothing was sent");
  const not_after = { boot_id: heartbeat.boot_id, heartbeat: heartbeat.cycle, within_ms: withinMs };
  /** @type {import("./connection.js").Connection["request"]} */
  const request = (path, payload, options) => connection.request(path, WITHOUT.some((end) => path.endsWith(end)) ? payload : { ...payload, not_after }, options);
  return new Proxy(connection, {
    get(target, name) {
      if (name === "request") return request;
      const value = Reflect.get(target, name, target);
      return typeof value === "function" ? value.bind(target) : value;
    },
  });
}

/** Sets locks, inputs and outputs of the plant once, as a person does: nothing is written again. */
export class PersonLevels {
  #connection;
  owner = null;

  /** @param {import("./connection.js").Connection} connection */
  constructor(connection) {
    this.#connection = connection;
  }

  /** @param {import("./levels.js").Wanted} wanted */
  async set({ topic, payload }) {
    await this.#connection.request(topic, payload);
  }
}
