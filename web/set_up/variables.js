// P and Q variables: a part of them, to be looked at and changed.

import { button, fill, h, setAttr } from "../dom.js";
import { plain } from "../format.js";
import { t } from "../language.js";
import { disableFor, whyNotNow } from "../why_not.js";
import { numberField, Undo } from "./values.js";

/** Variables shown at once. */
const SHOWN = 50;
/** Read at once, when only those with a value are shown. */
const READ_MAX = 1000;

/** @type {import("./values.js").Section} */
export const variables = {
  title: t("variables.variables"),
  create(app) {
    /** @type {"p" | "q"} */
    let kind = "p";
    /** @type {[number, import("../types.d.ts").Number][]} */
    let values = [];
    let shown = "";
    const from = h("input", { type: "number", class: "input value", min: 0, step: 1, value: 0, "aria-label": t("variables.first_variable") });
    const used = button({ class: "button pick", role: "switch", "aria-checked": "false", onclick: () => {
      setAttr(used, "aria-checked", String(used.getAttribute("aria-checked") !== "true"));
      void read();
    } }, t("variables.in_use"));
    const kinds = /** @type {const} */ (["p", "q"]).map((one) => button({ class: "button pick", role: "radio", "aria-checked": String(one === kind), onclick: () => {
      kind = one;
      for (const [at, pick] of kinds.entries()) setAttr(pick, "aria-checked", String(["p", "q"][at] === kind));
      void read();
    } }, one.toUpperCase()));
    const read = async () => {
      const cs = app.model.selected;
      const first = Math.max(0, Math.floor(Number(from.value) || 0));
      const onlyUsed = used.getAttribute("aria-checked") === "true";
      await app.attempt(async () => {
        const all = await app.api.variables(cs, kind, first, onlyUsed ? READ_MAX : SHOWN);
        const numbered = all.map((value, at) => /** @type {[number, import("../types.d.ts").Number]} */ ([first + at, value]));
        values = onlyUsed ? numbered.filter(([, value]) => value !== 0).slice(0, SHOWN * 4) : numbered;
      });
      app.invalidate();
    };
    from.addEventListener("change", () => void read());
    const undo = new Undo(app, () => void read());
    const body = h("div", { class: "variable-rows" });
    const again = button({ class: "button small", onclick: () => void read() }, t("common.read_again"));

    /** @param {[number, import("../types.d.ts").Number]} entry */
    const row = ([number, value]) => {
      const name = `${kind.toUpperCase()}${number}`;
      const [cs, of] = [app.model.selected, kind];
      const field = numberField(name, (to) => void undo.do(t("variables.was", { name, value: typeof value === "number" ? plain(value) : value }), () => app.api.setVariables(cs, of, number, [to]), () => app.api.setVariables(cs, of, number, [value])));
      field.show(typeof value === "number" ? plain(value) : value);
      return h("div", { class: "variable-row" }, h("strong", {}, name), field.element);
    };
    const render = () => {
      const key = JSON.stringify([kind, values]);
      if (key !== shown) {
        shown = key;
        fill(body, ...(values.length > 0 ? values.map(row) : [h("p", { class: "empty" }, t("variables.none_of_these_has_a"))]));
      }
      const why = whyNotNow(app.model, "set");
      for (const one of body.querySelectorAll("input")) disableFor(one, why);
      undo.render();
    };
    const choices = h("div", { class: "choice" }, h("div", { class: "row", role: "radiogroup", "aria-label": t("variables.kind_of_variable") }, ...kinds), h("span", { class: "label" }, t("variables.from")), from, used);
    return { element: h("div", { class: "variables" }, choices, body, h("div", { class: "row end" }, undo.element, again)), render, read: () => void read() };
  },
};
