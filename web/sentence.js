// The state in the operator's words: one sentence that says what the machine waits for, or what to do next.

import { duration, params, programName, rounded } from "./format.js";

/**
 * How a state is shown.
 * `ready` nothing to worry about; `active` moves; `wait` the machine works on something; `attention` the operator's
 * turn; `alarm`; `done`; `ended` before its end.
 * @typedef {"ready" | "active" | "wait" | "attention" | "alarm" | "done" | "ended"} Tone
 */

/**
 * Tone and icon of a state.
 * @param {import("./types.d.ts").StateMessage} state
 * @param {import("./types.d.ts").PendingOutput[]} [open] its open M codes
 * @returns {{tone: Tone, icon: string, word: string}}
 */
export function look(state, open = []) {
  const word = state.execution.replaceAll("_", " ");
  switch (state.execution) {
    case "READY":
      return { tone: "ready", icon: "ready", word };
    case "ACTIVE":
      return { tone: "active", icon: "play", word };
    case "WAIT":
      return { tone: isOperatorsTurn(state, open) ? "attention" : "wait", icon: "wait", word };
    case "PROGRAM_COMPLETED":
      return { tone: "done", icon: "done", word };
    case "STOPPED":
      return state.reason === "ALARM" ? { tone: "alarm", icon: "alarm", word } : { tone: "ended", icon: "ended", word };
    default:
      return { tone: "attention", icon: "pause", word };
  }
}

/**
 * Whether a wait goes on by nothing but a person: a question, a lost handler, an M code that no handler has taken.
 * @param {import("./types.d.ts").StateMessage} state @param {import("./types.d.ts").PendingOutput[]} open
 */
function isOperatorsTurn(state, open) {
  if (state.reason === "HANDLER_LOST" || asked(state)) return true;
  const waited = open.find((output) => output.seq === state.waiting_on?.seq);
  return waited !== undefined && waited.handler_id === null;
}

/** The open question of a handler. @param {import("./types.d.ts").StateMessage} state */
export function asked(state) {
  const question = state.waiting_on?.question;
  return question?.answer === undefined ? question : undefined;
}

/** Characters of a text in the sentence; the card of the alarm or M code shows all of it. */
const BRIEF_CHARS = 140;

/** The beginning of a text, up to the end of a word. @param {string} text */
export function brief(text, chars = BRIEF_CHARS) {
  if (text.length <= chars) return text;
  const end = text.lastIndexOf(" ", chars);
  return `${text.slice(0, end > 0 ? end : chars).replace(/[.,;:\s]+$/, "")} …`;
}

/** How long an output may be unclaimed before the sentence says so, ms. */
const UNTAKEN_MS = 2000;

/** @type {Record<string, string>} */
const TRANSITIONS = {
  STARTING: "Starting the program.",
  HOLDING: "Feed hold: slowing down on the path.",
  STOPPING: "Stopping: slowing down on the path.",
  RESUMING: "Going on.",
  RESETTING: "Resetting.",
};

/**
 * The sentence.
 * @param {import("./model.js").CoordinateSystem} system
 * @param {import("./types.d.ts").AlarmRecord[]} alarms active ones of the machine
 * @param {(timestamp: string) => number} ageMs
 * @returns {string}
 */
export function sentence(system, alarms, ageMs) {
  const { state, place } = system;
  if (!state) return "Waiting for the state of this coordinate system.";
  if (state.transition) return TRANSITIONS[state.transition] ?? `${state.transition}.`;
  const program = programName(state.program);
  switch (state.execution) {
    case "READY":
      return state.program === null
        ? "Ready to move by hand. No program is loaded: choose one of the list and press Load."
        : `Program ${program} is loaded and at its head. Press Start.`;
    case "ACTIVE":
      if (state.run_kind && state.run_kind !== "program") return byHand(system, state.run_kind);
      if (state.reason === "BACK_TRACE") return `Goes back along its path, line ${place?.line ?? "?"}. Press Hold to turn round.`;
      return place?.line ? `Program ${programName(place.number)} runs, line ${place.line}.` : `Program ${program} runs.`;
    case "WAIT":
      return waiting(system, ageMs);
    case "FEED_HOLD":
      if (state.reason === "BUS_LOST") return `Held: the connection to the MQTT broker was lost${state.waiting_on ? ` while M${state.waiting_on.m} is open` : ""}. Look at the machine, then press Resume.`;
      if (state.reason === "SERVO_LATE") return "Held: the servo was late, so the motors got no set points for a while. Look at the machine and at the computer's load, then press Resume.";
      if (state.reason === "CLIENT_LOST") return "Held: a client that the machine watches is not heard any more; the warning names it. Look at it and at the machine, then press Resume.";
      if (state.reason === "BACK_TRACE_END") return "The way back ends here. Press Resume to go forward again.";
      return state.waiting_on
        ? `Held while M${state.waiting_on.m} is open. Press Resume to go on.`
        : "Held by the operator. Press Resume to go on, or Stop to end the run.";
    case "PROGRAM_STOPPED":
      return "Program stop (M00). Press Resume to go on.";
    case "OPTIONAL_STOP":
      return "Optional stop (M01). Press Resume to go on.";
    case "INTERRUPTED":
      return state.reason === "SINGLE_BLOCK"
        ? "Single block: the block is done. Press Resume for the next one."
        : interlocked(system.interlock);
    case "PROGRAM_COMPLETED":
      return `Program ${program} is complete. Press Start to run it again, or load another one.`;
    case "STOPPED":
      return stopped(system, alarms);
    default:
      return "";
  }
}

