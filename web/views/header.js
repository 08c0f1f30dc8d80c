// Machine name, one tab for each coordinate system with its state, connection, colour scheme.

import { userButton } from "../access/user.js";
import { showShortcuts, toggleFar } from "../app/shortcuts.js";
import { theme, toggleTheme } from "../app/theme.js";
import { openHistory } from "../history/dialog.js";
import { look } from "../machine/sentence.js";
import { t } from "../text/language.js";
import { chosenUnits, handUnitOf, lengthScale, nextUnits, unitOf } from "../text/units.js";
import { button, fill, h, setAttr, setText } from "../ui/dom.js";
import { icon, setIcon } from "../ui/icons.js";

/** @type {import("../main.js").View} */
export const header = {
  place: "header",
  create(app) {
    const machine = h("span", { class: "machine" }, "Tandem");
    const tabs = h("div", { class: "tabs", role: "tablist", "aria-label": t("header.coordinate_systems") });
    const linkIcon = icon("unlink");
    const linkText = h("span", {}, t("header.connecting"));
    const link = h("span", { class: "link" }, linkIcon, linkText);
    const onclick = () => {
      toggleTheme();
      app.invalidate();
    };
    const themeButton = button({ class: "icon-button theme", onclick }, icon("theme"));
    const onUnits = () => {
      nextUnits();
      app.invalidate();
    };
    const unitsButton = button({ class: "icon-button units", onclick: onUnits });
    const farButton = button({ class: "icon-button", "aria-label": t("header.read_from_three_metres"), title: t("header.read_from_three_metres_key"), onclick: () => toggleFar(app) }, icon("far"));
    const historyButton = button({ class: "icon-button", "aria-label": t("header.history"), title: t("header.history_key"), onclick: () => openHistory(app) }, icon("history"));
    const helpButton = button({ class: "icon-button help", "aria-label": t("header.shortcuts"), title: t("header.shortcuts_key"), onclick: showShortcuts }, "?");
    const user = userButton(app);
    /** @type {Map<number, ReturnType<typeof tab>>} */
    let shown = new Map();

    /** @param {KeyboardEvent} event */
    const move = (event) => {
      const numbers = [...shown.keys()];
      const at = numbers.indexOf(app.model.selected);
      const step = { ArrowRight: at + 1, ArrowLeft: at - 1, Home: 0, End: numbers.length - 1 }[event.key];
      if (step === undefined) return;
      event.preventDefault();
      const next = numbers[(step + numbers.length) % numbers.length];
      if (next === undefined) return;
      app.select(next);
      shown.get(next)?.element.focus();
    };
    tabs.addEventListener("keydown", move);

    const render = () => {
      const { model } = app;
      setText(machine, model.birth?.machine ?? "Tandem");
      if ([...shown.keys()].join() !== [...model.systems.keys()].join()) {
        shown = new Map([...model.systems.keys()].map((cs) => [cs, tab(cs, () => app.select(cs))]));
        fill(tabs, ...[...shown.values()].map((t) => t.element));
      }
      for (const [cs, one] of shown) one.render(model, cs === model.selected);
      setIcon(linkIcon, model.online ? "link" : "unlink");
      setText(linkText, model.online ? t("header.connected") : t("header.not_connected"));
      setAttr(link, "data-online", String(model.online));
      user.render();
      const { unit } = lengthScale(unitOf(model.current));
      setText(unitsButton, unit);
      const says = chosenUnits() === "auto" ? t("header.units_of_program", { unit, hand: lengthScale(handUnitOf(model.current)).unit }) : t("header.units", { unit });
      setAttr(unitsButton, "aria-label", says);
      setAttr(unitsButton, "title", says);
      setAttr(unitsButton, "data-chosen", chosenUnits() !== "auto");
      setAttr(themeButton, "aria-label", theme() === "dark" ? t("header.use_light_colours") : t("header.use_dark_colours"));
    };
    return { element: h("div", { class: "bar" }, machine, tabs, h("span", { class: "spring" }), link, h("div", { class: "bar-tools" }, user.element, historyButton, unitsButton, farButton, themeButton, helpButton)), render };
  },
};

/** @param {number} cs @param {() => void} select */
function tab(cs, select) {
  const sign = icon("ready");
  const word = h("span", { class: "tab-word" });
  const count = h("span", {});
  const unit = h("span", { class: "tab-unit" });
  const alarms = h("span", { class: "tab-alarms" }, count, unit);
  const element = button(
    { class: "tab", role: "tab", id: `tab-${cs}`, "aria-controls": "panel", onclick: select },
    h("span", { class: "tab-name" }, t("common.cs", { cs })),
    h("span", { class: "badge" }, sign, word),
    alarms,
  );
  return {
    element,
    /** @param {import("../machine/model.js").Model} model @param {boolean} selected */
    render(model, selected) {
      setAttr(element, "aria-selected", String(selected));
      setAttr(element, "tabindex", selected ? "0" : "-1");
      const state = model.systems.get(cs)?.state;
      const { tone, icon: name, word: text } = state ? look(state, model.systems.get(cs)?.pending?.outputs) : { tone: "ready", icon: "ready", word: "…" };
      setAttr(element, "data-tone", tone);
      setIcon(sign, name);
      setText(word, text);
      const active = state?.alarm_count ?? 0;
      setText(count, String(active));
      setText(unit, `\u00a0${t("header.alarms", { count: active })}`);
      setAttr(alarms, "hidden", active === 0);
      setAttr(element, "title", t("header.coordinate_system", { cs, text }));
    },
  };
}
