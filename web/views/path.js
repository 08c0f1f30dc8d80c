// The path of the loaded program in space, drawn before anything moves, with the tool at the position of the machine; the travelled path if
// no plan exists (manual data input, jogs).

import { machine } from "../machine/machine.js";
import { locateWord } from "../path/bytes.js";
import { VIEW_NAMES } from "../path/camera.js";
import { corners } from "../path/extent.js";
import { atTime } from "../path/find.js";
import { Live } from "../path/live.js";
import { PathLoader } from "../path/load.js";
import { Picture } from "../path/picture.js";
import { follow } from "../path/pointer.js";
import { Rehearse } from "../path/rehearse.js";
import { isShown, runsProgram } from "../path/shown.js";
import { toolRadius } from "../path/tool.js";
import { position } from "../text/format.js";
import { sentences, t } from "../text/language.js";
import { lengthScale, scaleOf, unitOf } from "../text/units.js";
import { button, card, h, setAttr, setText } from "../ui/dom.js";
import { icon } from "../ui/icons.js";

/** @typedef {[number, number, number]} Point */

/** @type {import("../main.js").View} */
export const path = {
  place: "middle",
  create: (app) => new PathView(app),
};

class PathView {
  #back = h("canvas", { class: "path-back", "aria-hidden": "true" });
  #canvas = h("canvas", { class: "path-lines", role: "img", tabindex: 0 });
  #note = h("p", { class: "path-note", hidden: true });
  #box = h("div", { class: "canvas-box" }, this.#back, this.#canvas, this.#note);
  #picture = new Picture(this.#canvas, this.#back, this.#box, () => this.app.invalidate());
  #loader = new PathLoader(machine, () => this.#changed());
  #live = new Live();
  #rehearse;
  #views;
  #clear;
  /** Key of the content to which the picture was fitted. */
  #fitted = "";
  /** Key of the last frame. */
  #drawn = "";
  /** The unit of lengths that the picture names. */
  #unit = "";
  #frame = 0;
  /** Coordinate system, program and hash of the plan. */
  #of = "";
  /** @type {import("../path/picture.js").PictureContent | null} */
  #shown = null;
  /** The last searched block. */
  #place = { key: "", place: 0 };
  element;

