// A card of the machine builder: an open M code, a variable, an input, or the drawing of a module of its folder.

import { machine } from "../machine/machine.js";
import { duration, plain } from "../text/format.js";
import { t } from "../text/language.js";
import { h, setText } from "../ui/dom.js";
import { addressOf, inputOf, picture, publishedValue, seenFrom, variableOf } from "./values.js";

/** Interval at which a visible variable is read, ms. */
const AGAIN_MS = 1000;

/** @typedef {import("../types.d.ts").HmiCard} HmiCard */

/** @param {import("../main.js").App} app @param {HmiCard} wanted */
export function addedCard(app, wanted) {
  const value = h("div", { class: "added-value" });
  const element = h("section", { class: "added-card", "aria-label": wanted.text }, h("h3", {}, picture(wanted.icon), wanted.text), value);
  const seen = () => seenFrom(app.model, wanted.cs);
  const render =
    wanted.m_code !== undefined ? () => setText(value, openCode(app.model, seen(), wanted.m_code ?? 0))
    : wanted.input !== undefined ? () => setText(value, inputText(seen(), wanted.input ?? ""))
    : wanted.variable !== undefined ? variable(wanted, seen, value)
    : drawn(wanted, seen, value);
  return { element, render };
}

/** @param {import("../machine/model.js").Model} model @param {ReturnType<typeof seenFrom>} seen @param {number} m */
function openCode(model, { current }, m) {
  const open = current?.pending?.outputs.find((output) => output.m === m);
  if (!open) return t("card.m_is_not_open", { m });
  return `${open.progress?.text ?? t("card.m_is_open", { m })}, ${duration(model.ageMs(open.since))}`;
}

/** @param {ReturnType<typeof seenFrom>} seen @param {string} name */
function inputText({ current }, name) {
  const isOn = inputOf(current, name);
  const lock = name === "interlock" ? current?.interlock : name === "start_lock" ? current?.startLock : null;
  if (isOn === null) return "–";
  return isOn ? [t("card.on"), lock?.text].filter(Boolean).join(": ") : t("card.off");
}

/** Shows the published value of a variable; an unpublished one is read repeatedly while the card is visible. @param {HmiCard} wanted @param {() => ReturnType<typeof seenFrom>} seen @param {HTMLElement} value */
function variable({ variable: name = "", unit = "" }, seen, value) {
  const { kind, number } = variableOf(name);
  let askedAt = 0;
  const show = (/** @type {number | string | undefined} */ now) =>
    setText(value, now === undefined ? "–" : `${typeof now === "number" ? plain(now) : now} ${unit}`.trim());
  const read = async () => {
    const path = kind === "p" ? "/variables/p" : `/cs/${seen().selected}/variables/q`;
    const answer = await machine.get(`${path}?from=${number}&count=1`).catch(() => null);
    show(answer?.values?.[0]);
  };
  return () => {
    const published = publishedValue(seen(), name);
    if (published !== undefined) return show(published);
    if (!seen().online || Date.now() - askedAt < AGAIN_MS) return;
    askedAt = Date.now();
    void read();
  };
}

/** Lets a module draw once. @param {HmiCard} wanted @param {() => ReturnType<typeof seenFrom>} seen @param {HTMLElement} value */
function drawn({ module = "" }, seen, value) {
  let isAsked = false;
  const draw = async () => {
    try {
      const { default: show } = await import(addressOf(module));
      await show(value, { tandem: machine, cs: () => seen().selected });
    } catch (error) {
      setText(value, t("card.cannot_be_shown", { module, reason: error instanceof Error ? error.message : String(error) }));
    }
  };
  return () => {
    if (isAsked) return;
    isAsked = true;
    void draw();
  };
}
