// Start, hold, resume, stop, reset, abort. There are no toggles: each button always means the same.

import { button, h } from "../dom.js";
import { icon } from "../icons.js";

/**
 * The states in which each is enabled. Hold, stop and abort are allowed in every state and stay enabled even without a
 * connection: a request that visibly fails is better than a dead button.
 * @type {{verb: import("../types.d.ts").Verb, label: string, icon: string, states: string[] | null}[]}
 */
const COMMANDS = [
  { verb: "start", label: "Start", icon: "play", states: ["READY", "PROGRAM_COMPLETED"] },
  { verb: "hold", label: "Hold", icon: "pause", states: null },
  { verb: "resume", label: "Resume", icon: "resume", states: ["FEED_HOLD", "PROGRAM_STOPPED", "OPTIONAL_STOP", "INTERRUPTED"] },
  { verb: "stop", label: "Stop", icon: "stop", states: null },
  { verb: "reset", label: "Reset", icon: "reset", states: ["READY", "WAIT", "FEED_HOLD", "PROGRAM_STOPPED", "OPTIONAL_STOP", "INTERRUPTED", "STOPPED", "PROGRAM_COMPLETED"] },
  { verb: "abort", label: "Abort", icon: "abort", states: null },
];

/** @type {import("../main.js").View} */
export const commands = {
  place: "footer",
  create(app) {
    const buttons = COMMANDS.map(({ verb, label, icon: name, states }) => {
      const onclick = () => app.command(verb);
      return { verb, states, element: button({ class: `command ${verb}`, onclick }, icon(name), h("span", {}, label)) };
    });
    const render = () => {
      const { online, current } = app.model;
      const state = current?.state;
      for (const { verb, states, element: one } of buttons) {
        const needsProgram = verb === "start" && state?.program === null;
        one.disabled = states !== null && !(online && state && states.includes(state.execution) && !needsProgram);
      }
    };
    const element = h("div", { class: "commands", role: "group", "aria-label": "Commands" }, ...buttons.map((one) => one.element));
    return { element, render };
  },
};
