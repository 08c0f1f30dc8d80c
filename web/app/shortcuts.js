// Shortcuts: one key each, without effect during typing. No shortcut starts motion.

import { openHistory } from "../history/dialog.js";
import { t } from "../text/language.js";
import { openDialog } from "../ui/dialog.js";
import { button, h } from "../ui/dom.js";

/** @type {{key: string, says: string, does: (app: import("../main.js").App) => void}[]} */
const SHORTCUTS = [
  { key: "?", says: t("shortcuts.this_list"), does: () => showShortcuts() },
  { key: "f", says: t("shortcuts.read_from_three_metres_and"), does: toggleFar },
  { key: "h", says: t("shortcuts.feed_hold"), does: (app) => app.command("hold") },
  { key: "p", says: t("shortcuts.programs"), does: (app) => app.open("programs") },
  { key: "b", says: t("shortcuts.by_hand"), does: (app) => app.open("by-hand") },
  { key: "s", says: t("shortcuts.set_up"), does: (app) => app.open("set-up") },
  { key: "t", says: t("shortcuts.history_timeline_journal_past_alarms"), does: (app) => openHistory(app) },
  { key: "n", says: t("shortcuts.next_coordinate_system"), does: next },
];

/** @param {import("../main.js").App} app */
export function listenToKeys(app) {
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.altKey || event.metaKey || event.repeat) return;
    if (event.target instanceof Element && event.target.closest("input, textarea, select, dialog[open], [contenteditable]")) return;
    if (event.key === "Escape" && app.model.far) return toggleFar(app);
    const shortcut = SHORTCUTS.find(({ key }) => key === event.key.toLowerCase());
    if (!shortcut) return;
    event.preventDefault();
    shortcut.does(app);
  });
}

/** Shows them. */
export function showShortcuts() {
  const rows = SHORTCUTS.map(({ key, says }) => h("div", { class: "shortcut" }, h("dt", {}, h("kbd", {}, key.toUpperCase())), h("dd", {}, says)));
  const close = button({ autofocus: true, onclick: () => dialog.close() }, t("common.close"));
  const dialog = openDialog("shortcuts", t("shortcuts.shortcuts"), [h("dl", { class: "scroll" }, ...rows), h("div", { class: "row end" }, close)]);
}

/** @param {import("../main.js").App} app */
export function toggleFar(app) {
  app.model.far = !app.model.far;
  app.invalidate();
}

/** @param {import("../main.js").App} app */
function next(app) {
  const numbers = [...app.model.systems.keys()];
  const one = numbers[(numbers.indexOf(app.model.selected) + 1) % numbers.length];
  if (one !== undefined) app.select(one);
}
