// Millimetres or inches, as chosen by the operator. Without a choice, positions and related inputs use the program's
// unit (G20, G21), and motion by hand uses the machine's unit, which no program changes.

import { t } from "./language.js";

const KEY = "tandem-units";
const MM_PER_INCH = 25.4;
const CHOICES = /** @type {const} */ (["auto", "mm", "inch"]);

/** @typedef {"mm" | "inch"} Unit */

/**
 * A unit of numbers: its name, its size in mm or degrees, and its decimals.
 * @typedef {{unit: string, size: number, decimals: number}} Scale
 */

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

/** The operator's choice. */
export function chosenUnits() {
  return chosen;
}

/** The unit of lengths on the screen. @param {import("../machine/model.js").CoordinateSystem | null} system @returns {Unit} */
export function unitOf(system) {
  if (chosen !== "auto") return chosen;
  return Object.values(system?.modal?.g ?? {}).includes("G20") ? "inch" : "mm";
}

/** The unit of lengths of motion by hand: without a choice that of `units` in the configuration. @param {import("../machine/model.js").CoordinateSystem | null} system @returns {Unit} */
export function handUnitOf(system) {
  if (chosen !== "auto") return chosen;
  return system?.info.units === "inch" ? "inch" : "mm";
}

/** The unit in which the next line of MDI begins; null: not known yet. @param {import("../machine/model.js").CoordinateSystem | null} system @returns {Unit | null} */
export function manualUnitOf(system) {
  const inForce = system?.modal?.mdi;
  if (!inForce) return null;
  if (inForce.includes("G20")) return "inch";
  if (inForce.includes("G21")) return "mm";
  return system.info.units === "inch" ? "inch" : "mm";
}

/** Returns whether an axis rotates. @param {import("../machine/model.js").Model} model @param {string} axis */
export function isRotary(model, axis) {
  const motor = model.birth?.motors.find((one) => one.number === model.current?.info.axes[axis]);
  return motor?.kind === "rotary";
}

/**
 * Returns the scale of an axis, for showing and reading its lengths.
 * @param {import("../machine/model.js").Model} model @param {string} axis @returns {Scale}
 */
export function scaleOf(model, axis) {
  return isRotary(model, axis) ? degrees() : lengthScale(unitOf(model.current));
}

/** Degrees. @returns {Scale} */
export function degrees() {
  return { unit: t("unit.deg"), size: 1, decimals: 3 };
}

/** Returns the scale of any length. @param {Unit} unit @returns {Scale} */
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
