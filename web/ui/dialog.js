// One dialog at a time. It does not block the rest of the screen: hold, stop and abort remain usable.

import { h } from "./dom.js";

/**
 * Opens a dialog. Its first element with `autofocus` has the focus; Escape closes it, and the focus goes back.
 * @param {string} name class, and beginning of the title's id
 * @param {string} title
 * @param {import("./dom.js").Child[]} children
 * @param {(answer: string) => void} [closed] receives the argument of `dialog.close`; nothing after Escape
 * @returns {HTMLDialogElement}
 */
export function openDialog(name, title, children, closed = () => {}) {
  /** @type {HTMLDialogElement | null} */ (document.querySelector("dialog[open]"))?.close("");
  const before = document.activeElement;
  const id = `${name}-title`;
  const dialog = h("dialog", { class: `dialog ${name}`, "aria-labelledby": id }, h("h2", { id }, title), ...children);
  // if the focused element is replaced while the dialog is open, the page has the focus
  const onKey = (/** @type {KeyboardEvent} */ event) => {
    const isHere = event.target === document.body || (event.target instanceof Node && dialog.contains(event.target));
    if (event.key === "Escape" && isHere && !event.defaultPrevented) dialog.close("");
  };
  document.addEventListener("keydown", onKey);
  dialog.addEventListener("close", () => {
    document.removeEventListener("keydown", onKey);
    dialog.remove();
    if (before instanceof HTMLElement) before.focus();
    closed(dialog.returnValue);
  });
  document.body.append(dialog);
  dialog.show();
  // the focused element may be at the end of a long dialog; the dialog is shown from its top
  dialog.scrollTop = 0;
  return dialog;
}