/** What moves without a program. @param {import("./model.js").CoordinateSystem} system @param {"mdi" | "home" | "jog"} kind */
function byHand({ place, position }, kind) {
  if (kind === "home") return "Axes move to their reference points.";
  if (kind === "mdi") return `MDI runs${place?.block ? `: ${brief(place.block)}` : ""}.`;
  const axis = Object.entries(position?.distance_to_go ?? {}).find(([, left]) => left !== 0)?.[0];
  return `Jog: ${axis ? `axis ${axis}` : "an axis"} moves by hand.`;
}

/** @param {import("./types.d.ts").LockMessage | null} interlock */
function interlocked(interlock) {
  if (interlock && !interlock.value) return "The interlock is off again. Press Resume to go on.";
  const why = interlock?.text ? ` (${brief(interlock.text)})` : "";
  return `The interlock is on${why}: motion goes on when it is released and Resume is pressed.`;
}

/** How the run before this start ended. @param {import("./types.d.ts").LastRun | null} run */
function cutShort(run) {
  if (!run || ["READY", "STOPPED", "PROGRAM_COMPLETED"].includes(run.execution)) return "";
  const open = run.outputs.map((output) => `M${output.m}`).join(", ");
  return ` The run of ${programName(run.program)} was cut short in line ${run.line}${open ? `, with ${open} open` : ""}.`;
}

/**
 * @param {import("./model.js").CoordinateSystem} system
 * @param {(timestamp: string) => number} ageMs
 */
function waiting({ state, pending }, ageMs) {
  const on = state?.waiting_on;
  if (!state || !on) return "Waiting until every output of the run is reset.";
  const output = pending?.outputs.find((open) => open.seq === on.seq);
  const name = `M${on.m}${state.wait_state ? ` (${state.wait_state})` : ""}`;
  const given = output && Object.keys(output.params).length > 0 ? `, ${params(output.params).replaceAll("  ", ", ")}` : "";
  if (state.reason === "HANDLER_LOST") {
    if (output?.how) return `${name} is redelivered (${output.how}): waiting for its handler to come back.`;
    return `The handler of ${name} has gone. Look at the machine, then redeliver ${name} or confirm it by hand.`;
  }
  const since = `Waiting ${duration(ageMs(on.since))} for ${name}${given}`;
  const question = asked(state);
  if (question) return `${name} asks: ${brief(question.text)} Answer it beside M${on.m}.`;
  const progress = on.progress ?? output?.progress;
  if (output?.state === "CLAIMED") {
    const handler = `handler ${output.handler_id ?? "unknown"}`;
    if (!progress) return `${since}: ${handler} has it.`;
    const percent = progress.percent === undefined ? "" : ` (${Math.round(progress.percent)}\u00a0%)`;
    return `${since}: ${handler} works: ${brief(progress.text)}${percent}.`;
  }
  if (ageMs(on.since) < UNTAKEN_MS) return `${since}.`;
  return `${since}: no handler has taken it. When its work is done, confirm it by hand.`;
}

/**
 * @param {import("./model.js").CoordinateSystem} system
 * @param {import("./types.d.ts").AlarmRecord[]} alarms
 */
function stopped({ state, info, lastRun }, alarms) {
  switch (state?.reason) {
    case "ALARM": {
      const alarm = alarms.findLast((a) => a.severity === "alarm" && (a.cs === null || a.cs === info.number));
      const what = alarm ? `Alarm ${alarm.number}: ${brief(rounded(alarm.text))}`.replace(/(?<!…)[.\s]*$/, ".") : "Stopped by an alarm.";
      return `${what} Remove the cause, then press Reset.`;
    }
    case "NO_PROGRAM":
      return "No program is loaded: choose one of the list and press Load.";
    case "RESTARTED":
      return state.program === null
        ? `The runtime was started again and nothing goes on by itself.${cutShort(lastRun)} Load a program.`
        : `The runtime was started again and nothing goes on by itself.${cutShort(lastRun)} Press Reset to be ready with ${programName(state.program)}.`;
    case "ABORTED":
      return "Aborted: the motors braked at once. Look at the machine, then press Reset.";
    default:
      return state?.program === null
        ? "Stopped. Load a program."
        : `Stopped. Press Reset to go back to the head of ${programName(state?.program)}.`;
  }
}

/**
 * The text for a screen reader: it changes with the state and with what the machine waits for, but not every second.
 * @param {import("./model.js").CoordinateSystem} system
 * @param {import("./types.d.ts").AlarmRecord[]} alarms
 */
export function announcement(system, alarms) {
  if (!system.state) return "";
  const text = sentence(system, alarms, () => UNTAKEN_MS).replace(/^Waiting \d+ s for/, "Waiting for");
  const running = system.state.execution === "ACTIVE" && !system.state.transition;
  return `Coordinate system ${system.info.number}: ${look(system.state).word}. ${running ? "" : text}`.trim();
}
