// <tandem-path>: the planned path of the loaded program, with the tool at the position of the machine. `view` is XY, XZ, YZ or ISO; dragging
// turns it, the wheel and two fingers zoom.

import { VIEW_NAMES } from "../path/camera.js";
import { corners } from "../path/extent.js";
import { atTime } from "../path/find.js";
import { Live } from "../path/live.js";
import { PathLoader } from "../path/load.js";
import { Picture } from "../path/picture.js";
import { follow } from "../path/pointer.js";
import { isShown, runsProgram } from "../path/shown.js";
import { t } from "../text/language.js";
import { h, setAttr, setText } from "../ui/dom.js";
import { TandemElement } from "./element.js";

/** Own pages show lengths in mm, as `tandem-dro` does. */
const MILLIMETRES = { unit: "mm", size: 1 };

/** @typedef {[number, number, number]} Point */

export class TandemPath extends TandemElement {
  static observedAttributes = ["cs", "view"];
  #note = h("p", { class: "note muted", hidden: true });
  #box = h("div", { class: "box" });
  /** Exists while the element is in the page. @type {Picture | null} */
  #picture = null;
  #live = new Live();
  /** @type {PathLoader | null} */
  #loader = null;
  #of = "";
  #fitted = "";
  #frame = 0;
  #resized = new ResizeObserver(() => this.redraw());

  constructor() {
    super(STYLE);
    this.root.append(this.#box);
  }

  #begin() {
    const back = h("canvas", { class: "back", "aria-hidden": "true" });
    const canvas = h("canvas", { class: "lines", role: "img", tabindex: 0, "aria-label": t("elements.path_of_the_tool") });
    this.#box.replaceChildren(back, canvas, this.#note);
    const changed = () => this.redraw();
    const picture = new Picture(canvas, back, this.#box, changed);
    const fit = () => {
      this.#fitted = "";
      changed();
    };
    follow(canvas, picture.camera, { changed, click: () => {}, fit });
    this.#fitted = "";
    return picture;
  }

  connectedCallback() {
    super.connectedCallback();
    this.#picture ??= this.#begin();
    this.#loader ??= new PathLoader(this.tandem, () => this.redraw());
    this.#resized.observe(this.#box);
  }

  disconnectedCallback() {
    super.disconnectedCallback();
    this.#resized.disconnect();
    this.#loader?.show(0, 0);
    this.#picture?.stop();
    this.#picture = null;
    cancelAnimationFrame(this.#frame);
    this.#frame = 0;
  }

  /** The picture, for tests and the console. */
  get picture() {
    return this.#picture;
  }

  /** @override @param {import("./element.js").CoordinateSystem} system */
  render(system) {
    const [loader, picture] = [this.#loader, this.#picture];
    if (!loader || !picture) return;
    const { state } = system;
    loader.show(state?.program ?? 0, system.info.number);
    const of = [state?.program, state?.hash, state?.execution === "READY", runsProgram(state) && state?.run_id].join();
    const path = isShown(state, loader.path) ? loader.path : null;
    loader.isCurrent = loader.path === null || path !== null;
    if (of !== this.#of) {
      this.#of = of;
      loader.again();
    }
    const runs = runsProgram(state) ? (state?.run_id ?? "") : null;
    this.#live.addPosition(path, runs, system.position, point(system.position?.machine), performance.now());
    const text = picture.trouble || (state?.program ? loader.error || (path ? "" : t("path.not_planned_yet")) : t("elements.no_program_is_loaded"));
    setText(this.#note, text);
    setAttr(this.#note, "hidden", text === "");
    this.#draw(system);
  }

  /** @param {import("./element.js").CoordinateSystem} system */
  #draw(system) {
    const [loader, picture] = [this.#loader, this.#picture];
    if (!loader || !picture?.measure()) return;
    const now = performance.now();
    const path = isShown(system.state, loader.path) ? loader.path : null;
    const at = point(system.position?.machine);
    const time = path ? this.#live.time(now) : null;
    const place = path && time !== null ? atTime(path, time) : null;
    const work = point(system.position?.work);
    const tool = place?.at ?? at;
    this.#fit(system, picture.camera, path, tool);
    picture.drawBackdrop(MILLIMETRES);
    picture.tidy(path);
    const zero = /** @type {Point} */ (at.map((value, i) => value - (work[i] ?? 0)));
    const ended = state(system) === "PROGRAM_COMPLETED" ? Infinity : -1;
    picture.draw({ path, now: time ?? ended, tool, radius: 0, zero, limits: null, trail: null, selected: 0 }, (chunk) => loader.refine(chunk));
    if (this.#live.isMoving(now)) {
      this.#frame ||= requestAnimationFrame(() => {
        this.#frame = 0;
        if (this.system) this.#draw(this.system);
      });
    }
  }

  /** After a change of program, view or size, the whole path is shown. @param {import("./element.js").CoordinateSystem} system @param {import("../path/camera.js").Camera} camera @param {import("../path/bytes.js").Answer | null} path @param {Point} tool */
  #fit(system, camera, path, tool) {
    const view = VIEW_NAMES.find((name) => name === this.getAttribute("view")) ?? "ISO";
    const key = [view, system.state?.program, path?.complete, path?.chunks.length, camera.width, camera.height].join();
    if (key === this.#fitted) return;
    if (!this.#fitted.startsWith(`${view},`)) camera.look(view);
    this.#fitted = key;
    const fitted = path?.chunks.length ? corners(path) : [tool];
    const of = (/** @type {(...values: number[]) => number} */ most) => /** @type {Point} */ ([0, 1, 2].map((i) => fitted.map((corner) => corner[i] ?? 0).reduce((best, value) => most(best, value))));
    camera.fit(of(Math.min), of(Math.max));
  }
}

/** @param {import("./element.js").CoordinateSystem} system */
function state(system) {
  return system.state?.execution;
}

/** @param {Record<string, number> | null | undefined} values @returns {Point} */
function point(values) {
  return [values?.X ?? 0, values?.Y ?? 0, values?.Z ?? 0];
}

const STYLE = `
.box { position: relative; width: 100%; height: 100%; min-height: 200px; background: var(--card); border: 1px solid var(--line); }
canvas { position: absolute; inset: 0; width: 100%; height: 100%; touch-action: none; }
.back { pointer-events: none; }
.note { position: absolute; left: 0.6em; bottom: 0.4em; margin: 0; pointer-events: none; }
canvas:focus-visible { outline: 3px solid var(--accent); outline-offset: -3px; }
`;
