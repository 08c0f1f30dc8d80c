// What the planned run does: cycle time and how it is spent, M codes, ranges, peaks; a slider that moves the tool along; while the
// program runs, how far it is and how much time is left.

import { button, fill, h, setAttr, setText } from "../dom.js";
import { openDialog } from "../dialog.js";
import { duration, plain, position, programName } from "../format.js";
import { machine } from "../machine.js";
import { lastRuns } from "./runs.js";

/** How often the time left is asked for while a program runs, and the rehearsal while it is planned, ms. */
const AGAIN_MS = 1000;
/** M codes listed. */
const M_CODES_SHOWN = 100;

/** @typedef {import("../types.d.ts").Rehearsal} Rehearsal */

export class Rehearse {
  /** Planned time that the slider shows; null: it shows where the machine is. @type {number | null} */
  time = null;
  #summary = h("span", { class: "path-summary" });
  #away = h("span", { class: "path-away", hidden: true }, "The tool is outside of the picture.");
  #bar = h("progress", { class: "path-progress", max: 1, value: 0, "aria-label": "Share of the planned time that is done", hidden: true });
  #slider = h("input", { type: "range", class: "path-slider", min: 0, max: 1, step: "any", value: 0, "aria-label": "Planned time shown", hidden: true });
  #shown = h("span", { class: "path-time", hidden: true });
  #toggle;
  #details;
  element;
  #app;
  /** @type {Rehearsal | null} */
  #rehearsal = null;
  /** The path that it was asked for. @type {import("./bytes.js").Answer | null} */
  #of = null;
  #key = "";
  #askedAt = 0;
  #isAsking = false;
  #changed;

  /** @param {import("../main.js").App} app @param {() => void} changed */
  constructor(app, changed) {
    this.#app = app;
    this.#changed = changed;
    this.#toggle = button({ class: "button small", "aria-pressed": "false", onclick: () => this.#scrub(this.time === null) }, "Rehearse");
    this.#details = button({ class: "button small", onclick: () => this.#open() }, "Times");
    this.#slider.addEventListener("input", () => {
      this.time = Number(this.#slider.value);
      this.#show();
      changed();
    });
    this.element = h("div", { class: "path-foot" }, this.#summary, this.#away, this.#bar, this.#slider, this.#shown, h("span", { class: "path-buttons" }, this.#toggle, this.#details));
  }

