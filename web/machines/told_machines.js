// Other machines known to this machine's runtime: configured addresses, and machines at the shared broker.

import { Told } from "./told.js";

/** Interval of the requests, ms; short enough to report data younger than one second. */
const ASK_MS = 400;

export class ToldMachines {
  /** Addresses of the configuration. @type {string[]} */
  addresses = [];
  /** By name, ascending. @type {Map<string, Told>} */
  machines = new Map();
  #ask;
  #changed;

  /** @param {() => Promise<import("../types.d.ts").MachineList | null>} ask null while this machine does not answer @param {() => void} changed */
  constructor(ask, changed) {
    this.#ask = ask;
    this.#changed = changed;
    void this.#askAgain();
  }

  async #askAgain() {
    const said = await this.#ask();
    if (said) this.#take(said);
    else for (const told of this.machines.values()) told.lose();
    this.#changed();
    setTimeout(() => void this.#askAgain(), ASK_MS);
  }

  /** @param {import("../types.d.ts").MachineList} said */
  #take({ addresses, broker, machines }) {
    this.addresses = addresses;
    const known = this.machines;
    if (broker !== "connected") {
      for (const told of known.values()) told.lose();
      return;
    }
    this.machines = new Map(machines.map((seen) => [seen.machine, known.get(seen.machine) ?? new Told(seen.machine)]));
    for (const seen of machines) this.machines.get(seen.machine)?.take(seen);
  }
}
