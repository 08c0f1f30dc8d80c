// The panels at the right, one of which is shown: programs, by hand, set up.

import { t } from "../text/language.js";
import { button, h, setAttr } from "./dom.js";

export class Panels {
  #tabs = h("div", { class: "panel-tabs", role: "tablist", "aria-label": t("panels.panels") });
  element = h("section", { class: "card panels" }, this.#tabs);
  /** @type {{name: string, tab: HTMLElement, content: HTMLElement, isThere: () => boolean}[]} */
  #panels = [];

  /** @param {import("../main.js").App} app */
  constructor(app) {
    this.app = app;
    this.#tabs.addEventListener("keydown", (event) => {
      const there = this.#panels.filter(({ isThere }) => isThere());
      const at = there.findIndex(({ name }) => name === app.model.panel);
      const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
      const next = step && there[(at + step + there.length) % there.length];
      if (!next) return;
      event.preventDefault();
      app.open(next.name);
      next.tab.focus();
    });
  }

  /** @param {{name: string, title: string}} panel @param {{element: HTMLElement, isThere?: () => boolean}} made */
  add({ name, title }, { element, isThere = () => true }) {
    const tab = button({ class: "panel-tab", role: "tab", id: `panel-tab-${name}`, "aria-controls": name, onclick: () => this.app.open(name) }, title);
    const content = h("div", { id: name, class: `panel-content ${name}-panel`, role: "tabpanel", "aria-labelledby": `panel-tab-${name}` }, element);
    this.#panels.push({ name, tab, content, isThere });
    this.#tabs.append(tab);
    this.element.append(content);
  }

  render() {
    for (const { name, tab, content, isThere } of this.#panels) {
      setAttr(tab, "hidden", !isThere());
      const isShown = name === this.app.model.panel;
      setAttr(tab, "aria-selected", String(isShown));
      setAttr(tab, "tabindex", isShown ? "0" : "-1");
      setAttr(content, "hidden", !isShown);
    }
    setAttr(this.element, "data-panel", this.app.model.panel);
  }
}
