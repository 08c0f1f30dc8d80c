// Asks before something that cannot be taken back. The safe answer has the focus; Escape gives it.

import { openDialog } from "./dialog.js";
import { h } from "./dom.js";

/**
 * @param {{title: string, text: string, yes: string, no: string}} question
 * @returns {Promise<boolean>}
 */
export function confirm({ title, text, yes, no }) {
  return new Promise((resolve) => {
    const keep = h("button", { type: "button", class: "button", autofocus: true }, no);
    const go = h("button", { type: "button", class: "button danger" }, yes);
    const children = [h("p", {}, text), h("div", { class: "row end" }, keep, go)];
    const dialog = openDialog("confirm", title, children, (answer) => resolve(answer === "yes"));
    keep.addEventListener("click", () => dialog.close("no"));
    go.addEventListener("click", () => dialog.close("yes"));
  });
}
