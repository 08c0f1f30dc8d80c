// Tooltip with the meaning of the word under the pointer.

import { h, setAttr } from "../ui/dom.js";
import { api } from "./api.js";
import { meaning } from "./explain.js";

/** Rest time of the pointer before the meaning is shown, ms. */
const REST_MS = 400;
/** Number of cached meanings. */
const KEPT_MAX = 200;
/** Room below a tip, px. */
const ROOM_PX = 260;

/** @type {Map<string, Promise<boolean>>} whether words have a meaning */
const known = new Map();

/** Returns whether a word has a meaning. @param {string} word */
function hasMeaning(word) {
  const asked = known.get(word) ?? api.explain(word).then(() => true, () => false);
  if (known.size >= KEPT_MAX) known.clear();
  known.set(word, asked);
  return asked;
}

/**
 * Returns the content of a tooltip; null for an unknown word.
 * @param {string} word @returns {Promise<HTMLElement | null>}
 */
export async function tipOf(word) {
  if (word === "" || !(await hasMeaning(word))) return null;
  const { title, parts } = await meaning(word);
  return h("div", { class: "meaning-tip" }, h("strong", {}, title), ...parts);
}

/**
 * Shows the meaning of words below the pointer, which `wordAt` finds.
 * @param {HTMLElement} element @param {(target: Element) => string} wordAt empty: none
 */
export function tipsOn(element, wordAt) {
  const tip = h("div", { class: "tip", role: "tooltip", hidden: true });
  element.append(tip);
  let timer = 0;
  const hide = () => {
    clearTimeout(timer);
    setAttr(tip, "hidden", true);
  };
  const show = async (/** @type {Element} */ target) => {
    const shown = await tipOf(wordAt(target));
    if (!shown || !target.isConnected || !target.matches(":hover")) return;
    const { left, top, bottom } = target.getBoundingClientRect();
    tip.replaceChildren(shown);
    setAttr(tip, "hidden", false);
    const isAbove = innerHeight - bottom < ROOM_PX;
    tip.style.left = `${Math.max(8, Math.min(left, innerWidth - tip.offsetWidth - 8))}px`;
    tip.style.top = `${isAbove ? Math.max(8, top - tip.offsetHeight - 4) : bottom + 4}px`;
  };
  element.addEventListener("pointerover", (event) => {
    hide();
    const target = event.target instanceof Element ? event.target : null;
    if (event.pointerType === "mouse" && target && !tip.contains(target) && wordAt(target) !== "") timer = setTimeout(() => void show(target), REST_MS);
  });
  for (const end of ["pointerleave", "pointerdown", "wheel"]) element.addEventListener(end, hide, { passive: true });
  document.addEventListener("keydown", hide);
}
