// Resolves names used by the machine builder's buttons and cards: coordinate systems, inputs, variables, pictures.

import { h } from "../ui/dom.js";

/** @typedef {import("../machine/model.js").Model} Model */

/**
 * Returns the model as if this coordinate system were selected; without a number, the selected one.
 * @param {Model} model @param {number | undefined} cs
 * @returns {Pick<Model, "online" | "user" | "viewing" | "selected" | "current" | "variables">}
 */
export function seenFrom(model, cs) {
  if (cs === undefined) return model;
  const { online, user, viewing, variables } = model;
  return { online, user, viewing, variables, selected: cs, current: model.systems.get(cs) ?? null };
}

/** Returns whether an input is on; null if unknown. @param {import("../machine/model.js").CoordinateSystem | null} system @param {string} name */
export function inputOf(system, name) {
  const skip = /^optional_skip\/(\d+)$/.exec(name);
  if (skip) return system?.optionalSkip?.requested.includes(Number(skip[1])) ?? null;
  if (name === "dry_run") return system?.state?.dry_run ?? null;
  const fields = { optional_stop: system?.optionalStop, single_block: system?.singleBlock, interlock: system?.interlock, start_lock: system?.startLock };
  return fields[/** @type {keyof typeof fields} */ (name)]?.value ?? null;
}

/** Kind and number of a variable, such as `P100`. @param {string} name */
export function variableOf(name) {
  return { kind: /** @type {"p" | "q"} */ (name.charAt(0).toLowerCase()), number: Number(name.slice(1)) };
}

/**
 * Returns the published value of a variable; undefined if the machine does not publish it.
 * @param {Pick<Model, "variables" | "current">} seen @param {string} name
 */
export function publishedValue({ variables, current }, name) {
  const { kind, number } = variableOf(name);
  const published = (kind === "p" ? variables : current?.variables)?.variables ?? [];
  const row = published.find(({ from, values }) => from <= number && number < from + values.length);
  return row?.values[number - row.from];
}

/** Returns a picture from the folder of the machine builder. @param {string | undefined} file */
export function picture(file) {
  return file !== undefined && h("img", { class: "added-icon", src: addressOf(file), alt: "" });
}

/** Returns the address of a file of the folder. @param {string} file */
export function addressOf(file) {
  return `/hmi/${file.split("/").map(encodeURIComponent).join("/")}`;
}
