// The timeline: the choice of the run, the shares of the time, and each wait as a row.

import { programName, timeOfDay } from "../text/format.js";
import { sentences, t } from "../text/language.js";
import { button, fill, h, setAttr, setText } from "../ui/dom.js";
import { lasting } from "./alarms.js";
import { Chart } from "./chart.js";
import { labelled, PAGE_LINES, picker } from "./journal.js";
import { describe, losses, timelineOf } from "./timeline.js";

/** Interval at which the journal is read while the timeline is open, ms. */
const AGAIN_MS = 2000;
/** Runs to choose from, and waits listed. */
const RUNS_SHOWN = 40;
const WAITS_SHOWN = 300;

const LEGEND = { moving: t("timeline.moves"), waiting: t("timeline.waits_m"), asked: t("timeline.asks"), held: t("timeline.is_held"), stopped: t("timeline.stands_in_program") };
const LATEST = t("timeline.latest");
const MINUTES = t("timeline.minutes");
const ALL = t("timeline.all_read");

/** @typedef {import("./timeline.js").Run} Run @typedef {import("./journal.js").Line} Line */

export class TimelineView {
  #app;
  #chart = new Chart((cs, span) => setText(this.#said, t("timeline.said", { cs, time: timeOfDay(new Date(span.from).toISOString()), lasted: lasting(span.to - span.from), what: describe(span) })));
  #which = picker(t("timeline.show"), [[LATEST, LATEST]]);
  #said = h("p", { class: "timeline-said", role: "status" }, t("timeline.choose_a_stretch_to_see"));
  #shares = h("p", {});
  #causes = h("tbody", {});
  #waits = h("tbody", {});
  #older = button({ onclick: () => void this.#read(true) }, t("timeline.read_further_back"));
  /** @type {Line[]} */
  #lines = [];
  /** @type {Run[]} */
  #runs = [];
  /** Number of lines that were read before the newest page. */
  #further = 0;
  #timer;
  #drawn = "";
  element;

