// Motion by hand: jog buttons that act while they are held, homing, a line of NC text, back trace; dry run, the locks and
// the control lease.

import { button, card, fill, h, setAttr, setText } from "../dom.js";
import { icon } from "../icons.js";
import { JogButton } from "../jog.js";
import { leaseButton } from "../lease.js";
import { mdiLine } from "../mdi.js";
import { dryRunSwitch, lockSwitch } from "./switches.js";

/** Jog velocities to choose from, mm/min or deg/min. */
const VELOCITIES = [100, 500, 2000, 6000];
/** Distances to choose from, mm or degrees; 0: as long as the button is held. */
const WAYS = [0, 0.01, 0.1, 1, 10];

/** @type {import("../main.js").View} */
export const byHand = {
  place: "middle",
  create(app) {
    const toggle = () => {
      open = !open;
      app.invalidate();
    };
    const opener = button({ class: "button small", "aria-expanded": "false", "aria-controls": "by-hand", onclick: toggle }, "Open");
    const velocity = choice("Velocity", VELOCITIES, 500, (value) => String(value), "mm/min");
    const way = choice("Way", WAYS, 0, (value) => (value === 0 ? "held" : String(value)), "mm");
    const axes = h("div", { class: "jog-axes", role: "group", "aria-label": "Jog and home" });
    const homeAll = homeButton(app, null);
    const mdi = mdiLine(app);
    const back = backButton(app);
    const lease = leaseButton(app);
    const switches = [dryRunSwitch(app), lockSwitch(app, "interlock", "Interlock"), lockSwitch(app, "start_lock", "Start lock")];
    const content = h(
      "div",
      { id: "by-hand", class: "by-hand", hidden: true },
      mdi.element,
      h("div", { class: "jog-choices" }, velocity.element, way.element),
      axes,
      h("div", { class: "row by-hand-foot" }, homeAll, back.element, h("span", { class: "spring" }), lease.element),
      h("div", { class: "row by-hand-foot" }, ...switches.map((one) => one.element)),
    );
    const element = card("by-hand-card", "By hand", [opener], content);
    let open = false;
    /** @type {(JogButton | {render: () => void})[]} */
    let rows = [];
    let shown = "";

    const render = () => {
      const system = app.model.current;
      const letters = Object.keys(system?.info.axes ?? {});
      const key = `${app.model.selected} ${letters.join("")}`;
      if (key !== shown) {
        shown = key;
        for (const row of rows) if (row instanceof JogButton) row.end();
        const made = letters.map((axis) => jogRow(app, axis, () => ({ velocity: velocity.value(), distance: way.value() })));
        rows = made.flatMap((row) => row.parts);
        fill(axes, ...made.map((row) => row.element));
      }
      setText(opener, open ? "Close" : "Open");
      setAttr(opener, "aria-expanded", String(open));
      setAttr(element, "data-open", open);
      setAttr(content, "hidden", !open);
      for (const row of rows) row.render();
      homeAll.disabled = !app.model.movesByHand;
      mdi.render(app.model.movesByHand);
      for (const one of [back, lease, ...switches]) one.render();
    };
    return { element, render };
  },
};

/** @param {import("../main.js").App} app @param {string} axis @param {() => import("../jog.js").JogChoice} chosen */
function jogRow(app, axis, chosen) {
  const minus = new JogButton(app, axis, -1, chosen);
  const plus = new JogButton(app, axis, 1, chosen);
  const home = homeButton(app, axis);
  const homed = {
    render() {
      home.disabled = !app.model.movesByHand;
    },
  };
  const element = h("div", { class: "jog-row" }, minus.element, plus.element, home);
  return { element, parts: [minus, plus, homed] };
}

/** @param {import("../main.js").App} app @param {string | null} axis null: all axes */
function homeButton(app, axis) {
  const says = axis === null ? "Home all axes" : `Home ${axis}`;
  const onclick = () => app.command("home", axis === null ? {} : { axes: [axis] });
  return button({ "aria-label": says, title: says, onclick }, icon("home"), axis === null ? "Home all" : null);
}

/** Moves backward along the path from a feed hold. @param {import("../main.js").App} app */
function backButton(app) {
  const title = "From a feed hold back along what was passed with G500";
  const element = button({ title, onclick: () => app.command("back_trace", { on: true }) }, icon("back"), "Back trace");
  const render = () => {
    const state = app.model.current?.state;
    const isHeld = state?.execution === "FEED_HOLD" && state.reason !== "BACK_TRACE_END" && !state.transition;
    element.disabled = !app.model.online || !isHeld;
  };
  return { element, render };
}

/**
 * A few values, one of which is chosen.
 * @param {string} label
 * @param {number[]} values
 * @param {number} first
 * @param {(value: number) => string} text
 * @param {string} unit
 */
function choice(label, values, first, text, unit) {
  const select = h(
    "select",
    { "aria-label": `${label}, ${unit}` },
    ...values.map((value) => h("option", { value, selected: value === first }, value === 0 ? text(value) : `${text(value)} ${unit}`)),
  );
  return { element: h("label", { class: "choice" }, h("span", { class: "label" }, label), select), value: () => Number(select.value) };
}
