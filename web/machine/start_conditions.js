// Obstacles to a start: one list of the machine for the sentence, other machines' tiles, and the Start button.

import { programName } from "../text/format.js";
import { listed, t } from "../text/language.js";
import { ownFence } from "./fences.js";

/** @typedef {import("../types.d.ts").StartObstacle} StartObstacle */
/** @typedef {import("./model.js").CoordinateSystem} CoordinateSystem */

/**
 * Returns the obstacles to a start, the first to be removed first. A lease of this page is no obstacle.
 * @param {CoordinateSystem | null} system @returns {StartObstacle[]}
 */
export function startObstacles(system) {
  const all = system?.startConditions?.obstacles ?? [];
  return all.filter(({ kind }) => kind !== "lease" || ownFence(system?.info.number ?? 0) === undefined);
}

/** Returns the text of an obstacle for the operator. @param {StartObstacle} obstacle @param {CoordinateSystem | null} system */
export function obstacleWords({ kind, detail = "", text, m_codes: codes = [], at }, system) {
  switch (kind) {
    case "interlock":
      return detail ? t("why_not.interlock_why", { text: detail }) : t("why_not.interlock");
    case "start_lock":
      return detail ? t("why_not.start_lock_why", { text: detail }) : t("why_not.start_lock");
    case "lease":
      return t("why_not.leased", { holder: detail });
    case "alarm":
      return t("why_not.an_alarm_is_active_remove");
    case "no_program":
      return t("sentence.no_program");
    case "reset":
      return t("why_not.press_reset_first_which_makes", { program: programName(system?.state?.program) });
    case "running":
      return t("why_not.a_run_is_on_wait");
    case "program":
      return t("start.program", { text: detail });
    case "m_code":
      return t("start.m_code", { codes: listed(codes.map((m) => `M${m}`)) });
    case "prediction":
      return at ? t("start.prediction_at", { text: detail, line: at.line }) : t("start.prediction", { text: detail });
    default:
      return text;
  }
}

/** Returns the reason why Start would be refused; null if it would not. @param {CoordinateSystem | null} system */
export function whyNoStart(system) {
  const refusing = startObstacles(system).find(({ refuses }) => refuses);
  return refusing ? obstacleWords(refusing, system) : null;
}

/**
 * Returns the problems that would end a run although Start is accepted.
 * @param {CoordinateSystem | null} system @returns {string[]}
 */
export function risksOfStart(system) {
  return startObstacles(system).filter(({ refuses }) => !refuses).map((one) => obstacleWords(one, system));
}
