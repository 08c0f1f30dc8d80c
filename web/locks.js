// Interlock and start lock: what this screen has set it clears by itself; what a handler watches an operator clears by force.

import { Refusal } from "./api.js";
import { openDialog } from "./dialog.js";
import { button, fill, h, setAttr, setText } from "./dom.js";

/** @typedef {"interlock" | "start_lock"} Input */
/** @typedef {import("./types.d.ts").LockSource} LockSource */

/** @type {Record<Input, {says: string, field: "interlock" | "startLock"}>} */
const LOCKS = { interlock: { says: "Interlock", field: "interlock" }, start_lock: { says: "Start lock", field: "startLock" } };

/** The source that a set without a name means. */
const DEFAULT = "default";

/** What a lock is set by, on or forced. @param {import("./main.js").App} app @param {number} cs @param {Input} input */
function sourcesOf(app, cs, input) {
  return app.model.systems.get(cs)?.[LOCKS[input].field]?.sources ?? [];
}

/**
 * Switches a lock: sets it, or clears every source that anybody clears; where others remain, the operator is asked.
 * @param {import("./main.js").App} app @param {number} cs @param {Input} input @param {boolean} on
 */
export async function switchLock(app, cs, input, on) {
  if (on) return app.api.setLock(cs, input, { value: true, text: "set at the HMI" });
  const set = sourcesOf(app, cs, input).filter(({ value }) => value);
  const free = set.filter(({ handler_id, lost }) => handler_id === null && !lost);
  for (const { source } of free.length > 0 || set.length > 0 ? free : [{ source: DEFAULT }]) {
    try {
      await app.api.setLock(cs, input, { value: false, text: "", source });
    } catch (error) {
      // somebody has taken it over since
      if (!(error instanceof Refusal) || error.problem.status !== 409) throw error;
      return askToForce(app, cs, input);
    }
  }
  if (free.length < set.length) askToForce(app, cs, input);
}

/** Shows who holds a lock, with a button that clears each source by force. @param {import("./main.js").App} app @param {number} cs @param {Input} input */
function askToForce(app, cs, input) {
  const { says } = LOCKS[input];
  const list = h("ul", { class: "list", tabindex: 0, "aria-label": "Sources" });
  const show = () => {
    const held = sourcesOf(app, cs, input).filter(({ value }) => value);
    fill(list, ...held.map((source) => entry(app, cs, input, source)));
    if (held.length === 0) dialog.close();
  };
  const close = button({ autofocus: true, onclick: () => dialog.close() }, "Keep");
  const text = `The ${says.toLowerCase()} of coordinate system ${cs} is held by what watches the machine. Clear it by force only if you see that nothing can happen, such as to move out with a broken contact.`;
  const timer = setInterval(show, 300);
  const dialog = openDialog("locks", `${says} is held`, [h("p", {}, text), list, h("div", { class: "row end" }, close)], () => clearInterval(timer));
  show();
}

/** @param {import("./main.js").App} app @param {number} cs @param {Input} input @param {LockSource} one */
function entry(app, cs, input, { source, text, handler_id, lost }) {
  const who = handler_id === null ? "waits for the handler that watches it" : `handler ${handler_id}${lost ? ", which has gone" : ""}`;
  const force = () => app.attempt(() => app.api.setLock(cs, input, { value: false, text: "cleared by force at the HMI", source, force: true }));
  return h("li", { class: "row wrap lock-source" }, h("div", { class: "grow" }, h("strong", {}, source), h("p", {}, text || "no reason is given"), h("p", { class: "muted" }, who)), button({ class: "button danger", "aria-label": `Clear ${source} by force`, onclick: () => void force() }, "Clear by force"));
}

/** Says which sources are forced, so that nobody forgets. @param {import("./main.js").App} app */
export function forcedNote(app) {
  const element = h("p", { class: "forced", role: "status", hidden: true });
  const render = () => {
    const cs = app.model.selected;
    const all = /** @type {Input[]} */ (Object.keys(LOCKS)).flatMap((input) => sourcesOf(app, cs, input).filter(({ forced_by }) => forced_by).map((one) => ({ input, one })));
    const texts = all.map(({ input, one }) => `${LOCKS[input].says}: ${one.source} is ${one.value ? "set" : "cleared"} by force (${one.forced_by}), until ${one.handler_id ? `handler ${one.handler_id}` : "its handler"} writes it again.`);
    setText(element, texts.join(" "));
    setAttr(element, "hidden", texts.length === 0);
  };
  return { element, render };
}
