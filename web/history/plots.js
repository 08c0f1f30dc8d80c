// Curves of the axes over time: following error, position, velocity, acceleration, feedrate, spindle. The values are recorded by the servo,
// 100 a second, for the last minute.

import { machine } from "../machine/machine.js";
import { axesOf } from "../machine/model.js";
import { fixed, plain, timeOfDay } from "../text/format.js";
import { t } from "../text/language.js";
import { button, fill, h, setAttr, setText } from "../ui/dom.js";
import { labelled, picker } from "./journal.js";
import { saveCsv } from "./save.js";
import { picture, shape, text } from "./svg.js";
import { csvOf, drawn, GAP_MS, Trace } from "./trace.js";

const AGAIN_MS = 500;
const HEIGHT_PX = 260;
const LEFT_PX = 74;
const FOOT_PX = 24;
const TOP_PX = 10;
/** Number of horizontal lines above the lowest. */
const RULES = 4;

/** @type {{quantity: import("./trace.js").Quantity, name: string, unit: string, isOfAxes: boolean}[]} */
const QUANTITIES = [
  { quantity: "error", name: t("plots.following_error"), unit: t("plots.lengths"), isOfAxes: true },
  { quantity: "position", name: t("plots.position"), unit: t("plots.lengths"), isOfAxes: true },
  { quantity: "velocity", name: t("plots.velocity"), unit: t("plots.velocities"), isOfAxes: true },
  { quantity: "acceleration", name: t("plots.acceleration"), unit: t("plots.accelerations"), isOfAxes: true },
  { quantity: "feedrate", name: t("plots.feedrate"), unit: "mm/min", isOfAxes: false },
  { quantity: "spindle", name: t("plots.spindle"), unit: t("unit.rpm"), isOfAxes: false },
];
/** Milliseconds, and text. @type {[string, string][]} */
const TIMES = [["60000", t("plots.1_minute")], ["30000", t("plots.30_seconds")], ["10000", t("plots.10_seconds")]];

export class PlotsView {
  #app;
  #what = picker(t("plots.curve_of"), QUANTITIES.map(({ quantity, name }) => [quantity, name]));
  #time = picker(t("plots.over_the_last"), TIMES);
  #axes = h("div", { class: "row", role: "group", "aria-label": t("plots.axes") });
  /** Axes that are not drawn. @type {Set<string>} */
  #hidden = new Set();
  #picture = picture("plot-picture");
  #box = h("div", { class: "plot" });
  #rows = h("tbody", {});
  #note = h("p", { class: "muted", role: "status" });
  #trace = new Trace();
  #shown = "";
  #timer = 0;
  #isClosed = false;
  element;

