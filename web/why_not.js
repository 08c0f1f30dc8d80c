// Why something cannot be done now, in the operator's words: buttons are disabled for these reasons and say them.

import { ownFence } from "./fences.js";
import { programName } from "./format.js";

/** @typedef {import("./types.d.ts").Verb} Verb */

const AT_REST = ["READY", "PROGRAM_COMPLETED", "STOPPED"];
const PAUSED = ["FEED_HOLD", "PROGRAM_STOPPED", "OPTIONAL_STOP", "INTERRUPTED"];

/** The states in which each command is allowed; hold, stop and abort: all. @type {Partial<Record<Verb, string[]>>} */
const STATES = {
  load: AT_REST,
  run: AT_REST,
  mdi: AT_REST,
  jog: AT_REST,
  home: AT_REST,
  start: ["READY", "PROGRAM_COMPLETED"],
  resume: PAUSED,
  back_trace: ["FEED_HOLD"],
  reset: [...AT_REST, ...PAUSED, "WAIT"],
};
/** What the interlock forbids, and what the start lock does. */
const MOVES = new Set(["start", "run", "resume", "back_trace", "mdi", "jog", "home"]);
const BEGINS = new Set(["start", "run", "mdi"]);
/** What the holder of a control lease alone may command. */
const NEEDS_LEASE = new Set([...MOVES, "load"]);

/** What each role lacks. @type {Record<string, Set<string>>} */
const FORBIDDEN = {
  view: new Set(["operate", "set", "reset", "administrate"]),
  handler: new Set(["operate", "administrate"]),
  operate: new Set(["administrate"]),
};

/**
 * Why this user may not; null: may.
 * @param {Pick<import("./model.js").Model, "user" | "viewing">} model
 * @param {"operate" | "set" | "reset" | "administrate"} [right]
 * @returns {string | null}
 */
export function whyNotUser({ user, viewing }, right = "operate") {
  if (viewing) return "This screen is in view mode: leave it at the user's button at the top.";
  if (!user || !FORBIDDEN[user.role]?.has(right)) return null;
  const may = user.role === "view" ? "may look, and not command" : right === "administrate" ? "may not change stored programs" : "may not operate the machine";
  return `${user.user ?? "This user"} is logged in with the role ${user.role}, which ${may}.`;
}

/**
 * Why nothing can be sent; null: it can.
 * @param {import("./model.js").Model} model
 * @param {"operate" | "set" | "reset" | "administrate"} [right]
 */
export function whyNotNow(model, right = "operate") {
  if (!model.online) return "This screen is not connected to the machine.";
  return whyNotUser(model, right);
}

/**
 * Why a command would be refused; null: it would not.
 * @param {import("./model.js").Model} model
 * @param {Verb} verb
 * @returns {string | null}
 */
export function whyNot(model, verb) {
  const states = STATES[verb];
  if (!states) return whyNotUser({ user: model.user, viewing: false });
  const state = model.current?.state;
  const now = whyNotNow(model);
  if (now !== null) return now;
  if (!state) return "The state of the machine is not known yet.";
  if (state.transition) return "The machine is on its way to another state.";
  return whyNotInState(state, verb, states) ?? leased(model, verb) ?? locked(model, verb);
}

/** @param {import("./types.d.ts").StateMessage} state @param {Verb} verb @param {string[]} states @returns {string | null} */
function whyNotInState(state, verb, states) {
  const { execution } = state;
  if (states === AT_REST && execution === "STOPPED" && (state.reason === "ALARM" || state.alarm_count > 0)) return "An alarm is active: remove its cause, then press Reset.";
  if (verb === "start" && execution === "READY" && state.program === null) return "No program is loaded: choose one of the list and press Load.";
  if (states.includes(execution)) return null;
  if (verb === "start" && execution === "STOPPED") return state.program === null ? "No program is loaded: choose one of the list and press Load." : `Press Reset first, which makes ${programName(state.program)} ready.`;
  if (verb === "resume") return execution === "WAIT" ? "The program waits for an M code, and goes on by itself." : "There is nothing to resume.";
  if (verb === "back_trace") return "This goes back from a feed hold: press Hold first.";
  if (verb === "reset") return "The machine moves: press Hold or Stop first.";
  if (execution === "ACTIVE") return state.run_kind === "jog" ? "An axis is moved by hand." : "A run is on: wait for its end, or stop it.";
  if (execution === "WAIT") return "The run waits for an M code.";
  return "A run is paused: let it go on, or end it with Stop.";
}

/** @param {import("./model.js").Model} model @param {Verb} verb @returns {string | null} */
function leased({ selected, current }, verb) {
  const holder = current?.lease?.holder;
  if (!holder || !NEEDS_LEASE.has(verb) || ownFence(selected) !== undefined) return null;
  return `${holder} has the control of this coordinate system: wait until it is given back, or end it in By hand.`;
}

/** @param {import("./model.js").Model} model @param {Verb} verb @returns {string | null} */
function locked({ current }, verb) {
  const says = (/** @type {string} */ name, /** @type {{text: string}} */ { text }) => `The ${name} is on${text ? `: ${text}` : ""}.`;
  if (MOVES.has(verb) && current?.interlock?.value) return says("interlock", current.interlock);
  if (BEGINS.has(verb) && current?.startLock?.value) return says("start lock", current.startLock);
  return null;
}

/** What Start commands: it begins, and goes on after a pause. @param {import("./model.js").Model} model @returns {"start" | "resume"} */
export function startVerb(model) {
  return PAUSED.includes(model.current?.state?.execution ?? "") ? "resume" : "start";
}

/**
 * Disables a button for a reason, which it says.
 * @param {HTMLButtonElement | HTMLInputElement | HTMLSelectElement} element
 * @param {string | null} reason
 * @param {string} [title] what it says when it is enabled
 */
export function disableFor(element, reason, title = "") {
  element.disabled = reason !== null;
  const says = reason ?? title;
  if (element.title !== says) element.title = says;
  if (reason === null) element.removeAttribute("aria-description");
  else if (element.getAttribute("aria-description") !== reason) element.setAttribute("aria-description", reason);
}

/** A press on something disabled tells why. @param {(text: string) => void} tell */
export function tellWhyNot(tell) {
  document.addEventListener("pointerdown", ({ clientX, clientY, target }) => {
    const at = target instanceof Element ? target : document.body;
    const near = at.closest("button, input, select")?.parentElement ?? at;
    for (const one of near.querySelectorAll(":disabled[aria-description]")) {
      const { left, right, top, bottom } = one.getBoundingClientRect();
      const isHit = clientX >= left && clientX <= right && clientY >= top && clientY <= bottom;
      if (isHit) return tell(one.getAttribute("aria-description") ?? "");
    }
  }, { capture: true });
}