  /** @param {import("../main.js").App} app */
  constructor(app) {
    this.#app = app;
    this.#which.addEventListener("input", () => this.#show());
    const zoom = (/** @type {string} */ says, /** @type {string} */ sign, /** @type {number} */ factor) => button({ "aria-label": says, title: says, onclick: () => this.#chart.zoom(factor) }, sign);
    const tools = h("div", { class: "history-tools" }, labelled(this.#which), zoom(t("timeline.zoom_out"), "−", 1 / 1.6), zoom(t("timeline.zoom_in"), "+", 1.6), zoom(t("timeline.whole_time"), t("timeline.fit"), 0), this.#older);
    const legend = h("ul", { class: "timeline-legend", "aria-label": t("timeline.colours") }, ...Object.entries(LEGEND).map(([kind, says]) => h("li", {}, h("i", { class: `key-${kind}` }), says)));
    const tables = h("div", { class: "timeline-tables" }, h("div", {}, h("h3", {}, t("timeline.where_the_time_went")), this.#shares, table([t("common.cs_short"), t("timeline.lost_to"), t("timeline.whom"), t("timeline.times"), t("timeline.longest"), t("timeline.in_all")], this.#causes)), h("div", {}, h("h3", {}, t("timeline.each_wait_the_newest_first")), table([t("journal.time"), t("common.cs_short"), t("timeline.lasted"), t("journal.what")], this.#waits)));
    this.element = h("div", { class: "history-part" }, tools, this.#chart.element, legend, this.#said, h("div", { class: "scroll", tabindex: 0, role: "region", "aria-label": t("timeline.the_timeline_as_tables") }, tables));
    this.#timer = setInterval(() => void this.#read(false), AGAIN_MS);
    void this.#read(false);
  }

  close() {
    clearInterval(this.#timer);
  }

  /** @param {boolean} isOlder */
  async #read(isOlder) {
    if (!this.#app.model.online) return;
    if (isOlder) this.#further += PAGE_LINES;
    const read = async () => {
      const page = await this.#app.api.journal(isOlder ? this.#further : 0, PAGE_LINES, {});
      setAttr(this.#older, "hidden", isOlder ? page.length < PAGE_LINES : this.#older.hidden || (this.#further === 0 && page.length < PAGE_LINES));
      this.#lines = joined(isOlder ? page : this.#lines, isOlder ? this.#lines : page);
      this.#show();
    };
    if (isOlder) await this.#app.attempt(read);
    else await read().catch((error) => setText(this.#said, error instanceof Error ? error.message : String(error)));
  }

  #show() {
    // the machine's time of day
    const now = this.#app.model.ageMs("1970-01-01T00:00:00Z");
    this.#runs = timelineOf(this.#lines, now);
    this.#choices();
    const { runs, from, to } = this.#window(now);
    const lanes = [...this.#app.model.systems.keys()];
    this.#chart.show(runs, lanes, from, to);
    this.#tables(runs.filter((run) => run.to > from && run.from < to));
  }

  /** The newest runs, to be chosen. */
  #choices() {
    const named = this.#runs.filter(({ program }) => program > 0).slice(-RUNS_SHOWN).reverse();
    const names = [LATEST, MINUTES, ALL, ...named.map(nameOf)];
    const key = names.join("\n");
    if (key === this.#drawn) return;
    this.#drawn = key;
    const { value } = this.#which;
    fill(this.#which, ...names.map((name) => h("option", { value: name }, name)));
    this.#which.value = names.includes(value) ? value : LATEST;
  }

  /** @param {number} now */
  #window(now) {
    const runs = this.#runs;
    const { value } = this.#which;
    if (value === MINUTES) return { runs, from: now - 600_000, to: now };
    if (value === ALL) return { runs, from: runs[0]?.from ?? now - 1000, to: Math.max(...runs.map(({ to }) => to), now - 1000) };
    const run = runs.findLast((one) => (value === LATEST ? one.program > 0 : nameOf(one) === value)) ?? runs.at(-1);
    if (!run) return { runs, from: now - 60_000, to: now };
    // coordinate systems that run at the same time are shown as well
    const together = runs.filter((one) => one.from < run.to && one.to > run.from && one.program > 0);
    return { runs, from: Math.min(run.from, ...together.map(({ from }) => from)), to: Math.max(run.to, ...together.map(({ to }) => to)) };
  }

  /** @param {Run[]} runs */
  #tables(runs) {
    const { shares, causes } = losses(runs);
    const parts = [...shares].sort(([a], [b]) => a - b).map(([cs, { moving, total }]) => t("timeline.moved", { cs, moving: lasting(moving), total: lasting(total) }));
    setText(this.#shares, parts.length > 0 ? sentences(...parts) : t("timeline.nothing"));
    fill(this.#causes, ...causes.map(({ cs, kind, says, whom, count, total, longest }) => row([String(cs), kind === "held" ? t("timeline.held_by", { reason: says }) : says, whom, String(count), lasting(longest), lasting(total)])));
    const waits = runs.flatMap((run) => run.spans.filter(({ kind }) => kind !== "moving").map((span) => ({ cs: run.cs, span }))).sort((a, b) => b.span.from - a.span.from);
    const rows = waits.slice(0, WAITS_SHOWN).map(({ cs, span }) => {
      const time = timeOfDay(new Date(span.from).toISOString());
      const go = button({ class: "button small", "aria-label": t("timeline.show_in_the_timeline", { time }), onclick: () => this.#chart.choose(span) }, time);
      return h("tr", {}, h("td", {}, go), ...[String(cs), lasting(span.to - span.from), describe(span)].map((cell) => h("td", {}, cell)));
    });
    if (!this.#waits.contains(document.activeElement)) fill(this.#waits, ...rows);
  }
}

/** Two pages, the older one first, each line once. @param {Line[]} older @param {Line[]} newer */
function joined(older, newer) {
  const first = newer[0];
  if (!first) return older;
  const key = (/** @type {Line} */ { boot_id, n, ts }) => `${boot_id} ${n} ${ts}`;
  const at = older.findIndex((line) => key(line) === key(first));
  return [...(at < 0 ? older : older.slice(0, at)), ...newer];
}

/** @param {Run} run */
function nameOf({ cs, program, from, to, ended }) {
  const run = { time: timeOfDay(new Date(from).toISOString()), cs, program: programName(program) };
  return ended === "" ? t("timeline.runs", run) : t("timeline.ran", { ...run, lasted: lasting(to - from), ended });
}

/** @param {string[]} names @param {HTMLElement} body */
function table(names, body) {
  return h("table", { class: "history-table" }, h("thead", {}, h("tr", {}, ...names.map((name) => h("th", { scope: "col" }, name)))), body);
}

/** @param {string[]} cells */
function row(cells) {
  return h("tr", {}, ...cells.map((cell) => h("td", {}, cell)));
}
