// Known data of the machine: the last message of each topic, and the recent path.

import { Trail } from "./trail.js";

/** Topics of the machine as a whole. */
export const MACHINE_TOPICS = ["presence", "birth", "alarm/active", "io/#", "variables", "tools", "stored_data", "heartbeat"];

/** Topics of a coordinate system that the screen shows, with the field that keeps them. */
const CS_TOPICS = /** @type {const} */ ({
  state: "state",
  program: "place",
  position: "position",
  modal: "modal",
  "m_code/pending": "pending",
  "input/optional_skip/state": "optionalSkip",
  "input/optional_stop/state": "optionalStop",
  "input/single_block/state": "singleBlock",
  "input/interlock/state": "interlock",
  "input/start_lock/state": "startLock",
  "override/state": "overrides",
  "lease/state": "lease",
  run: "runState",
  time_left: "timeLeft",
  start_conditions: "startConditions",
  variables: "variables",
  work_offsets: "workOffsets",
});

/**
 * One coordinate system.
 * @typedef {object} CoordinateSystem
 * @property {import("../types.d.ts").CoordinateSystemInfo} info
 * @property {import("../types.d.ts").StateMessage | null} state
 * @property {import("../types.d.ts").ProgramLocationMessage | null} place
 * @property {import("../types.d.ts").PositionMessage | null} position
 * @property {import("../types.d.ts").ModalMessage | null} modal
 * @property {import("../types.d.ts").PendingMessage | null} pending
 * @property {import("../types.d.ts").OptionalSkipMessage | null} optionalSkip
 * @property {import("../types.d.ts").RunStateMessage | null} runState
 * @property {Pick<import("../types.d.ts").TimeLeftMessage, "run_id" | "left_s" | "progress"> | null} timeLeft
 * @property {Pick<import("../types.d.ts").StartConditionsMessage, "obstacles"> | null} startConditions obstacles to a start
 * @property {import("../types.d.ts").SwitchMessage | null} optionalStop
 * @property {import("../types.d.ts").SwitchMessage | null} singleBlock
 * @property {import("../types.d.ts").LockMessage | null} interlock
 * @property {import("../types.d.ts").LockMessage | null} startLock
 * @property {import("../types.d.ts").LastRun | null} lastRun the last run before this start of the runtime
 * @property {import("../types.d.ts").OverridesMessage | null} overrides
 * @property {import("../types.d.ts").LeaseStateMessage | null} lease
 * @property {import("../types.d.ts").PublishedVariablesMessage | null} variables Q variables that the machine publishes
 * @property {import("../types.d.ts").WorkOffsetValuesMessage | null} workOffsets
 * @property {{hash: string | null, text: string} | null} note note with which the last load was accepted
 * @property {Trail} trail
 */

/** Time without a heartbeat (10 per second) after which the shown data is stale, ms; with the check interval, less than
 * a second. */
export const STALE_MS = 700;

export class Model {
  online = false;
  /** Time of the last heartbeat, on the clock of `performance`; null before the first. @type {number | null} */
  #beatAt = null;
  /** @type {number | null} time of the next try to connect, ms of the local clock */
  retryAt = null;
  /** @type {string | null} */
  bootId = null;
  /** @type {import("../types.d.ts").BirthMessage | null} */
  birth = null;
  /** @type {import("../types.d.ts").PresenceMessage | null} */
  presence = null;
  /** @type {import("../types.d.ts").AlarmRecord[]} */
  alarms = [];
  /** Inputs and outputs of the plant by topic. @type {Map<string, import("../types.d.ts").IoStateMessage>} */
  io = new Map();
  /** P variables that the machine publishes. @type {import("../types.d.ts").PublishedVariablesMessage | null} */
  variables = null;
  /** Whether the stored files fit together. @type {import("../types.d.ts").StoredDataMessage | null} */
  storedData = null;
  /** The tool table. @type {import("../types.d.ts").ToolTableMessage | null} */
  tools = null;
  /** @type {Map<number, CoordinateSystem>} */
  systems = new Map();
  /** The coordinate system on the screen. */
  selected = 1;
  /** A block selected on the path or in the program. @type {{program: number, line: number, by: "path" | "program"} | null} */
  chosen = null;
  /** A preview before a run, drawn instead of the program. @type {{path: import("../path/bytes.js").Answer, key: string} | null} */
  preview = null;
  /** @type {import("../types.d.ts").ProgramInfo[] | null} programs of the store; null: not read yet */
  programs = null;
  /** @type {import("../types.d.ts").CurrentUser | null} the logged-in user */
  user = null;
  /** View mode: this screen sends no commands except hold, stop and abort. */
  viewing = false;
  /** The panel at the right. */
  panel = "programs";
  /** Shown large, to be read from three metres. */
  far = false;
  #clockAheadMs = Number.POSITIVE_INFINITY;

