// Short notices over the screen: refusals and events. Errors stay longer; each can be closed.

import { h } from "./dom.js";
import { icon } from "./icons.js";

const SHOWN_MS = { info: 5000, error: 12000 };
/** Notices on the screen at once; the oldest goes first. */
const NOTICES_MAX = 4;

export class Toasts {
  element = h("div", { class: "toasts", role: "log", "aria-live": "assertive", "aria-label": "Notices" });

  /** @param {string} text @param {"info" | "error"} [tone] */
  show(text, tone = "info") {
    for (const old of this.element.children) if (old.textContent === text) old.remove();
    while (this.element.children.length >= NOTICES_MAX) this.element.firstElementChild?.remove();
    const close = h("button", { class: "icon-button", type: "button", "aria-label": "Close notice" }, icon("close"));
    const toast = h(
      "div",
      { class: `toast ${tone}` },
      icon(tone === "error" ? "alarm" : "info"),
      h("p", {}, text),
      close,
    );
    close.addEventListener("click", () => toast.remove());
    this.element.append(toast);
    setTimeout(() => toast.remove(), SHOWN_MS[tone]);
  }
}