  /** @param {import("../model.js").CoordinateSystem} system @param {import("./bytes.js").Answer | null} path */
  render(system, path) {
    const { state } = system;
    const key = [this.#app.model.bootId, system.info.number, state?.program, state?.hash].join();
    if (key !== this.#key) {
      this.#key = key;
      this.#rehearsal = null;
      this.#askedAt = 0;
      this.#scrub(false);
    }
    const runs = ["ACTIVE", "WAIT", "FEED_HOLD", "INTERRUPTED", "PROGRAM_STOPPED", "OPTIONAL_STOP"].includes(state?.execution ?? "");
    const isOpen = runs || !this.#rehearsal || this.#rehearsal.outcome === "planning" || path !== this.#of;
    if (state?.program && path && isOpen && this.#app.model.online && Date.now() - this.#askedAt >= AGAIN_MS) {
      this.#of = path;
      void this.#ask(state.program, system.info.number);
    }
    setAttr(this.element, "hidden", !state?.program || !path);
    if (runs && this.time !== null) this.#scrub(false);
    setAttr(this.#toggle, "disabled", runs || !path?.complete);
    setAttr(this.#toggle, "title", runs ? "While the program runs the picture shows the machine" : null);
    setText(this.#summary, this.#says(runs));
    const run = runs ? this.#rehearsal?.run : null;
    setAttr(this.#bar, "hidden", !run);
    if (run) this.#bar.value = run.progress;
    const end = String(path?.end ?? 1);
    if (this.#slider.max !== end) this.#slider.max = end;
  }

  /** Whether the tool is outside of the picture. @param {boolean} isAway */
  outside(isAway) {
    setAttr(this.#away, "hidden", !isAway);
  }

  /** @param {boolean} runs */
  #says(runs) {
    const rehearsal = this.#rehearsal;
    if (!rehearsal) return "";
    if (runs && rehearsal.run) {
      return `${Math.floor(rehearsal.run.progress * 100)} %, ${time(rehearsal.run.left_s)} left of ${time(rehearsal.cycle_time_s)}`;
    }
    if (rehearsal.outcome === "planning") return `Planned so far: ${time(rehearsal.cycle_time_s)}`;
    const unknown = rehearsal.m_codes.some((code) => code.waits && code.wait_s === null) ? " and M codes" : "";
    const ends = rehearsal.outcome === "completed" ? "" : `, then: ${rehearsal.text}${rehearsal.at ? ` (line ${rehearsal.at.line})` : ""}`;
    return `${rehearsal.outcome === "completed" ? "Cycle" : "Runs"} ${time(rehearsal.cycle_time_s)}${unknown}${ends}`;
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
    setText(this.#shown, `${at.toFixed(2)} s${line ? `, line ${line.line}` : ""}`);
  }

  /** @param {number} program @param {number} cs */
  async #ask(program, cs) {
    if (this.#isAsking) return;
    this.#isAsking = true;
    this.#askedAt = Date.now();
    const key = this.#key;
    try {
      // the connection says where the machine is not there
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
    const close = button({ autofocus: true, onclick: () => dialog.close("") }, "Close");
    const dialog = openDialog("rehearsal", `${programName(rehearsal.program)} takes ${time(rehearsal.cycle_time_s)}`, [
      h("p", {}, shares(rehearsal)),
      rehearsal.text ? h("p", { class: "error" }, `${rehearsal.text}${rehearsal.at ? ` (line ${rehearsal.at.line})` : ""}`) : null,
      rehearsal.depends ? h("p", {}, `From line ${rehearsal.depends.line} on it may be otherwise: ${rehearsal.depends.why}.`) : null,
      h("div", { class: "scroll" }, axes(rehearsal), mCodes(rehearsal), lastRuns(rehearsal.program, rehearsal.cs)),
      h("div", { class: "dialog-buttons" }, close),
    ]);
  }
}

/** @param {number} s */
function time(s) {
  return s < 60 ? `${s.toFixed(1)} s` : duration(s * 1000);
}

/** @param {Rehearsal} rehearsal */
function shares({ feed_s, rapid_s, fixed_s, wait_s }) {
  const parts = Object.entries({ "at feedrate": feed_s, "rapid": rapid_s, "dwells and stops": fixed_s, "M codes": wait_s });
  return `At 100 percent: ${parts.map(([name, s]) => `${time(s)} ${name}`).join(", ")}.`;
}

/** @param {Rehearsal} rehearsal */
function axes({ axes: all }) {
  const share = (/** @type {import("../types.d.ts").RehearsedPeak} */ { value, limit, line }) => `${plain(Math.round(value * 10) / 10)} (${Math.round((100 * value) / limit)} %, line ${line})`;
  const rows = Object.entries(all).map(([letter, axis]) => row([letter, position(axis.lowest), position(axis.highest), axis.soft_limits?.join(" … ") ?? "none", share(axis.velocity), share(axis.acceleration)]));
  return table(["Axis", "Lowest", "Highest", "Soft limits", "Speed /s", "Acceleration /s²"], rows);
}

/** @param {Rehearsal} rehearsal */
function mCodes({ m_codes, m_code_count }) {
  if (!m_codes.length) return null;
  const rows = m_codes.slice(0, M_CODES_SHOWN).map(({ m, line, at_s, waits, wait_s }) => {
    const takes = !waits ? "the program goes on" : wait_s === null ? "not known yet" : time(wait_s);
    return row([`M${m}`, String(line), time(at_s), takes]);
  });
  const more = m_code_count > rows.length ? h("p", {}, `and ${m_code_count - rows.length} more`) : null;
  return h("div", {}, table(["M code", "Line", "At", "Takes"], rows), more);
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
