// Other machines known to this machine's runtime: configured addresses, and machines at the shared broker.

import { PeerMachine } from "./peer_machine.js";

/** Interval of the requests, ms; short enough to report data younger than one second. */
const ASK_MS = 400;

export class PeerMachineList {
  /** Addresses of the configuration. @type {string[]} */
  addresses = [];
  /** By name, ascending. @type {Map<string, PeerMachine>} */
  machines = new Map();
  #ask;
  #changed;

  /** @param {() => Promise<import("../types.d.ts").MachineList | null>} ask null while this machine does not answer @param {() => void} changed */
  constructor(ask, changed) {
    this.#ask = ask;
    this.#changed = changed;
    void this.#poll();
  }

  async #poll() {
    const answer = await this.#ask();
    if (answer) this.#update(answer);
    else for (const machine of this.machines.values()) machine.markUnheard();
    this.#changed();
    setTimeout(() => void this.#poll(), ASK_MS);
  }

  /** @param {import("../types.d.ts").MachineList} answer */
  #update({ addresses, broker, machines }) {
    this.addresses = addresses;
    const known = this.machines;
    if (broker !== "connected") {
      for (const machine of known.values()) machine.markUnheard();
      return;
    }
    this.machines = new Map(machines.map((seen) => [seen.machine, known.get(seen.machine) ?? new PeerMachine(seen.machine)]));
    for (const seen of machines) this.machines.get(seen.machine)?.update(seen);
  }
}
