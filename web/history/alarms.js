// Past alarms: their texts, remedies and durations.

import { explained } from "../machine/explain.js";
import { alarmWords } from "../text/alarm_words.js";
import { dayAndTime, duration, programName, rounded, seconds } from "../text/format.js";
import { listed, t } from "../text/language.js";
import { fill, h, setText } from "../ui/dom.js";
import { icon } from "../ui/icons.js";
import { labelled, picker } from "./journal.js";

/** Alarms shown. */
const SHOWN_MAX = 500;

/** @typedef {import("../types.d.ts").AlarmRecord} AlarmRecord */

/** @param {import("../main.js").App} app */
export function alarmHistory(app) {
  const kind = picker(t("alarm_history.kind"), [["all", t("alarm_history.all")], ["alarm", t("alarm_history.alarms")], ["warning", t("alarm_history.warnings")], ["active", t("alarm_history.active")]]);
  const search = h("input", { class: "input", type: "search", "aria-label": t("alarm_history.search_alarms") });
  const list = h("ul", { class: "list", tabindex: 0, "aria-label": t("alarm_history.alarms_of_the_past") });
  const note = h("p", { class: "muted", role: "status" }, "…");
  /** @type {AlarmRecord[] | null} */
  let alarms = null;
  const show = () => {
    if (!alarms) return;
    const wanted = search.value.toLowerCase();
    const found = alarms.filter((alarm) => isFound(alarm, kind.value, wanted));
    fill(list, ...found.slice(0, SHOWN_MAX).map((alarm) => entry(app, alarm)));
    setText(note, alarms.length === 0 ? t("alarm_history.there_was_no_alarm_since") : t("alarm_history.found", { found: found.length, count: alarms.length }));
  };
  for (const one of [kind, search]) one.addEventListener("input", show);
  void app.attempt(async () => {
    alarms = (await app.api.alarmHistory()).sort((a, b) => b.id - a.id);
    show();
  });
  return h("div", { class: "history-part" }, h("div", { class: "history-tools" }, labelled(kind), labelled(search)), list, note);
}

/** @param {AlarmRecord} alarm @param {string} kind @param {string} wanted */
function isFound(alarm, kind, wanted) {
  const { severity, cleared_at, number } = alarm;
  const { text, detail } = alarmWords(alarm);
  const isKind = kind === "all" || kind === severity || (kind === "active" && cleared_at === null);
  return isKind && `${number} ${text} ${detail ?? ""}`.toLowerCase().includes(wanted);
}

/** @param {import("../main.js").App} app @param {AlarmRecord} alarm */
function entry(app, alarm) {
  const { severity, number, cs, program, line, raised_at, cleared_at, acknowledged_by } = alarm;
  const { text, remedy, detail } = alarmWords(alarm);
  const place = line ? t("common.program_line", { program: programName(program), line }) : programName(program);
  const where = listed([cs === null ? t("alarm_history.machine") : t("common.coordinate_system", { cs }), program ? place : ""]);
  const lasted = cleared_at === null ? t("alarm_history.active_for", { time: duration(app.model.ageMs(raised_at)) }) : t("alarm_history.lasted", { time: lasting(Date.parse(cleared_at) - Date.parse(raised_at)) });
  const facts = [dayAndTime(raised_at), lasted, where, acknowledged_by && t("alarm_history.acknowledged", { user: acknowledged_by })].filter(Boolean).join(" · ");
  return h(
    "li",
    { class: "alarm", "data-severity": severity, "data-past": String(cleared_at !== null) },
    icon(severity === "alarm" ? "alarm" : "info"),
    h("div", { class: "grow" }, h("div", { class: "row" }, explained(`alarm ${number}`), h("strong", {}, rounded(text))), detail && h("p", { class: "muted" }, rounded(detail)), remedy && h("p", { class: "remedy" }, remedy), h("p", { class: "muted" }, facts)),
  );
}

/** @param {number} ms */
export function lasting(ms) {
  return ms < 60_000 ? seconds(ms / 1000, 1) : duration(ms);
}
