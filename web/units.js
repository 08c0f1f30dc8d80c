// Millimetres or inches on the whole screen: as the program has it in force (G20, G21), unless the operator chooses.

import { t } from "./language.js";

const KEY = "tandem-units";
const MM_PER_INCH = 25.4;
const CHOICES = /** @type {const} */ (["auto", "mm", "inch"]);

/** @typedef {"mm" | "inch"} Unit */

/** @type {(typeof CHOICES)[number]} */
let chosen = stored();

/** The next choice: as the program, mm, inches. */
export function nextUnits() {
  chosen = CHOICES[(CHOICES.indexOf(chosen) + 1) % CHOICES.length] ?? "auto";
  try {
    localStorage.setItem(KEY, chosen);
  } catch {
    // without storage the choice lasts until the page is closed
  }
}

/** What is chosen. */
export function chosenUnits() {
  return chosen;
}

/** The unit of lengths on the screen. @param {import("./model.js").CoordinateSystem | null} system @returns {Unit} */
export function unitOf(system) {
  if (chosen !== "auto") return chosen;
  return Object.values(system?.modal?.g ?? {}).includes("G20") ? "inch" : "mm";
}

/** Whether an axis turns. @param {import("./model.js").Model} model @param {string} axis */
export function isRotary(model, axis) {
  const motor = model.birth?.motors.find((one) => one.number === model.current?.info.axes[axis]);
  return motor?.kind === "rotary";
}

/**
 * How lengths of an axis are shown and read: its unit, mm or degrees in one of it, and decimals.
 * @param {import("./model.js").Model} model @param {string} axis
 */
export function scaleOf(model, axis) {
  if (isRotary(model, axis)) return { unit: t("unit.deg"), size: 1, decimals: 3 };
  return lengthScale(unitOf(model.current));
}

/** The same of any length. @param {Unit} unit */
export function lengthScale(unit) {
  return unit === "inch" ? { unit: t("unit.in"), size: MM_PER_INCH, decimals: 4 } : { unit: "mm", size: 1, decimals: 3 };
}

/** @returns {(typeof CHOICES)[number]} */
function stored() {
  try {
    const known = localStorage.getItem(KEY);
    return CHOICES.find((one) => one === known) ?? "auto";
  } catch {
    return "auto";
  }
}
