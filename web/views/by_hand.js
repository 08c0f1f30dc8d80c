// Motion by hand: a cross of jog buttons with their speed and step, homing, a line of NC text, back trace; dry run, the locks
// and the control lease.

import { leaseButton } from "../access/lease.js";
import { disableFor, whyNot } from "../access/why_not.js";
import { notHomed } from "../by_hand/homed.js";
import { jogButton } from "../by_hand/jog.js";
import { JogChoices } from "../by_hand/jog_choice.js";
import { mdiLine } from "../by_hand/mdi.js";
import { Pad } from "../by_hand/pad.js";
import { forcedNote } from "../inputs/locks.js";
import { explained } from "../machine/explain.js";
import { axesOf } from "../machine/model.js";
import { t } from "../text/language.js";
import { handUnitOf, isRotary } from "../text/units.js";
import { button, fill, h, setAttr, setText } from "../ui/dom.js";
import { icon } from "../ui/icons.js";
import { dryRunSwitch, lockSwitch } from "./switches.js";

/** Buttons of the cross: axis, direction, column and row. @type {[number, 1 | -1, number, number][]} */
const CROSS = [[1, 1, 2, 1], [0, -1, 1, 2], [0, 1, 3, 2], [1, -1, 2, 3], [2, 1, 4, 1], [2, -1, 4, 3]];

/** @type {import("../main.js").View} */
export const byHand = {
  place: "right",
  panel: { name: "by-hand", title: t("by_hand.by_hand") },
  create(app) {
    const lengths = new JogChoices("mm");
    const turns = new JogChoices("degrees");
    const chosen = (/** @type {string} */ axis) => (isRotary(app.model, axis) ? turns : lengths).chosen();
    const jogs = h("div", { class: "jog-cross", role: "group", "aria-label": t("by_hand.jog") });
    const more = h("div", { class: "jog-more", role: "group", "aria-label": t("by_hand.jog_further_axes") });
    const homes = h("div", { class: "homes", role: "group", "aria-label": t("by_hand.home") });
    /** Letters of the cross. @type {string[]} */
    let cross = [];
    const pad = new Pad(app, (at, direction) => {
      const axis = cross[at];
      if (axis) app.jogger.begin(axis, direction, chosen(axis));
    });
    const keys = button({ class: "switch keys", role: "switch", "aria-label": t("by_hand.jog_by_keyboard_and_gamepad"), onclick: () => pad.set(!pad.on) }, t("by_hand.keys"));
    const padNote = h("p", { class: "muted pad-note", role: "status" });
    const unhomed = h("span", { class: "grow" });
    const homedNote = h("div", { class: "row homed-note", role: "status", "data-tone": "attention" }, icon("alarm"), unhomed, explained("alarm 208"));
    const mdi = mdiLine(app);
    const back = backButton(app);
    const lease = leaseButton(app);
    const switches = [dryRunSwitch(app), lockSwitch(app, "interlock", t("by_hand.interlock")), lockSwitch(app, "start_lock", t("locks.start_lock"))];
    const forced = forcedNote(app);
    const element = h(
      "div",
      { class: "by-hand" },
      jogs,
      padNote,
      more,
      ...lengths.elements,
      ...turns.elements,
      homes,
      homedNote,
      mdi.element,
      h("div", { class: "by-hand-foot" }, back.element, lease.element),
      h("div", { class: "by-hand-foot" }, ...switches.map((one) => one.element)),
      forced.element,
    );
    /** @type {{render: () => void}[]} */
    let parts = [];
    let shown = "";

    const build = () => {
      const letters = app.model.current ? axesOf(app.model.current) : [];
      app.jogger.leave();
      cross = [..."XYZ"].map((letter) => (letters.includes(letter) ? letter : ""));
      const placed = CROSS.filter(([at]) => cross[at]).map(([at, direction, column, row]) => {
        const made = jogButton(app, cross[at] ?? "", direction, chosen);
        made.element.classList.add(`at-${column}-${row}`);
        return made;
      });
      const rest = letters.filter((letter) => !cross.includes(letter));
      const pairs = rest.map((axis) => [jogButton(app, axis, -1, chosen), jogButton(app, axis, 1, chosen)]);
      const home = [homeButton(app, null), ...letters.map((axis) => homeButton(app, axis))];
      fill(jogs, ...placed.map((one) => one.element), keys);
      fill(more, ...pairs.map((pair) => h("div", { class: "jog-pair" }, ...pair.map((one) => one.element))));
      fill(homes, ...home.map((one) => one.element));
      parts = [...placed, ...pairs.flat(), ...home];
    };
    const render = () => {
      const system = app.model.current;
      const key = `${app.model.selected} ${Object.keys(system?.info.axes ?? {}).join("")}`;
      if (key !== shown) {
        shown = key;
        build();
      }
      if (app.model.panel !== "by-hand") pad.set(false);
      const letters = Object.keys(system?.info.axes ?? {});
      const rotary = letters.filter((axis) => isRotary(app.model, axis));
      lengths.render(handUnitOf(system), letters.length === 0 || rotary.length < letters.length);
      turns.render("degrees", rotary.length > 0);
      setAttr(keys, "aria-checked", String(pad.on));
      disableFor(keys, pad.on ? null : whyNot(app.model, "jog"), t("by_hand.arrows_and_page_up_and"));
      setText(padNote, !pad.on ? "" : pad.names[0] ? t("by_hand.keys_and_pad", { pad: pad.names[0] }) : t("by_hand.keys_jog"));
      setAttr(padNote, "hidden", !pad.on);
      for (const one of parts) one.render();
      setText(unhomed, notHomed(system));
      setAttr(homedNote, "hidden", unhomed.textContent === "");
      mdi.render(whyNot(app.model, "mdi"));
      for (const one of [back, lease, ...switches, forced]) one.render();
    };
    return { element, render };
  },
};

/** @param {import("../main.js").App} app @param {string | null} axis null: all axes */
function homeButton(app, axis) {
  const says = axis === null ? t("by_hand.home_all_axes") : t("by_hand.home_axis", { axis });
  const onclick = () => app.command("home", axis === null ? {} : { axes: [axis] });
  const element = button({ class: "button home", "aria-label": says, onclick }, icon("home"), axis ?? t("by_hand.all"));
  return { element, render: () => disableFor(element, whyNot(app.model, "home"), says) };
}

/** Moves backward along the path from a feed hold. @param {import("../main.js").App} app */
function backButton(app) {
  const title = t("by_hand.from_a_feed_hold_back");
  const element = button({ onclick: () => app.command("back_trace", { on: true }) }, icon("back"), t("by_hand.back_trace"));
  const render = () => {
    const isAtEnd = app.model.current?.state?.reason === "BACK_TRACE_END";
    disableFor(element, isAtEnd ? t("by_hand.the_way_back_ends_here") : whyNot(app.model, "back_trace"), title);
  };
  return { element, render };
}
