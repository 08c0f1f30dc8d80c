// Inputs of the operator: optional stop, block skip 1 to 9.

import { h, setAttr } from "../dom.js";

/** @type {import("../main.js").View} */
export const switches = {
  place: "footer",
  create(app) {
    const optionalStop = toggle(app, "optional_stop", "Opt. stop", "Optional stop", (cs) => cs.optionalStop?.value ?? cs.state?.optional_stop);
    const skips = Array.from({ length: 9 }, (_, i) => i + 1).map((number) =>
      toggle(app, `optional_skip/${number}`, `/${number}`, `Skip blocks marked /${number}`, (cs) =>
        (cs.optionalSkip?.requested ?? cs.state?.optional_skip)?.includes(number),
      ),
    );
    const all = [optionalStop, ...skips];
    const element = h(
      "div",
      { class: "switches" },
      h("div", { class: "row", role: "group", "aria-label": "Stops" }, optionalStop.element),
      h("div", { class: "skips", role: "group", "aria-label": "Block skip" }, ...skips.map((s) => s.element)),
    );
    return { element, render: () => all.forEach((one) => one.render()) };
  },
};

/**
 * @param {import("../main.js").App} app
 * @param {string} input
 * @param {string} text
 * @param {string} says
 * @param {(cs: import("../model.js").CoordinateSystem) => boolean | undefined} value
 */
function toggle(app, input, text, says, value) {
  const element = h("button", { type: "button", class: "switch", role: "switch", "aria-label": says, title: says }, text);
  const isOn = () => (app.model.current ? (value(app.model.current) ?? false) : false);
  element.addEventListener("click", () => {
    const cs = app.model.selected;
    const next = !isOn();
    void app.attempt(() => app.api.setInput(cs, input, next));
  });
  const render = () => {
    setAttr(element, "aria-checked", String(isOn()));
    element.disabled = !app.model.online;
  };
  return { element, render };
}
