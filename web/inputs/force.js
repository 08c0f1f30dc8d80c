// Forcing an input or output of the plant: the operator sees the consequences and chooses the value.

import { t } from "../text/language.js";
import { openDialog } from "../ui/dialog.js";
import { button, h } from "../ui/dom.js";
import { ioOf, nameOf, pointsOf, valueText } from "./plant.js";

/** @typedef {import("./plant.js").Point} Point */

/** Asks for the value that replaces the written one. @param {import("../main.js").App} app @param {Point} point */
export function askToForce(app, point) {
  const force = (/** @type {boolean | number} */ value) => {
    dialog.close();
    void app.attempt(() => app.api.forceIo(point, value));
  };
  const about = t(point.side === "in" ? "plant.about_forcing_an_input" : "plant.about_forcing_an_output");
  const keep = button({ autofocus: true, onclick: () => dialog.close() }, t("locks.keep"));
  const choices = point.declared.kind === "bool" ? switches(force) : number(app, point, force);
  const dialog = openDialog("force", t("plant.force_one", { name: nameOf(point) }), [h("p", {}, about), h("div", { class: "row wrap end" }, keep, ...choices)]);
}

/** @param {(value: boolean) => void} force */
function switches(force) {
  return [button({ class: "button danger", onclick: () => force(false) }, t("plant.force_off")), button({ class: "button danger", onclick: () => force(true) }, t("plant.force_on"))];
}

/** @param {import("../main.js").App} app @param {Point} point @param {(value: number) => void} force */
function number(app, point, force) {
  const { declared } = point;
  const now = ioOf(app.model, point)?.value;
  const field = h("input", { type: "number", class: "input value", step: "any", min: declared.min, max: declared.max, value: typeof now === "number" ? now : 0, "aria-label": t("plant.value") });
  const onclick = () => {
    if (!field.reportValidity() || !Number.isFinite(field.valueAsNumber)) return;
    const unit = pointsOf(app.model).find(({ topic }) => topic === point.topic)?.declared.unit;
    if (unit === declared.unit) return force(field.valueAsNumber);
    app.toast(t("values.discarded", { field: nameOf(point), typed: field.value, before: declared.unit ?? "", unit: unit ?? "–" }), "error");
  };
  return [h("label", { class: "row" }, field, declared.unit ?? ""), button({ class: "button danger", onclick }, t("plant.force"))];
}

/** Asks whether the written value takes effect again. @param {import("../main.js").App} app @param {Point} point */
export async function askToRelease(app, point) {
  const written = ioOf(app.model, point)?.written;
  const name = nameOf(point);
  const text = t("plant.about_the_release", { value: written === undefined ? "–" : valueText(point, written) });
  const isSure = await app.confirm({ title: t("plant.release_one", { name }), text, yes: t("plant.release"), no: t("locks.keep") });
  if (isSure) await app.attempt(() => app.api.forceIo(point, null));
}
