// The past: timeline of all coordinate systems, all runs, the journal, curves of the last minutes, earlier alarms.

import { t } from "../text/language.js";
import { openDialog } from "../ui/dialog.js";
import { button, fill, h, setAttr } from "../ui/dom.js";
import { alarmHistory } from "./alarms.js";
import { journal } from "./journal.js";
import { PlotsView } from "./plots.js";
import { runsView } from "./runs_view.js";
import { TimelineView } from "./timeline_view.js";

/** @typedef {{element: HTMLElement, close?: () => void}} Part */

/** @type {{title: string, create: (app: import("../main.js").App) => Part}[]} */
const PARTS = [
  { title: t("history.timeline"), create: (app) => new TimelineView(app) },
  { title: t("history.runs"), create: runsView },
  { title: t("history.journal"), create: (app) => ({ element: journal(app) }) },
  { title: t("history.curves"), create: (app) => new PlotsView(app) },
  { title: t("history.past_alarms"), create: (app) => ({ element: alarmHistory(app) }) },
];

/** @param {import("../main.js").App} app */
export function openHistory(app) {
  /** @type {Part | null} */
  let part = null;
  const place = h("div", { class: "history-place" });
  const picks = PARTS.map(({ title }, at) => button({ class: "button pick", role: "radio", onclick: () => show(at) }, title));
  const group = h("div", { class: "history-picks", role: "radiogroup", "aria-label": t("history.part_of_the_history") }, ...picks);
  /** @param {number} at */
  const show = (at) => {
    part?.close?.();
    part = PARTS[at]?.create(app) ?? null;
    for (const [number, pick] of picks.entries()) {
      const isShown = number === at;
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
  const close = button({ onclick: () => dialog.close() }, t("common.close"));
  const dialog = openDialog("history", t("history.history"), [h("div", { class: "row wrap" }, group, close), place], () => part?.close?.());
  show(0);
  picks[0]?.focus();
}