  /** @param {import("../main.js").App} app */
  constructor(app) {
    this.#app = app;
    this.#box.append(this.#picture);
    for (const one of [this.#what, this.#time]) one.addEventListener("input", () => this.#draw());
    const save = button({ onclick: () => this.#save() }, t("common.save_csv"));
    const head = h("tr", {}, ...[t("plots.curve"), t("plots.now"), t("plots.least"), t("plots.most"), t("plots.range")].map((name) => h("th", { scope: "col" }, name)));
    const table = h("table", { class: "history-table" }, h("thead", {}, head), this.#rows);
    this.element = h("div", { class: "history-part" }, h("div", { class: "history-tools" }, labelled(this.#what), labelled(this.#time), this.#axes, save), this.#box, h("div", { class: "scroll", tabindex: 0, role: "region", "aria-label": t("plots.the_curves_as_a_table") }, table), this.#note);
    void this.#read();
    new ResizeObserver(() => this.#draw()).observe(this.#box);
  }

  close() {
    this.#isClosed = true;
    clearTimeout(this.#timer);
  }

  /** Requests new values repeatedly. */
  async #read() {
    const { selected } = this.#app.model;
    this.#trace.show(selected);
    /** @type {import("../types.d.ts").Trace | null} */
    const answer = await machine.get(`/cs/${selected}/trace?from=${this.#trace.next}`).catch(() => null);
    if (this.#isClosed) return;
    const isWhole = !answer || this.#trace.addAnswer(answer);
    this.#draw();
    this.#timer = setTimeout(() => void this.#read(), isWhole ? AGAIN_MS : 0);
  }

  /** Returns the selected system with its curves over the selected time. */
  #chosen() {
    const system = this.#app.model.current;
    const wanted = QUANTITIES.find(({ quantity }) => quantity === this.#what.value);
    if (!system || !wanted) return null;
    const letters = axesOf(system);
    const { times: all } = this.#trace;
    const to = all.at(-1) ?? 0;
    const from = to - Number(this.#time.value);
    const first = all.findIndex((time) => time >= from);
    const names = wanted.isOfAxes ? letters.filter((letter) => !this.#hidden.has(letter)) : [wanted.name];
    const curves = names.map((name) => ({ name, at: wanted.isOfAxes ? letters.indexOf(name) : 0, values: this.#trace.of(wanted.quantity, name).slice(first) }));
    return { wanted, letters, times: all.slice(first), curves, from, to };
  }

  #draw() {
    const chosen = this.#chosen();
    if (!chosen) return;
    const { wanted, letters, times, curves, from, to } = chosen;
    this.#offer(letters, wanted.isOfAxes);
    this.#paint(times, curves, from, to);
    fill(this.#rows, ...curves.map(({ name, at, values }) => row(name, at, values, wanted.unit)));
    setText(this.#note, times.length < 2 ? t("plots.nothing_has_been_heard_yet") : t("plots.note", { unit: wanted.unit, cs: this.#app.model.selected }));
  }

  /** Saves the drawn curves as a file. */
  #save() {
    const chosen = this.#chosen();
    if (!chosen) return;
    const { wanted, times, curves } = chosen;
    saveCsv(`${wanted.quantity}.csv`, csvOf(times, curves.map(({ name, values }) => ({ name: wanted.isOfAxes ? `${name}_${wanted.quantity}` : wanted.quantity, values }))));
  }

  /** @param {string[]} letters @param {boolean} isOfAxes */
  #offer(letters, isOfAxes) {
    const key = letters.join();
    setAttr(this.#axes, "hidden", !isOfAxes);
    if (key === this.#shown) return;
    this.#shown = key;
    fill(this.#axes, ...letters.map((letter) => {
      const one = button({ "aria-pressed": String(!this.#hidden.has(letter)), onclick: () => {
        if (!this.#hidden.delete(letter)) this.#hidden.add(letter);
        setAttr(one, "aria-pressed", String(!this.#hidden.has(letter)));
        this.#draw();
      } }, letter);
      return one;
    }));
  }

  /** @param {number[]} times @param {{name: string, at: number, values: number[]}[]} curves @param {number} from @param {number} to */
  #paint(times, curves, from, to) {
    const width = Math.max(200, this.#box.clientWidth);
    this.#picture.setAttribute("viewBox", `0 0 ${width} ${HEIGHT_PX}`);
    const [least, most] = bounds(curves.flatMap(({ values }) => values));
    const x = (/** @type {number} */ time) => LEFT_PX + ((time - from) / Math.max(1, to - from)) * (width - LEFT_PX - 12);
    const y = (/** @type {number} */ value) => TOP_PX + (1 - (value - least) / (most - least)) * (HEIGHT_PX - FOOT_PX - TOP_PX);
    const rules = Array.from({ length: RULES + 1 }, (_, i) => least + ((most - least) * i) / RULES).flatMap((value) => [
      shape("line", { x1: LEFT_PX, x2: width - 12, y1: y(value), y2: y(value), class: "timeline-mark" }),
      text(LEFT_PX - 6, y(value) + 4, short(value, (most - least) / RULES), "plot-value"),
    ]);
    const marks = to === 0 ? [] : [from, (from + to) / 2, to].map((time, i) => text(x(time), HEIGHT_PX - 6, timeOfDay(new Date(time).toISOString()), `plot-time plot-time-${i}`));
    const xs = times.map(x);
    const lines = curves.map(({ at, values }) => {
      const points = drawn(xs, values).map((i) => {
        const time = times[i] ?? Number.NaN;
        const joins = i > 0 && time - (times[i - 1] ?? Number.NaN) <= GAP_MS;
        return `${joins ? "L" : "M"}${(xs[i] ?? 0).toFixed(1)} ${y(values[i] ?? 0).toFixed(1)}`;
      });
      return shape("path", { d: points.join(""), class: `curve curve-${at % 8}` });
    });
    this.#picture.replaceChildren(...rules, ...marks, ...lines);
  }
}

/** Returns the lowest and highest value with a margin, never equal. @param {number[]} values @returns {[number, number]} */
function bounds(values) {
  const finite = values.filter(Number.isFinite);
  if (finite.length === 0) return [0, 1];
  const [least, most] = finite.reduce(([low, high], value) => [Math.min(low, value), Math.max(high, value)], [Infinity, -Infinity]);
  const room = Math.max((most - least) * 0.05, 0.0005);
  return [least - room, most + room];
}

/** Formats a value with enough decimals to distinguish it from the next line. @param {number} value @param {number} step to the next line */
function short(value, step) {
  return fixed(value, Math.max(0, Math.min(6, 1 - Math.floor(Math.log10(step)))));
}

/** @param {string} name @param {number} at @param {number[]} values @param {string} unit */
function row(name, at, values, unit) {
  const finite = values.filter(Number.isFinite);
  const [least, most] = [Math.min(...finite), Math.max(...finite)];
  const told = finite.length === 0 ? ["–", "–", "–", "–"] : [finite.at(-1) ?? 0, least, most, most - least].map((value) => plain(Math.round(value * 1000) / 1000));
  return h("tr", { title: unit }, h("th", { scope: "row" }, h("i", { class: `curve-key curve-key-${at % 8}` }), name), ...told.map((cell) => h("td", {}, cell)));
}
