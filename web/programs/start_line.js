// Start from a line: modal state there, the steps before the start, and the order of the axes. The start requires the
// operator's confirmation.

import { disableFor, whyNot } from "../access/why_not.js";
import { params, plain, position, programName } from "../text/format.js";
import { listed, t } from "../text/language.js";
import { lengthScale, scaleOf, unitOf } from "../text/units.js";
import { openDialog } from "../ui/dialog.js";
import { button, fill, h, setAttr } from "../ui/dom.js";
import { acceptsRisks } from "./start_risks.js";

/** @typedef {import("../machine/api.js").LineStart} LineStart */
/** @typedef {import("../types.d.ts").LineState} LineState */

/** Orders of the axes, and their names. */
const APPROACHES = { plane_first: t("start_line.in_the_plane_first_then"), infeed_first: t("start_line.the_infeed_axis_first"), direct: t("start_line.all_axes_at_once") };

/**
 * The block in which the last run of the loaded program was cut short; null if the run was completed, or if there was no run.
 * @param {import("../machine/model.js").CoordinateSystem | null} system @returns {{program: number, line: number} | null}
 */
export function cutShortAt(system) {
  const run = system?.runState?.run;
  return run?.program === system?.state?.program ? (run?.end?.place ?? null) : null;
}

/** The order chosen last. @type {keyof typeof APPROACHES} */
let approach = "plane_first";

/**
 * Shows the effects of a start from a line, and starts after the confirmation.
 * @param {import("../main.js").App} app
 * @param {{line: number, program: number}} place
 */
export function openLineStart(app, { line, program }) {
  const { model } = app;
  const cs = model.selected;
  const seen = { boot_id: model.bootId, state_rev: model.current?.state?.rev };
  const main = model.current?.state?.program ?? null;
  /** @type {LineStart} */
  const from = { from_line: line, approach, ...(program === main ? {} : { program }) };

  const found = h("div", { class: "scroll line-state" }, h("p", { class: "muted" }, t("start_line.the_program_is_read_as")));
  const occurrence = h("input", { class: "input", type: "number", min: 1, step: 1, inputmode: "numeric" });
  const which = h("label", { class: "choice", hidden: true }, t("start_line.which_time_the_program_comes"), occurrence);
  const order = h("select", { class: "input", "aria-label": t("start_line.order_of_the_axes") }, ...Object.entries(APPROACHES).map(([value, name]) => h("option", { value, selected: value === approach }, name)));
  const start = button({ class: "button start", disabled: true, onclick: () => dialog.close("start") }, t("start_line.title", { line }));
  const cut = cutShortAt(model.current);
  const isThere = cut?.line === line && cut.program === program;
  const there = cut && !isThere && button({ onclick: () => {
    dialog.close("");
    openLineStart(app, cut);
  } }, t("start_line.where_cut_short", { line: cut.line }));
  const leave = button({ autofocus: true, onclick: () => dialog.close("") }, t("lease.leave_it"));

  let asked = 0;
  const ask = async () => {
    const number = ++asked;
    start.disabled = true;
    try {
      const state = await app.api.lineState(cs, from);
      if (number !== asked) return;
      fill(found, ...tables(state, model));
      disableFor(start, whyNot(app.model, "start"));
    } catch (error) {
      if (number !== asked) return;
      const text = error instanceof Error ? error.message : String(error);
      fill(found, h("p", { class: "error" }, text));
      if (text.includes("occurrence")) setAttr(which, "hidden", false);
    }
  };
  order.addEventListener("change", () => {
    approach = /** @type {keyof typeof APPROACHES} */ (order.value);
    from.approach = approach;
    void ask();
  });
  occurrence.addEventListener("change", () => {
    const chosen = Number(occurrence.value);
    if (chosen >= 1) from.occurrence = chosen;
    else delete from.occurrence;
    void ask();
  });

  const startAfterQuestion = async () => {
    if (await acceptsRisks(app)) await app.api.command(cs, "start", from, seen);
  };
  const children = [isThere ? h("p", { class: "muted" }, t("start_line.is_cut_short")) : null, found, h("div", { class: "row" }, which, h("label", { class: "choice" }, t("start_line.the_axes_go_there"), order)), h("div", { class: "row end wrap" }, there, leave, start)];
  const dialog = openDialog("line-start", program === main ? t("start_line.title", { line }) : t("start_line.title_of", { line, program: programName(program) }), children, (answer) => {
    if (answer === "start") void app.attempt(startAfterQuestion);
  });
  void ask();
}

/** @param {LineState} state @param {import("../machine/model.js").Model} model */
function tables(state, model) {
  const { modal } = state;
  const lengths = lengthScale(unitOf(model.current));
  const axes = Object.entries(state.work).map(([axis, at]) => {
    const scale = scaleOf(model, axis);
    return [axis, position(at, scale), position(state.machine[axis] ?? 0, scale), scale.unit];
  });
  const goesTo = (/** @type {string} */ axis, /** @type {number} */ at) => `${axis} ${position(at, scaleOf(model, axis))} ${scaleOf(model, axis).unit}`;
  const calls = listed(state.stack.map((call) => t("common.program_line", { program: programName(call.program), line: call.line })));
  const variables = listed(Object.entries(state.variables).map(([name, value]) => `${name} = ${plain(value)}`));
  const approach = state.approach.map((step) => Object.entries(step).map(([axis, at]) => goesTo(axis, at)).join(", ")).join(t("start_line.then"));
  /** @type {[string, string][]} */
  const facts = [
    [t("start_line.codes"), Object.values(modal.g).join(" ")],
    ["F, S", `${plain(modal.f / lengths.size)} ${lengths.unit}/min / ${plain(modal.s)} ${t("unit.rpm")}`],
    [t("start_line.tool"), modal.tool === null || modal.tool === undefined ? t("start_line.not_known") : String(modal.tool)],
    [t("start_line.put_out_before"), listed(state.restore.map(words)) || t("start_line.nothing")],
    [t("start_line.axes_go_machine"), approach || t("start_line.they_stand_there")],
  ];
  if (calls) facts.push([t("start_line.called_by"), calls]);
  if (variables) facts.push([t("start_line.variables_set"), variables]);
  return [
    h("p", {}, h("code", {}, state.block)),
    table(["", t("start_line.work"), t("start_line.machine"), ""], axes),
    h("dl", { class: "facts" }, ...facts.flatMap(([name, value]) => [h("dt", {}, name), h("dd", {}, value)])),
    state.not_restored.length > 0 ? h("p", { class: "warning" }, t("start_line.not_restored", { count: state.not_restored.length, codes: listed(state.not_restored.map(words)) })) : null,
  ];
}

/** @param {import("../types.d.ts").RestoredOutput} output */
function words({ m, params: given, line }) {
  return t("start_line.code_in", { code: [`M${String(m).padStart(2, "0")}`, params(given)].filter(Boolean).join(" "), line });
}

/** @param {string[]} names @param {string[][]} rows */
function table(names, rows) {
  const cells = (/** @type {string[]} */ [first, ...rest]) => [h("th", { scope: "row" }, first ?? ""), ...rest.map((cell) => h("td", {}, cell))];
  const head = h("thead", {}, h("tr", {}, ...names.map((name) => h("th", { scope: "col" }, name))));
  return h("table", { class: "rehearsal-table" }, head, h("tbody", {}, ...rows.map((row) => h("tr", {}, ...cells(row)))));
}
