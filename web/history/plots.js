// Curves over time of what the axes do: following error, position, velocity, feedrate, spindle. A value 10 times a second, as far back as
// this page has heard them.

import { button, fill, h, setAttr, setText } from "../dom.js";
import { fixed, plain, timeOfDay } from "../format.js";
import { t } from "../language.js";
import { axesOf } from "../model.js";
import { labelled, picker } from "./journal.js";
import { GAP_MS, valuesOf } from "./recorder.js";
import { picture, shape, text } from "./svg.js";

const AGAIN_MS = 500;
const HEIGHT_PX = 260;
const LEFT_PX = 74;
const FOOT_PX = 24;
const TOP_PX = 10;
/** Lines across, besides the lowest. */
const RULES = 4;

/** @type {{quantity: import("./recorder.js").Quantity, name: string, unit: string, isOfAxes: boolean}[]} */
const QUANTITIES = [
  { quantity: "error", name: t("plots.following_error"), unit: t("plots.lengths"), isOfAxes: true },
  { quantity: "position", name: t("plots.position"), unit: t("plots.lengths"), isOfAxes: true },
  { quantity: "velocity", name: t("plots.velocity"), unit: t("plots.velocities"), isOfAxes: true },
  { quantity: "feedrate", name: t("plots.feedrate"), unit: "mm/min", isOfAxes: false },
  { quantity: "spindle", name: t("plots.spindle"), unit: t("unit.rpm"), isOfAxes: false },
];
/** Milliseconds, and in words. @type {[string, string][]} */
const TIMES = [["30000", t("plots.30_seconds")], ["60000", t("plots.1_minute")], ["300000", t("plots.5_minutes")]];

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
  #shown = "";
  #timer;
  element;

  /** @param {import("../main.js").App} app */
  constructor(app) {
    this.#app = app;
    this.#box.append(this.#picture);
    for (const one of [this.#what, this.#time]) one.addEventListener("input", () => this.#draw());
    const head = h("tr", {}, ...[t("plots.curve"), t("plots.now"), t("plots.least"), t("plots.most"), t("plots.range")].map((name) => h("th", { scope: "col" }, name)));
    const table = h("table", { class: "history-table" }, h("thead", {}, head), this.#rows);
    this.element = h("div", { class: "history-part" }, h("div", { class: "history-tools" }, labelled(this.#what), labelled(this.#time), this.#axes), this.#box, h("div", { class: "scroll", tabindex: 0, role: "region", "aria-label": t("plots.the_curves_as_a_table") }, table), this.#note);
    this.#timer = setInterval(() => this.#draw(), AGAIN_MS);
    new ResizeObserver(() => this.#draw()).observe(this.#box);
  }

  close() {
    clearInterval(this.#timer);
  }

  #draw() {
    const { model } = this.#app;
    const system = model.current;
    const wanted = QUANTITIES.find(({ quantity }) => quantity === this.#what.value);
    if (!system || !wanted) return;
    const letters = axesOf(system);
    this.#offer(letters, wanted.isOfAxes);
    const all = model.recorder.of(model.selected);
    const to = all.at(-1)?.at ?? 0;
    const from = to - Number(this.#time.value);
    const samples = all.filter(({ at }) => at >= from);
    const names = wanted.isOfAxes ? letters.filter((letter) => !this.#hidden.has(letter)) : [wanted.name];
    const curves = names.map((name) => ({ name, at: wanted.isOfAxes ? letters.indexOf(name) : 0, values: valuesOf(samples, wanted.quantity, name) }));
    this.#paint(samples, curves, from, to);
    fill(this.#rows, ...curves.map(({ name, at, values }) => row(name, at, values, wanted.unit)));
    setText(this.#note, samples.length < 2 ? t("plots.nothing_has_been_heard_yet") : t("plots.note", { unit: wanted.unit, cs: model.selected }));
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

  /** @param {import("./recorder.js").Sample[]} samples @param {{name: string, at: number, values: number[]}[]} curves @param {number} from @param {number} to */
  #paint(samples, curves, from, to) {
    const width = Math.max(200, this.#box.clientWidth);
    this.#picture.setAttribute("viewBox", `0 0 ${width} ${HEIGHT_PX}`);
    const [least, most] = bounds(curves.flatMap(({ values }) => values));
    const x = (/** @type {number} */ time) => LEFT_PX + ((time - from) / Math.max(1, to - from)) * (width - LEFT_PX - 12);
    const y = (/** @type {number} */ value) => TOP_PX + (1 - (value - least) / (most - least)) * (HEIGHT_PX - FOOT_PX - TOP_PX);
    const rules = Array.from({ length: RULES + 1 }, (_, i) => least + ((most - least) * i) / RULES).flatMap((value) => [
      shape("line", { x1: LEFT_PX, x2: width - 12, y1: y(value), y2: y(value), class: "timeline-mark" }),
      text(LEFT_PX - 6, y(value) + 4, short(value, (most - least) / RULES), "plot-value"),
    ]);
    const times = to === 0 ? [] : [from, (from + to) / 2, to].map((time, i) => text(x(time), HEIGHT_PX - 6, timeOfDay(new Date(time).toISOString()), `plot-time plot-time-${i}`));
    const lines = curves.map(({ at, values }) => {
      const points = values.map((value, i) => {
        const sample = samples[i];
        if (!sample || !Number.isFinite(value)) return "";
        const before = samples[i - 1];
        const joins = before && Number.isFinite(values[i - 1]) && sample.at - before.at <= GAP_MS;
        return `${joins ? "L" : "M"}${x(sample.at).toFixed(1)} ${y(value).toFixed(1)}`;
      });
      return shape("path", { d: points.join(""), class: `curve curve-${at % 8}` });
    });
    this.#picture.replaceChildren(...rules, ...times, ...lines);
  }
}

/** Least and most with room around, never the same. @param {number[]} values @returns {[number, number]} */
function bounds(values) {
  const finite = values.filter(Number.isFinite);
  if (finite.length === 0) return [0, 1];
  const [least, most] = finite.reduce(([low, high], value) => [Math.min(low, value), Math.max(high, value)], [Infinity, -Infinity]);
  const room = Math.max((most - least) * 0.05, 0.0005);
  return [least - room, most + room];
}

/** With as many decimals as tell it from the next rule. @param {number} value @param {number} step to the next rule */
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
