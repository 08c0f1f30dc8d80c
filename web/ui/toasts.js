// Short notices: refusals and events. Errors stay longer; each can be closed.

import { t } from "../text/language.js";
import { button, h } from "./dom.js";
import { icon } from "./icons.js";

const SHOWN_MS = { info: 5000, error: 12000 };
/** Notices shown at once; the oldest is removed first. */
const NOTICES_MAX = 4;

export class Toasts {
  element = h("div", { class: "toasts", role: "log", "aria-live": "assertive", "aria-label": t("toasts.notices") });

  /**
   * Shows a notice. It replaces a notice with the same text or of the same kind.
   * @param {string} text @param {"info" | "error"} [tone] @param {string} [kind]
   */
  show(text, tone = "info", kind = text) {
    for (const old of this.element.children) if (old.getAttribute("data-kind") === kind) old.remove();
    while (this.element.children.length >= NOTICES_MAX) this.element.firstElementChild?.remove();
    const close = button({ class: "icon-button", "aria-label": t("toasts.close_notice"), onclick: () => toast.remove() }, icon("close"));
    const toast = h("div", { class: `toast ${tone}`, "data-kind": kind }, icon(tone === "error" ? "alarm" : "info"), h("p", {}, text), close);
    this.element.append(toast);
    setTimeout(() => toast.remove(), SHOWN_MS[tone]);
  }
}
