// Touches with a probe: edges, corners, bores, bosses, the top of a part, tool lengths. Each is a cycle with a preview before it runs.

import { disableFor, whyNot, whyNotNow } from "../access/why_not.js";
import { dialect } from "../dialects/dialects.js";
import { position, readNumber } from "../text/format.js";
import { sentences, t } from "../text/language.js";
import { isRotary, lengthScale, unitOf } from "../text/units.js";
import { button, fill, h, setAttr, setText } from "../ui/dom.js";
import { icon } from "../ui/icons.js";
import { AXES, cycleOf, foundBy } from "./cycles.js";
import { Planned } from "./planned.js";
import { runCycle } from "./touching.js";
import { Undo } from "./values.js";

/** @typedef {import("./cycles.js").Kind} Kind */
/** @typedef {import("./cycles.js").Letter} Letter */
/** @typedef {"distance" | "feed" | "ball" | "clearance" | "size" | "depth" | "tip" | "setter"} Value */

const KEY = "tandem-probe";

/** Inputs of each cycle. @type {Record<Kind, Value[]>} */
const VALUES = {
  edge: ["distance", "ball", "feed"],
  corner: ["distance", "clearance", "ball", "feed"],
  bore: ["distance", "ball", "feed"],
  boss: ["size", "clearance", "depth", "distance", "ball", "feed"],
  surface: ["distance", "tip", "feed"],
  length: ["distance", "setter", "feed"],
};
/** Names and descriptions of the cycles. @type {Record<Kind, [string, string]>} */
const TEXTS = {
  edge: [t("probe.edge"), t("probe.edge_about")],
  corner: [t("probe.corner"), t("probe.corner_about")],
  bore: [t("probe.bore"), t("probe.bore_about")],
  boss: [t("probe.boss"), t("probe.boss_about")],
  surface: [t("probe.surface"), t("probe.surface_about")],
  length: [t("probe.length"), t("probe.length_about")],
};
/** Names of values, with their units. @type {Record<Value, (unit: string) => string>} */
const LABELS = {
  distance: (unit) => t("probe.value_distance", { unit }),
  feed: (unit) => t("probe.value_feed", { unit: `${unit}/min` }),
  ball: (unit) => t("probe.value_ball", { unit }),
  clearance: (unit) => t("probe.value_clearance", { unit }),
  size: (unit) => t("probe.value_size", { unit }),
  depth: (unit) => t("probe.value_depth", { unit }),
  tip: (unit) => t("probe.value_tip", { unit }),
  setter: (unit) => t("probe.value_setter", { unit }),
};
const KINDS = /** @type {Kind[]} */ (Object.keys(VALUES));
/** Inputs that must be greater than 0. */
const POSITIVE = new Set(["distance", "feed", "size", "depth"]);
/** Inputs that may be negative. */
const SIGNED = new Set(["setter"]);
/** Inputs used by manual touches. @type {Set<Value>} */
const BY_HAND = new Set(["ball", "tip", "setter"]);
/** Typed values that are larger are rejected, mm or mm/min. */
const VALUE_MAX = 100_000;

/** Initial values, mm and mm/min. @type {Record<Value, number>} */
const FIRST = { distance: 20, feed: 500, ball: 4, clearance: 5, size: 30, depth: 5, tip: 0, setter: 0 };

/** Directions in which the part lies. @type {Partial<Record<Kind, [string, Letter, 1 | -1, 1 | -1][]>>} */
const DIRECTIONS = {
  edge: [["X+", "X", 1, 1], ["X\u2212", "X", -1, 1], ["Y+", "Y", 1, 1], ["Y\u2212", "Y", 1, -1]],
  corner: [["X+ Y+", "X", 1, 1], ["X\u2212 Y+", "X", -1, 1], ["X\u2212 Y\u2212", "X", -1, -1], ["X+ Y\u2212", "X", 1, -1]],
};

/** @type {import("./values.js").Section} */
export const probe = { title: t("probe.probe"), create: (app) => new Probe(app) };