  /** The coordinate system on the screen, once it is known. */
  get current() {
    return this.systems.get(this.selected) ?? null;
  }

  /** Topics of all coordinate systems that the birth message names. */
  topics() {
    return [...this.systems.keys()].flatMap((cs) => Object.keys(CS_TOPICS).map((topic) => `cs/${cs}/${topic}`));
  }

  /**
   * Applies one message.
   * @param {string} topic
   * @param {any} message
   * @returns {boolean} true when the runtime was started again since the last message
   */
  apply(topic, message) {
    const restarted = this.#boot(message.boot_id);
    this.#measureClock(message.ts);
    if (topic === "heartbeat") this.#beatAt = performance.now();
    else if (topic === "birth") this.#applyBirth(message);
    else if (topic === "presence") this.presence = message;
    else if (topic === "alarm/active") this.alarms = message.alarms ?? [];
    else if (topic === "variables") this.variables = message;
    else if (topic === "tools") this.tools = message;
    else if (topic === "stored_data") this.storedData = message;
    else if (topic.startsWith("io/")) this.io.set(topic, message);
    else this.#applyCs(topic, message);
    return restarted;
  }

  /** Age of the shown data in ms; 0 if it is current, or if the connection is lost, which is shown separately. */
  get staleMs() {
    const ageMs = this.online && this.#beatAt !== null ? performance.now() - this.#beatAt : 0;
    return ageMs > STALE_MS ? ageMs : 0;
  }

  /** Discards the measured difference of the clocks, which may change in a pause of the computer. */
  disconnected() {
    this.#beatAt = null;
    this.#clockAheadMs = Number.POSITIVE_INFINITY;
  }

  /**
   * Returns the age of a time of the machine. The clocks of machine and screen may differ: the smallest difference
   * between a message's time and its arrival is taken as the difference of the clocks.
   * @param {string} timestamp
   */
  ageMs(timestamp) {
    const ahead = Number.isFinite(this.#clockAheadMs) ? this.#clockAheadMs : 0;
    return Math.max(0, Date.now() - ahead - Date.parse(timestamp));
  }

  /** @param {string | undefined} bootId */
  #boot(bootId) {
    if (!bootId || bootId === this.bootId) return false;
    const restarted = this.bootId !== null;
    this.bootId = bootId;
    if (restarted) {
      this.alarms = [];
      this.io.clear();
      this.programs = null;
      this.#clockAheadMs = Number.POSITIVE_INFINITY;
      for (const system of this.systems.values()) this.systems.set(system.info.number, empty(system.info));
    }
    return restarted;
  }

  /** @param {string | undefined} ts */
  #measureClock(ts) {
    const ahead = Date.now() - Date.parse(ts ?? "");
    if (Number.isFinite(ahead)) this.#clockAheadMs = Math.min(this.#clockAheadMs, ahead);
  }

  /** @param {import("../types.d.ts").BirthMessage} birth */
  #applyBirth(birth) {
    // the name of an M code stays after the loss of the handler that declared it, because operators then need it most
    const serves = birth.serves ?? [];
    const before = (this.birth?.boot_id === birth.boot_id && this.birth.serves) || [];
    this.birth = { ...birth, serves: [...serves, ...before.filter((old) => !serves.some((now) => now.m === old.m && now.cs.join() === old.cs.join()))] };
    const known = this.systems;
    this.systems = new Map();
    for (const info of birth.coordinate_systems) {
      const system = known.get(info.number) ?? empty(info);
      system.info = info;
      this.systems.set(info.number, system);
    }
    const first = birth.coordinate_systems[0];
    if (first && !this.systems.has(this.selected)) this.selected = first.number;
  }

  /** @param {string} topic @param {any} message */
  #applyCs(topic, message) {
    const [, number, path] = /^cs\/(\d+)\/(.+)$/.exec(topic) ?? [];
    const system = this.systems.get(Number(number));
    const field = CS_TOPICS[/** @type {keyof typeof CS_TOPICS} */ (path)];
    if (!system || !field) return;
    /** @type {any} */ (system)[field] = message;
    if (field === "state") system.trail.run(message.run_id);
    if (field === "position") system.trail.add(message.machine, system.modal?.g["01"] === "G00");
  }
}

/**
 * @param {import("../types.d.ts").CoordinateSystemInfo} info
 * @returns {CoordinateSystem}
 */
function empty(info) {
  /** @type {any} */
  const fields = Object.fromEntries(Object.values(CS_TOPICS).map((field) => [field, null]));
  return { ...fields, info, lastRun: null, note: null, trail: new Trail() };
}

/** Axis letters in the usual order. */
const ORDER = "XYZABCUVW";

/** Returns the letters of the axes in the usual order. @param {CoordinateSystem} system */
export function axesOf(system) {
  return Object.keys(system.info.axes).sort((a, b) => ORDER.indexOf(a) - ORDER.indexOf(b));
}
