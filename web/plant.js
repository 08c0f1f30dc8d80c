// Inputs and outputs of the plant, as the machine declares and tells them.

import { plain } from "./format.js";
import { t } from "./language.js";

/**
 * One of them.
 * @typedef {object} Point
 * @property {"in" | "out"} side
 * @property {string} name
 * @property {`io/in/${string}` | `io/out/${string}`} topic
 * @property {import("./types.d.ts").IoDeclaration} declared
 */

/** All of them: inputs, then outputs, by name. @param {import("./model.js").Model} model @returns {Point[]} */
export function pointsOf({ birth }) {
  /** @type {("in" | "out")[]} */
  const sides = ["in", "out"];
  return sides.flatMap((side) => Object.entries(birth?.io?.[side] ?? {}).map(([name, declared]) => ({ side, name, topic: /** @type {Point["topic"]} */ (`io/${side}/${name}`), declared })));
}

/** Returns the known state of an input or output. @param {import("./model.js").Model} model @param {Point} point */
export function ioOf(model, point) {
  return model.io.get(point.topic) ?? null;
}

/** Those that are forced. @param {import("./model.js").Model} model */
export function forcedOf(model) {
  return pointsOf(model).filter((point) => ioOf(model, point)?.forced);
}

/** Returns its name for people. @param {Point} point */
export function nameOf({ name, declared }) {
  return declared.text || name;
}

/** @param {Point} point @param {boolean | number} value */
export function valueText({ declared }, value) {
  if (typeof value === "boolean") return value ? t("card.on") : t("card.off");
  return `${plain(value)} ${declared.unit ?? ""}`.trim();
}
