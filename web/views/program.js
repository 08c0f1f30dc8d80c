// The text of the program that runs, with its line kept in view. Only the lines on the screen exist as elements, so a
// program of a million lines costs no more than a short one.

import { card, fill, h, setAttr, setText } from "../dom.js";
import { programName } from "../format.js";
import { NcText } from "../nc_text.js";

/** Height of a line; style.css says the same. */
const LINE_PX = 24;
/** Browsers limit the height of an element; longer programs are scrolled in proportion. */
const HEIGHT_MAX_PX = 8_000_000;

/** @type {import("../main.js").View} */
export const program = {
  place: "middle",
  create(app) {
    const stack = h("span", { class: "muted stack" });
    const follow = h("button", { type: "button", class: "button small", "aria-pressed": "true" }, "Follow");
    const spacer = h("div", { class: "spacer" });
    const rows = h("ol", { class: "rows" });
    const view = h("div", { class: "program-text", tabindex: 0, role: "region", "aria-label": "Program text" }, spacer, rows);
    const note = h("p", { class: "empty" });
    const element = card("program-card", "Program", [stack, follow], view, note);

    /** @type {{number: number | null, key: string, text: NcText | null, error: string}} */
    let loaded = { number: null, key: "", text: null, error: "" };
    let following = true;
    let scrolledTo = -1;
    let drawn = "";

    const setFollowing = (/** @type {boolean} */ on) => {
      following = on;
      drawn = "";
      app.invalidate();
    };
    follow.addEventListener("click", () => setFollowing(!following));
    view.addEventListener("scroll", () => {
      // a scroll that this view did not ask for is the operator's
      if (Math.abs(view.scrollTop - scrolledTo) > 2 && following) setFollowing(false);
      else app.invalidate();
    });
    new ResizeObserver(() => {
      drawn = "";
      app.invalidate();
    }).observe(view);

    /** @param {number} number @param {string} key */
    const read = async (number, key) => {
      const dialect = app.model.current?.info.dialect ?? "";
      loaded = { number, key, text: null, error: "" };
      drawn = "";
      try {
        const text = new NcText(await app.api.programText(number), dialect);
        if (loaded.key === key) loaded.text = text;
      } catch (error) {
        if (loaded.key === key) loaded.error = error instanceof Error ? error.message : String(error);
      }
      drawn = "";
      following = true;
      app.invalidate();
    };

    const render = () => {
      const { model } = app;
      const system = model.current;
      const number = system?.place?.number ?? system?.state?.program ?? null;
      // a program may have been written anew before a load or a start, so those read it again
      const key = `${model.bootId} ${model.selected} ${number} ${system?.state?.run_id} ${system?.state?.program}`;
      if (number === null) {
        loaded = { number: null, key, text: null, error: "" };
        setText(note, model.current?.state ? "No program is loaded." : "");
      } else if (key !== loaded.key) void read(number, key);
      else setText(note, loaded.error);
      setAttr(note, "hidden", !note.textContent || loaded.text !== null);
      setAttr(view, "hidden", loaded.text === null);
      setAttr(follow, "aria-pressed", String(following));
      setText(stack, callers(system?.place ?? null, number));
      if (loaded.text) draw(loaded.text, system?.place ?? null);
    };

    /** @param {NcText} text @param {import("../types.d.ts").ProgramPlace | null} place */
    const draw = (text, place) => {
      const height = Math.min(text.lines * LINE_PX, HEIGHT_MAX_PX);
      const fits = Math.max(1, Math.floor(view.clientHeight / LINE_PX));
      const lastFirst = Math.max(0, text.lines - fits);
      const scrollable = Math.max(1, height - view.clientHeight);
      const line = place?.line ?? 0;
      if (following) {
        const first = Math.min(lastFirst, Math.max(0, line - 1 - Math.floor(fits / 3)));
        setHeight(spacer, height);
        scrolledTo = lastFirst === 0 ? 0 : Math.round((first / lastFirst) * scrollable);
        if (Math.abs(view.scrollTop - scrolledTo) > 1) view.scrollTop = scrolledTo;
        scrolledTo = view.scrollTop;
      }
      const first = lastFirst === 0 ? 0 : Math.round((view.scrollTop / scrollable) * lastFirst);
      const key = [first, fits, line, place?.interpreted_line, view.scrollTop, loaded.key].join();
      if (key === drawn) return;
      drawn = key;
      setHeight(spacer, height);
      rows.style.transform = `translateY(${view.scrollTop}px)`;
      const numbers = Array.from({ length: Math.min(fits + 1, text.lines - first) }, (_, i) => first + i + 1);
      fill(rows, ...numbers.map((n) => row(n, text, line, place?.interpreted_line ?? 0)));
    };
    return { element, render };
  },
};

/** @param {HTMLElement} element @param {number} height */
function setHeight(element, height) {
  const text = `${height}px`;
  if (element.style.height !== text) element.style.height = text;
}

/** @param {number} number @param {NcText} text @param {number} running @param {number} interpreted */
function row(number, text, running, interpreted) {
  const is = number === running;
  const ahead = number === interpreted && interpreted !== running;
  return h(
    "li",
    { class: "line", "aria-current": is ? "step" : null, "data-interpreted": ahead, title: ahead ? "The program has been read ahead to this line" : null },
    h("span", { class: "mark", "aria-hidden": "true" }, is ? "▶" : ahead ? "◦" : ""),
    h("span", { class: "line-number" }, String(number)),
    h("code", {}, ...text.parts(number).map(({ kind, text: part }) => (kind ? h("span", { class: `nc-${kind}` }, part) : part))),
  );
}

/** @param {import("../types.d.ts").ProgramPlace | null} place @param {number | null} number */
function callers(place, number) {
  if (number === null) return "";
  const calls = (place?.stack ?? []).map((site) => `${programName(site.program)} line ${site.line} › `);
  return `${calls.join("")}${programName(number)}${place?.line ? ` line ${place.line}` : ""}`;
}
