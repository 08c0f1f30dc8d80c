// Alarms of the past: what they were, what helps, and how long they lasted.

import { fill, h, setText } from "../dom.js";
import { explained } from "../explain.js";
import { duration, programName, rounded } from "../format.js";
import { icon } from "../icons.js";
import { dayAndTime, labelled, picker } from "./journal.js";

/** Alarms shown. */
const SHOWN_MAX = 500;

/** @typedef {import("../types.d.ts").AlarmRecord} AlarmRecord */

/** @param {import("../main.js").App} app */
export function alarmHistory(app) {
  const kind = picker("Kind", ["all", "alarm", "warning", "active"]);
  const search = h("input", { class: "input", type: "search", "aria-label": "Search alarms" });
  const list = h("ul", { class: "list", tabindex: 0, "aria-label": "Alarms of the past" });
  const note = h("p", { class: "muted", role: "status" }, "…");
  /** @type {AlarmRecord[] | null} */
  let alarms = null;
  const show = () => {
    if (!alarms) return;
    const wanted = search.value.toLowerCase();
    const found = alarms.filter((alarm) => isFound(alarm, kind.value, wanted));
    fill(list, ...found.slice(0, SHOWN_MAX).map((alarm) => entry(app, alarm)));
    setText(note, alarms.length === 0 ? "There was no alarm since the runtime was started." : `${found.length} of ${alarms.length} since the runtime was started, the newest first.`);
  };
  for (const one of [kind, search]) one.addEventListener("input", show);
  void app.attempt(async () => {
    alarms = (await app.api.alarmHistory()).sort((a, b) => b.id - a.id);
    show();
  });
  return h("div", { class: "history-part" }, h("div", { class: "history-tools" }, labelled(kind), labelled(search)), list, note);
}

/** @param {AlarmRecord} alarm @param {string} kind @param {string} wanted */
function isFound({ severity, cleared_at, number, text }, kind, wanted) {
  const isKind = kind === "all" || kind === severity || (kind === "active" && cleared_at === null);
  return isKind && `${number} ${text}`.toLowerCase().includes(wanted);
}

/** @param {import("../main.js").App} app @param {AlarmRecord} alarm */
function entry(app, { severity, number, text, remedy, cs, program, line, raised_at, cleared_at, acknowledged_by }) {
  const where = [cs === null ? "machine" : `coordinate system ${cs}`, program ? `${programName(program)}${line ? ` line ${line}` : ""}` : ""].filter(Boolean).join(", ");
  const lasted = cleared_at === null ? `active for ${duration(app.model.ageMs(raised_at))}` : `lasted ${lasting(Date.parse(cleared_at) - Date.parse(raised_at))}`;
  const facts = [dayAndTime(raised_at), lasted, where, acknowledged_by && `acknowledged by ${acknowledged_by}`].filter(Boolean).join(" · ");
  return h(
    "li",
    { class: "alarm", "data-severity": severity, "data-past": String(cleared_at !== null) },
    icon(severity === "alarm" ? "alarm" : "info"),
    h("div", { class: "grow" }, h("div", { class: "row" }, explained(`alarm ${number}`), h("strong", {}, rounded(text))), remedy ? h("p", { class: "remedy" }, remedy) : null, h("p", { class: "muted" }, facts)),
  );
}

/** @param {number} ms */
export function lasting(ms) {
  return ms < 60_000 ? `${(ms / 1000).toFixed(1)} s` : duration(ms);
}
