// A button of the machine builder: runs a line of NC text, sets a variable, or switches an input.

import { disableFor, whyNot, whyNotNow } from "../access/why_not.js";
import { stateWord } from "../machine/sentence.js";
import { listed, t } from "../text/language.js";
import { button, h, setAttr } from "../ui/dom.js";
import { inputOf, picture, seenFrom, variableOf } from "./values.js";

/** @typedef {import("../types.d.ts").HmiButton} HmiButton */

/** @param {import("../main.js").App} app @param {HmiButton} wanted */
export function addedButton(app, wanted) {
  const element = button({ class: "button added-button", onclick: () => press(app, wanted) }, picture(wanted.icon), h("span", {}, wanted.text));
  const does = doing(wanted);
  const render = () => {
    const seen = seenFrom(app.model, wanted.cs);
    disableFor(element, whyNotPressed(seen, wanted), does);
    if (wanted.input !== undefined) setAttr(element, "aria-pressed", String(inputOf(seen.current, wanted.input) ?? false));
  };
  return { element, render };
}

/** The line of NC text that it runs. @param {HmiButton} wanted */
function lineOf({ m_code, mdi }) {
  return mdi ?? (m_code === undefined ? null : `M${String(m_code).padStart(2, "0")}`);
}

/** Returns a text of its action. @param {HmiButton} wanted */
function doing(wanted) {
  const line = lineOf(wanted);
  if (line !== null) return t("added.runs_at_once", { line });
  return wanted.variable !== undefined ? t("added.sets_to", { variable: wanted.variable, value: wanted.value }) : t("added.switches", { input: wanted.input });
}

/** Returns the reason why the button cannot be pressed; null if it can. @param {ReturnType<typeof seenFrom>} seen @param {HmiButton} wanted */
function whyNotPressed(seen, wanted) {
  const now = lineOf(wanted) === null ? whyNotNow(/** @type {any} */ (seen), "set") : whyNot(/** @type {any} */ (seen), "mdi");
  if (now !== null) return now;
  const execution = seen.current?.state?.execution;
  if (!execution) return t("added.the_state_of_the_machine");
  const { states = [] } = wanted;
  if (states.length === 0 || states.includes(execution)) return null;
  return t("added.only_in", { states: listed(states.map(stateWord)) });
}

/** @param {import("../main.js").App} app @param {HmiButton} wanted */
async function press(app, wanted) {
  const { text, confirm } = wanted;
  if (confirm !== undefined && !(await app.confirm({ title: text, text: confirm, yes: text, no: t("common.cancel") }))) return;
  const { selected: cs, current } = seenFrom(app.model, wanted.cs);
  const line = lineOf(wanted);
  await app.attempt(async () => {
    if (line !== null) await app.api.command(cs, "mdi", { text: line, macro: true });
    else if (wanted.variable !== undefined) {
      const { kind, number } = variableOf(wanted.variable);
      await app.api.setVariables(cs, kind, number, [wanted.value ?? 0]);
    } else if (wanted.input !== undefined) await app.api.setInput(cs, wanted.input, !inputOf(current, wanted.input));
  });
}
