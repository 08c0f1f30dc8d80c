// Active alarms, newest first, with their remedies.

import { button, card, fill, h, setText } from "../dom.js";
import { explained } from "../explain.js";
import { programName, rounded, timeOfDay } from "../format.js";
import { icon } from "../icons.js";

/** @type {import("../main.js").View} */
export const alarms = {
  place: "now",
  create(app) {
    const count = h("span", { class: "muted" });
    const list = h("ul", { class: "list" });
    const log = h("div", { class: "scroll", role: "log", "aria-live": "assertive", "aria-label": "Active alarms", tabindex: 0 }, list);
    let shown = "";
    const render = () => {
      const active = [...app.model.alarms].reverse();
      const key = JSON.stringify([app.model.bootId, active]);
      if (key !== shown) {
        shown = key;
        fill(list, ...active.map((alarm) => entry(app, alarm)));
        setText(count, active.length > 0 ? `${active.length} active` : app.model.bootId === null ? "" : "No alarm is active.");
      }
    };
    return { element: card("alarms-card", "Alarms", [count], log), render };
  },
};

/** @param {import("../main.js").App} app @param {import("../types.d.ts").AlarmRecord} alarm */
function entry(app, alarm) {
  const place = alarm.program === null ? "" : `${programName(alarm.program)}${alarm.line === null ? "" : ` line ${alarm.line}`}`;
  const facts = [alarm.cs === null ? "all" : `CS ${alarm.cs}`, place, timeOfDay(alarm.raised_at)].filter((text) => text !== "");
  const remedy = alarm.remedy ?? (alarm.severity === "alarm" ? "Remove the cause, then press Reset." : "");
  const onclick = () => void app.attempt(() => app.api.acknowledge(alarm.id));
  const acknowledge = button({ class: "button small", "aria-label": `Acknowledge ${alarm.number}`, onclick }, "Acknowledge");
  return h(
    "li",
    { class: "alarm", "data-severity": alarm.severity },
    icon(alarm.severity === "alarm" ? "alarm" : "info"),
    h(
      "div",
      { class: "grow" },
      h("div", { class: "row" }, h("strong", {}, alarm.severity === "alarm" ? "Alarm" : "Warning"), explained(`alarm ${alarm.number}`), h("span", { class: "spring" }), h("span", { class: "muted" }, facts.join(" · "))),
      h("p", {}, rounded(alarm.text)),
      remedy && h("p", { class: "remedy" }, remedy),
      alarm.acknowledged_by ? h("p", { class: "muted" }, `Acknowledged by ${alarm.acknowledged_by}`) : alarm.severity === "warning" && h("div", { class: "row end" }, acknowledge),
    ),
  );
}
