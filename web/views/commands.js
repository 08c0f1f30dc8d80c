// Start, hold, resume, stop, reset, abort. Never one toggle: each button always means the same.

import { h } from "../dom.js";
import { icon } from "../icons.js";

/**
 * Where each is of use. Hold, stop and abort are allowed in every state and stay pressable even when this screen has
 * lost the machine: better a request that fails aloud than a dead button.
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
    const buttons = COMMANDS.map((command) => {
      const button = h("button", { type: "button", class: `command ${command.verb}` }, icon(command.icon), h("span", {}, command.label));
      button.addEventListener("click", () => {
        const cs = app.model.selected;
        void app.attempt(() => app.api.command(cs, command.verb));
      });
      return { ...command, button };
    });
    const render = () => {
      const { online, current } = app.model;
      const state = current?.state;
      for (const { verb, states, button } of buttons) {
        const needsProgram = verb === "start" && state?.program === null;
        button.disabled = states !== null && !(online && state && states.includes(state.execution) && !needsProgram);
      }
    };
    const element = h("div", { class: "commands", role: "group", "aria-label": "Commands" }, ...buttons.map((b) => b.button));
    return { element, render };
  },
};
