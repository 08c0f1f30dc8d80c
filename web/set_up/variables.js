// P and Q variables: a range of them, to be read and changed.

import { disableFor, whyNotNow } from "../access/why_not.js";
import { plain } from "../text/format.js";
import { t } from "../text/language.js";
import { arrange, button, h, setAttr } from "../ui/dom.js";
import { numberField, Undo } from "./values.js";

/** Variables shown at once. */
const SHOWN = 50;
/** Variables of one request, when only those with a value are shown. */
const READ_MAX = 1000;

/** @type {import("./values.js").Section} */
export const variables = {
  title: t("variables.variables"),
  create(app) {
    /** @type {"p" | "q"} */
    let kind = "p";
    /** Values with their source: rows always refer to these variables, regardless of a later selection. @type {{ cs: number, kind: "p" | "q", values: [number, import("../types.d.ts").Number][] }} */
    let known = { cs: app.model.selected, kind, values: [] };
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
      const [cs, of] = [app.model.selected, kind];
      const first = Math.max(0, Math.floor(Number(from.value) || 0));
      const onlyUsed = used.getAttribute("aria-checked") === "true";
      await app.attempt(async () => {
        const all = await app.api.variables(cs, of, first, onlyUsed ? READ_MAX : SHOWN);
        const numbered = all.map((value, at) => /** @type {[number, import("../types.d.ts").Number]} */ ([first + at, value]));
        const values = onlyUsed ? numbered.filter(([, value]) => value !== 0).slice(0, SHOWN * 4) : numbered;
        if (cs === app.model.selected && of === kind) known = { cs, kind: of, values };
      });
      app.invalidate();
    };
    from.addEventListener("change", () => void read());
    const undo = new Undo(app, () => void read());
    const body = h("div", { class: "variable-rows" });
    const again = button({ class: "button small", onclick: () => void read() }, t("common.read_again"));

    /** @param {number} cs @param {"p" | "q"} of @param {number} number */
    const row = (cs, of, number) => {
      const name = `${of.toUpperCase()}${number}`;
      /** @type {import("../types.d.ts").Number} */
      let value = 0;
      const field = numberField(app, name, (to) => {
        const before = value;
        const set = (/** @type {import("../types.d.ts").Number} */ one) => () => app.api.setVariables(cs, of, number, [one]);
        void undo.do(t("variables.was", { name, value: typeof before === "number" ? plain(before) : before }), set(to), set(before));
      });
      const show = (/** @type {import("../types.d.ts").Number} */ now) => {
        value = now;
        field.show(typeof value === "number" ? plain(value) : value);
      };
      return { element: h("div", { class: "variable-row" }, h("strong", {}, name), field.element), show };
    };
    /** Rows by variable: typed text remains when the values are read again. @type {Map<string, ReturnType<typeof row>>} */
    let rows = new Map();
    const none = h("p", { class: "empty" }, t("variables.none_of_these_has_a"));
    const render = () => {
      const { cs, kind: of, values } = known;
      const key = JSON.stringify(known);
      if (key !== shown) {
        shown = key;
        const before = rows;
        rows = new Map();
        for (const [number, value] of values) {
          const place = `${cs} ${of} ${number}`;
          const one = before.get(place) ?? row(cs, of, number);
          one.show(value);
          rows.set(place, one);
        }
        arrange(body, ...(values.length > 0 ? [...rows.values()].map(({ element }) => element) : [none]));
      }
      const why = whyNotNow(app.model, "set");
      for (const one of body.querySelectorAll("input")) disableFor(one, why);
      undo.render();
    };
    const choices = h("div", { class: "choice" }, h("div", { class: "row", role: "radiogroup", "aria-label": t("variables.kind_of_variable") }, ...kinds), h("span", { class: "label" }, t("variables.from")), from, used);
    return { element: h("div", { class: "variables" }, choices, body, h("div", { class: "row end" }, undo.element, again)), render, read: () => void read() };
  },
};
