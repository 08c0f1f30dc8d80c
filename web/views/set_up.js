// Setting up a part: work offsets with zero-set and touch-off by hand, probe cycles, the tool table, variables, and the machine's M codes.

import { mButtons } from "../set_up/m_buttons.js";
import { offsets } from "../set_up/offsets.js";
import { probe } from "../set_up/probe.js";
import { tools } from "../set_up/tools.js";
import { variables } from "../set_up/variables.js";
import { t } from "../text/language.js";
import { arrange, button, h, setAttr } from "../ui/dom.js";

/** @type {import("../set_up/values.js").Section[]} */
const SECTIONS = [offsets, probe, tools, variables, mButtons];

/** @type {import("../main.js").View} */
export const setUp = {
  place: "right",
  panel: { name: "set-up", title: t("set_up.set_up") },
  create(app) {
    const sections = SECTIONS.map(({ title, create }) => ({ title, section: create(app) }));
    let at = 0;
    let shown = "";
    const place = h("div", { class: "set-up-section" });
    const picks = sections.map(({ title }, number) => button({ class: "button pick", role: "radio", onclick: () => choose(number) }, title));
    const choose = (/** @type {number} */ number) => {
      at = number;
      shown = "";
      app.model.preview = null;
      app.invalidate();
    };
    const render = () => {
      if (app.model.panel !== "set-up") {
        shown = "";
        return;
      }
      const section = sections[at]?.section;
      // reads the shown values again, because other clients may have changed them
      const key = `${app.model.bootId} ${app.model.selected} ${at} ${app.model.online}`;
      if (section && key !== shown) {
        shown = key;
        arrange(place, section.element);
        section.read();
      }
      for (const [number, pick] of picks.entries()) setAttr(pick, "aria-checked", String(number === at));
      section?.render();
    };
    const element = h("div", { class: "set-up" }, h("div", { class: "choice", role: "radiogroup", "aria-label": t("set_up.set_up") }, ...picks), place);
    return { element, render };
  },
};
