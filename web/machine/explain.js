// Explanations of names on the screen: alarms, diagnostics, codes, state words.

import { t } from "../text/language.js";
import { openDialog } from "../ui/dialog.js";
import { button, fill, h } from "../ui/dom.js";
import { api } from "./api.js";

/** Shows the meaning of a name, or the reason why it is unknown. @param {string} what */
export async function explain(what) {
  const { title, parts } = await meaning(what);
  const close = button({ autofocus: true, onclick: () => dialog.close() }, t("common.close"));
  const dialog = openDialog("explanation", title, [h("div", { class: "scroll", tabindex: 0 }, ...parts), h("div", { class: "row end" }, close)]);
}

/** Returns a button that shows the meaning of a name. @param {string} what */
export function explained(what) {
  const [, number = what] = /^alarm (.*)$/.exec(what) ?? [];
  const name = number === what ? what : t("alerts.alarm", { number });
  return button({ class: "chip-button", "aria-label": t("explain.explain", { what: name }), onclick: () => void explain(what) }, h("span", { class: "chip" }, number));
}

/** Returns a button that shows and hides the meaning in a place. @param {string} what @param {Element} place */
export function unfolding(what, place) {
  const unfold = async () => {
    const open = one.getAttribute("aria-expanded") === "true";
    one.setAttribute("aria-expanded", String(!open));
    if (open) fill(place);
    else fill(place, ...(await meaning(what)).parts);
  };
  const one = button({ class: "chip-button", "aria-label": t("explain.explain", { what }), "aria-expanded": "false", onclick: () => void unfold() }, h("span", { class: "chip" }, what));
  return one;
}

/** Returns a title with its explanation, or the reason why no explanation exists. @param {string} what */
export async function meaning(what) {
  try {
    const { text, picture } = await api.explain(what);
    const [title = what, ...paragraphs] = text.split("\n\n");
    const shown = picture ? [h("img", { src: `/pictures/${picture}`, alt: t("explain.tool_path_of_the_example") })] : [];
    return { title, parts: [...paragraphs.map(part), ...shown] };
  } catch (error) {
    return { title: what, parts: [h("p", {}, error instanceof Error ? error.message : String(error))] };
  }
}

/** Returns a paragraph; indented lines and lists keep their lines. @param {string} text */
function part(text) {
  return /^( {4}|- )/.test(text) ? h("pre", {}, text.replace(/^ {4}/gm, "")) : h("p", {}, text);
}
