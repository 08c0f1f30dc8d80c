// Short notices: refusals and events. Errors stay longer; each can be closed.

import { button, h } from "./dom.js";
import { icon } from "./icons.js";
import { t } from "./language.js";

const SHOWN_MS = { info: 5000, error: 12000 };
/** Notices shown at once; the oldest is removed first. */
const NOTICES_MAX = 4;

export class Toasts {
  element = h("div", { class: "toasts", role: "log", "aria-live": "assertive", "aria-label": t("toasts.notices") });

  /** @param {string} text @param {"info" | "error"} [tone] */
  show(text, tone = "info") {
    for (const old of this.element.children) if (old.textContent === text) old.remove();
    while (this.element.children.length >= NOTICES_MAX) this.element.firstElementChild?.remove();
    const close = button({ class: "icon-button", "aria-label": t("toasts.close_notice"), onclick: () => toast.remove() }, icon("close"));
    const toast = h("div", { class: `toast ${tone}` }, icon(tone === "error" ? "alarm" : "info"), h("p", {}, text), close);
    this.element.append(toast);
    setTimeout(() => toast.remove(), SHOWN_MS[tone]);
  }
}
