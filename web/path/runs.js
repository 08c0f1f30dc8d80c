// The last runs of a program: durations, ends, waits for M codes; and its parts.

import { machine } from "../machine/machine.js";
import { duration, seconds, timeOfDay } from "../text/format.js";
import { listed, t } from "../text/language.js";
import { h } from "../ui/dom.js";

/** Number of runs that are searched, of all programs. */
const RUNS = 200;
/** Runs listed. */
const RUNS_SHOWN = 10;

/** @typedef {import("../types.d.ts").Run} Run */

/** Texts for the ends of a run. @type {Record<import("../types.d.ts").RunEndedHow, import("../text/language.js").Key>} */
export const ENDS = {
  completed: "runs.end_completed", stopped: "runs.end_stopped", aborted: "runs.end_aborted", reset: "runs.end_reset", alarm: "runs.end_alarm",
  lease_lost: "runs.end_lease_lost", replaced: "runs.end_replaced", refused: "runs.end_refused", restarted: "runs.end_restarted",
};

/** Returns the known runs of a program; completed when the machine has answered. @param {number} program @param {number} cs */
export function lastRuns(program, cs) {
  const element = h("div", { class: "last-runs" });
  void read(cs).then(({ runs, production }) => {
    const of = runs.filter((run) => run.program === program).slice(0, RUNS_SHOWN);
    if (!of.length) return;
    const parts = production.find((made) => made.program === program)?.parts ?? 0;
    const rows = of.map((run) => h("tr", {}, ...cells(run).map((cell) => h("td", {}, cell))));
    const head = h("tr", {}, ...[t("runs.started"), t("runs.ended"), t("runs.took"), t("runs.parts"), t("runs.m_codes")].map((name) => h("th", { scope: "col" }, name)));
    element.append(
      h("h3", {}, t("runs.completed", { count: parts })),
      h("table", { class: "rehearsal-table" }, h("thead", {}, head), h("tbody", {}, ...rows)),
    );
  });
  return element;
}

/** @param {Run} run */
export function cells(run) {
  const alarm = run.alarms.at(-1);
  const ended = [run.end ? t(ENDS[run.end.how]) : t("runs.goes_on"), alarm?.text, run.end?.text, run.waits_for].filter(Boolean).join(": ");
  const waits = listed(run.waits.map(({ m, total_s }) => `M${m} ${took(total_s)}`));
  return [timeOfDay(run.began), ended, took(run.took_s), run.parts === 1 ? `${run.parts_done}` : t("runs.of", { done: run.parts_done, parts: run.parts }), waits || t("runs.none")];
}

/** @param {number} s */
function took(s) {
  return s < 60 ? seconds(s, 1) : duration(s * 1000);
}

/** @param {number} cs @returns {Promise<import("../types.d.ts").RunList>} */
async function read(cs) {
  return machine.get(`/runs?cs=${cs}&count=${RUNS}`).catch(() => ({ runs: [], production: [] }));
}
