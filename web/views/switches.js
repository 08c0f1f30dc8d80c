// Inputs of the operator: single block, optional stop, block skip 1 to 9, and the locks.

import { disableFor, whyNotNow } from "../access/why_not.js";
import { dialect, OPTIONAL_SKIPS_MAX } from "../dialects/dialects.js";
import { switchLock } from "../inputs/locks.js";
import { t } from "../text/language.js";
import { button, h, setAttr } from "../ui/dom.js";

/** @type {import("../main.js").View} */
export const switches = {
  place: "footer",
  create(app) {
    const optionalStop = toggle(app, "optional_stop", t("switches.opt_stop"), t("switches.optional_stop"), (cs) => cs.optionalStop?.value ?? cs.state?.optional_stop);
    const singleBlock = toggle(app, "single_block", t("switches.single"), t("switches.single_block"), (cs) => cs.singleBlock?.value ?? cs.state?.single_block);
    const skips = Array.from({ length: OPTIONAL_SKIPS_MAX }, (_, i) => i + 1).map((number) =>
      toggle(app, `optional_skip/${number}`, `/${number}`, t("switches.skip", { number }), (cs) =>
        (cs.optionalSkip?.requested ?? cs.state?.optional_skip)?.includes(number),
      ),
    );
    const all = [singleBlock, optionalStop, ...skips];
    const element = h(
      "div",
      { class: "switches" },
      h("div", { class: "row", role: "group", "aria-label": t("switches.stops") }, singleBlock.element, optionalStop.element),
      h("div", { class: "skips", role: "group", "aria-label": t("switches.block_skip") }, ...skips.map((s) => s.element)),
    );
    const render = () => {
      const most = dialect(app.model.current?.info.dialect).optionalSkips;
      skips.forEach((skip, i) => setAttr(skip.element, "hidden", i >= most));
      for (const one of all) one.render();
    };
    return { element, render };
  },
};

/**
 * A lock that this screen can switch; it also shows the sources of other clients.
 * @param {import("../main.js").App} app
 * @param {"interlock" | "start_lock"} input
 * @param {string} says
 */
export function lockSwitch(app, input, says) {
  const field = input === "interlock" ? "interlock" : "startLock";
  return switchButton(app, says, says, (cs) => cs[field]?.value, (cs, value) => switchLock(app, cs, input, value));
}

/** Blocks that are interpreted now move at the dry run feedrate. @param {import("../main.js").App} app */
export function dryRunSwitch(app) {
  return toggle(app, "dry_run", t("switches.dry_run"), t("switches.dry_run"), (cs) => cs.state?.dry_run);
}

/**
 * @param {import("../main.js").App} app
 * @param {string} input
 * @param {string} text
 * @param {string} says
 * @param {(cs: import("../machine/model.js").CoordinateSystem) => boolean | undefined} value
 */
function toggle(app, input, text, says, value) {
  return switchButton(app, text, says, value, (cs, next) => app.api.setInput(cs, input, next));
}

/**
 * @param {import("../main.js").App} app
 * @param {string} text
 * @param {string} says
 * @param {(cs: import("../machine/model.js").CoordinateSystem) => boolean | undefined} value
 * @param {(cs: number, value: boolean) => Promise<void>} set
 */
function switchButton(app, text, says, value, set) {
  const isOn = () => (app.model.current ? (value(app.model.current) ?? false) : false);
  const onclick = () => {
    const cs = app.model.selected;
    const next = !isOn();
    return app.attempt(() => set(cs, next));
  };
  const element = button({ class: "switch", role: "switch", "aria-label": says, onclick }, text);
  const render = () => {
    setAttr(element, "aria-checked", String(isOn()));
    disableFor(element, whyNotNow(app.model), says);
  };
  return { element, render };
}
