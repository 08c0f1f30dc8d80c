// Elements that show a machine, for third-party pages: <tandem-state>, <tandem-dro>, <tandem-m-codes> and <tandem-path>. Each has the
// attributes `cs` (coordinate system, without it the first one) and `url` (of the machine, without it the server of the page).

import { axesOf } from "../machine/model.js";
import { look, sentence } from "../machine/sentence.js";
import { duration, params, position, seconds } from "../text/format.js";
import { t } from "../text/language.js";
import { fill, h, setAttr, setText } from "../ui/dom.js";
import { icon, setIcon } from "../ui/icons.js";
import { machineAt, TandemElement } from "./element.js";
import { TandemPath } from "./path_element.js";

export { machineAt, TandemElement };

/** @typedef {import("../machine/model.js").CoordinateSystem} CoordinateSystem */

/** State word and sentence. */
class TandemState extends TandemElement {
  #sign = icon("ready");
  #word = h("strong", {});
  #said = h("p", {}, t("elements.waiting_for_the_machine"));

  constructor() {
    super(STATE);
    this.root.append(h("div", { class: "state", role: "status" }, h("span", { class: "word" }, this.#sign, this.#word), this.#said));
  }

  /** @override @param {CoordinateSystem} system */
  render(system) {
    const { state } = system;
    if (!state) return;
    const { tone, icon: name, word } = look(state, system.pending?.outputs);
    setAttr(this, "tone", tone);
    setIcon(this.#sign, name);
    setText(this.#word, word);
    setText(this.#said, this.#trouble() ?? sentence(system, this.model.alarms, (ts) => this.model.ageMs(ts), this.model.birth));
  }

  /** Returns why the data is not current; null if it is. */
  #trouble() {
    const { online, staleMs } = this.model;
    if (!online) return t("connection.lost");
    return staleMs > 0 ? t("connection.stale", { seconds: seconds(staleMs / 1000, 1) }) : null;
  }
}

/** Positions of the axes: attribute `of` is `work` (without it), `machine` or `distance_to_go`. */
class TandemDro extends TandemElement {
  #list = h("dl", {});
  #shown = "";

  constructor() {
    super(DRO);
    this.root.append(this.#list);
  }

  /** @override @param {CoordinateSystem} system */
  render(system) {
    const axes = axesOf(system);
    if (axes.join() !== this.#shown) {
      this.#shown = axes.join();
      fill(this.#list, ...axes.map((axis) => h("div", {}, h("dt", {}, axis), h("dd", { "data-axis": axis }))));
    }
    const of = this.getAttribute("of") ?? "work";
    const values = of === "machine" || of === "distance_to_go" ? system.position?.[of] : system.position?.work;
    for (const cell of this.#list.querySelectorAll("dd")) {
      const axis = cell.dataset.axis ?? "";
      const isNotHomed = system.position?.homed?.[axis] === false;
      setText(cell, position(values?.[axis]));
      setAttr(cell, "data-not-homed", isNotHomed);
      setAttr(cell, "title", isNotHomed ? t("homed.is_not_homed", { axis }) : null);
    }
  }
}

/** Open M codes, with progress and questions of their handlers. With `answers` the operator answers here. */
class TandemMCodes extends TandemElement {
  #list = h("ul", { "aria-label": t("elements.open_m_codes") });
  #none = h("p", { class: "muted" }, t("elements.no_m_code_is_open"));
  #shown = "";

  constructor() {
    super(M_CODES);
    this.root.append(this.#list, this.#none);
  }

  /** @override @param {CoordinateSystem} system */
  render(system) {
    const outputs = system.pending?.outputs ?? [];
    const key = JSON.stringify([outputs, this.hasAttribute("answers")]);
    if (key !== this.#shown) {
      this.#shown = key;
      fill(this.#list, ...outputs.map((output) => this.#entry(output)));
    }
    setAttr(this.#none, "hidden", outputs.length > 0);
    for (const age of this.#list.querySelectorAll("time")) setText(age, duration(this.model.ageMs(age.dateTime)));
  }

  /** @param {import("../types.d.ts").PendingOutput} output */
  #entry({ m, seq, params: given, handler_id, progress, question, since }) {
    const said = progress?.text ?? (handler_id ? t("elements.works_on_it", { handler: handler_id }) : t("m_codes.no_handler"));
    const asked = question?.answer === undefined ? question : undefined;
    const choose = (/** @type {string} */ choice) => {
      const body = { boot_id: this.model.bootId, question_id: asked?.id, choice, client_id: "page" };
      void this.attempt(() => this.tandem.request("POST", `/cs/${this.cs}/m_codes/${seq}/answer`, { body }));
    };
    const choices = asked && this.hasAttribute("answers") ? asked.choices.map((choice) => h("button", { type: "button", onclick: () => choose(choice) }, choice)) : [];
    return h(
      "li",
      { "data-m": m },
      h("div", {}, h("strong", {}, `M${m}`), ` ${params(given)}`, h("time", { datetime: since })),
      h("p", {}, asked ? asked.text : said),
      progress?.percent !== undefined && h("progress", { max: 100, value: progress.percent, "aria-label": t("elements.progress_of_m", { m }) }),
      choices.length > 0 && h("div", { class: "choices", role: "group", "aria-label": t("common.answer") }, ...choices),
    );
  }
}

const STATE = `
.state { border-left: 10px solid var(--tone, var(--ready)); padding: 0.4em 0.8em; background: var(--card); }
.word { display: flex; align-items: center; gap: 0.4em; font-size: 1.6em; color: var(--tone, var(--ready)); }
.icon { width: 1em; height: 1em; fill: currentcolor; flex: none; }
p { margin: 0.2em 0 0; }
${["active", "wait", "attention", "alarm", "done", "ended"].map((tone) => `:host([tone="${tone}"]) { --tone: var(--${tone}); }`).join("\n")}
`;

const DRO = `
dl { margin: 0; display: grid; gap: 0.1em; }
dl div { display: flex; justify-content: space-between; align-items: baseline; gap: 1em; border-bottom: 1px solid var(--line); }
dt { color: var(--muted); font-weight: 600; }
dd { margin: 0; font: 1.8em/1.3 ui-monospace, "DejaVu Sans Mono", monospace; font-variant-numeric: tabular-nums; }
dd[data-not-homed] { color: var(--muted); text-decoration: underline wavy 1.5px var(--attention); }
`;

const M_CODES = `
ul { list-style: none; margin: 0; padding: 0; display: grid; gap: 0.6em; }
li { border: 1px solid var(--line); border-radius: 8px; padding: 0.5em 0.8em; background: var(--card); }
li > div:first-child { display: flex; gap: 0.5em; }
time { margin-left: auto; color: var(--muted); }
p { margin: 0.2em 0; }
progress { width: 100%; accent-color: var(--accent); }
.choices { display: flex; flex-wrap: wrap; gap: 0.5em; margin-top: 0.4em; }
`;

customElements.define("tandem-state", TandemState);
customElements.define("tandem-dro", TandemDro);
customElements.define("tandem-m-codes", TandemMCodes);
customElements.define("tandem-path", TandemPath);
