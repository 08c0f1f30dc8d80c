// The tool table: numbers, lengths and radii.

import { disableFor, whyNotNow } from "../access/why_not.js";
import { position } from "../text/format.js";
import { t } from "../text/language.js";
import { lengthScale, unitOf } from "../text/units.js";
import { arrange, button, h, setAttr, setText } from "../ui/dom.js";
import { icon } from "../ui/icons.js";
import { numberField, Undo } from "./values.js";

/** @type {import("./values.js").Section} */
export const tools = {
  title: t("tools.tools"),
  create(app) {
    /** @type {import("../types.d.ts").ToolData[]} */
    let table = [];
    let shown = "";
    /** @type {unknown} */
    let told = null;
    const read = async () => {
      await app.attempt(async () => {
        table = await app.api.tools();
      });
      app.invalidate();
    };
    const undo = new Undo(app, () => void read());
    const body = h("div", { class: "tool-rows" });
    const number = h("input", { type: "number", class: "input value", min: 1, max: 65535, step: 1, "aria-label": t("tools.number_of_the_new_tool"), placeholder: "T" });
    const add = button({ type: "submit" }, t("tools.add_tool"));
    const form = h("form", { class: "row wrap end" }, number, add, undo.element);
    form.addEventListener("submit", (event) => {
      event.preventDefault();
      const id = number.valueAsNumber;
      if (!(id >= 1) || table.some((tool) => tool.id === id)) return app.toast(id >= 1 ? t("tools.t_is_in_the_table", { id }) : t("tools.write_the_number_of_the"), "error");
      number.value = "";
      void undo.do(t("tools.t_was_added", { id }), () => app.api.changeTools({ tools: [{ id, length: 0, radius: 0 }] }), () => app.api.changeTools({ remove: [id] }));
    });

    /** @param {import("../types.d.ts").ToolData} tool @param {Partial<import("../types.d.ts").ToolData>} change */
    const set = (tool, change) => {
      const put = (/** @type {import("../types.d.ts").ToolData} */ one) => () => app.api.changeTools({ tools: [one] });
      void undo.do(t("tools.t_was_changed", { id: tool.id }), put({ ...tool, ...change }), put(tool));
    };
    /** @param {import("../types.d.ts").ToolData} first */
    const row = (first) => {
      let tool = first;
      const length = numberField(app, t("tools.length_of_t", { id: tool.id }), (value) => set(tool, { length: value }));
      const radius = numberField(app, t("tools.radius_of_t", { id: tool.id }), (value) => set(tool, { radius: value }));
      const remove = button({ class: "icon-button", "aria-label": t("tools.take_t_out_of_the", { id: tool.id }), onclick: () => void undo.do(t("tools.t_was_taken_out", { id: tool.id }), () => app.api.changeTools({ remove: [tool.id] }), () => app.api.changeTools({ tools: [tool] })) }, icon("trash"));
      const element = h("div", { class: "tool-row" }, h("strong", {}, `T${tool.id}`), length.element, radius.element, remove);
      const show = (/** @type {import("../types.d.ts").ToolData} */ one, /** @type {import("../text/units.js").Scale} */ now) => {
        tool = one;
        setAttr(element, "data-in-spindle", tool.id === app.model.current?.modal?.tool);
        length.show(position(tool.length, now), now);
        radius.show(position(tool.radius, now), now);
      };
      return { element, show };
    };
    /** Rows by tool number: a row, with its typed text, remains while its tool is in the table. @type {Map<number, ReturnType<typeof row>>} */
    let rows = new Map();
    const [lengths, radii] = [h("span", {}), h("span", {})];
    const head = h("div", { class: "tool-row label" }, h("span", {}, t("tools.tool")), lengths, radii, h("span", {}));
    const render = () => {
      if (app.model.tools !== null && app.model.tools !== told) {
        told = app.model.tools;
        table = app.model.tools.tools;
      }
      const ids = table.map(({ id }) => id).join();
      if (ids !== shown || head.parentElement === null) {
        shown = ids;
        rows = new Map(table.map((tool) => [tool.id, rows.get(tool.id) ?? row(tool)]));
        arrange(body, head, ...[...rows.values()].map(({ element }) => element));
      }
      const now = lengthScale(unitOf(app.model.current));
      setText(lengths, t("tools.length", { unit: now.unit }));
      setText(radii, t("tools.radius", { unit: now.unit }));
      for (const tool of table) rows.get(tool.id)?.show(tool, now);
      const why = whyNotNow(app.model);
      for (const one of /** @type {NodeListOf<HTMLInputElement | HTMLButtonElement>} */ (body.querySelectorAll("input, button"))) disableFor(one, why);
      disableFor(add, why);
      setAttr(body, "data-empty", table.length === 0);
      undo.render();
    };
    return { element: h("div", { class: "tools" }, body, form), render, read: () => void read() };
  },
};
