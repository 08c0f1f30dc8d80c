// Feedrate and spindle speed, and the overrides.

import { disableFor, whyNotNow } from "../access/why_not.js";
import { position, whole } from "../text/format.js";
import { t } from "../text/language.js";
import { lengthScale, unitOf } from "../text/units.js";
import { button, card, h, setAttr, setText } from "../ui/dom.js";
import { OverrideSlider } from "../ui/override_slider.js";

/** Time between two settings while a slider is dragged, ms. */
const SEND_MS = 120;
/** After a change by the operator the slider shows that value for this long, until the machine reports it, ms. */
const OWN_MS = 1500;

/** @type {import("../main.js").View} */
export const feed = {
  place: "left",
  create(app) {
    const feedrate = h("output", { class: "big" });
    const programmed = h("span", { class: "small" });
    const feedUnit = h("span", { class: "unit" });
    const speed = h("output", { class: "big" });
    const commanded = h("span", { class: "small" });
    const spindleBox = h("div", { class: "reading" }, h("span", { class: "label" }, t("feed.spindle")), h("div", {}, speed, h("span", { class: "unit" }, t("unit.rpm"))), commanded);
    const readings = h(
      "div",
      { class: "readings" },
      h("div", { class: "reading" }, h("span", { class: "label" }, t("feed.feedrate")), h("div", {}, feedrate, feedUnit), programmed),
      spindleBox,
    );
    const sliders = [override(app, "feed", t("feed.feed"), 200), override(app, "rapid", t("feed.rapid"), 100), override(app, "spindle", t("feed.spindle"), 200)];
    const render = () => {
      const system = app.model.current;
      const scale = lengthScale(unitOf(system));
      const feedOf = (/** @type {number | undefined} */ mm) => (scale.size === 1 ? whole(mm) : position(mm, { ...scale, decimals: 1 }));
      setText(feedUnit, `${scale.unit}/min`);
      setText(feedrate, feedOf(system?.position?.feedrate));
      setText(programmed, system?.modal ? `F ${feedOf(system.modal.f)}` : "");
      setText(speed, whole(system?.position?.spindle_rpm));
      setText(commanded, system?.modal ? `S ${whole(system.modal.s)}` : "");
      setAttr(spindleBox, "hidden", system !== null && system.info.spindle === null);
      for (const slider of sliders) slider.render();
    };
    return { element: card("feed-card", t("feed.feed_and_speed"), [], readings, ...sliders.map((s) => s.element)), render };
  },
};

/**
 * @param {import("../main.js").App} app
 * @param {"feed" | "rapid" | "spindle"} which
 * @param {string} label
 * @param {number} max percent
 */
function override(app, which, label, max) {
  const slider = new OverrideSlider(t("feed.override_percent", { label }), max, (percent) => set(percent));
  const value = h("output", { class: "override-value" });
  let ownUntil = 0;
  let ownCs = 0;
  let timer = 0;

  /** @param {number} percent */
  const set = (percent) => {
    slider.show(percent);
    ownUntil = Date.now() + OWN_MS;
    const cs = app.model.selected;
    ownCs = cs;
    clearTimeout(timer);
    timer = window.setTimeout(() => {
      void app.attempt(() => app.api.setOverrides(cs, { [which]: percent })).then((done) => {
        if (!done) ownUntil = 0;
        app.invalidate();
      });
    }, SEND_MS);
    app.invalidate();
  };
  const key = (/** @type {string} */ text, /** @type {string} */ says, /** @type {() => void} */ onclick) =>
    button({ class: "button small", "aria-label": t("feed.override", { label, change: says }), onclick }, text);
  const element = h(
    "div",
    { class: "override" },
    h("span", { class: "label" }, label),
    key("−", t("feed.10_percent_less"), () => slider.step(-10)),
    slider.element,
    key("+", t("feed.10_percent_more"), () => slider.step(10)),
    button({ class: "button small value", "aria-label": t("feed.override_100_percent", { label }), title: t("feed.set_to_100_percent"), onclick: () => set(100) }, value),
  );
  const render = () => {
    const system = app.model.current;
    const percent = system?.overrides?.[which];
    if (percent !== undefined && (Date.now() > ownUntil || ownCs !== app.model.selected)) slider.show(percent);
    setText(value, percent === undefined ? "–" : `${Math.round(slider.value)} %`);
    setAttr(value, "data-changed", percent !== undefined && slider.value !== 100);
    setAttr(slider.input, "aria-valuetext", t("feed.percent", { percent: slider.value }));
    setAttr(element, "hidden", which === "spindle" && system !== null && system.info.spindle === null);
    disableFor(slider.input, whyNotNow(app.model));
  };
  return { element, render };
}