  /** @param {import("../main.js").App} app */
  constructor(app) {
    this.app = app;
    this.#rehearse = new Rehearse(app, () => this.#changed());
    this.#views = VIEW_NAMES.map((name) => button({ class: "button small", "aria-pressed": "false", onclick: () => this.#look(name) }, name));
    const fit = button({ class: "button small", onclick: () => this.#fit() }, t("path.fit"));
    this.#clear = button({ class: "icon-button", "aria-label": t("path.clear"), title: t("path.clear"), onclick: () => this.#forgetTrail() }, icon("trash"));
    const tools = h("div", { class: "path-views", role: "group", "aria-label": t("path.view_of_the_path") }, ...this.#views, fit);
    this.element = card("path-card", t("path.path"), [this.#clear, tools], this.#box, this.#rehearse.element);
    // for tests and the console
    Object.assign(this.#canvas, { statistics: () => this.#picture.statistics });
    follow(this.#canvas, this.#picture.camera, { changed: () => this.#changed(), click: (x, y) => this.#click(x, y), fit: () => this.#fit() });
    new ResizeObserver(() => this.#changed()).observe(this.#box);
  }

  render() {
    const { model } = this.app;
    const system = model.current;
    if (!system) return;
    const { state } = system;
    this.#loader.show(state?.program ?? 0, system.info.number);
    const of = [system.info.number, state?.program, state?.hash, state?.execution === "READY", runsProgram(state) && state?.run_id].join();
    this.#loader.isCurrent = this.#loader.path === null || this.#plan !== null;
    if (of !== this.#of) {
      this.#of = of;
      this.#loader.again();
    }
    this.#rehearse.render(system, this.#plan);
    const isRun = runsProgram(state);
    const at = point(system.position?.machine);
    this.#live.addPosition(this.#plan, isRun ? (state?.run_id ?? "") : null, system.position, at, performance.now());
    setAttr(this.#clear, "hidden", system.trail.points.length < 2 || this.#live.onPlan);
    for (const [i, one] of this.#views.entries()) setAttr(one, "aria-pressed", String(VIEW_NAMES[i] === this.#picture.camera.view));
    this.#showNote(system);
    this.#request();
  }

  /** Returns the planned path, if it belongs to the active run, or to the text that a start would run. */
  get #plan() {
    const { path: plan } = this.#loader;
    return isShown(this.app.model.current?.state, plan) ? plan : null;
  }

  /** @param {import("../machine/model.js").CoordinateSystem} system */
  #showNote(system) {
    const text = this.#preview() ? sentences(this.#picture.trouble, t("path.preview")) : this.#planNote(system);
    setText(this.#note, text);
    setAttr(this.#note, "hidden", text === "");
    const letters = Object.keys(system.info.axes).sort().filter((letter) => "XYZ".includes(letter));
    const where = letters.map((letter) => {
      const scale = scaleOf(this.app.model, letter);
      return `${letter} ${position(system.position?.machine[letter], scale)} ${scale.unit}`;
    }).join(", ");
    setAttr(this.#canvas, "aria-label", t("path.tool_at", { place: where }));
  }

  /** @param {import("../machine/model.js").CoordinateSystem} system */
  #planNote(system) {
    const { error } = this.#loader;
    const plan = this.#plan;
    const texts = [this.#picture.trouble || error];
    if (!plan && !error && system.state?.program) texts.push(t("path.not_planned_yet"));
    if (plan && !plan.complete) texts.push(plan.chunks.length ? t("path.planning_drawn") : t("path.planning"));
    if (plan?.cut) texts.push(t("path.the_program_is_longer_than"));
    if (plan && Number.isFinite(plan.dependsAt)) {
      const { program, line } = locateWord(plan.dependsWord, plan.programs);
      texts.push(program === system.state?.program ? t("path.dashed", { line, text: plan.why }) : t("path.dashed_of", { line, program, text: plan.why }));
    }
    return sentences(...texts);
  }

  #changed() {
    this.#drawn = "";
    this.#request();
  }

  #request() {
    this.#frame ||= requestAnimationFrame(() => this.#paint());
  }

  #paint() {
    this.#frame = 0;
    const system = this.app.model.current;
    if (!system) return;
    const now = performance.now();
    const shown = this.#see(system, now);
    const { camera } = this.#picture;
    const scene = [
      this.#loader.revision, this.#plan === null, this.#preview()?.key, shown.now, ...shown.tool, shown.radius, ...shown.zero, shown.selected, shown.trail?.revision, this.#box.clientWidth, this.#box.clientHeight,
      devicePixelRatio, document.documentElement.dataset.theme,
    ].join();
    const lengths = lengthScale(unitOf(system));
    const isOtherUnit = lengths.unit !== this.#unit;
    if ((scene !== this.#drawn || isOtherUnit) && this.#picture.measure()) {
      const all = this.#drawn === "" || isOtherUnit;
      this.#unit = lengths.unit;
      this.#drawn = scene;
      this.#shown = shown;
      this.#fitFirst(system, shown);
      if (all) {
        this.#picture.drawBackdrop(lengths);
        this.#picture.tidy(shown.path);
      }
      this.#picture.draw(shown, (chunk) => this.#loader.refine(chunk));
      const [x, y] = camera.project(shown.tool);
      this.#rehearse.outside(x < 0 || y < 0 || x > camera.width || y > camera.height);
    }
    if (this.#live.isMoving(now)) this.#request();
  }

  /**
   * Returns the content to show now.
   * @param {import("../machine/model.js").CoordinateSystem} system @param {number} now ms @returns {import("../path/picture.js").PictureContent}
   */
  #see(system, now) {
    const preview = this.#preview();
    const plan = preview?.path ?? this.#plan;
    const at = point(system.position?.machine);
    if (preview) return { ...this.#unmoved(system, at), path: plan, tool: at, trail: null };
    const scrubbed = plan ? this.#rehearse.time : null;
    const live = plan ? this.#live.time(now) : null;
    const time = scrubbed ?? live;
    const place = plan && time !== null ? atTime(plan, time) : null;
    const { chosen } = this.app.model;
    const ended = system.state?.execution === "PROGRAM_COMPLETED" ? Infinity : -1;
    return {
      ...this.#unmoved(system, at),
      path: plan,
      now: time ?? ended,
      tool: place?.at ?? at,
      trail: live === null && scrubbed === null ? system.trail : null,
      selected: plan && chosen ? this.#wordIndexOf(plan, chosen) : 0,
    };
  }

  /** Returns the preview that is shown instead of the program. */
  #preview() {
    const { model } = this.app;
    return model.panel === "set-up" ? model.preview : null;
  }

  /**
   * Returns the parts of the picture that do not depend on a path.
   * @param {import("../machine/model.js").CoordinateSystem} system @param {Point} at
   */
  #unmoved(system, at) {
    const work = point(system.position?.work);
    return {
      now: -1,
      radius: toolRadius(this.app, system),
      zero: /** @type {Point} */ (at.map((value, i) => value - /** @type {number} */ (work[i]))),
      limits: limitsOf(system, this.app.model.birth?.motors ?? []),
      selected: 0,
    };
  }

  /** Returns the word index of a block on the path, searched once. @param {import("../path/bytes.js").Answer} plan @param {{program: number, line: number}} chosen */
  #wordIndexOf(plan, { program, line }) {
    const key = [this.#loader.revision, program, line].join();
    if (key !== this.#place.key) this.#place = { key, place: this.#picture.wordIndexOf(plan, program, line) };
    return this.#place.place;
  }

  /** Fits the whole path when the picture shows another program, or none. @param {import("../machine/model.js").CoordinateSystem} system @param {import("../path/picture.js").PictureContent} shown */
  #fitFirst(system, shown) {
    const size = shown.path?.complete ? "all" : shown.path?.chunks.length ? "some" : "none";
    const { camera } = this.#picture;
    const of = [system.info.number, this.#preview()?.key ?? system.state?.program].join();
    const key = [of, size, camera.width, camera.height].join();
    if (key === this.#fitted) return;
    const isOther = !this.#fitted.startsWith(`${of},`);
    if (!this.#fitted.startsWith(`${system.info.number},`)) camera.look(planeOf(system));
    this.#fitted = key;
    if (isOther || camera.isFitted) this.#fitTo(shown);
  }

  #fit() {
    if (this.#shown) this.#fitTo(this.#shown);
    this.#changed();
  }

  /** @param {import("../path/picture.js").PictureContent} shown */
  #fitTo({ path: plan, tool, trail }) {
    const fitted = plan?.chunks.length ? corners(plan) : [tool, ...(trail?.points.map(({ at }) => point(at)) ?? [])];
    const of = (/** @type {(...values: number[]) => number} */ most) => /** @type {Point} */ ([0, 1, 2].map((i) => fitted.reduce((best, corner) => most(best, corner[i] ?? 0), fitted[0]?.[i] ?? 0)));
    this.#picture.camera.fit(of(Math.min), of(Math.max));
  }

  /** @param {import("../path/camera.js").ViewName} view */
  #look(view) {
    this.#picture.camera.look(view);
    this.#fit();
    this.app.invalidate();
  }

  #forgetTrail() {
    this.app.model.current?.trail.clear();
    this.#changed();
    this.app.invalidate();
  }

  /** Selects the line of the path at a point: the program shows its block. @param {number} x @param {number} y */
  #click(x, y) {
    if (this.#preview()) return;
    const plan = this.#plan;
    const found = this.#picture.pick(plan, x, y);
    this.app.model.chosen = plan && found ? { ...locateWord(found.word, plan.programs), by: "path" } : null;
    this.app.invalidate();
  }
}

/** @param {Record<string, number> | null | undefined} values @returns {Point} */
function point(values) {
  return [values?.X ?? 0, values?.Y ?? 0, values?.Z ?? 0];
}

/** Returns the view of the two axes of the machine. @param {import("../machine/model.js").CoordinateSystem} system */
function planeOf({ info }) {
  const [x, y, z] = ["X", "Y", "Z"].map((letter) => letter in info.axes);
  if (x && y) return z ? "ISO" : "XY";
  return y ? "YZ" : "XZ";
}

/** Returns the corners of the space within the soft limits. @param {import("../machine/model.js").CoordinateSystem} system @param {import("../types.d.ts").MotorInfo[]} motors @returns {[Point, Point] | null} */
function limitsOf({ info }, motors) {
  const of = ["X", "Y", "Z"].map((letter) => motors.find((motor) => motor.number === info.axes[letter])?.soft_limits ?? null);
  if (of.every((limits) => limits === null)) return null;
  const side = (/** @type {0 | 1} */ i) => /** @type {Point} */ (of.map((limits) => limits?.[i] ?? 0));
  return [side(0), side(1)];
}
