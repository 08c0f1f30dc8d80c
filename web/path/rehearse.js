// Forecast of the planned run: cycle time and its parts, M codes, ranges, peaks; a slider that moves the tool along;
// during the run, its progress and remaining time.

import { machine } from "../machine/machine.js";
import { duration, plain, position, programName, seconds } from "../text/format.js";
import { listed, t } from "../text/language.js";
import { scaleOf } from "../text/units.js";
import { openDialog } from "../ui/dialog.js";
import { button, fill, h, setAttr, setText } from "../ui/dom.js";
import { lastRuns } from "./runs.js";
import { isShown, runsProgram } from "./shown.js";

/** Request intervals: of the time left while a program runs, and of the rehearsal while it is planned, ms. */
const AGAIN_MS = 1000;
/** M codes listed. */
const M_CODES_SHOWN = 100;

/** @typedef {import("../types.d.ts").Rehearsal} Rehearsal */

export class Rehearse {
  /** Planned time that the slider shows; null: it shows the position of the machine. @type {number | null} */
  time = null;
  #summary = h("span", { class: "path-summary" });
  #outsideNote = h("span", { class: "path-away", hidden: true }, t("rehearse.the_tool_is_outside_of"));
  #bar = h("progress", { class: "path-progress", max: 1, value: 0, "aria-label": t("rehearse.share_of_the_planned_time"), hidden: true });
  #slider = h("input", { type: "range", class: "path-slider", min: 0, max: 1, step: "any", value: 0, "aria-label": t("rehearse.planned_time_shown"), hidden: true });
  #shown = h("span", { class: "path-time", hidden: true });
  #toggle;
  #details;
  element;
  #app;
  /** @type {Rehearsal | null} */
  #rehearsal = null;
  /** The path to which the rehearsal belongs. @type {import("./bytes.js").Answer | null} */
  #of = null;
  #key = "";
  #askedAt = 0;
  #isAsking = false;
  #changed;

  /** @param {import("../main.js").App} app @param {() => void} changed */
  constructor(app, changed) {
    this.#app = app;
    this.#changed = changed;
    this.#toggle = button({ class: "button small", "aria-pressed": "false", onclick: () => this.#scrub(this.time === null) }, t("rehearse.rehearse"));
    this.#details = button({ class: "button small", onclick: () => this.#open() }, t("rehearse.times"));
    this.#slider.addEventListener("input", () => {
      this.time = Number(this.#slider.value);
      this.#show();
      changed();
    });
    this.element = h("div", { class: "path-foot" }, this.#summary, this.#outsideNote, this.#bar, this.#slider, this.#shown, h("span", { class: "path-buttons" }, this.#toggle, this.#details));
  }

