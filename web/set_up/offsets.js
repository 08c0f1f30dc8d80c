// Work offsets: their values, and setting of zero at the position of the tool or of a touch.

import { disableFor, whyNot, whyNotNow } from "../access/why_not.js";
import { dialect } from "../dialects/dialects.js";
import { axesOf } from "../machine/model.js";
import { position } from "../text/format.js";
import { sentences, t } from "../text/language.js";
import { scaleOf } from "../text/units.js";
import { button, fill, h, setAttr, setText } from "../ui/dom.js";
import { numberField, Undo } from "./values.js";

/** Codes that rotate, scale or mirror positions, by modal group, with their end codes: with them, one axis offset does
 * not define zero. */
const TURNS = [{ group: "16", code: "G68", end: "G69" }, { group: "11", code: "G51", end: "G50" }, { group: "22", code: "G51.1", end: "G50.1" }];
/** Resolution of the published positions, mm or degrees. */
const NEAR = 0.0015;

/** @type {import("./values.js").Section} */
export const offsets = { title: t("offsets.offsets"), create: (app) => new Offsets(app) };

class Offsets {
  #name = "G54";
  /** @type {Record<string, Record<string, number>>} */
  #values = {};
  /** Work position of the first of two points whose middle becomes zero, by axis. @type {Map<string, number>} */
  #marks = new Map();
  #key = "";
  /** Last published offsets and tools. @type {unknown[]} */
  #applied = [];
  /** Names of the work offsets of the dialect, each with its button. @type {Map<string, HTMLButtonElement>} */
  #picks = new Map();
  #choice = h("div", { class: "choice", role: "radiogroup", "aria-label": t("offsets.work_offset") });
  /** @type {import("../types.d.ts").ToolData[]} */
  #tools = [];
  #body = h("div", { class: "offset-rows" });
  #note = h("p", { class: "muted", role: "status" });
  #use = button({ onclick: () => this.app.command("mdi", { text: this.#name }) });
  #undo;
  /** @type {{axis: string, render: () => void, forget: () => void}[]} */
  #rows = [];

