// Interlock and start lock: this screen clears its own sources; an operator clears a handler's sources by force.

import { Refusal } from "../machine/api.js";
import { sentences, t } from "../text/language.js";
import { openDialog } from "../ui/dialog.js";
import { button, fill, h, setAttr, setText } from "../ui/dom.js";

/** @typedef {"interlock" | "start_lock"} Input */
/** @typedef {import("../types.d.ts").LockSource} LockSource */

/** @type {Record<Input, {says: string, held: string, about: (cs: number) => string, field: "interlock" | "startLock"}>} */
const LOCKS = {
  interlock: { says: t("locks.interlock"), held: t("locks.interlock_held"), about: (cs) => t("locks.interlock_about", { cs }), field: "interlock" },
  start_lock: { says: t("locks.start_lock"), held: t("locks.start_lock_held"), about: (cs) => t("locks.start_lock_about", { cs }), field: "startLock" },
};

/** The source of a write without a name. */
const DEFAULT = "default";

/**
 * Returns the sources of a lock that are on or forced.
 * @param {import("../main.js").App} app @param {number} cs @param {Input} input
 */
function sourcesOf(app, cs, input) {
  return app.model.systems.get(cs)?.[LOCKS[input].field]?.sources ?? [];
}

/**
 * Switches a lock: sets it, or clears every source without an owner. If other sources remain, asks the operator.
 * @param {import("../main.js").App} app @param {number} cs @param {Input} input @param {boolean} on
 */
export async function switchLock(app, cs, input, on) {
  if (on) return app.api.setLock(cs, input, { value: true, text: t("locks.set_at_the_hmi") });
  const set = sourcesOf(app, cs, input).filter(({ value }) => value);
  const free = set.filter(({ handler_id, lost }) => handler_id === null && !lost);
  for (const { source } of free.length > 0 || set.length > 0 ? free : [{ source: DEFAULT }]) {
    try {
      await app.api.setLock(cs, input, { value: false, text: "", source });
    } catch (error) {
      // another client has become the owner in the meantime
      if (!(error instanceof Refusal) || error.problem.status !== 409) throw error;
      return askToForce(app, cs, input);
    }
  }
  if (free.length < set.length) askToForce(app, cs, input);
}

/** Shows the sources that hold a lock, with a button that clears each by force. @param {import("../main.js").App} app @param {number} cs @param {Input} input */
function askToForce(app, cs, input) {
  const { held: title, about } = LOCKS[input];
  const list = h("ul", { class: "list", tabindex: 0, "aria-label": t("locks.sources") });
  const show = () => {
    const held = sourcesOf(app, cs, input).filter(({ value }) => value);
    fill(list, ...held.map((source) => entry(app, cs, input, source)));
    if (held.length === 0) dialog.close();
  };
  const close = button({ autofocus: true, onclick: () => dialog.close() }, t("locks.keep"));
  const timer = setInterval(show, 300);
  const dialog = openDialog("locks", title, [h("p", {}, about(cs)), list, h("div", { class: "row end" }, close)], () => clearInterval(timer));
  show();
}

/** @param {import("../main.js").App} app @param {number} cs @param {Input} input @param {LockSource} one */
function entry(app, cs, input, { source, text, handler_id, lost }) {
  const who = handler_id === null ? t("locks.waits_for_handler") : t(lost ? "locks.handler_gone" : "locks.handler", { handler: handler_id });
  const force = () => app.attempt(() => app.api.setLock(cs, input, { value: false, text: t("locks.cleared_by_force_at_the"), source, force: true }));
  return h("li", { class: "row wrap lock-source" }, h("div", { class: "grow" }, h("strong", {}, source), h("p", {}, text || t("locks.no_reason_is_given")), h("p", { class: "muted" }, who)), button({ class: "button danger", "aria-label": t("locks.clear_source_by_force", { source }), onclick: () => void force() }, t("locks.clear_by_force")));
}

/** Shows which sources are forced, as a permanent reminder. @param {import("../main.js").App} app */
export function forcedNote(app) {
  const element = h("p", { class: "forced", role: "status", hidden: true });
  const render = () => {
    const cs = app.model.selected;
    const all = /** @type {Input[]} */ (Object.keys(LOCKS)).flatMap((input) => sourcesOf(app, cs, input).filter(({ forced_by }) => forced_by).map((one) => ({ input, one })));
    const texts = all.map(({ input, one }) => t(one.value ? "locks.forced_on" : "locks.forced_off", { lock: LOCKS[input].says, source: one.source, user: one.forced_by ?? "", handler: one.handler_id ? t("locks.handler", { handler: one.handler_id }) : t("locks.its_handler") }));
    setText(element, sentences(...texts));
    setAttr(element, "hidden", texts.length === 0);
  };
  return { element, render };
}
