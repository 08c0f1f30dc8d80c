// The panel Plant: declared inputs and outputs with their values, owners and forced values.

import { disableFor, whyNotNow } from "../access/why_not.js";
import { askToForce, askToRelease } from "../inputs/force.js";
import { ioOf, nameOf, pointsOf, valueText } from "../inputs/plant.js";
import { t } from "../text/language.js";
import { button, fill, h, setAttr, setText } from "../ui/dom.js";

/** @type {import("../main.js").View} */
export const plant = {
  place: "right",
  panel: { name: "plant", title: t("plant.plant") },
  create(app) {
    const element = h("div", { class: "plant" });
    /** @type {{render: () => void}[]} */
    let rows = [];
    let shown = "";
    const build = () => {
      const all = pointsOf(app.model).map((point) => ({ point, row: entry(app, point) }));
      const lists = [["in", t("plant.inputs")], ["out", t("plant.outputs")]].map(([side = "", title = ""]) => {
        const own = all.filter(({ point }) => point.side === side).map(({ row }) => row.element);
        return own.length > 0 && h("section", { "aria-label": title }, h("h3", {}, title), h("ul", { class: "io-list" }, ...own));
      });
      fill(element, ...lists);
      rows = all.map(({ row }) => row);
    };
    const render = () => {
      if (app.model.panel !== "plant") return;
      const key = `${app.model.bootId} ${JSON.stringify(app.model.birth?.io)}`;
      if (key !== shown) {
        shown = key;
        build();
      }
      for (const row of rows) row.render();
    };
    return { element, render, isThere: () => pointsOf(app.model).length > 0 };
  },
};

/** @param {import("../main.js").App} app @param {import("../inputs/plant.js").Point} point */
function entry(app, point) {
  const name = nameOf(point);
  const value = h("strong", { class: "io-value" });
  const who = h("p", { class: "muted" });
  const mark = h("p", { class: "forced" });
  const force = button({ class: "button small", "aria-label": t("plant.force_one", { name }), onclick: () => askToForce(app, point) }, t("plant.force"));
  const release = button({ class: "button small", "aria-label": t("plant.release_one", { name }), onclick: () => void askToRelease(app, point) }, t("plant.release"));
  const element = h("li", { class: "io-point", "data-io": point.topic }, h("div", { class: "grow" }, h("div", { class: "row" }, h("span", { class: "grow" }, name), value), who, mark), h("div", { class: "row" }, release, force));
  const render = () => {
    const io = ioOf(app.model, point);
    setText(value, io ? valueText(point, io.value) : "–");
    setText(who, !io ? "" : io.owner === null ? t("plant.nobody_owns_it") : t(io.lost ? "plant.owner_has_gone" : "plant.owner", { handler: io.owner }));
    setText(mark, io?.forced ? t("plant.forced_by", { user: io.forced.by, value: valueText(point, io.written) }) : io?.unknown ? t("plant.unknown") : "");
    setAttr(element, "data-on", io?.value === true);
    setAttr(element, "data-forced", Boolean(io?.forced));
    setAttr(release, "hidden", !io?.forced);
    const whyNot = whyNotNow(app.model);
    disableFor(force, whyNot, t("plant.force_one", { name }));
    disableFor(release, whyNot, t("plant.release_one", { name }));
  };
  return { element, render };
}
