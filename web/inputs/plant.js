// Inputs and outputs of the plant, as the machine declares and publishes them.

import { plain } from "../text/format.js";
import { t } from "../text/language.js";

/**
 * An input or output.
 * @typedef {object} Point
 * @property {"in" | "out"} side
 * @property {string} name
 * @property {`io/in/${string}` | `io/out/${string}`} topic
 * @property {import("../types.d.ts").IoDeclaration} declared
 */

/** Returns all inputs, then all outputs, by name. @param {import("../machine/model.js").Model} model @returns {Point[]} */
export function pointsOf({ birth }) {
  /** @type {("in" | "out")[]} */
  const sides = ["in", "out"];
  return sides.flatMap((side) => Object.entries(birth?.io?.[side] ?? {}).map(([name, declared]) => ({ side, name, topic: /** @type {Point["topic"]} */ (`io/${side}/${name}`), declared })));
}

/** Returns the known state of an input or output. @param {import("../machine/model.js").Model} model @param {Point} point */
export function ioOf(model, point) {
  return model.io.get(point.topic) ?? null;
}

/** Returns the forced inputs and outputs. @param {import("../machine/model.js").Model} model */
export function forcedOf(model) {
  return pointsOf(model).filter((point) => ioOf(model, point)?.forced);
}

/** Returns the name of an input or output for people. @param {Point} point */
export function nameOf({ name, declared }) {
  return declared.text || name;
}

/** @param {Point} point @param {boolean | number} value */
export function valueText({ declared }, value) {
  if (typeof value === "boolean") return value ? t("card.on") : t("card.off");
  return `${plain(value)} ${declared.unit ?? ""}`.trim();
}
