// Motion of one axis by hand. A held jog is refreshed while its button, key or stick is held, and ended on release. If
// the refreshes stop without an end, the machine stops the axis 200 ms later. A step needs no refresh up to the longest
// step of the machine, and continues when the page loses its focus; its end is requested, and reported if it was short.

import { disableFor, whyNot } from "../access/why_not.js";
import { Refusal } from "../machine/api.js";
import { plain } from "../text/format.js";
import { t } from "../text/language.js";
import { button, setAttr } from "../ui/dom.js";

/** Time between two refreshes, ms. */
const REFRESH_MS = 80;
/** A step that was clicked while another one ran begins within this time, ms, or not at all: nothing moves late. */
const CLICK_MS = 1000;
/** Number of further requests for the reply to a step that has ended. */
const REPLY_TRIES = 5;
/** The longest step without refresh, mm or degrees, until the machine publishes its limit. */
const STEP_MAX = 10;
/** Why a step was short, by the code of its reply; other codes have the machine's text. @type {Record<string, string>} */
const WHY = {
  limit: t("jog.why_limit"), hold: t("jog.why_hold"), interlock: t("jog.why_interlock"), stop: t("jog.why_stop"),
  aborted: t("jog.why_stop"), ended: t("jog.why_ended"), not_refreshed: t("jog.why_not_refreshed"), alarm: t("jog.why_alarm"),
};

/**
 * @typedef {object} JogChoice
 * @property {number} velocity mm/min or deg/min
 * @property {number} distance mm or degrees; 0: until the button is released
 * @property {number} shown the same in the unit of the choice
 * @property {string} unit of the choice
 * @property {string} says the distance in this unit
 */

/**
 * @typedef {object} RunningJog
 * @property {number} cs
 * @property {string} axis
 * @property {1 | -1} direction
 * @property {boolean} isStep
 * @property {{refresh_id: string, distance?: number}} args
 * @property {JogChoice} choice
 * @property {string | null | undefined} before the run before it
 */

export class Jogger {
  /** @type {RunningJog | null} */
  running = null;
  /** Steps that were clicked while another one runs. @type {{axis: string, direction: 1 | -1, choice: JogChoice, at: number}[]} */
  #clicks = [];
  #timer = 0;
  /** Steps that were not made since the last step that began without a queue. */
  #notMade = 0;
  /** Until the machine has said it, the default: a step that is too long is reported. */
  #stepMax = STEP_MAX;
  #knowsStepMax = false;

  /** @param {import("../main.js").App} app */
  constructor(app) {
    this.app = app;
    for (const event of ["blur", "pagehide"]) addEventListener(event, () => this.leave());
    document.addEventListener("visibilitychange", () => this.leave());
  }

  /**
   * Begins a jog. A step that is clicked while another one runs begins after it if that ends soon.
   * @param {string} axis @param {1 | -1} direction @param {JogChoice} choice
   */
  begin(axis, direction, choice) {
    const { model } = this.app;
    const { velocity, distance } = choice;
    if (this.running?.isStep && distance > 0) {
      this.#clicks.push({ axis, direction, choice, at: performance.now() });
      setTimeout(() => this.#jogClicks(), CLICK_MS + 1);
    }
    if (this.running || whyNot(model, "jog") !== null) return;
    if (this.#clicks.length === 0) this.#notMade = 0;
    const bytes = crypto.getRandomValues(new Uint32Array(3));
    const refresh_id = `hmi-${[...bytes].map((part) => part.toString(36)).join("")}`;
    const args = { axis, velocity: direction * velocity, refresh_id, ...(distance > 0 && { distance }) };
    const run = { cs: model.selected, axis, direction, isStep: distance > 0, args, choice, before: model.current?.state?.run_id };
    this.running = run;
    this.app.invalidate();
    if (run.isStep && !this.#knowsStepMax) void this.#readStepMax();
    void this.#refresh(run, true);
  }

  /** The button, key or stick is released: a held jog ends, a step continues to its end. */
  release() {
    if (this.running && !this.running.isStep) this.cancel();
  }

  /** Called when the screen loses focus: a held jog ends, a step continues, and none begins afterwards. */
  leave() {
    this.#rejectClicks(this.#clicks.splice(0));
    this.release();
  }

  /** Ends the jog, also a step. */
  cancel() {
    const run = this.#forget();
    if (run) void this.app.api.endJog(run.cs, run.axis, run.args.refresh_id);
  }

  /** Checks whether the jog has ended without a request, or the machine has become silent. */
  render() {
    const { running } = this;
    if (!running) return;
    const { model } = this.app;
    const state = model.systems.get(running.cs)?.state;
    if (!model.online) this.leave();
    else if (state && state.run_id !== running.before && state.run_kind !== "jog") void this.#end(running);
  }

  async #readStepMax() {
    const { jog_step_max } = await this.app.api.hmi().catch(() => ({ jog_step_max: undefined }));
    this.#knowsStepMax = jog_step_max !== undefined;
    this.#stepMax = jog_step_max ?? STEP_MAX;
  }

  /** Handles a jog that was not ended here; reports a step that was too short. @param {RunningJog} run */
  async #end(run) {
    this.#forget();
    if (!run.isStep) return;
    const reply = await this.#replyTo(run.args.refresh_id);
    if (reply?.status === "failed") {
      this.#rejectClicks(this.#clicks.splice(0));
      this.#reportShort(run, reply);
    } else this.#jogClicks();
  }

  /** Returns the last reply to a command; it may arrive shortly after the state. @param {string} id */
  async #replyTo(id) {
    for (let tries = 0; ; tries += 1) {
      const reply = await this.app.api.reply(id).catch(() => null);
      if (reply?.status !== "accepted" || tries === REPLY_TRIES) return reply;
      await new Promise((resolve) => setTimeout(resolve, REFRESH_MS));
    }
  }

