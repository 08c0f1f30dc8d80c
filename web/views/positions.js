// The axes: work position in large digits, machine position and distance to go. All axes are visible at every size: the digits
// use the available space.

import { homedSign } from "../by_hand/homed.js";
import { axesOf } from "../machine/model.js";
import { position } from "../text/format.js";
import { t } from "../text/language.js";
import { scaleOf } from "../text/units.js";
import { card, fill, h, setAttr, setText } from "../ui/dom.js";

/** Longest position in large digits, characters. */
const LONG_POSITION = 8;

/** @type {import("../main.js").View} */
export const positions = {
  place: "left",
  create(app) {
    const body = h("tbody", {});
    const head = [t("positions.axis"), t("positions.work"), t("positions.machine"), t("positions.to_go")].map((text) => h("th", { scope: "col" }, text));
    const table = h("table", { class: "positions" }, h("thead", {}, h("tr", {}, ...head)), body);
    /** @type {{axis: string, unit: HTMLElement, sign: ReturnType<typeof homedSign>, work: HTMLElement, machine: HTMLElement, toGo: HTMLElement}[]} */
    let rows = [];
    let shown = "";

    /** @param {import("../machine/model.js").CoordinateSystem} system */
    const build = (system) => {
      rows = axesOf(system).map((axis) => ({ axis, unit: h("small", {}), sign: homedSign(axis), work: h("td", { class: "work" }), machine: h("td", {}), toGo: h("td", {}) }));
      const row = (/** @type {typeof rows[number]} */ { axis, unit, sign, work, machine, toGo }) => h("tr", { "data-axis": axis }, h("th", { scope: "row" }, axis, unit, sign.element), work, machine, toGo);
      fill(body, ...rows.map(row));
      element.style.setProperty("--rows", String(rows.length));
    };
    const render = () => {
      const system = app.model.current;
      if (!system) return;
      const key = `${system.info.number} ${Object.keys(system.info.axes).join("")}`;
      if (key !== shown) {
        shown = key;
        build(system);
      }
      // a held jog continues until release, so it has no remaining distance
      const isJog = system.state?.run_kind === "jog";
      for (const { axis, unit, sign, work, machine, toGo } of rows) {
        const scale = scaleOf(app.model, axis);
        setText(unit, scale.unit);
        sign.render(system);
        setText(work, position(system.position?.work[axis], scale));
        setText(machine, position(system.position?.machine[axis], scale));
        const left = system.position?.distance_to_go[axis];
        setText(toGo, isJog && left !== 0 ? t("positions.jog") : position(left, scale));
      }
      setAttr(table, "data-long", rows.some(({ work, machine }) => [work, machine].some((cell) => (cell.textContent ?? "").length > LONG_POSITION)));
    };
    const element = card("positions-card", t("positions.position"), [], h("div", { class: "positions-box" }, table));
    return { element, render };
  },
};
