// Active alarms, newest first, with their remedies.

import { explained } from "../machine/explain.js";
import { alarmWords } from "../text/alarm_words.js";
import { programName, rounded, timeOfDay } from "../text/format.js";
import { t } from "../text/language.js";
import { button, card, fill, h, setText } from "../ui/dom.js";
import { icon } from "../ui/icons.js";

/** @type {import("../main.js").View} */
export const alarms = {
  place: "now",
  create(app) {
    const count = h("span", { class: "muted" });
    const list = h("ul", { class: "list" });
    const log = h("div", { class: "scroll", role: "log", "aria-live": "assertive", "aria-label": t("alarms.active_alarms"), tabindex: 0 }, list);
    let shown = "";
    const render = () => {
      const active = [...app.model.alarms].reverse();
      const key = JSON.stringify([app.model.bootId, active]);
      if (key !== shown) {
        shown = key;
        fill(list, ...active.map((alarm) => entry(app, alarm)));
        setText(count, active.length > 0 ? t("alarms.active", { count: active.length }) : app.model.bootId === null ? "" : t("alarms.no_alarm_is_active"));
      }
    };
    return { element: card("alarms-card", t("alarms.alarms"), [count], log), render };
  },
};

/** @param {import("../main.js").App} app @param {import("../types.d.ts").AlarmRecord} alarm */
function entry(app, alarm) {
  const program = programName(alarm.program);
  const place = alarm.program === null ? "" : alarm.line === null ? program : t("common.program_line", { program, line: alarm.line });
  const facts = [alarm.cs === null ? t("alarms.all") : t("common.cs", { cs: alarm.cs }), place, timeOfDay(alarm.raised_at)].filter((text) => text !== "");
  const words = alarmWords(alarm);
  const remedy = words.remedy ?? (alarm.severity === "alarm" ? t("sentence.remove_cause") : "");
  const onclick = () => app.attempt(() => app.api.acknowledge(alarm.id));
  const acknowledge = button({ class: "button small", "aria-label": t("alarms.acknowledge_number", { number: alarm.number }), onclick }, t("alarms.acknowledge_this"));
  return h(
    "li",
    { class: "alarm", "data-severity": alarm.severity },
    icon(alarm.severity === "alarm" ? "alarm" : "info"),
    h(
      "div",
      { class: "grow" },
      h("div", { class: "row" }, h("strong", {}, alarm.severity === "alarm" ? t("alarms.alarm") : t("alarms.warning")), explained(`alarm ${alarm.number}`), h("span", { class: "spring" }), h("span", { class: "muted" }, facts.join(" · "))),
      h("p", {}, rounded(words.text)),
      words.detail && h("p", { class: "muted" }, rounded(words.detail)),
      remedy && h("p", { class: "remedy" }, remedy),
      alarm.acknowledged_by ? h("p", { class: "muted" }, t("alarms.acknowledged_by", { user: alarm.acknowledged_by })) : alarm.severity === "warning" && h("div", { class: "row end" }, acknowledge),
    ),
  );
}
