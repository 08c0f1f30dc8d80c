// The axes: work position in large digits, machine position and distance to go.

import { card, fill, h, setAttr, setText } from "../dom.js";
import { position } from "../format.js";

/** Axis letters in the usual order. */
const ORDER = "XYZABCUVW";
/** A longer position is set in smaller digits. */
const LONG_POSITION = 8;

/** @type {import("../main.js").View} */
export const positions = {
  place: "left",
  create(app) {
    const body = h("tbody", {});
    const head = ["Axis", "Work", "Machine", "To go"].map((text) => h("th", { scope: "col" }, text));
    const table = h("table", { class: "positions" }, h("thead", {}, h("tr", {}, ...head)), body);
    /** @type {{axis: string, work: HTMLElement, machine: HTMLElement, toGo: HTMLElement}[]} */
    let rows = [];
    let shown = "";

    /** @param {import("../model.js").CoordinateSystem} system */
    const build = (system) => {
      const axes = Object.keys(system.info.axes).sort((a, b) => ORDER.indexOf(a) - ORDER.indexOf(b));
      rows = axes.map((axis) => ({ axis, work: h("td", { class: "work" }), machine: h("td", {}), toGo: h("td", {}) }));
      const unit = (/** @type {string} */ axis) => {
        const motor = app.model.birth?.motors.find((m) => m.number === system.info.axes[axis]);
        return motor?.kind === "rotary" ? "deg" : "mm";
      };
      fill(
        body,
        ...rows.map((row) =>
          h("tr", { "data-axis": row.axis }, h("th", { scope: "row" }, row.axis, h("small", {}, unit(row.axis))), row.work, row.machine, row.toGo),
        ),
      );
    };
    const render = () => {
      const system = app.model.current;
      if (!system) return;
      const key = `${system.info.number} ${Object.keys(system.info.axes).join("")}`;
      if (key !== shown) {
        shown = key;
        build(system);
      }
      for (const { axis, work, machine, toGo } of rows) {
        setText(work, position(system.position?.work[axis]));
        setText(machine, position(system.position?.machine[axis]));
        setText(toGo, position(system.position?.distance_to_go[axis]));
      }
      setAttr(table, "data-long", rows.some(({ work, machine }) => [work, machine].some((cell) => (cell.textContent ?? "").length > LONG_POSITION)));
    };
    return { element: card("positions-card", "Position", [], h("div", { class: "positions-box" }, table)), render };
  },
};
