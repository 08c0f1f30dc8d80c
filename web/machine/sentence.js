// The state in the operator's words: one sentence with the reason of a wait, or the next action.

import { alarmWords } from "../text/alarm_words.js";
import { declared, inWords } from "../text/declared.js";
import { duration, programName, rounded } from "../text/format.js";
import { listed, sentences, t } from "../text/language.js";
import { obstacleWords, startObstacles } from "./start_conditions.js";

/**
 * Appearance of a state.
 * `ready` no action needed; `active` motion; `wait` the machine works; `attention` the operator's
 * turn; `alarm`; `done`; `ended` before its end.
 * @typedef {"ready" | "active" | "wait" | "attention" | "alarm" | "done" | "ended"} Tone
 */

/**
 * Tone and icon of a state.
 * @param {import("../types.d.ts").StateMessage} state
 * @param {import("../types.d.ts").PendingOutput[]} [open] its open M codes
 * @returns {{tone: Tone, icon: string, word: string}}
 */
export function look(state, open = []) {
  const word = stateWord(state.execution);
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
 * Returns whether only a person can end a wait: a question, a lost handler, an M code without a handler.
 * @param {import("../types.d.ts").StateMessage} state @param {import("../types.d.ts").PendingOutput[]} open
 */
function isOperatorsTurn(state, open) {
  if (state.reason === "HANDLER_LOST" || asked(state)) return true;
  const waited = open.find((output) => output.seq === state.waiting_on?.seq);
  return waited !== undefined && waited.handler_id === null;
}

/** The open question of a handler. @param {import("../types.d.ts").StateMessage} state */
export function asked(state) {
  const question = state.waiting_on?.question;
  return question?.answer === undefined ? question : undefined;
}

/** Most characters of a text in the sentence; the card of the alarm or M code shows the whole text. */
const BRIEF_CHARS = 140;

/** Returns the beginning of a text, up to the end of a word. @param {string} text */
export function brief(text, chars = BRIEF_CHARS) {
  if (text.length <= chars) return text;
  const end = text.lastIndexOf(" ", chars);
  return `${text.slice(0, end > 0 ? end : chars).replace(/[.,;:\s]+$/, "")} …`;
}

/** Time after which the sentence mentions an unclaimed output, ms. */
const UNTAKEN_MS = 2000;

/** Names of states. @type {Record<string, import("../text/language.js").Key>} */
const STATES = {
  READY: "state.READY", ACTIVE: "state.ACTIVE", WAIT: "state.WAIT", FEED_HOLD: "state.FEED_HOLD", PROGRAM_STOPPED: "state.PROGRAM_STOPPED", OPTIONAL_STOP: "state.OPTIONAL_STOP",
  INTERRUPTED: "state.INTERRUPTED", PROGRAM_COMPLETED: "state.PROGRAM_COMPLETED", STOPPED: "state.STOPPED",
};

/** Reasons of holds and ends of a run. @type {Record<string, import("../text/language.js").Key>} */
const REASONS = {
  HOLD: "reason.HOLD", HANDLER_LOST: "reason.HANDLER_LOST", SINGLE_BLOCK: "reason.SINGLE_BLOCK", INTERLOCK: "reason.INTERLOCK", BUS_LOST: "reason.BUS_LOST", SERVO_LATE: "reason.SERVO_LATE",
  CLIENT_LOST: "reason.CLIENT_LOST", BACK_TRACE: "reason.BACK_TRACE", BACK_TRACE_END: "reason.BACK_TRACE_END", OVERRIDE_ZERO: "reason.OVERRIDE_ZERO", ALARM: "reason.ALARM", STOP: "reason.STOP", ABORTED: "reason.ABORTED",
  NO_PROGRAM: "reason.NO_PROGRAM", RESTARTED: "reason.RESTARTED",
};

/** Returns the text of a state, such as `FEED_HOLD`. @param {string} execution */
export function stateWord(execution) {
  const key = STATES[execution];
  return key ? t(key) : execution.replaceAll("_", " ");
}

/** Returns the text of a reason, such as `SINGLE_BLOCK`. @param {unknown} reason */
export function reasonWord(reason) {
  const key = REASONS[String(reason)];
  return key ? t(key) : String(reason).toLowerCase().replaceAll("_", " ");
}

/** @type {Record<string, string>} */
const TRANSITIONS = {
  STARTING: t("sentence.starting_the_program"),
  HOLDING: t("sentence.feed_hold_slowing_down_on"),
  STOPPING: t("sentence.stopping_slowing_down_on_the"),
  RESUMING: t("sentence.going_on"),
  RESETTING: t("sentence.resetting"),
};

/**
 * The sentence.
 * @param {import("./model.js").CoordinateSystem} system
 * @param {import("../types.d.ts").AlarmRecord[]} alarms active ones of the machine
 * @param {((timestamp: string) => number) | null} ageMs converts a timestamp to its age; null: no times are shown
 * @param {import("../types.d.ts").BirthMessage | null} [birth] which declares the parameters of M codes
 * @returns {string}
 */
export function sentence(system, alarms, ageMs, birth = null) {
  const { state, place } = system;
  if (!state) return t("sentence.waiting_for_the_state_of");
  if (state.transition) return TRANSITIONS[state.transition] ?? `${state.transition}.`;
  const program = programName(state.program);
  switch (state.execution) {
    case "READY":
      if (state.program === null) return t("sentence.ready_to_move_by_hand");
      return prevented(system, t("sentence.program_is_loaded", { program })) ?? t("sentence.program_is_loaded_and_at", { program });
    case "ACTIVE":
      if (state.reason === "OVERRIDE_ZERO" && state.run_kind !== "program") return t("sentence.override_zero_by_hand");
      if (state.run_kind && state.run_kind !== "program") return byHand(system, state.run_kind);
      if (state.reason === "BACK_TRACE") return t("sentence.goes_back_along_its_path", { line: place?.line ?? "?" });
      if (state.reason === "OVERRIDE_ZERO") return t("sentence.override_zero", { program });
      return place?.line ? t("sentence.program_runs_line", { program: programName(place.number), line: place.line }) : t("sentence.program_runs", { program });
    case "WAIT":
      return waiting(system, ageMs, birth);
    case "FEED_HOLD":
      if (state.reason === "BUS_LOST") return state.waiting_on ? t("sentence.bus_lost_in_m", { m: state.waiting_on.m }) : t("sentence.bus_lost");
      if (state.reason === "SERVO_LATE") return t("sentence.held_the_servo_was_late");
      if (state.reason === "CLIENT_LOST") return t("sentence.held_a_client_that_the");
      if (state.reason === "BACK_TRACE_END") return t("sentence.the_way_back_ends_here");
      return state.waiting_on
        ? t("sentence.held_while_m_is_open", { m: state.waiting_on.m })
        : t("sentence.held_by_the_operator_press");
    case "PROGRAM_STOPPED":
      return t("sentence.program_stop_m00_press_resume");
    case "OPTIONAL_STOP":
      return t("sentence.optional_stop_m01_press_resume");
    case "INTERRUPTED":
      return state.reason === "SINGLE_BLOCK"
        ? t("sentence.single_block_the_block_is")
        : interlocked(system.interlock);
    case "PROGRAM_COMPLETED":
      return prevented(system, t("sentence.program_is_complete", { program })) ?? t("sentence.program_is_complete_press_start", { program });
    case "STOPPED":
      return stopped(system, alarms);
    default:
      return "";
  }
}

/**
 * Returns the obstacle to remove before a start; null if there is none.
 * @param {import("./model.js").CoordinateSystem} system @param {string} where the name of the program
 */
function prevented(system, where) {
  const [first] = startObstacles(system);
  return first ? sentences(where, brief(obstacleWords(first, system))) : null;
}

/**
 * Returns a text about motion without a program.
 * @param {import("./model.js").CoordinateSystem} system @param {"mdi" | "home" | "jog"} kind
 */
function byHand({ place, position }, kind) {
  if (kind === "home") return t("sentence.axes_move_to_their_reference");
  if (kind === "mdi") return place?.block ? t("sentence.mdi_block", { block: brief(place.block) }) : t("sentence.mdi");
  const axis = Object.entries(position?.distance_to_go ?? {}).find(([, left]) => left !== 0)?.[0];
  return axis ? t("sentence.jog", { axis }) : t("sentence.jog_any");
}

/** @param {import("../types.d.ts").LockMessage | null} interlock */
function interlocked(interlock) {
  if (interlock && !interlock.value) return t("sentence.the_interlock_is_off_again");
  return interlock?.text ? t("sentence.interlocked_why", { text: brief(interlock.text) }) : t("sentence.interlocked");
}

/** Returns the end of the run before this start. @param {import("../types.d.ts").LastRun | null} run */
function cutShort(run) {
  if (!run || ["READY", "STOPPED", "PROGRAM_COMPLETED"].includes(run.execution)) return "";
  const codes = listed(run.outputs.map((output) => `M${output.m}`));
  const told = { program: programName(run.program), line: run.line };
  return codes ? t("sentence.cut_short_in_m", { ...told, codes }) : t("sentence.cut_short", told);
}

/**
 * @param {import("./model.js").CoordinateSystem} system
 * @param {((timestamp: string) => number) | null} ageMs
 * @param {import("../types.d.ts").BirthMessage | null} birth
 */
function waiting({ info, state, pending }, ageMs, birth) {
  const on = state?.waiting_on;
  if (!state || !on) return t("sentence.waiting_until_every_output_of");
  const output = pending?.outputs.find((open) => open.seq === on.seq);
  const name = `M${on.m}${state.wait_state ? ` (${state.wait_state})` : ""}`;
  if (state.reason === "HANDLER_LOST") {
    if (output?.how) return t("sentence.redelivered", { name });
    return t("sentence.handler_gone", { name });
  }
  const what = listed([name, ...inWords(output?.params ?? {}, declared(birth, info.number, on.m)?.params)]);
  const waits = ageMs ? t("sentence.waits_since", { time: duration(ageMs(on.since)), what }) : t("sentence.waits", { what });
  const question = asked(state);
  if (question) return t("sentence.asks", { name, text: brief(question.text), m: on.m });
  const progress = on.progress ?? output?.progress;
  if (output?.state === "CLAIMED") {
    const told = { waits, handler: output.handler_id ?? "–" };
    if (!progress) return t("sentence.claimed", told);
    const percent = progress.percent === undefined ? "" : ` (${Math.round(progress.percent)}\u00a0%)`;
    return t("sentence.in_work", { ...told, text: `${brief(progress.text)}${percent}` });
  }
  return ageMs && ageMs(on.since) < UNTAKEN_MS ? t("sentence.just_waits", { waits }) : t("sentence.untaken", { waits });
}

/**
 * @param {import("./model.js").CoordinateSystem} system
 * @param {import("../types.d.ts").AlarmRecord[]} alarms
 */
function stopped({ state, info, lastRun }, alarms) {
  switch (state?.reason) {
    case "ALARM": {
      const alarm = alarms.findLast((a) => a.severity === "alarm" && (a.cs === null || a.cs === info.number));
      const what = alarm ? t("sentence.alarm", { number: alarm.number, text: brief(rounded(alarmWords(alarm).text)).replace(/(?<!…)[.\s]*$/, ".") }) : t("sentence.stopped_by_alarm");
      return sentences(what, t("sentence.remove_cause"));
    }
    case "NO_PROGRAM":
      return t("sentence.no_program");
    case "RESTARTED":
      return sentences(t("sentence.restarted"), cutShort(lastRun), state.program === null ? t("sentence.load") : t("sentence.reset_for", { program: programName(state.program) }));
    case "ABORTED":
      return t("sentence.aborted_the_motors_braked_at");
    default:
      return state?.program === null
        ? t("sentence.stopped_load_a_program")
        : t("sentence.stopped_press_reset_to_go", { program: programName(state?.program) });
  }
}

/**
 * Returns the text for a screen reader: it changes with the state and the awaited M code, but not every second.
 * @param {import("./model.js").CoordinateSystem} system
 * @param {import("../types.d.ts").AlarmRecord[]} alarms
 * @param {import("../types.d.ts").BirthMessage | null} birth
 */
export function announcement(system, alarms, birth) {
  if (!system.state) return "";
  const text = sentence(system, alarms, null, birth);
  const running = system.state.execution === "ACTIVE" && !system.state.transition;
  return sentences(t("sentence.announced", { cs: system.info.number, state: look(system.state).word }), !running && text);
}