  /** @param {import("../machine/model.js").CoordinateSystem} system @param {import("./bytes.js").Answer | null} path */
  render(system, path) {
    const { state } = system;
    const key = [this.#app.model.bootId, system.info.number, state?.program, state?.hash].join();
    if (key !== this.#key) {
      this.#key = key;
      this.#rehearsal = null;
      this.#askedAt = 0;
      this.#scrub(false);
    }
    const runs = runsProgram(state);
    const isOpen = runs || !this.#current(state) || !this.#rehearsal || this.#rehearsal.outcome === "planning" || path !== this.#of;
    if (state?.program && isOpen && this.#app.model.online && Date.now() - this.#askedAt >= AGAIN_MS) {
      this.#of = path;
      void this.#ask(state.program, system.info.number);
    }
    setAttr(this.element, "hidden", !state?.program);
    if (runs && this.time !== null) this.#scrub(false);
    setAttr(this.#toggle, "disabled", runs || !path?.complete);
    setAttr(this.#toggle, "title", runs ? t("rehearse.while_the_program_runs_the") : null);
    setAttr(this.#details, "disabled", !this.#current(state));
    setText(this.#summary, this.#summaryText(state));
    const run = runs ? this.#current(state)?.run : null;
    setAttr(this.#bar, "hidden", !run);
    if (run) this.#bar.value = run.progress;
    const end = String(path?.end ?? 1);
    if (this.#slider.max !== end) this.#slider.max = end;
  }

  /** Shows whether the tool is outside of the picture. @param {boolean} isAway */
  outside(isAway) {
    setAttr(this.#outsideNote, "hidden", !isAway);
  }

  /**
   * Returns the rehearsal of the current run, or of the text that a start would run.
   * @param {import("../types.d.ts").StateMessage | null | undefined} state
   */
  #current(state) {
    const rehearsal = this.#rehearsal;
    return rehearsal && isShown(state, { runId: rehearsal.run_id ?? null, hash: rehearsal.hash }) ? rehearsal : null;
  }

  /** @param {import("../types.d.ts").StateMessage | null | undefined} state */
  #summaryText(state) {
    const rehearsal = this.#current(state);
    if (!rehearsal) return t("path.not_planned_yet");
    if (runsProgram(state) && rehearsal.run) {
      if (rehearsal.run.left_s === null) return t("rehearse.left_unknown", { percent: Math.floor(rehearsal.run.progress * 100), all: time(rehearsal.cycle_time_s) });
      return t("rehearse.left", { percent: Math.floor(rehearsal.run.progress * 100), left: time(rehearsal.run.left_s), all: time(rehearsal.cycle_time_s) });
    }
    if (rehearsal.outcome === "planning") return t("rehearse.planned_so_far", { time: time(rehearsal.cycle_time_s) });
    const isUnknown = rehearsal.m_codes.some((code) => code.waits && code.wait_s === null);
    const takes = t(isUnknown ? "rehearse.time_and_m_codes" : "rehearse.time", { time: time(rehearsal.cycle_time_s) });
    return rehearsal.outcome === "completed" ? t("rehearse.cycle", { time: takes }) : t("rehearse.runs", { time: takes, text: ending(rehearsal) });
  }

  /** @param {boolean} on */
  #scrub(on) {
    this.time = on ? 0 : null;
    setAttr(this.#toggle, "aria-pressed", String(on));
    setAttr(this.#slider, "hidden", !on);
    setAttr(this.#shown, "hidden", !on);
    if (on) this.#slider.value = "0";
    this.#show();
    this.#changed();
  }

  #show() {
    const at = this.time ?? 0;
    const lines = this.#rehearsal?.lines ?? [];
    const line = lines.findLast((one) => one.at_s <= at);
    setText(this.#shown, listed([seconds(at, 2), line && t("common.line", { line: line.line })]));
  }

  /** @param {number} program @param {number} cs */
  async #ask(program, cs) {
    if (this.#isAsking) return;
    this.#isAsking = true;
    this.#askedAt = Date.now();
    const key = this.#key;
    try {
      // the connection banner reports an unreachable machine
      const answer = await machine.get(`/programs/${program}/rehearsal?cs=${cs}`).catch(() => null);
      if (key === this.#key) this.#rehearsal = answer;
    } finally {
      this.#isAsking = false;
      this.#app.invalidate();
    }
  }

  #open() {
    const rehearsal = this.#rehearsal;
    if (!rehearsal) return;
    const close = button({ autofocus: true, onclick: () => dialog.close("") }, t("common.close"));
    const dialog = openDialog("rehearsal", t("rehearse.title", { program: programName(rehearsal.program), time: time(rehearsal.cycle_time_s) }), [
      h("p", {}, shares(rehearsal)),
      rehearsal.text ? h("p", { class: "error" }, ending(rehearsal)) : null,
      rehearsal.depends ? h("p", {}, t("rehearse.from_line_on_it_may", { line: rehearsal.depends.line, why: rehearsal.depends.why })) : null,
      corner(rehearsal),
      h("div", { class: "scroll" }, axes(rehearsal, this.#app.model), mCodes(rehearsal), lastRuns(rehearsal.program, rehearsal.cs)),
      h("div", { class: "row end" }, close),
    ]);
  }
}

/** @param {number} s */
function time(s) {
  return s < 60 ? seconds(s, 1) : duration(s * 1000);
}

/** Returns the reason and the place at which the rehearsed run ends early. @param {Rehearsal} rehearsal */
function ending({ text, at }) {
  return at ? t("rehearse.text_at", { text, line: at.line }) : text;
}

/** @param {Rehearsal} rehearsal */
function shares({ feed_s, rapid_s, fixed_s, wait_s }) {
  return t("rehearse.shares", { feed: time(feed_s), rapid: time(rapid_s), fixed: time(fixed_s), wait: time(wait_s) });
}

/** Returns the largest distance of the path from a programmed corner. @param {Rehearsal} rehearsal */
function corner({ corners }) {
  const [largest] = corners;
  return largest ? h("p", {}, t("rehearse.corner", { distance: plain(Math.round(1000 * largest.distance_mm) / 1000), line: largest.line })) : null;
}

/** @param {Rehearsal} rehearsal @param {import("../machine/model.js").Model} model */
function axes({ axes: all }, model) {
  const rows = Object.entries(all).map(([letter, axis]) => {
    const scale = scaleOf(model, letter);
    const share = (/** @type {import("../types.d.ts").RehearsedPeak} */ { value, limit, line }) => t("rehearse.peak", { value: plain(Math.round((10 * value) / scale.size) / 10), percent: Math.round((100 * value) / limit), line });
    const limits = axis.soft_limits?.map((limit) => plain(limit / scale.size)).join(" … ") ?? t("rehearse.none");
    return row([`${letter} ${scale.unit}`, position(axis.lowest, scale), position(axis.highest, scale), limits, share(axis.velocity), share(axis.acceleration)]);
  });
  return table([t("positions.axis"), t("rehearse.lowest"), t("rehearse.highest"), t("rehearse.soft_limits"), t("rehearse.speed"), t("rehearse.acceleration")], rows);
}

/** @param {Rehearsal} rehearsal */
function mCodes({ m_codes, m_code_count }) {
  if (!m_codes.length) return null;
  const rows = m_codes.slice(0, M_CODES_SHOWN).map(({ m, line, at_s, waits, wait_s }) => {
    const takes = !waits ? t("rehearse.the_program_goes_on") : wait_s === null ? t("rehearse.not_known_yet") : time(wait_s);
    return row([`M${m}`, String(line), time(at_s), takes]);
  });
  const more = m_code_count > rows.length ? h("p", {}, t("common.and_more", { count: m_code_count - rows.length })) : null;
  return h("div", {}, table([t("journal.m_code"), t("rehearse.line"), t("rehearse.at"), t("rehearse.takes")], rows), more);
}

/** @param {string[]} names @param {HTMLElement[]} rows */
function table(names, rows) {
  const body = h("tbody", {});
  fill(body, ...rows);
  return h("table", { class: "rehearsal-table" }, h("thead", {}, h("tr", {}, ...names.map((name) => h("th", { scope: "col" }, name)))), body);
}

/** @param {string[]} cells */
function row(cells) {
  return h("tr", {}, ...cells.map((cell) => h("td", {}, cell)));
}
