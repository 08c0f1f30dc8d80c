// Start from a line: what is in force there, what the start does before it, and the order of the axes; nothing happens before the
// operator has confirmed it.

import { button, fill, h, setAttr } from "./dom.js";
import { openDialog } from "./dialog.js";
import { params, plain, position, programName } from "./format.js";
import { disableFor, whyNot } from "./why_not.js";

/** @typedef {import("./api.js").LineStart} LineStart */
/** @typedef {import("./types.d.ts").LineState} LineState */

/** Orders of the axes, and their names. */
const APPROACHES = { plane_first: "in the plane first, then the infeed axis", infeed_first: "the infeed axis first", direct: "all axes at once" };

/** The order chosen last. @type {keyof typeof APPROACHES} */
let approach = "plane_first";

/**
 * Shows what a start from a line does, and starts when it is confirmed.
 * @param {import("./main.js").App} app
 * @param {{line: number, program: number}} place
 */
export function openLineStart(app, { line, program }) {
  const { model } = app;
  const cs = model.selected;
  const seen = { boot_id: model.bootId, state_rev: model.current?.state?.rev };
  const main = model.current?.state?.program ?? null;
  /** @type {LineStart} */
  const from = { from_line: line, approach, ...(program === main ? {} : { program }) };

  const found = h("div", { class: "scroll line-state" }, h("p", { class: "muted" }, "The program is read as far as this line…"));
  const occurrence = h("input", { class: "input", type: "number", min: 1, step: 1, inputmode: "numeric" });
  const which = h("label", { class: "choice", hidden: true }, "Which time the program comes there", occurrence);
  const order = h("select", { class: "input", "aria-label": "Order of the axes" }, ...Object.entries(APPROACHES).map(([value, name]) => h("option", { value, selected: value === approach }, name)));
  const start = button({ class: "button start", disabled: true, onclick: () => dialog.close("start") }, `Start at line ${line}`);
  const leave = button({ autofocus: true, onclick: () => dialog.close("") }, "Leave it");

  let asked = 0;
  const ask = async () => {
    const number = ++asked;
    start.disabled = true;
    try {
      const state = await app.api.lineState(cs, from);
      if (number !== asked) return;
      fill(found, ...tables(state));
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

  const place = program === main ? `line ${line}` : `line ${line} of ${programName(program)}`;
  const children = [found, h("div", { class: "row" }, which, h("label", { class: "choice" }, "The axes go there", order)), h("div", { class: "row end" }, leave, start)];
  const dialog = openDialog("line-start", `Start at ${place}`, children, (answer) => {
    if (answer === "start") void app.attempt(() => app.api.command(cs, "start", from, seen));
  });
  void ask();
}

/** @param {LineState} state */
function tables(state) {
  const { modal } = state;
  const axes = Object.entries(state.work).map(([axis, at]) => [axis, position(at), position(state.machine[axis] ?? 0)]);
  const calls = state.stack.map((call) => `${programName(call.program)} line ${call.line}`).join(", ");
  const variables = Object.entries(state.variables).map(([name, value]) => `${name} = ${plain(value)}`).join(", ");
  const approach = state.approach.map((step) => Object.entries(step).map(([axis, at]) => `${axis} ${position(at)}`).join(" ")).join(", then ");
  /** @type {[string, string][]} */
  const facts = [
    ["Codes", Object.values(modal.g).join(" ")],
    ["F, S", `${plain(modal.f)}, ${plain(modal.s)}`],
    ["Tool", modal.tool === null || modal.tool === undefined ? "not known" : String(modal.tool)],
    ["Put out before", state.restore.map(words).join(", ") || "nothing"],
    ["Axes go (machine)", approach || "they stand there"],
  ];
  if (calls) facts.push(["Called by", calls]);
  if (variables) facts.push(["Variables set", variables]);
  return [
    h("p", {}, h("code", {}, state.block)),
    table(["", "Work", "Machine"], axes),
    h("dl", { class: "facts" }, ...facts.flatMap(([name, value]) => [h("dt", {}, name), h("dd", {}, value)])),
    state.not_restored.length > 0 ? h("p", { class: "warning" }, `See for yourself: ${state.not_restored.map(words).join(", ")} ${state.not_restored.length > 1 ? "were" : "was"} put out before this line, and will not be again.`) : null,
  ];
}

/** @param {import("./types.d.ts").RestoredOutput} output */
function words({ m, params: given, line }) {
  return `${[`M${String(m).padStart(2, "0")}`, params(given)].filter(Boolean).join(" ")} (line ${line})`;
}

/** @param {string[]} names @param {string[][]} rows */
function table(names, rows) {
  const cells = (/** @type {string[]} */ [first, ...rest]) => [h("th", { scope: "row" }, first ?? ""), ...rest.map((cell) => h("td", {}, cell))];
  const head = h("thead", {}, h("tr", {}, ...names.map((name) => h("th", { scope: "col" }, name))));
  return h("table", { class: "rehearsal-table" }, head, h("tbody", {}, ...rows.map((row) => h("tr", {}, ...cells(row)))));
}
