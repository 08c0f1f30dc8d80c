// The state in large letters, and a sentence that explains it.

import { explain } from "../machine/explain.js";
import { announcement, asked, brief, look, sentence } from "../machine/sentence.js";
import { partsSaid } from "../programs/order.js";
import { programName } from "../text/format.js";
import { t } from "../text/language.js";
import { button, h, setAttr, setText } from "../ui/dom.js";
import { icon, setIcon } from "../ui/icons.js";

/** Longest state in large letters, characters. */
const LONG_WORD = 10;
/** Most characters of a program's title; the list of programs shows more. */
const TITLE_CHARS = 40;

/** @type {import("../main.js").View} */
export const status = {
  place: "banner",
  create(app) {
    const sign = icon("ready");
    const word = h("span", { class: "word" });
    const said = h("p", { class: "sentence" });
    const detail = h("p", { class: "detail" });
    const note = h("p", { class: "load-note", role: "status", "data-tone": "attention" });
    const why = button({ class: "button small why", onclick: () => void explain(asking) }, t("common.explain"));
    let asking = "";
    const answer = button({ class: "button answer", hidden: true, onclick: showQuestion }, t("common.answer"));
    const live = h("p", { class: "visually-hidden", "aria-live": "polite" });
    const element = h(
      "section",
      { class: "status", "aria-label": t("status.state") },
      h("div", { class: "state-word" }, sign, word),
      h("div", { class: "said" }, said, note, detail),
      why,
      answer,
      live,
    );
    const render = () => {
      const { model } = app;
      const system = model.current;
      const state = system?.state;
      if (!system || !state) {
        setText(word, "…");
        setText(said, t("elements.waiting_for_the_machine"));
        return;
      }
      const { tone, icon: name, word: text } = look(state, system.pending?.outputs);
      setAttr(element, "data-tone", tone);
      setAttr(document.body, "data-tone", tone);
      setAttr(element, "data-execution", state.execution);
      setIcon(sign, name);
      setText(word, text);
      asking = state.transition ?? state.reason ?? state.execution;
      setAttr(why, "aria-label", t("explain.explain", { what: asking }));
      setAttr(word, "data-long", text.length > LONG_WORD);
      setText(said, sentence(system, model.alarms, (ts) => model.ageMs(ts), model.birth));
      setText(note, noteOfLoad(system));
      setText(detail, details(system, model.programs));
      setAttr(answer, "hidden", state.transition !== null || !asked(state));
      setText(live, announcement(system, model.alarms, model.birth));
    };
    return { element, render };
  },
};

/** States before a start. */
const BEFORE = new Set(["READY", "PROGRAM_COMPLETED", "STOPPED"]);

/**
 * Returns the note with which the load was accepted, until the program runs.
 * @param {import("../machine/model.js").CoordinateSystem} system
 */
function noteOfLoad({ state, note }) {
  if (!state || !note?.text || note.hash !== state.hash || !BEFORE.has(state.execution)) return "";
  return `${note.text.charAt(0).toUpperCase()}${note.text.slice(1).replace(/[^.!?]$/, "$&.")}`;
}

/** Scrolls to the open question. */
function showQuestion() {
  const choice = /** @type {HTMLElement | null} */ (document.querySelector(".asked:not([hidden]) button"));
  choice?.closest(".output")?.scrollIntoView();
  choice?.focus({ preventScroll: true });
}

/**
 * @param {import("../machine/model.js").CoordinateSystem} system
 * @param {import("../types.d.ts").ProgramInfo[] | null} programs
 */
function details({ state, modal, info, interlock, startLock, lease, runState }, programs) {
  const parts = [];
  if (state?.program !== null && state?.program !== undefined) {
    const title = programs?.find((program) => program.number === state.program)?.title;
    parts.push(title ? `${programName(state.program)} ${brief(title, TITLE_CHARS)}` : programName(state.program));
  }
  const ordered = partsSaid(runState?.run);
  if (ordered) parts.push(ordered);
  if (modal?.work_offset) parts.push(modal.work_offset);
  if (modal && info.spindle !== null) parts.push(modal.tool === null ? t("status.tool_unknown") : modal.tool > 0 ? `T${modal.tool}` : t("status.no_tool"));
  if (state?.single_block) parts.push(t("reason.SINGLE_BLOCK"));
  if (interlock?.value) parts.push(lock(t("status.interlock"), interlock));
  if (startLock?.value) parts.push(lock(t("status.start_lock"), startLock));
  if (lease?.holder) parts.push(t("status.control_lease", { holder: lease.holder }));
  if (state?.dry_run) parts.push(t("status.dry_run"));
  return parts.join("  ·  ");
}

/** @param {string} name @param {{text: string}} lock */
function lock(name, { text }) {
  return text ? `${name}: ${text}` : name;
}
