// All that checking says of a program, in one list.

import { openDialog } from "./dialog.js";
import { h } from "./dom.js";
import { programName } from "./format.js";
import { icon } from "./icons.js";

/** Findings shown; a program that is none at all has thousands. */
const SHOWN_MAX = 200;

/**
 * @param {number} program
 * @param {import("./types.d.ts").ProgramDiagnostic[]} diagnostics
 */
export function showFindings(program, diagnostics) {
  const errors = diagnostics.filter((one) => one.severity === "error").length;
  const counted = [count(errors, "error"), count(diagnostics.length - errors, "warning")].filter((text) => text !== "");
  const close = h("button", { type: "button", class: "button", autofocus: true }, "Close");
  const more = diagnostics.length - SHOWN_MAX;
  const dialog = openDialog("findings", `${programName(program)}: ${counted.join(", ") || "nothing to say"}`, [
    h("ol", { class: "list" }, ...diagnostics.slice(0, SHOWN_MAX).map(finding)),
    more > 0 && h("p", { class: "muted" }, `and ${more} more`),
    h("div", { class: "row end" }, close),
  ]);
  close.addEventListener("click", () => dialog.close());
}

/** @param {number} number @param {string} word */
export function count(number, word) {
  return number === 0 ? "" : `${number} ${word}${number === 1 ? "" : "s"}`;
}

/** One of them, as an entry of a list. @param {import("./types.d.ts").ProgramDiagnostic} one */
export function finding({ severity, code, line, column, message, help }) {
  return h(
    "li",
    { class: "finding", "data-tone": severity === "error" ? "alarm" : "attention" },
    icon(severity === "error" ? "alarm" : "info"),
    h(
      "div",
      { class: "grow" },
      h("div", { class: "row" }, h("strong", {}, `Line ${line}, column ${column}`), h("span", { class: "spring" }), h("span", { class: "chip" }, code)),
      h("p", {}, message),
      help && h("p", { class: "muted" }, help),
    ),
  );
}
