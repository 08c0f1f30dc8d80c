// Reasons why an action is not possible now: buttons are disabled for these reasons, and show them.

import { ownFence } from "../machine/fences.js";
import { whyNoStart } from "../machine/start_conditions.js";
import { programName } from "../text/format.js";
import { t } from "../text/language.js";

/** @typedef {import("../types.d.ts").Verb} Verb */

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
/** Commands forbidden by the interlock and by the start lock. */
const MOVES = new Set(["start", "run", "resume", "back_trace", "mdi", "jog", "home"]);
const BEGINS = new Set(["start", "run", "mdi"]);
/** Commands permitted only to the holder of a control lease. */
const NEEDS_LEASE = new Set([...MOVES, "load"]);

/** Commands forbidden to each role. @type {Record<string, Set<string>>} */
const FORBIDDEN = {
  view: new Set(["operate", "set", "reset", "administrate"]),
  handler: new Set(["operate", "administrate"]),
  operate: new Set(["administrate"]),
};

/**
 * Returns the reason why this user has no right to a command; null if the user has it.
 * @param {Pick<import("../machine/model.js").Model, "user" | "viewing">} model
 * @param {"operate" | "set" | "reset" | "administrate"} [right]
 * @returns {string | null}
 */
export function whyNotUser({ user, viewing }, right = "operate") {
  if (viewing) return t("why_not.this_screen_is_in_view");
  if (!user || !FORBIDDEN[user.role]?.has(right)) return null;
  const told = { user: user.user ?? t("why_not.this_user"), role: user.role };
  if (user.role === "view") return t("why_not.may_look", told);
  return right === "administrate" ? t("why_not.may_not_store", told) : t("why_not.may_not_operate", told);
}

/**
 * Returns the reason why nothing can be sent; null if it can.
 * @param {import("../machine/model.js").Model} model
 * @param {"operate" | "set" | "reset" | "administrate"} [right]
 */
export function whyNotNow(model, right = "operate") {
  if (!model.online) return t("why_not.this_screen_is_not_connected");
  return whyNotUser(model, right);
}

/**
 * Returns the reason why a command would be refused; null if it would not.
 * @param {import("../machine/model.js").Model} model
 * @param {Verb} verb
 * @returns {string | null}
 */
export function whyNot(model, verb) {
  const states = STATES[verb];
  if (!states) return whyNotUser({ user: model.user, viewing: false });
  const state = model.current?.state;
  const now = whyNotNow(model);
  if (now !== null) return now;
  if (!state) return t("added.the_state_of_the_machine");
  if (state.transition) return t("why_not.the_machine_is_on_its");
  const inState = whyNotInState(state, verb, states);
  if (inState === null && verb === "start" && model.current?.startConditions) return whyNoStart(model.current);
  return inState ?? leased(model, verb) ?? locked(model, verb);
}

/** @param {import("../types.d.ts").StateMessage} state @param {Verb} verb @param {string[]} states @returns {string | null} */
function whyNotInState(state, verb, states) {
  const { execution } = state;
  if (states === AT_REST && execution === "STOPPED" && (state.reason === "ALARM" || state.alarm_count > 0)) return t("why_not.an_alarm_is_active_remove");
  if (verb === "start" && execution === "READY" && state.program === null) return t("sentence.no_program");
  if (states.includes(execution)) return null;
  if (verb === "start" && execution === "STOPPED") return state.program === null ? t("sentence.no_program") : t("why_not.press_reset_first_which_makes", { program: programName(state.program) });
  if (verb === "resume") return execution === "WAIT" ? t("why_not.the_program_waits_for_an") : t("why_not.there_is_nothing_to_resume");
  if (verb === "back_trace") return t("why_not.this_goes_back_from_a");
  if (verb === "reset") return t("why_not.the_machine_moves_press_hold");
  if (execution === "ACTIVE") return state.run_kind === "jog" ? t("why_not.an_axis_is_moved_by") : t("why_not.a_run_is_on_wait");
  if (execution === "WAIT") return t("why_not.the_run_waits_for_an");
  return t("why_not.a_run_is_paused_let");
}

/** @param {import("../machine/model.js").Model} model @param {Verb} verb @returns {string | null} */
function leased({ selected, current }, verb) {
  const holder = current?.lease?.holder;
  if (!holder || !NEEDS_LEASE.has(verb) || ownFence(selected) !== undefined) return null;
  return t("why_not.leased", { holder });
}

/** @param {import("../machine/model.js").Model} model @param {Verb} verb @returns {string | null} */
function locked({ current }, verb) {
  const { interlock, startLock } = current ?? {};
  if (MOVES.has(verb) && interlock?.value) return interlock.text ? t("why_not.interlock_why", { text: interlock.text }) : t("why_not.interlock");
  if (BEGINS.has(verb) && startLock?.value) return startLock.text ? t("why_not.start_lock_why", { text: startLock.text }) : t("why_not.start_lock");
  return null;
}

/**
 * Returns the command of the Start button: a start, or a resume after a pause.
 * @param {import("../machine/model.js").Model} model @returns {"start" | "resume"}
 */
export function startVerb(model) {
  return PAUSED.includes(model.current?.state?.execution ?? "") ? "resume" : "start";
}

/**
 * Disables a button for a reason, which the button shows.
 * @param {HTMLButtonElement | HTMLInputElement | HTMLSelectElement} element
 * @param {string | null} reason
 * @param {string} [title] title of the enabled button
 */
export function disableFor(element, reason, title = "") {
  element.disabled = reason !== null;
  const says = reason ?? title;
  if (element.title !== says) element.title = says;
  if (reason === null) element.removeAttribute("aria-description");
  else if (element.getAttribute("aria-description") !== reason) element.setAttribute("aria-description", reason);
}

/** Reports the reason when a disabled button is pressed. @param {(text: string) => void} report */
export function reportWhyNot(report) {
  document.addEventListener("pointerdown", ({ clientX, clientY, target }) => {
    const at = target instanceof Element ? target : document.body;
    const near = at.closest("button, input, select")?.parentElement ?? at;
    for (const one of near.querySelectorAll(":disabled[aria-description]")) {
      const { left, right, top, bottom } = one.getBoundingClientRect();
      const isHit = clientX >= left && clientX <= right && clientY >= top && clientY <= bottom;
      if (isHit) return report(one.getAttribute("aria-description") ?? "");
    }
  }, { capture: true });
}
