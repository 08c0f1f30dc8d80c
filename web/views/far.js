// The screen for reading from three metres: state, sentence, positions, program; its frame has the colour of the state.

import { axesOf } from "../machine/model.js";
import { brief, look, sentence } from "../machine/sentence.js";
import { position, programName } from "../text/format.js";
import { t } from "../text/language.js";
import { scaleOf } from "../text/units.js";
import { fill, h, setAttr, setText } from "../ui/dom.js";
import { icon, setIcon } from "../ui/icons.js";

/** Most characters of the sentence. */
const SENTENCE_CHARS = 110;

/** @type {import("../main.js").View} */
export const far = {
  place: "far",
  create(app) {
    const sign = icon("ready");
    const word = h("span", {});
    const said = h("p", { class: "far-sentence" });
    const program = h("p", { class: "far-program" });
    const axes = h("dl", { class: "far-axes" });
    const element = h("section", { class: "far", "aria-label": t("far.from_three_metres") }, h("div", { class: "far-state" }, sign, word), said, axes, program);
    /** @type {[string, HTMLElement, HTMLElement][]} */
    let cells = [];
    let shown = "";
    const render = () => {
      const { model } = app;
      const system = model.current;
      if (!model.far || !system?.state) return;
      const letters = axesOf(system);
      const key = `${system.info.number} ${letters.join("")}`;
      if (key !== shown) {
        shown = key;
        cells = letters.map((axis) => [axis, h("dd", {}), h("small", {})]);
        fill(axes, ...cells.map(([axis, cell, unit]) => h("div", {}, h("dt", {}, axis, unit), cell)));
        axes.style.setProperty("--rows", String(Math.ceil(letters.length / 2)));
      }
      const { tone, icon: name, word: text } = look(system.state, system.pending?.outputs);
      setAttr(element, "data-tone", tone);
      setIcon(sign, name);
      setText(word, text);
      setText(said, brief(sentence(system, model.alarms, (ts) => model.ageMs(ts), model.birth), SENTENCE_CHARS));
      for (const [axis, cell, unit] of cells) {
        const scale = scaleOf(model, axis);
        setText(cell, position(system.position?.work[axis], scale));
        setText(unit, scale.unit);
      }
      const title = model.programs?.find((one) => one.number === system.state?.program)?.title ?? "";
      const line = system.place?.line ? `  ${t("common.line", { line: system.place.line })}` : "";
      setText(program, system.state.program === null ? t("far.no_program") : `${programName(system.state.program)} ${brief(title, 40)}${line}`);
    };
    return { element, render };
  },
};
