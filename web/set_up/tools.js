// The tool table: numbers, lengths and radii.

import { button, fill, h, setAttr } from "../dom.js";
import { position } from "../format.js";
import { icon } from "../icons.js";
import { lengthScale, unitOf } from "../units.js";
import { disableFor, whyNotNow } from "../why_not.js";
import { numberField, Undo } from "./values.js";

/** @type {import("./values.js").Section} */
export const tools = {
  title: "Tools",
  create(app) {
    /** @type {import("../types.d.ts").ToolData[]} */
    let table = [];
    let shown = "";
    const scale = () => lengthScale(unitOf(app.model.current));
    const read = async () => {
      await app.attempt(async () => {
        table = await app.api.tools();
      });
      app.invalidate();
    };
    const undo = new Undo(app, () => void read());
    const body = h("div", { class: "tool-rows" });
    const number = h("input", { type: "number", class: "input value", min: 1, max: 65535, step: 1, "aria-label": "Number of the new tool", placeholder: "T" });
    const add = button({ type: "submit" }, "Add tool");
    const form = h("form", { class: "row end" }, number, add, undo.element);
    form.addEventListener("submit", (event) => {
      event.preventDefault();
      const id = number.valueAsNumber;
      if (!(id >= 1) || table.some((tool) => tool.id === id)) return app.toast(id >= 1 ? `T${id} is in the table already.` : "Write the number of the tool, from 1.", "error");
      number.value = "";
      void undo.do(`T${id} was added`, () => app.api.changeTools({ tools: [{ id, length: 0, radius: 0 }] }), () => app.api.changeTools({ remove: [id] }));
    });

    /** @param {import("../types.d.ts").ToolData} tool @param {Partial<import("../types.d.ts").ToolData>} change */
    const set = (tool, change) => {
      const put = (/** @type {import("../types.d.ts").ToolData} */ one) => () => app.api.changeTools({ tools: [one] });
      void undo.do(`T${tool.id} was changed`, put({ ...tool, ...change }), put(tool));
    };
    /** @param {import("../types.d.ts").ToolData} tool */
    const row = (tool) => {
      const length = numberField(`Length of T${tool.id}`, (value) => set(tool, { length: value * scale().size }));
      const radius = numberField(`Radius of T${tool.id}`, (value) => set(tool, { radius: value * scale().size }));
      length.show(position(tool.length, scale()));
      radius.show(position(tool.radius, scale()));
      const remove = button({ class: "icon-button", "aria-label": `Take T${tool.id} out of the table`, onclick: () => void undo.do(`T${tool.id} was taken out`, () => app.api.changeTools({ remove: [tool.id] }), () => app.api.changeTools({ tools: [tool] })) }, icon("trash"));
      return h("div", { class: "tool-row", "data-in-spindle": tool.id === app.model.current?.modal?.tool }, h("strong", {}, `T${tool.id}`), length.element, radius.element, remove);
    };
    const render = () => {
      const key = JSON.stringify([table, scale(), app.model.current?.modal?.tool]);
      if (key !== shown) {
        shown = key;
        const { unit } = scale();
        fill(body, h("div", { class: "tool-row label" }, h("span", {}, "Tool"), h("span", {}, `Length, ${unit}`), h("span", {}, `Radius, ${unit}`), h("span", {})), ...table.map(row));
      }
      const why = whyNotNow(app.model);
      for (const one of /** @type {NodeListOf<HTMLInputElement | HTMLButtonElement>} */ (body.querySelectorAll("input, button"))) disableFor(one, why);
      disableFor(add, why);
      setAttr(body, "data-empty", table.length === 0);
      undo.render();
    };
    return { element: h("div", { class: "tools" }, body, form), render, read: () => void read() };
  },
};
