// Preview of a cycle as the runtime plans it: drawn with the path, with the alarm that would end it.

import { Refusal } from "../machine/api.js";
import { readPath } from "../path/bytes.js";
import { seconds } from "../text/format.js";
import { sentences, t } from "../text/language.js";

/** Interval of the requests for an incomplete plan, ms, and their highest number. */
const AGAIN_MS = 200;
const ASKED_MAX = 75;

export class Planned {
  /** @type {import("./cycles.js").Cycle | null} */
  cycle = null;
  /** Reason why the cycle cannot run; empty if it can. */
  trouble = "";
  isAsked = false;
  #key = "";
  #seconds = 0;

  /** @param {import("../main.js").App} app */
  constructor(app) {
    this.app = app;
  }

  /** Discards a plan made for other inputs. @param {string} key */
  render(key) {
    if (this.#key !== "" && key !== this.#key) this.forget();
  }

  forget() {
    this.#key = "";
    this.cycle = null;
    this.trouble = "";
    this.app.model.preview = null;
  }

  /** Returns the reason why a cycle may not run now. */
  whyNot() {
    if (this.cycle === null || this.isAsked) return t("probe.look_first");
    return this.trouble || null;
  }

  says() {
    if (this.cycle === null || this.isAsked) return "";
    if (this.trouble) return this.trouble;
    return sentences(t("probe.planned", { count: this.cycle.touches.length, time: seconds(this.#seconds, 1) }), t("probe.planned_as_if"));
  }

  /**
   * Plans a cycle with each touch over its longest distance.
   * @param {string} key @param {import("./cycles.js").Cycle} cycle
   */
  async plan(key, cycle) {
    this.forget();
    this.#key = key;
    this.cycle = cycle;
    this.isAsked = true;
    const cs = this.app.model.selected;
    try {
      const rehearsal = await this.#rehearse(cs, cycle.whole);
      if (this.#key !== key) return;
      this.trouble = rehearsal.outcome === "completed" ? "" : rehearsal.text || t("path.planning");
      this.#seconds = rehearsal.cycle_time_s;
      const path = readPath(await this.app.api.manualPath(cs, cycle.whole));
      if (this.#key === key) this.app.model.preview = { path, key };
    } catch (error) {
      if (!(error instanceof Refusal)) throw error;
      if (this.#key === key) this.trouble = error.message;
    } finally {
      this.isAsked = false;
      this.app.invalidate();
    }
  }

  /** @param {number} cs @param {string} text */
  async #rehearse(cs, text) {
    for (let asked = 1; ; asked += 1) {
      const rehearsal = await this.app.api.manualRehearsal(cs, text);
      if (rehearsal.outcome !== "planning" || asked === ASKED_MAX) return rehearsal;
      await new Promise((resolve) => setTimeout(resolve, AGAIN_MS));
    }
  }
}
