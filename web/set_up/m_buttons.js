// A button for each M code of the machine's table, and the spindle: each runs as a line of MDI.

import { disableFor, whyNot } from "../access/why_not.js";
import { t } from "../text/language.js";
import { button, fill, h, setAttr } from "../ui/dom.js";

/** Standard names of M codes. @type {Record<number, string>} */
const NAMES = { 3: t("m_buttons.spindle_cw"), 4: t("m_buttons.spindle_ccw"), 5: t("m_buttons.spindle_stop"), 6: t("m_buttons.tool_change"), 7: t("m_buttons.mist_on"), 8: t("m_buttons.coolant_on"), 9: t("m_buttons.coolant_off"), 19: t("m_buttons.orient_spindle") };
const SPINDLE = [3, 4, 5];
const SPEED_MAX = 1_000_000;

/** @type {import("./values.js").Section} */
export const mButtons = {
  title: t("m_buttons.m_codes"),
  create(app) {
    const speed = h("input", { type: "number", class: "input value", min: 0, max: SPEED_MAX, step: 1, value: 1000, "aria-label": t("m_buttons.spindle_speed_r_min") });
    const row = h("label", { class: "row" }, h("span", { class: "label" }, t("m_buttons.s", { unit: t("unit.rpm") })), speed);
    const list = h("div", { class: "m-buttons", role: "group", "aria-label": t("m_buttons.m_codes") });
    let shown = "";
    const run = (/** @type {number} */ m) => {
      const s = m === 3 || m === 4 ? ` S${speed.valueAsNumber || 0}` : "";
      return app.command("mdi", { text: `M${String(m).padStart(2, "0")}${s}`, macro: true });
    };
    const render = () => {
      const system = app.model.current;
      const hasSpindle = typeof system?.info.spindle === "number";
      const known = Object.keys(app.model.birth?.m_codes ?? {}).map(Number);
      const codes = [...new Set([...(hasSpindle ? SPINDLE : []), ...known])].sort((a, b) => a - b);
      const key = codes.join();
      if (key !== shown) {
        shown = key;
        const one = (/** @type {number} */ m) => button({ "data-m": m, onclick: () => run(m) }, h("strong", {}, `M${String(m).padStart(2, "0")}`), NAMES[m] ?? app.model.birth?.m_codes[m]?.wait_state?.replaceAll("_", " ").toLowerCase() ?? "");
        fill(list, ...codes.map(one));
      }
      setAttr(row, "hidden", !hasSpindle);
      for (const one of list.querySelectorAll("button")) disableFor(one, whyNot(app.model, "mdi"), t("m_buttons.runs_m_at_once", { m: one.dataset.m }));
    };
    return { element: h("div", {}, row, list), render, read: () => {} };
  },
};
