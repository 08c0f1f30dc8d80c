// Decides whether a plan may be shown: during a run only the plan of that run, else the plan of the text that a start would run.

/** @typedef {import("../types.d.ts").StateMessage} StateMessage */

/** True while the loaded program runs, moving or paused. @param {StateMessage | null | undefined} state */
export function runsProgram(state) {
  return state?.run_kind === "program";
}

/**
 * @param {StateMessage | null | undefined} state
 * @param {{runId: string | null, hash: string | null} | null} plan
 */
export function isShown(state, plan) {
  if (!state || !plan) return false;
  return runsProgram(state) ? plan.runId === state.run_id : plan.hash !== null && plan.hash === state.hash;
}
