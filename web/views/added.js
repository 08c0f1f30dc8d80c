// The panel Machine: buttons and cards that the machine builder has added in the configuration; without them the panel is not shown.

import { addedButton } from "../added/button.js";
import { addedCard } from "../added/card.js";
import { t } from "../text/language.js";
import { fill, h } from "../ui/dom.js";

/** Time limit of a missing answer, ms. */
const AGAIN_MS = 3000;

/** @type {import("../main.js").View} */
export const added = {
  place: "right",
  panel: { name: "added", title: t("added.machine") },
  create(app) {
    const cards = h("div", { class: "added-cards" });
    const buttons = h("div", { class: "m-buttons", role: "group", "aria-label": t("added.machine") });
    /** @type {{element: HTMLElement, render: () => void}[]} */
    let shown = [];
    /** The boot of the configuration that is shown or requested. */
    let of = "";
    let askedAt = 0;
    const read = async () => {
      const hmi = await app.api.hmi();
      const [made, pressed] = [hmi.cards.map((card) => addedCard(app, card)), hmi.buttons.map((one) => addedButton(app, one))];
      fill(cards, ...made.map(({ element }) => element));
      fill(buttons, ...pressed.map(({ element }) => element));
      shown = [...made, ...pressed];
      app.invalidate();
    };
    const render = () => {
      const { online, bootId, panel } = app.model;
      if (online && bootId && bootId !== of && Date.now() - askedAt > AGAIN_MS) {
        of = bootId;
        askedAt = Date.now();
        // requested again later; connection problems are shown elsewhere
        void read().catch(() => (of = ""));
      }
      if (panel === "added") for (const one of shown) one.render();
    };
    return { element: h("div", { class: "added" }, cards, buttons), render, isThere: () => shown.length > 0 };
  },
};
