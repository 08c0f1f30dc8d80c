// Whether an axis is homed: its position counts from the machine's zero. An axis that is not homed does not move, and its position is invalid.

import { axesOf } from "../machine/model.js";
import { listed, t } from "../text/language.js";
import { h, setAttr } from "../ui/dom.js";
import { icon, setIcon } from "../ui/icons.js";

/** Returns whether an axis is homed; null if unknown. @param {import("../machine/model.js").CoordinateSystem | null} system @param {string} axis */
function isHomed(system, axis) {
  return system?.position?.homed?.[axis] ?? null;
}

/** Returns the sign of an axis, with a text for screen readers. @param {string} axis */
export function homedSign(axis) {
  const sign = icon("home");
  const element = h("span", { class: "homed-sign", role: "img" }, sign);
  /** @param {import("../machine/model.js").CoordinateSystem} system */
  const render = (system) => {
    const homed = isHomed(system, axis);
    setAttr(element, "hidden", homed === null);
    setAttr(element, "data-homed", homed === null ? null : String(homed));
    setIcon(sign, homed ? "home" : "alarm");
    const text = homed ? t("homed.is_homed", { axis }) : t("homed.is_not_homed", { axis });
    setAttr(element, "aria-label", text);
    setAttr(element, "title", text);
  };
  return { element, render };
}

/**
 * Returns a text about the axes that are not homed; empty if all are.
 * @param {import("../machine/model.js").CoordinateSystem | null} system
 */
export function notHomed(system) {
  const axes = system ? axesOf(system).filter((axis) => isHomed(system, axis) === false) : [];
  return axes.length === 0 ? "" : t("homed.home_at_the_drive", { axes: listed(axes), count: axes.length });
}
