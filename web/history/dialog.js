// What was: the timeline of all coordinate systems, the journal, curves of the last minutes, the alarms of the past.

import { openDialog } from "../dialog.js";
import { button, fill, h, setAttr } from "../dom.js";
import { alarmHistory } from "./alarms.js";
import { journal } from "./journal.js";
import { PlotsView } from "./plots.js";
import { TimelineView } from "./timeline_view.js";

/** @typedef {{element: HTMLElement, close?: () => void}} Part */

/** @type {Record<string, (app: import("../main.js").App) => Part>} */
const PARTS = {
  Timeline: (app) => new TimelineView(app),
  Journal: (app) => ({ element: journal(app) }),
  Curves: (app) => new PlotsView(app),
  "Past alarms": (app) => ({ element: alarmHistory(app) }),
};

/** @param {import("../main.js").App} app @param {string} [first] the part that is shown */
export function openHistory(app, first = "Timeline") {
  /** @type {Part | null} */
  let part = null;
  const place = h("div", { class: "history-place" });
  const picks = Object.keys(PARTS).map((name) => button({ class: "button pick", role: "radio", onclick: () => show(name) }, name));
  const group = h("div", { class: "history-picks", role: "radiogroup", "aria-label": "Part of the history" }, ...picks);
  /** @param {string} name */
  const show = (name) => {
    part?.close?.();
    part = PARTS[name]?.(app) ?? null;
    for (const pick of picks) {
      const isShown = pick.textContent === name;
      setAttr(pick, "aria-checked", String(isShown));
      setAttr(pick, "tabindex", isShown ? "0" : "-1");
    }
    fill(place, part?.element);
  };
  group.addEventListener("keydown", (event) => {
    const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    const at = picks.findIndex((pick) => pick === document.activeElement);
    const next = step && at >= 0 ? picks[(at + step + picks.length) % picks.length] : undefined;
    next?.click();
    next?.focus();
  });
  const close = button({ onclick: () => dialog.close() }, "Close");
  const dialog = openDialog("history", "History", [h("div", { class: "row wrap" }, group, close), place], () => part?.close?.());
  show(first);
  picks.find((pick) => pick.textContent === first)?.focus();
}
