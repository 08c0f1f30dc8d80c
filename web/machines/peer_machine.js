// A machine that this machine's runtime reports, because it receives its messages at the shared broker.

import { STALE_MS } from "../machine/model.js";

export class PeerMachine {
  /** @type {import("./watched_machine.js").LinkState} */
  link = "connecting";
  /** Address of the screen of the machine, if published. @type {string | null} */
  address = null;
  name;
  /** Time of the newest heartbeat, on the clock of `performance`; before the first heartbeat, time of the first report. */
  #receivedAt = performance.now();
  alarmCount = 0;
  /** @type {import("../types.d.ts").AlarmRecord[]} */
  alarms = [];
  /** @type {Map<number, import("../machine/model.js").CoordinateSystem>} */
  systems = new Map();

  /** @param {string} name */
  constructor(name) {
    this.name = name;
  }

  /** @param {import("../types.d.ts").MachineSeen} seen */
  update(seen) {
    this.link = seen.link;
    if (seen.age_ms !== null) this.#receivedAt = performance.now() - seen.age_ms;
    this.address = seen.url;
    this.alarmCount = seen.alarm_count;
    this.alarms = seen.alarms;
    this.systems = new Map(seen.coordinate_systems.map((system) => [system.number, systemOf(system)]));
  }

  /** Called if the broker is unreachable, or this machine is silent. */
  markUnheard() {
    this.link = "unheard";
  }

  /** Age of the tile's data in ms; 0 if current. */
  get staleMs() {
    const ageMs = performance.now() - this.#receivedAt;
    return ageMs > STALE_MS ? ageMs : 0;
  }

  /** Times are unknown, because the clock of that machine may differ. */
  get ageMs() {
    return null;
  }

  get birth() {
    return null;
  }
}

/** Converts a report to the input of the sentence. @param {import("../types.d.ts").CoordinateSystemSeen} seen */
function systemOf({ number, state, waiting_on: output, left_s, progress, start_conditions: startConditions }) {
  /** @type {any} */
  const system = { info: { number }, state, pending: { outputs: output ? [output] : [] }, place: null, lastRun: null, interlock: null, position: null, timeLeft: { run_id: state?.run_id ?? null, left_s, progress }, startConditions };
  return system;
}
