// A permanently visible line with all forced values, as a reminder.

import { forcedOf, ioOf, nameOf, valueText } from "../inputs/plant.js";
import { listed, t } from "../text/language.js";
import { button, h, setAttr, setText } from "../ui/dom.js";

/** @type {import("../main.js").View} */
export const forced = {
  place: "banner",
  create(app) {
    const text = h("p", { class: "grow" });
    const show = button({ class: "button small", onclick: () => app.open("plant") }, t("plant.show"));
    const element = h("div", { class: "forced-note", role: "status", hidden: true }, text, show);
    const render = () => {
      const all = forcedOf(app.model);
      setAttr(element, "hidden", all.length === 0);
      const list = all.map((point) => `${nameOf(point)} ${valueText(point, ioOf(app.model, point)?.forced?.value ?? false)}`);
      setText(text, t("plant.forced", { list: listed(list) }));
    };
    return { element, render };
  },
};