  /** @param {import("../main.js").App} app */
  constructor(app) {
    this.app = app;
    this.#undo = new Undo(app, () => this.read());
    this.#buildPicks();
    this.element = h(
      "div",
      { class: "offsets" },
      this.#choice,
      this.#body,
      this.#note,
      h("div", { class: "row end" }, this.#undo.element, this.#use),
    );
  }

  async read() {
    const { api, model } = this.app;
    await this.app.attempt(async () => {
      [this.#values, this.#tools] = await Promise.all([api.workOffsets(model.selected), api.tools()]);
    });
    this.app.invalidate();
  }

  /** Builds a button for each work offset if the dialect has others than those shown. */
  #buildPicks() {
    const { workOffsets } = dialect(this.app.model.current?.info.dialect);
    if (workOffsets.join() === [...this.#picks.keys()].join()) return;
    this.#picks = new Map(workOffsets.map((name) => [name, button({ class: "button pick", role: "radio", onclick: () => this.#choose(name) }, name)]));
    fill(this.#choice, ...this.#picks.values());
    if (!this.#picks.has(this.#name)) this.#choose(workOffsets[0] ?? "");
  }

  /**
   * Replaces the values by the published ones.
   * @param {import("../types.d.ts").WorkOffsetValuesMessage | null} offsets @param {import("../types.d.ts").ToolTableMessage | null} tools
   */
  #setValues(offsets, tools) {
    if (this.#applied[0] === offsets && this.#applied[1] === tools) return;
    this.#applied = [offsets, tools];
    if (offsets !== null) this.#values = offsets.work_offsets;
    if (tools !== null) this.#tools = tools.tools;
  }

  render() {
    const { model } = this.app;
    const system = model.current;
    if (!system) return;
    this.#setValues(system.workOffsets, model.tools);
    const key = `${model.selected} ${Object.keys(system.info.axes).join("")}`;
    if (key !== this.#key) {
      this.#key = key;
      this.#marks.clear();
      this.#rows = axesOf(system).map((axis) => this.#row(axis));
    }
    this.#buildPicks();
    for (const [name, pick] of this.#picks) setAttr(pick, "aria-checked", String(name === this.#name));
    for (const row of this.#rows) row.render();
    this.#undo.render();
    const active = system.modal?.work_offset;
    setText(this.#note, sentences(active ? t("offsets.in_force", { offset: active }) : t("offsets.none_in_force"), t("offsets.counts_from", { offset: this.#name }), this.#whyNotStraight() ?? this.#elsewhere(), this.#aboutLength()));
    setText(this.#use, t("offsets.use", { offset: this.#name }));
    disableFor(this.#use, whyNot(model, "mdi"), t("offsets.use_about", { offset: this.#name }));
  }

  /** @param {string} name */
  #choose(name) {
    this.#name = name;
    this.#marks.clear();
    this.#rows.forEach((row) => row.forget());
    this.app.invalidate();
  }

  /** @param {string} axis */
  #row(axis) {
    const { model } = this.app;
    const field = numberField(this.app, t("offsets.offset", { axis }), (value) => void this.#store(axis, value));
    const here = numberField(this.app, t("offsets.is_here", { axis }), (value) => {
      void this.#touch(axis, value);
      here.element.value = "";
    });
    const unit = h("small", { class: "unit" });
    here.element.placeholder = t("offsets.is");
    const zero = button({ class: "button", onclick: () => void this.#touch(axis, 0) }, `${axis} = 0`);
    const middle = button({ class: "button", onclick: () => this.#middle(axis) });
    const row = h("div", { class: "offset-row", "data-axis": axis }, h("strong", {}, axis, unit), field.element, zero, here.element, middle);
    if (this.#body.querySelector(`[data-axis="${axis}"]`) === null) this.#body.append(row);
    else this.#body.querySelector(`[data-axis="${axis}"]`)?.replaceWith(row);
    const render = () => {
      const scale = scaleOf(model, axis);
      setText(unit, scale.unit);
      field.show(position(this.#values[this.#name]?.[axis] ?? 0, scale), scale);
      here.show("", scale);
      const marked = this.#marks.get(axis);
      setText(middle, marked === undefined ? t("offsets.1st", { axis }) : t("offsets.2nd", { axis }));
      setAttr(middle, "aria-label", marked === undefined ? t("offsets.first_edge_of_the_middle", { axis }) : t("offsets.second_edge_of_the_middle", { axis }));
      const why = whyNotNow(model) ?? this.#whyNotStanding() ?? this.#whyNotStraight() ?? this.#whyNoLength(axis);
      disableFor(field.element, whyNotNow(model));
      disableFor(zero, why, t("offsets.zero_of_is_where_the", { axis }));
      disableFor(here.element, why, t("offsets.the_tool_stands_at_this", { axis }));
      disableFor(middle, why, t("offsets.touch_both_sides_of_a"));
    };
    const forget = () => [field, here].forEach((one) => one.forget());
    return { axis, render, forget };
  }

  /** Returns the reason why zero cannot be set: only at rest. */
  #whyNotStanding() {
    const execution = this.app.model.current?.state?.execution ?? "";
    return ["ACTIVE", "WAIT"].includes(execution) ? t("offsets.a_run_is_on_zero") : null;
  }

  /** Returns the reason why zero cannot be set: positions must differ from machine positions by an offset only. */
  #whyNotStraight() {
    const { modal } = this.app.model.current ?? {};
    const turn = TURNS.find(({ group, code }) => modal?.g[group] === code);
    return turn ? t("offsets.turned", turn) : null;
  }

  /** Returns a text if positions have another zero than that of the offset in force; otherwise an empty text. */
  #elsewhere() {
    const { position: at, modal, info } = this.app.model.current ?? {};
    const values = this.#values[modal?.work_offset ?? ""];
    if (!at || !values || !modal) return "";
    const length = this.#length();
    const isElsewhere = Object.keys(info?.axes ?? {}).some((axis) => {
      if (axis === "Z" && length === undefined) return false;
      const zero = (at.machine[axis] ?? 0) - (at.work[axis] ?? 0);
      return Math.abs(zero - (values[axis] ?? 0) - (axis === "Z" ? (length?.adds ?? 0) : 0)) > NEAR;
    });
    return isElsewhere ? t("offsets.elsewhere", { offset: modal.work_offset }) : "";
  }

  /**
   * Returns the tool length in force and its amount in Z; null if none is in force, undefined if the length is unknown.
   * @returns {{code: string, tool: number, adds: number} | null | undefined}
   */
  #length() {
    const { current } = this.app.model;
    const code = current?.modal?.g["08"] ?? "G49";
    if (code === "G49") return null;
    const tool = this.#tools.find(({ id }) => id === current?.modal?.tool);
    if (!tool || !dialect(current?.info.dialect).usesSpindleToolLength) return undefined;
    return { code, tool: tool.id, adds: code === "G44" ? -tool.length : tool.length };
  }

  #aboutLength() {
    const length = this.#length();
    if (length === null) return t("offsets.without_length");
    const scale = scaleOf(this.app.model, "Z");
    return length ? t("offsets.length_is_off", { code: length.code, tool: length.tool, length: `${position(Math.abs(length.adds), scale)} ${scale.unit}` }) : this.#whyNoLength("Z") ?? "";
  }

  /** @param {string} axis */
  #whyNoLength(axis) {
    if (axis !== "Z" || this.#length() !== undefined) return null;
    return t("offsets.length_is_not_known", { code: this.app.model.current?.modal?.g["08"] });
  }

  /** Sets the work position of the present position of the tool. @param {string} axis @param {number} value */
  async #touch(axis, value) {
    await this.read();
    const offset = this.#offsetFor(axis, value);
    if (offset !== null) await this.#store(axis, offset);
  }

  /** Returns the offset that gives the axis a work position; for Z, of the tool tip if the length is in force. @param {string} axis @param {number} value */
  #offsetFor(axis, value) {
    const machine = this.app.model.current?.position?.machine[axis];
    const length = axis === "Z" ? this.#length() : null;
    if (machine === undefined || length === undefined) return null;
    return machine - value - (length?.adds ?? 0);
  }

  /** @param {string} axis */
  #middle(axis) {
    const zero = this.#offsetFor(axis, 0);
    if (zero === null) return;
    const first = this.#marks.get(axis);
    if (first === undefined) this.#marks.set(axis, zero);
    else {
      this.#marks.delete(axis);
      void this.#store(axis, (first + zero) / 2);
    }
    this.app.invalidate();
  }

  /** @param {string} axis @param {number} value mm or degrees */
  async #store(axis, value) {
    const cs = this.app.model.selected;
    const name = this.#name;
    const before = this.#values[name]?.[axis] ?? 0;
    const scale = scaleOf(this.app.model, axis);
    const set = (/** @type {number} */ to) => () => this.app.api.setWorkOffsets(cs, { [name]: { [axis]: to } });
    await this.#undo.do(t("offsets.was", { offset: name, axis, value: `${position(before, scale)} ${scale.unit}` }), set(value), set(before));
  }
}

