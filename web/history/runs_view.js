// All runs that the machine keeps: time, program, end, duration, parts, waits.

import { machine } from "../machine/machine.js";
import { cells, ENDS } from "../path/runs.js";
import { dayAndTime, programName } from "../text/format.js";
import { t } from "../text/language.js";
import { button, fill, h, setAttr, setText } from "../ui/dom.js";
import { labelled, picker } from "./journal.js";
import { saveCsv } from "./save.js";

/** @typedef {import("../types.d.ts").Run} Run */

/** Runs of one answer. */
const PAGE_RUNS = 1000;
/** Rows shown at once. */
const ROWS_MAX = 1000;
/** Value of a run that has not ended, in the column of the ends. */
const GOES_ON = "goes_on";
/** Interval at which the time of a current run is updated, ms. */
const TELL_MS = 1000;

/** @param {import("../main.js").App} app */
export function runsView(app) {
  const cs = picker(t("journal.coordinate_system"), [["", t("journal.all")], ...[...app.model.systems.keys()].map((number) => /** @type {[string, string]} */ ([String(number), String(number)]))]);
  const how = picker(t("runs.ended"), [["", t("journal.all")], [GOES_ON, t("runs.goes_on")], ...Object.entries(ENDS).map(([end, key]) => /** @type {[string, string]} */ ([end, t(key)]))]);
  const program = h("input", { class: "input", type: "number", min: 1, max: 9999, "aria-label": t("runs.program") });
  const text = h("input", { class: "input", type: "search", "aria-label": t("runs.search") });
  const body = h("tbody", {});
  const note = h("p", { class: "muted", role: "status" });
  const older = button({ onclick: () => void read(runs.length, runs) }, t("runs.older"));
  const again = button({ onclick: () => void read(0, []) }, t("common.read_again"));
  /** @type {Run[]} */
  let runs = [];
  const found = () => [...goOn(app.model, cs.value), ...runs].filter((run) => fits(run, { how: how.value, program: Number(program.value), text: text.value.trim().toLowerCase() }));
  const save = button({ onclick: () => saveCsv("runs.csv", csvOf(found())) }, t("common.save_csv"));
  const show = () => {
    const shown = found();
    fill(body, ...shown.slice(0, ROWS_MAX).map((run) => h("tr", { "data-how": run.end?.how ?? GOES_ON }, ...row(run).map((cell) => h("td", {}, cell)))));
    setText(note, shown.length === 0 ? t("runs.no_run") : t("runs.shown", { shown: Math.min(shown.length, ROWS_MAX), count: runs.length + goOn(app.model, cs.value).length }));
  };
  let asked = 0;
  /** Reads runs from an index on; the newest run has index 0. @param {number} from @param {Run[]} kept runs that stay */
  const read = async (from, kept) => {
    const mine = ++asked;
    await app.attempt(async () => {
      /** @type {import("../types.d.ts").RunList} */
      const answer = await machine.get(`/runs?from=${from}&count=${PAGE_RUNS}${cs.value === "" ? "" : `&cs=${cs.value}`}`);
      if (mine !== asked) return;
      const all = from === 0 ? [...answer.runs, ...kept] : [...kept, ...answer.runs];
      runs = [...new Map(all.map((run) => [run.id, run])).values()];
      if (from + answer.runs.length >= runs.length) setAttr(older, "hidden", answer.runs.length < PAGE_RUNS);
      show();
    });
  };
  cs.addEventListener("input", () => void read(0, []));
  for (const one of [how, program, text]) one.addEventListener("input", show);
  let open = "";
  const tell = () => {
    const now = goOn(app.model, "").map(({ id }) => id).join();
    if (now !== open) void read(0, runs);
    else if (now !== "") show();
    open = now;
  };
  const timer = setInterval(tell, TELL_MS);
  open = goOn(app.model, "").map(({ id }) => id).join();
  void read(0, []);
  const names = [t("runs.started"), t("common.cs_short"), t("runs.program"), t("runs.ended"), t("runs.took"), t("runs.parts"), t("runs.place"), t("runs.m_codes")];
  const head = h("tr", {}, ...names.map((name) => h("th", { scope: "col" }, name)));
  const filters = h("div", { class: "history-tools" }, ...[cs, program, how, text].map(labelled), again, save);
  const table = h("table", { class: "history-table runs-table" }, h("thead", {}, head), body);
  const element = h("div", { class: "history-part" }, filters, h("div", { class: "scroll", tabindex: 0, role: "region", "aria-label": t("runs.all_runs") }, table, older), note);
  return { element, close: () => clearInterval(timer) };
}

/** Returns the runs that have not ended, with their present duration. @param {import("../machine/model.js").Model} model @param {string} cs empty: of all coordinate systems */
function goOn(model, cs) {
  const open = [...model.systems.values()].flatMap(({ runState }) => (runState?.run && runState.run.end === null ? [runState.run] : []));
  return open.filter((run) => cs === "" || String(run.cs) === cs).map((run) => ({ ...run, took_s: (model.ageMs(run.began) ?? 0) / 1000 }));
}

/** @param {Run} run @param {{how: string, program: number, text: string}} wanted 0 and "": any */
function fits(run, { how, program, text }) {
  if (how !== "" && (run.end?.how ?? GOES_ON) !== how) return false;
  if (program > 0 && run.program !== program) return false;
  return text === "" || row(run).join(" ").toLowerCase().includes(text);
}

/** @param {Run} run */
function row(run) {
  const [, ended = "", took = "", parts = "", waits = ""] = cells(run);
  const place = run.end?.place;
  const at = place ? t("common.program_line", { program: programName(place.program), line: place.line }) : "";
  return [dayAndTime(run.began), String(run.cs), programName(run.program), ended, took, parts, at, waits];
}

/** Returns a table for other programs: times as the machine sends them, with a decimal point. @param {Run[]} runs */
export function csvOf(runs) {
  const quoted = (/** @type {unknown} */ value) => (/[",\n;]/.test(String(value ?? "")) ? `"${String(value).replaceAll('"', '""')}"` : String(value ?? ""));
  const names = ["began", "ended", "cs", "program", "how", "text", "parts", "parts_done", "took_s", "last_part_s", "place_program", "place_line", "waits_s", "alarms", "id"];
  const lines = runs.map((run) => [
    run.began, run.end?.at, run.cs, run.program, run.end?.how, run.end?.text, run.parts, run.parts_done, run.took_s, run.last_part_s, run.end?.place?.program, run.end?.place?.line,
    run.waits.map(({ m, total_s: total }) => `M${m} ${total}`).join("; "), run.alarms.map(({ number }) => number).join("; "), run.id,
  ]);
  return `${[names, ...lines].map((line) => line.map(quoted).join()).join("\n")}\n`;
}