class Probe {
  /** @type {Kind} */
  #kind = "edge";
  #direction = 0;
  #offset = "G54";
  #values = stored();
  #shown = "";
  /** Reason why the last cycle has no result, and the result. */
  #trouble = "";
  /** @type {import("./cycles.js").Found | null} */
  #found = null;
  #runs = false;
  /** Machine positions of the manual touches, in the order of the cycle. @type {number[]} */
  #taken = [];
  #planned;
  #undo;
  #kinds = KINDS.map((kind) => button({ class: "button pick", role: "radio", onclick: () => this.#choose(kind) }, TEXTS[kind][0]));
  #about = h("p", { class: "muted note" });
  #directions = h("div", { class: "choice", role: "radiogroup", "aria-label": t("probe.where_the_part_lies") });
  #fields = h("div", { class: "probe-fields" });
  #look = button({ onclick: () => void this.#preview() }, icon("search"), t("probe.preview"));
  #run = button({ class: "button primary", onclick: () => void this.#touch() }, icon("play"), t("probe.run"));
  #here = button({ onclick: () => this.#touchesNow() }, t("probe.touches_now"));
  #byHand = h("p", { class: "muted note", role: "status" });
  #text = h("pre", { class: "probe-text", tabindex: 0, "aria-label": t("probe.text_of_the_cycle") });
  #said = h("p", { class: "probe-said", role: "status" });
  #result = h("div", { class: "probe-result" });
  element;

