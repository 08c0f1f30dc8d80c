// Start, hold, resume, stop, reset, abort. Start begins, and goes on after a pause, as on every control; each other button
// always means the same.

import { button, h } from "../dom.js";
import { programName } from "../format.js";
import { icon } from "../icons.js";
import { disableFor, startVerb, whyNot } from "../why_not.js";

/** @type {{verb: import("../types.d.ts").Verb, label: string, icon: string, says: string}[]} */
const COMMANDS = [
  { verb: "start", label: "Start", icon: "play", says: "Cycle start: begins the program, or goes on after a pause" },
  { verb: "hold", label: "Hold", icon: "pause", says: "Feed hold" },
  { verb: "resume", label: "Resume", icon: "resume", says: "Goes on after a pause" },
  { verb: "stop", label: "Stop", icon: "stop", says: "Slows down on the path and ends the run" },
  { verb: "reset", label: "Reset", icon: "reset", says: "Ends the run, cancels open M codes, clears alarms" },
  { verb: "abort", label: "Abort", icon: "abort", says: "Brakes each motor at once and ends the run" },
];
/** States in which a reset throws a run away. */
const IN_RUN = new Set(["WAIT", "FEED_HOLD", "PROGRAM_STOPPED", "OPTIONAL_STOP", "INTERRUPTED"]);

/** @type {import("../main.js").View} */
export const commands = {
  place: "footer",
  create(app) {
    const buttons = COMMANDS.map(({ verb, label, icon: name, says }) => {
      const onclick = () => void press(app, verb);
      return { verb, says, element: button({ class: `command ${verb}`, onclick }, icon(name), h("span", {}, label)) };
    });
    const render = () => {
      for (const { verb, says, element: one } of buttons) {
        disableFor(one, whyNot(app.model, verb === "start" ? startVerb(app.model) : verb), says);
      }
    };
    const element = h("div", { class: "commands", role: "group", "aria-label": "Commands" }, ...buttons.map((one) => one.element));
    return { element, render };
  },
};

/** @param {import("../main.js").App} app @param {import("../types.d.ts").Verb} verb */
export async function press(app, verb) {
  const { model } = app;
  if (verb === "start" || verb === "resume") return app.go(verb === "start" ? startVerb(model) : verb);
  const state = model.current?.state;
  if (verb === "reset" && state && IN_RUN.has(state.execution)) {
    const open = model.current?.pending?.outputs.map((output) => `M${output.m}`) ?? [];
    const run = state.run_kind === "mdi" ? "the MDI run" : `the run of ${programName(state.program)}`;
    const sure = await app.confirm({
      title: `End ${run}?`,
      text: `Reset ends it for good${open.length > 0 ? `, cancels ${open.join(", ")}` : ""}, and the next Start begins at the head.`,
      yes: "End the run",
      no: "Keep the run",
    });
    if (!sure) return;
  }
  app.command(verb);
}
