// A machine of the page of which this machine's runtime tells: it has heard it at the broker that both share.

export class Told {
  /** @type {import("./watched.js").LinkState} */
  link = "connecting";
  /** Where its own screen is, if it says so. @type {string | null} */
  address = null;
  name;
  alarmCount = 0;
  /** @type {import("../types.d.ts").AlarmRecord[]} */
  alarms = [];
  /** @type {Map<number, import("../model.js").CoordinateSystem>} */
  systems = new Map();

  /** @param {string} name */
  constructor(name) {
    this.name = name;
  }

  /** @param {import("../types.d.ts").MachineSeen} seen */
  take(seen) {
    this.link = seen.link;
    this.address = seen.url;
    this.alarmCount = seen.alarm_count;
    this.alarms = seen.alarms;
    this.systems = new Map(seen.coordinate_systems.map((told) => [told.number, systemOf(told)]));
  }

  /** The broker cannot be reached from here, or this machine is not heard. */
  lose() {
    this.link = "unheard";
  }

  /** Times of another clock are not told. */
  get ageMs() {
    return null;
  }

  get birth() {
    return null;
  }
}

/** As the sentence reads it. @param {import("../types.d.ts").CoordinateSystemSeen} told */
function systemOf({ number, state, waiting_on: output, left_s, progress }) {
  /** @type {any} */
  const system = { info: { number }, state, pending: { outputs: output ? [output] : [] }, place: null, lastRun: null, interlock: null, position: null, timeLeft: { left_s, progress } };
  return system;
}