  /** @param {import("../main.js").App} app */
  constructor(app) {
    this.app = app;
    this.#planned = new Planned(app);
    this.#undo = new Undo(app, () => {});
    this.element = h(
      "div",
      { class: "probe" },
      h("div", { class: "choice", role: "radiogroup", "aria-label": t("probe.cycle") }, ...this.#kinds),
      this.#about,
      this.#directions,
      this.#fields,
      h("div", { class: "row wrap" }, this.#look, this.#run),
      h("div", { class: "row wrap" }, this.#here, this.#byHand),
      this.#said,
      this.#result,
      this.#text,
      h("div", { class: "row end" }, this.#undo.element),
    );
  }

  read() {
    this.#shown = "";
  }

  render() {
    const { model } = this.app;
    const system = model.current;
    if (!system) return;
    const scale = lengthScale(unitOf(system));
    const known = KINDS.filter((kind) => AXES[kind].every((axis) => axis in system.info.axes && !isRotary(model, axis)));
    const key = JSON.stringify([model.selected, this.#kind, this.#direction, scale.unit, known]);
    if (key !== this.#shown) {
      this.#shown = key;
      this.#build(scale);
    }
    for (const [i, pick] of this.#kinds.entries()) {
      const kind = KINDS[i] ?? "edge";
      setAttr(pick, "aria-checked", String(kind === this.#kind));
      disableFor(pick, known.includes(kind) ? null : t("probe.needs_axes", { axes: AXES[kind].join(" ") }));
    }
    const why = this.#whyNot();
    const plan = this.#planned;
    plan.render(this.#keyOf());
    disableFor(this.#look, why ?? (plan.isAsked ? t("path.planning") : null), t("probe.preview_about"));
    disableFor(this.#run, why ?? whyNot(model, "mdi") ?? plan.whyNot(), t("probe.run_about"));
    disableFor(this.#here, this.#whyNotByHand(), t("probe.touches_now_about"));
    setText(this.#byHand, this.#aboutTouch());
    const text = plan.cycle?.text ?? "";
    setText(this.#text, text);
    setAttr(this.#text, "hidden", text === "");
    setText(this.#said, this.#runs ? t("probe.runs") : sentences(this.#trouble, plan.says()));
    setAttr(this.#said, "data-tone", this.#trouble || plan.trouble ? "alarm" : null);
    this.#undo.render();
    for (const one of this.#result.querySelectorAll("button")) disableFor(one, whyNotNow(model));
  }

  /** @param {Kind} kind */
  #choose(kind) {
    this.#kind = kind;
    this.#direction = 0;
    this.#trouble = "";
    this.#found = null;
    this.#taken = [];
    this.#shown = "";
    this.app.invalidate();
  }

  /** @param {ReturnType<typeof lengthScale>} scale */
  #build(scale) {
    setText(this.#about, sentences(TEXTS[this.#kind][1], t("probe.speed_of_touches")));
    const directions = DIRECTIONS[this.#kind] ?? [];
    const pick = (/** @type {number} */ i) => button({ class: "button pick", role: "radio", "aria-checked": String(i === this.#direction), onclick: () => {
      this.#direction = i;
      this.#taken = [];
      this.app.invalidate();
    } }, directions[i]?.[0] ?? "");
    fill(this.#directions, ...directions.map((_, i) => pick(i)));
    setAttr(this.#directions, "hidden", directions.length === 0);
    fill(this.#fields, ...VALUES[this.#kind].map((name) => this.#field(name, scale)));
    this.#showState();
  }

  /** @param {Value} name @param {ReturnType<typeof lengthScale>} scale */
  #field(name, { unit, size, decimals }) {
    const label = LABELS[name](unit);
    const input = h("input", { type: "text", inputmode: "decimal", class: "input value", autocomplete: "off", value: Number.isNaN(this.#values[name]) ? "" : position(this.#values[name], { size, decimals }) });
    input.addEventListener("input", () => {
      const value = readNumber(input.value) * size;
      const isRight = Math.abs(value) <= VALUE_MAX && (SIGNED.has(name) || value >= 0) && (!POSITIVE.has(name) || value > 0);
      setAttr(input, "aria-invalid", !isRight);
      this.#values[name] = isRight ? value : Number.NaN;
      if (isRight) keep(this.#values);
      this.app.invalidate();
    });
    return h("label", {}, h("span", { class: "label" }, label), input);
  }

  /** @returns {import("./cycles.js").Asked} */
  #asked() {
    const [, axis = "Z", x = 1, y = 1] = DIRECTIONS[this.#kind]?.[this.#direction] ?? [];
    const { setter, tip, ...values } = this.#values;
    return { ...values, tip: this.#kind === "length" ? setter : tip, axis, x, y };
  }

  /** Returns the key of a preview, which is valid until one of these values changes. */
  #keyOf() {
    const { model } = this.app;
    const machine = Object.entries(model.current?.position?.machine ?? {}).map(([axis, at]) => [axis, at.toFixed(3)]);
    return JSON.stringify([model.bootId, model.selected, this.#kind, this.#asked(), machine]);
  }

  /** Returns the reason why no preview is possible. */
  #whyNot() {
    const { model } = this.app;
    if (this.#runs) return t("probe.runs");
    if (!dialect(model.current?.info.dialect).hasProbeCycles) return t("probe.no_g31", { dialect: model.current?.info.dialect });
    if (VALUES[this.#kind].some((name) => Number.isNaN(this.#values[name]))) return t("probe.write_all_values");
    const state = model.current?.state?.execution ?? "";
    return whyNotNow(model) ?? (["ACTIVE", "WAIT"].includes(state) ? t("offsets.a_run_is_on_zero") : null);
  }

  /** Returns the cycle from the tool's position; null if the position is unknown. */
  #cycle() {
    const { current } = this.app.model;
    if (!current?.position) return null;
    const { machine } = current.position;
    const { axes } = current.info;
    const motors = Object.values(axes).sort((a, b) => a - b);
    const of = (/** @type {Letter} */ axis) => motors.indexOf(axes[axis] ?? -1);
    const start = { X: machine.X ?? 0, Y: machine.Y ?? 0, Z: machine.Z ?? 0 };
    return cycleOf(this.#kind, start, this.#asked(), { X: of("X"), Y: of("Y"), Z: of("Z") });
  }

  async #preview() {
    const cycle = this.#cycle();
    if (!cycle) return;
    this.#forget();
    await this.#planned.plan(this.#keyOf(), cycle);
  }

  async #touch() {
    const { cycle } = this.#planned;
    if (!cycle) return;
    const [kind, asked] = [this.#kind, this.#asked()];
    this.#forget();
    this.#runs = true;
    this.app.invalidate();
    const isDone = await this.app.attempt(async () => {
      try {
        this.#found = foundBy(kind, asked, cycle.touches, await runCycle(this.app, cycle));
      } catch (error) {
        this.#trouble = error instanceof Error ? sentences(error.message, t("probe.nothing_was_written")) : "";
        throw error;
      }
    }).finally(() => {
      this.#runs = false;
    });
    if (isDone) this.#planned.forget();
    this.#showState();
    this.app.invalidate();
  }

  #whyNotByHand() {
    const { model } = this.app;
    if (this.#runs) return t("probe.runs");
    const isValue = (/** @type {Value} */ name) => BY_HAND.has(name) && VALUES[this.#kind].includes(name) && Number.isNaN(this.#values[name]);
    if ([...BY_HAND].some(isValue)) return t("probe.write_all_values");
    return whyNotNow(model) ?? (["ACTIVE", "WAIT"].includes(model.current?.state?.execution ?? "") ? t("offsets.a_run_is_on_zero") : null);
  }

  /** Returns the text for the next manual touch. */
  #aboutTouch() {
    const touches = this.#cycle()?.touches ?? [];
    const next = touches[this.#taken.length];
    if (!next || this.#found) return "";
    const way = `${next.axis}${next.sign > 0 ? "+" : "\u2212"}`;
    return t("probe.by_hand", { number: this.#taken.length + 1, count: touches.length, way });
  }

  /** Records the position of the tool as the next manual touch of the cycle. */
  #touchesNow() {
    const cycle = this.#cycle();
    if (!cycle) return;
    const taken = this.#found ? [] : this.#taken;
    const { axis } = cycle.touches[taken.length] ?? { axis: "Z" };
    const now = [...taken, this.app.model.current?.position?.machine[axis] ?? Number.NaN];
    this.#forget();
    if (now.length < cycle.touches.length) this.#taken = now;
    else this.#found = foundBy(this.#kind, this.#asked(), cycle.touches, now);
    this.#showState();
    this.app.invalidate();
  }

  #forget() {
    this.#trouble = "";
    this.#found = null;
    this.#taken = [];
    this.#showState();
  }

  /** Shows the results and the possible actions. */
  #showState() {
    const found = this.#found;
    const scale = lengthScale(unitOf(this.app.model.current));
    const said = (/** @type {string} */ name, /** @type {number} */ value) => h("div", {}, h("dt", {}, name), h("dd", {}, `${position(value, scale)} ${scale.unit}`));
    if (!found) return fill(this.#result);
    const values = Object.entries(found.zero).map(([axis, value]) => said(t("probe.machine_position", { axis }), value));
    if (found.diameter !== undefined) values.push(said(t("probe.diameter"), found.diameter));
    if (found.length !== undefined) values.push(said(t("probe.length_of_tool"), found.length));
    fill(this.#result, h("dl", { class: "probe-found" }, ...values), found.length === undefined ? this.#zeroForm(found.zero) : this.#toolForm(found.length));
  }

  /** @param {import("./cycles.js").Found["zero"]} zero */
  #zeroForm(zero) {
    const axes = Object.keys(zero);
    const { workOffsets } = dialect(this.app.model.current?.info.dialect);
    if (!workOffsets.includes(this.#offset)) this.#offset = workOffsets[0] ?? "";
    const names = h("select", { class: "input", "aria-label": t("offsets.work_offset") }, ...workOffsets.map((name) => h("option", { value: name, selected: name === this.#offset }, name)));
    names.addEventListener("change", () => {
      this.#offset = names.value;
    });
    const set = button({ class: "button primary", onclick: () => void this.#setZero(zero) }, t("probe.set_zero", { axes: axes.join(" ") }));
    return h("div", { class: "row end" }, names, set);
  }

  /** @param {import("./cycles.js").Found["zero"]} zero */
  async #setZero(zero) {
    const { api, model } = this.app;
    const [cs, name] = [model.selected, this.#offset];
    const axes = Object.keys(zero);
    await this.app.attempt(async () => {
      const now = (await api.workOffsets(cs))[name] ?? {};
      const before = Object.fromEntries(axes.map((axis) => [axis, now[axis] ?? 0]));
      const set = (/** @type {Record<string, number>} */ to) => () => api.setWorkOffsets(cs, { [name]: to });
      await this.#undo.do(t("probe.zero_was_set", { offset: name, axes: axes.join(" ") }), set(/** @type {Record<string, number>} */ (zero)), set(before));
    });
  }

  /** @param {number} length */
  #toolForm(length) {
    const number = h("input", { type: "number", class: "input editor-number", min: 1, max: 65535, step: 1, value: this.app.model.current?.modal?.tool || "", "aria-label": t("probe.tool_number") });
    const write = button({ class: "button primary", onclick: () => void this.#writeLength(number.valueAsNumber, length) }, t("probe.write_length"));
    return h("div", { class: "row end" }, h("span", { class: "label" }, "T"), number, write);
  }

  /** @param {number} id @param {number} length */
  async #writeLength(id, length) {
    const { api, toast } = this.app;
    if (!(id >= 1)) return toast(t("tools.write_the_number_of_the"), "error");
    await this.app.attempt(async () => {
      const known = (await api.tools()).find((tool) => tool.id === id);
      const back = known ? { tools: [known] } : { remove: [id] };
      const change = { tools: [{ radius: 0, ...known, id, length }] };
      await this.#undo.do(known ? t("tools.t_was_changed", { id }) : t("tools.t_was_added", { id }), () => api.changeTools(change), () => api.changeTools(back));
    });
  }
}

/** Returns the values stored in this browser. @returns {Record<Value, number>} */
function stored() {
  try {
    const kept = JSON.parse(localStorage.getItem(KEY) ?? "{}");
    return /** @type {Record<Value, number>} */ (Object.fromEntries(Object.entries(FIRST).map(([name, value]) => [name, Number.isFinite(kept[name]) ? kept[name] : value])));
  } catch {
    return { ...FIRST };
  }
}

/** @param {Record<Value, number>} values */
function keep(values) {
  try {
    localStorage.setItem(KEY, JSON.stringify(values));
  } catch {
    // without storage they last until the page is closed
  }
}
