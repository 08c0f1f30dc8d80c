// The last runs of a program, from the journal: how long they took, how they ended, and for which M codes they waited.

import { h } from "../dom.js";
import { duration, timeOfDay } from "../format.js";
import { machine } from "../machine.js";

/** Lines of the journal that are looked through. */
const LINES = 1000;
/** Runs listed. */
const RUNS_SHOWN = 10;

/** @typedef {{event: string, ts: string, t_s: number, boot_id: string, program?: number, run_id?: string, outcome?: string, reason?: string, seq?: number, m?: number}} Line */
/** @typedef {{program: number, began: string, took: number, ended: string, waits: Map<number, number>}} Run */

/**
 * Runs that have ended, the newest first.
 * @param {Line[]} lines in the order of time
 * @returns {Run[]}
 */
export function runsOf(lines) {
  /** @type {Run[]} */
  const runs = [];
  /** @type {{run: Run, since: number, boot: string} | null} */
  let open = null;
  /** @type {Map<number, {m: number, since: number}>} */
  const outputs = new Map();
  for (const line of lines) {
    if (line.event === "start" && line.program) {
      open = { run: { program: line.program, began: line.ts, took: 0, ended: "", waits: new Map() }, since: line.t_s, boot: line.boot_id };
      outputs.clear();
    } else if (!open || line.boot_id !== open.boot) {
      open = null;
    } else if (line.event === "output" && line.seq !== undefined) {
      outputs.set(line.seq, { m: line.m ?? 0, since: line.t_s });
    } else if (line.event === "reset" && line.seq !== undefined) {
      const output = outputs.get(line.seq);
      if (output) open.run.waits.set(output.m, (open.run.waits.get(output.m) ?? 0) + line.t_s - output.since);
    } else if (line.event === "end") {
      open.run.took = line.t_s - open.since;
      open.run.ended = line.reason ? `${line.outcome} (${line.reason})` : (line.outcome ?? "");
      runs.unshift(open.run);
      open = null;
    }
  }
  return runs;
}

/** What is known of the runs of a program; fills itself when the journal has answered. @param {number} program @param {number} cs */
export function lastRuns(program, cs) {
  const element = h("div", { class: "last-runs" });
  void read(cs).then((lines) => {
    const runs = runsOf(lines).filter((run) => run.program === program);
    if (!runs.length) return;
    const completed = runs.filter((run) => run.ended === "PROGRAM_COMPLETED").length;
    const rows = runs.slice(0, RUNS_SHOWN).map((run) => h("tr", {}, ...[timeOfDay(run.began), took(run.took), run.ended, waited(run)].map((cell) => h("td", {}, cell))));
    const head = h("tr", {}, ...["Started", "Took", "Ended", "M codes took"].map((name) => h("th", { scope: "col" }, name)));
    element.append(
      h("h3", {}, `${completed} ${completed === 1 ? "part" : "parts"} completed in the last ${runs.length === 1 ? "run" : `${runs.length} runs`}`),
      h("table", { class: "rehearsal-table" }, h("thead", {}, head), h("tbody", {}, ...rows)),
    );
  });
  return element;
}

/** @param {Run} run */
function waited({ waits }) {
  const longest = [...waits].sort(([, a], [, b]) => b - a);
  return longest.map(([m, s]) => `M${m} ${took(s)}`).join(", ") || "none";
}

/** @param {number} s */
function took(s) {
  return s < 60 ? `${s.toFixed(1)} s` : duration(s * 1000);
}

/** Without a journal there is nothing to show. @param {number} cs @returns {Promise<Line[]>} */
async function read(cs) {
  const journal = await machine.get(`/journal?cs=${cs}&count=${LINES}`).catch(() => null);
  return journal?.lines ?? [];
}
