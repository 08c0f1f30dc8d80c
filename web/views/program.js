// The text of the running program, with the current line in view. Only the visible lines exist as elements, so a program of
// a million lines costs as much as a short one.

import { disableFor, whyNot } from "../access/why_not.js";
import { explain } from "../machine/explain.js";
import { tipsOn } from "../machine/explain_tip.js";
import { NcText } from "../programs/nc_text.js";
import { cutShortAt, openLineStart } from "../programs/start_line.js";
import { programName, shortHash } from "../text/format.js";
import { t } from "../text/language.js";
import { button, card, fill, h, setAttr, setText } from "../ui/dom.js";

/** Height of a line, as in cards.css. */
const LINE_PX = 24;
/** Browsers limit the height of an element; longer programs scroll proportionally. */
const HEIGHT_MAX_PX = 8_000_000;
/** Delay before another attempt to read a text, ms. */
const AGAIN_MS = 2000;

/** @type {import("../main.js").View} */
export const program = {
  place: "middle",
  create: (app) => new ProgramView(app),
};

class ProgramView {
  #calls = h("span", { class: "calls" });
  #place = h("span", {});
  #hash = h("span", { class: "hash" });
  #stack = h("span", { class: "muted stack" }, this.#calls, this.#place, this.#hash);
  #follow = button({ class: "button small", "aria-pressed": "true", onclick: () => this.#setFollowing(!this.#following) }, t("program.follow"));
  #start = button({ class: "button small", hidden: true, onclick: () => this.#from && openLineStart(this.app, this.#from) });
  #spacer = h("div", { class: "spacer" });
  #rows = h("ol", { class: "rows" });
  #view = h("div", { class: "program-text", tabindex: 0, role: "region", "aria-label": t("editor.program_text") }, this.#spacer, this.#rows);
  #note = h("p", { class: "empty" });
  element = card("program-card", t("program.program"), [this.#stack, this.#start, this.#follow], this.#view, this.#note);

  /** The last requested text, and the result. @type {{key: string, text: NcText | null, error: string}} */
  #loaded = { key: "", text: null, error: "" };
  /** Time of the next try to read a text, ms of the local clock. */
  #againAt = Number.POSITIVE_INFINITY;
  #following = true;
  /** Position of the last automatic scroll, px. */
  #scrolledTo = -1;
  /** The program whose text is shown. */
  #number = 0;
  /** The shown block of the last choice. @type {import("../machine/model.js").Model["chosen"]} */
  #chosen = null;
  /** The block at which the view offers a start. @type {{program: number, line: number} | null} */
  #from = null;
  /** Height of the view when it was drawn, px. */
  #height = -1;
  /** Key of what the rows show. */
  #drawn = "";

  /** @param {import("../main.js").App} app */
  constructor(app) {
    this.app = app;
    this.#view.addEventListener("scroll", () => {
      // a scroll that this view did not cause is the operator's, unless the view has another size now
      const isResized = this.#view.clientHeight !== this.#height;
      if (this.#following && !isResized && Math.abs(this.#view.scrollTop - this.#scrolledTo) > 2) this.#setFollowing(false);
      else app.invalidate();
    });
    this.#rows.addEventListener("click", (event) => {
      const target = event.target instanceof Element ? event.target : null;
      const code = target?.closest(".nc-g, .nc-m");
      if (code) void explain(code.textContent);
      const line = Number(target?.closest(".line")?.querySelector(".line-number")?.textContent);
      if (line > 0) this.app.model.chosen = { program: this.#number, line, by: "program" };
      app.invalidate();
    });
    tipsOn(this.element, codeOf);
    this.#view.addEventListener("keydown", (event) => {
      if (event.key !== "F1") return;
      event.preventDefault();
      const hovered = this.#rows.querySelector(".nc-g:hover, .nc-m:hover");
      const code = hovered ?? this.#rows.querySelector(':is([data-chosen], [aria-current="step"]) :is(.nc-g, .nc-m)');
      if (code) void explain(codeOf(code));
    });
    new ResizeObserver(() => this.#drawAnew()).observe(this.#view);
  }

  render() {
    const { model } = this.app;
    const system = model.current;
    // MDI and jogs have number 0 and no stored text
    const place = system?.place?.number ? system.place : null;
    const number = place?.number ?? system?.state?.program ?? null;
    // a program may have changed before a load or a start, so it is read again then
    const key = `${model.bootId} ${model.selected} ${number} ${system?.state?.run_id} ${system?.state?.program} ${system?.state?.hash}`;
    if (number === null) this.#loaded = { key, text: null, error: system?.state ? t("elements.no_program_is_loaded") : "" };
    else if (key !== this.#loaded.key || (model.online && Date.now() > this.#againAt)) void this.#read(number, key);
    const { text, error } = this.#loaded;
    setText(this.#note, error);
    setAttr(this.#note, "hidden", error === "");
    setAttr(this.#view, "hidden", text === null);
    setAttr(this.#follow, "aria-pressed", String(this.#following));
    setText(this.#calls, callers(place));
    const o = number === system?.state?.program ? system?.state?.o_number : null;
    const program = own(number, o);
    setText(this.#place, number === null ? "" : place?.line ? t("common.program_line", { program, line: place.line }) : program);
    const hash = number !== null && number === system?.state?.program ? system.state.hash : null;
    setText(this.#hash, hash ? shortHash(hash) : "");
    setAttr(this.#stack, "title", `${this.#calls.textContent}${this.#place.textContent}${hash ? `\nSHA-256 ${hash}` : ""}`);
    this.#number = number ?? 0;
    this.#show(text);
    this.#offerStart(system?.state?.run_kind !== null);
    if (text) this.#draw(text, place?.line ?? 0, place?.interpreted_line ?? 0);
  }

  /**
   * Offers a start at the selected line, else at the line where the last run was interrupted; only the former during a
   * run.
   * @param {boolean} runs
   */
  #offerStart(runs) {
    const { chosen, current } = this.app.model;
    const here = chosen?.program === this.#number ? chosen : null;
    this.#from = here ?? cutShortAt(current);
    const line = this.#from?.line ?? 0;
    const isOffered = !runs && line !== 0;
    setAttr(this.#start, "hidden", !isOffered);
    // a narrow screen has no space for both
    setAttr(this.#hash, "hidden", isOffered);
    setText(this.#start, `${t(here ? "start_line.title" : "start_line.cut_short", { line })}…`);
    disableFor(this.#start, whyNot(this.app.model, "start"), here ? t("program.shows_what_is_in_force") : t("start_line.where_cut_short", { line }));
  }

  /** Brings a block that was chosen on the path into view. @param {NcText | null} text */
  #show(text) {
    const { chosen } = this.app.model;
    if (chosen === this.#chosen || !text) return;
    this.#chosen = chosen;
    this.#drawn = "";
    if (chosen?.by !== "path" || chosen.program !== this.#number) return;
    this.#following = false;
    setAttr(this.#follow, "aria-pressed", "false");
    const view = this.#view;
    const fits = Math.max(1, Math.floor(view.clientHeight / LINE_PX));
    const lastFirst = Math.max(1, text.lines - fits);
    const height = Math.min(text.lines * LINE_PX, HEIGHT_MAX_PX);
    setHeight(this.#spacer, height);
    const first = Math.max(0, chosen.line - 1 - Math.floor(fits / 2));
    view.scrollTop = (Math.min(first, lastFirst) / lastFirst) * Math.max(1, height - view.clientHeight);
  }

  /** @param {boolean} on */
  #setFollowing(on) {
    this.#following = on;
    this.#drawAnew();
  }

  #drawAnew() {
    this.#drawn = "";
    this.app.invalidate();
  }

  /** @param {number} number @param {string} key */
  async #read(number, key) {
    const { programs, current } = this.app.model;
    const dialect = programs?.find((program) => program.number === number)?.dialect ?? current?.info.dialect ?? "";
    const asked = { key, text: /** @type {NcText | null} */ (null), error: "" };
    this.#loaded = asked;
    this.#againAt = Number.POSITIVE_INFINITY;
    try {
      asked.text = await NcText.read(await this.app.api.programBytes(number), dialect);
    } catch (error) {
      asked.error = error instanceof Error ? error.message : String(error);
      this.#againAt = Date.now() + AGAIN_MS;
    }
    if (this.#loaded === asked) this.#setFollowing(true);
  }

  /** @param {NcText} text @param {number} running @param {number} interpreted */
  #draw(text, running, interpreted) {
    const view = this.#view;
    this.#height = view.clientHeight;
    const height = Math.min(text.lines * LINE_PX, HEIGHT_MAX_PX);
    const fits = Math.max(1, Math.floor(view.clientHeight / LINE_PX));
    const lastFirst = Math.max(0, text.lines - fits);
    const scrollable = Math.max(1, height - view.clientHeight);
    setHeight(this.#spacer, height);
    if (this.#following) {
      const wanted = Math.min(lastFirst, Math.max(0, running - 1 - Math.floor(fits / 3)));
      const top = lastFirst === 0 ? 0 : Math.round((wanted / lastFirst) * scrollable);
      if (Math.abs(view.scrollTop - top) > 1) view.scrollTop = top;
      this.#scrolledTo = view.scrollTop;
    }
    const first = lastFirst === 0 ? 0 : Math.round((view.scrollTop / scrollable) * lastFirst);
    const chosen = this.#chosen?.program === this.#number ? this.#chosen.line : 0;
    const key = [first, fits, running, interpreted, chosen, view.scrollTop, this.#loaded.key].join();
    if (key === this.#drawn) return;
    this.#drawn = key;
    this.#rows.style.transform = `translateY(${view.scrollTop}px)`;
    const numbers = Array.from({ length: Math.min(fits + 1, text.lines - first) }, (_, i) => first + i + 1);
    fill(this.#rows, ...numbers.map((number) => row(number, text, running, interpreted, chosen)));
  }
}

/** The code that an element shows; empty: none. @param {Element} element */
function codeOf(element) {
  return element.matches(".nc-g, .nc-m") ? (element.textContent ?? "") : "";
}

/** @param {HTMLElement} element @param {number} height */
function setHeight(element, height) {
  const text = `${height}px`;
  if (element.style.height !== text) element.style.height = text;
}

/** @param {number} number @param {NcText} text @param {number} running @param {number} interpreted @param {number} chosen */
function row(number, text, running, interpreted, chosen) {
  const is = number === running;
  const ahead = number === interpreted && interpreted !== running;
  const parts = text.parts(number).map(({ kind, text: part }) => (kind ? h("span", { class: `nc-${kind}` }, part) : part));
  return h(
    "li",
    { class: "line", "aria-current": is ? "step" : null, "data-interpreted": ahead, "data-chosen": number === chosen, title: ahead ? t("program.the_program_has_been_read") : null },
    h("span", { class: "mark", "aria-hidden": "true" }, is ? "▶" : ahead ? "◦" : ""),
    h("span", { class: "line-number" }, String(number)),
    h("code", {}, ...parts),
  );
}

/** Returns the name of the program, with the number in its text. @param {number | null} number @param {number | null | undefined} o */
function own(number, o) {
  return o === null || o === undefined ? programName(number) : t("program.own", { program: programName(number), o });
}

/** @param {import("../types.d.ts").ProgramLocationMessage | null} place */
function callers(place) {
  return (place?.stack ?? []).map((site) => `${t("common.program_line", { program: programName(site.program), line: site.line })} › `).join("");
}
