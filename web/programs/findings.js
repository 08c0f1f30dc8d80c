// The findings of a checked program.

import { unfolding } from "../machine/explain.js";
import { programName } from "../text/format.js";
import { listed, t } from "../text/language.js";
import { openDialog } from "../ui/dialog.js";
import { button, h } from "../ui/dom.js";
import { icon } from "../ui/icons.js";

/** Most findings shown; a text that is not a program has thousands. */
const SHOWN_MAX = 200;

/**
 * @param {number} program
 * @param {import("../types.d.ts").ProgramDiagnostic[]} diagnostics
 */
export function showFindings(program, diagnostics) {
  const close = button({ autofocus: true, onclick: () => dialog.close() }, t("common.close"));
  const more = diagnostics.length - SHOWN_MAX;
  const dialog = openDialog("findings", t("findings.title", { program: programName(program), found: summary(diagnostics) || t("findings.none") }), [
    h("ol", { class: "list" }, ...diagnostics.slice(0, SHOWN_MAX).map(finding)),
    more > 0 && h("p", { class: "muted" }, t("common.and_more", { count: more })),
    h("div", { class: "row end" }, close),
  ]);
}

/** Returns the numbers of errors and warnings, such as `1 error, 2 warnings`. @param {import("../types.d.ts").ProgramDiagnostic[]} diagnostics */
export function summary(diagnostics) {
  const errors = diagnostics.filter((one) => one.severity === "error").length;
  return counts(errors, diagnostics.length - errors);
}

/** Returns this text for given numbers; nothing if both are 0. @param {number} errors @param {number} warnings */
export function counts(errors, warnings) {
  return listed([errors > 0 && t("findings.errors", { count: errors }), warnings > 0 && t("findings.warnings", { count: warnings })]);
}

/** Returns a finding as an entry of a list. @param {import("../types.d.ts").ProgramDiagnostic} one */
export function finding({ severity, code, line, column, message, help }) {
  const more = h("div", { class: "explanation" });
  return h(
    "li",
    { class: "finding", "data-tone": severity === "error" ? "alarm" : "attention" },
    icon(severity === "error" ? "alarm" : "info"),
    h(
      "div",
      { class: "grow" },
      h("div", { class: "row" }, h("strong", {}, t("findings.line_column", { line, column })), h("span", { class: "spring" }), unfolding(code, more)),
      h("p", {}, message),
      help && h("p", { class: "muted" }, help),
      more,
    ),
  );
}
