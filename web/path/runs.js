// The last runs of a program: how long they took, how they ended, for which M codes they waited; and its parts.

import { h } from "../dom.js";
import { duration, timeOfDay } from "../format.js";
import { machine } from "../machine.js";

/** Runs that are looked through, of all programs. */
const RUNS = 200;
/** Runs listed. */
const RUNS_SHOWN = 10;

/** @typedef {import("../types.d.ts").Run} Run */

/** What is known of the runs of a program; fills itself when the machine has answered. @param {number} program @param {number} cs */
export function lastRuns(program, cs) {
  const element = h("div", { class: "last-runs" });
  void read(cs).then(({ runs, production }) => {
    const of = runs.filter((run) => run.program === program).slice(0, RUNS_SHOWN);
    if (!of.length) return;
    const parts = production.find((made) => made.program === program)?.parts ?? 0;
    const rows = of.map((run) => h("tr", {}, ...cells(run).map((cell) => h("td", {}, cell))));
    const head = h("tr", {}, ...["Started", "Took", "Parts", "Ended", "M codes took"].map((name) => h("th", { scope: "col" }, name)));
    element.append(
      h("h3", {}, `${parts} ${parts === 1 ? "part" : "parts"} completed`),
      h("table", { class: "rehearsal-table" }, h("thead", {}, head), h("tbody", {}, ...rows)),
    );
  });
  return element;
}

/** @param {Run} run */
export function cells(run) {
  const alarm = run.alarms.at(-1);
  const ended = [run.end?.how.replace("_", " "), alarm?.text, run.end?.text].filter(Boolean).join(": ");
  const waits = run.waits.map(({ m, total_s }) => `M${m} ${took(total_s)}`).join(", ");
  return [timeOfDay(run.began), took(run.took_s), run.parts === 1 ? `${run.parts_done}` : `${run.parts_done} of ${run.parts}`, ended, waits || "none"];
}

/** @param {number} s */
function took(s) {
  return s < 60 ? `${s.toFixed(1)} s` : duration(s * 1000);
}

/** @param {number} cs @returns {Promise<import("../types.d.ts").Runs>} */
async function read(cs) {
  return machine.get(`/runs?cs=${cs}&count=${RUNS}`).catch(() => ({ runs: [], production: [] }));
}
