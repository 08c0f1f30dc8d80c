// Asks before an action that cannot be undone. The safe answer has the focus; Escape selects it.

import { openDialog } from "./dialog.js";
import { button, h } from "./dom.js";

/**
 * @param {{title: string, text: string, yes: string, no: string}} question
 * @returns {Promise<boolean>}
 */
export function confirm({ title, text, yes, no }) {
  return new Promise((resolve) => {
    const keep = button({ autofocus: true, onclick: () => dialog.close("no") }, no);
    const go = button({ class: "button danger", onclick: () => dialog.close("yes") }, yes);
    const children = [h("p", {}, text), h("div", { class: "row end" }, keep, go)];
    const dialog = openDialog("confirm", title, children, (answer) => resolve(answer === "yes"));
  });
}