  /** @param {RunningJog} run @param {import("../types.d.ts").CommandReply} reply */
  #reportShort({ axis, direction, choice }, { code, text, moved = {} }) {
    const covered = plain((Math.abs(moved[axis] ?? 0) * choice.shown) / choice.distance);
    const way = `${axis}${direction > 0 ? "+" : "\u2212"}`;
    this.app.toast(t("jog.short", { way, covered, distance: plain(choice.shown), unit: choice.unit, why: WHY[code] ?? text }), "error");
  }

  /** Begins the next clicked step, and reports steps whose time limit has passed. */
  #jogClicks() {
    const now = performance.now();
    const late = this.#clicks.filter(({ at }) => now - at > CLICK_MS);
    this.#clicks = this.#clicks.filter(({ at }) => now - at <= CLICK_MS);
    this.#rejectClicks(late);
    const next = this.running ? undefined : this.#clicks.shift();
    if (next && whyNot(this.app.model, "jog") !== null) this.#rejectClicks([next, ...this.#clicks.splice(0)]);
    else if (next) this.begin(next.axis, next.direction, next.choice);
  }

  /** Reports steps that are not made. @param {{axis: string}[]} clicks */
  #rejectClicks(clicks) {
    if (clicks.length === 0) return;
    this.#notMade += clicks.length;
    this.app.toast(t("jog.not_made", { count: this.#notMade }), "error", "jog.not_made");
  }

  #forget() {
    const run = this.running;
    this.running = null;
    clearTimeout(this.#timer);
    if (run) this.app.invalidate();
    return run;
  }

  /**
   * Sends the jog, and repeats it while it lasts. Only one request is pending at a time: on a slow network the machine
   * stops instead of executing a queue of stale requests.
   * @param {RunningJog} run @param {boolean} first
   */
  async #refresh(run, first) {
    const sent = Date.now();
    try {
      await this.app.api.jog(run.cs, run.args, first ? run.args.refresh_id : undefined);
    } catch (error) {
      if (!(error instanceof Refusal)) throw error;
      if (this.running !== run) return;
      // a refresh is refused when the jog has ended: the end of a step is requested
      if (!first) return void this.#end(run);
      this.#forget();
      this.#rejectClicks(this.#clicks.splice(0));
      this.app.toast(error.message, "error");
      return;
    }
    if (this.running !== run || (run.args.distance ?? Infinity) <= this.#stepMax) return;
    this.#timer = window.setTimeout(() => void this.#refresh(run, false), Math.max(0, sent + REFRESH_MS - Date.now()));
  }
}

/**
 * A button that jogs: while it is held, or one step for each click.
 * @param {import("../main.js").App} app
 * @param {string} axis
 * @param {1 | -1} direction
 * @param {(axis: string) => JogChoice} chosen returns the setting for an axis
 */
export function jogButton(app, axis, direction, chosen) {
  const { jogger } = app;
  const element = button({ class: "button jog", "data-jog": `${axis}${direction > 0 ? "+" : "-"}` }, `${axis}${direction > 0 ? "+" : "−"}`);
  const begin = () => jogger.begin(axis, direction, chosen(axis));
  const release = () => isOwn() && jogger.release();
  const isOwn = () => jogger.running?.axis === axis && jogger.running.direction === direction;
  element.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return;
    element.setPointerCapture(event.pointerId);
    begin();
  });
  // occurs after a release and after any other loss of the pointer
  element.addEventListener("lostpointercapture", release);
  element.addEventListener("contextmenu", (event) => event.preventDefault());
  element.addEventListener("keydown", (event) => {
    if (event.key !== " " && event.key !== "Enter") return;
    event.preventDefault();
    if (!event.repeat) begin();
  });
  element.addEventListener("keyup", release);
  element.addEventListener("blur", release);
  // a press of assistive technology has no pointer or key, and can request a step only
  element.addEventListener("click", (event) => {
    if (event.detail === 0 && chosen(axis).distance > 0) begin();
  });
  const render = () => {
    const { distance, says } = chosen(axis);
    setAttr(element, "aria-label", t(direction > 0 ? "jog.plus" : "jog.minus", { axis, way: distance > 0 ? says : t("jog.hold") }));
    setAttr(element, "data-held", isOwn());
    disableFor(element, isOwn() ? null : whyNot(app.model, "jog"));
  };
  return { element, render };
}
