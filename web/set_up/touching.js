// Runs a probe cycle as manual data input, and collects the captured positions.

import { api, diagnosticsOf } from "../machine/api.js";
import { machine } from "../machine/machine.js";
import { Refusal } from "../tandem.js";
import { t } from "../text/language.js";
import { NEAR_MM } from "./cycles.js";

/** Interval at which the state is checked, ms. */
const LOOK_MS = 50;
const AT_REST = ["READY", "PROGRAM_COMPLETED", "STOPPED"];

/** @typedef {import("../types.d.ts").CapturedPositionsMessage} Captured */

/**
 * Runs a cycle to its end, holds and waits included; returns the captured machine positions in the order of its touches.
 * @param {import("../main.js").App} app @param {import("./cycles.js").Cycle} cycle
 * @returns {Promise<number[]>}
 */
export async function runCycle(app, cycle) {
  const cs = app.model.selected;
  const { bootId } = app.model;
  const before = app.model.current?.state?.run_id ?? null;
  /** @type {Captured[]} */
  const told = [];
  const end = machine.on(`cs/${cs}/captured`, (message) => void told.push(message));
  try {
    await api.command(cs, "mdi", { text: cycle.text, macro: true }).catch((error) => {
      // the captured positions show which touch was missed
      if (error instanceof Refusal && error.problem.code === "no_touch") return;
      throw new Refusal(diagnosticsOf(error).map(({ message, help }) => `${message} ${help}`).join(" "));
    });
    const state = await ended(app, cs, before);
    if (app.model.bootId !== bootId) throw new Refusal(t("main.the_runtime_was_started_again"));
    const captures = told.filter(({ run_id }) => run_id === state.run_id);
    const positions = cycle.touches.map((touch) => positionOf(app, cs, touch, captures));
    const none = positions.find((one) => one.why);
    if (none?.why) throw new Refusal(none.why);
    return positions.map(({ at }) => at);
  } finally {
    end();
  }
}

/** Returns the state at the end of the run that follows another run. @param {import("../main.js").App} app @param {number} cs @param {string | null} before */
async function ended(app, cs, before) {
  for (;;) {
    await new Promise((resolve) => setTimeout(resolve, LOOK_MS));
    const state = app.model.systems.get(cs)?.state;
    if (!app.model.online || !state || state.run_id === before || state.run_kind !== null || state.transition !== null) continue;
    if (!AT_REST.includes(state.execution)) continue;
    if (state.execution === "STOPPED") throw new Refusal(app.model.alarms.find((alarm) => alarm.cs === cs)?.text ?? t("probe.was_stopped"));
    return state;
  }
}

/** @param {import("../main.js").App} app @param {number} cs @param {import("./cycles.js").Cycle["touches"][number]} touch @param {Captured[]} captures */
function positionOf(app, cs, { axis, line, sign, from }, captures) {
  const way = `${axis}${sign > 0 ? "+" : "\u2212"}`;
  const capture = captures.find((one) => one.line === line);
  if (!capture) return { at: 0, why: t("probe.was_cut_short", { way }) };
  const i = capture.motors.indexOf(app.model.systems.get(cs)?.info.axes[axis] ?? 0);
  const at = capture.positions[i] ?? Number.NaN;
  if (!capture.captured[i]) return { at, why: t("probe.did_not_touch", { way }) };
  if (Math.abs(at - from) < NEAR_MM) return { at, why: t("probe.touched_before", { way }) };
  return { at, why: "" };
}
