// Start, hold, resume, stop, reset, abort. Start begins a run, and resumes after a pause, as on every control; each other button
// always has the same meaning.

import { disableFor, startVerb, whyNot } from "../access/why_not.js";
import { acceptsRisks } from "../programs/start_risks.js";
import { programName } from "../text/format.js";
import { listed, t } from "../text/language.js";
import { button, h } from "../ui/dom.js";
import { icon } from "../ui/icons.js";

/** @type {{verb: import("../types.d.ts").Verb, label: string, icon: string, says: string}[]} */
const COMMANDS = [
  { verb: "start", label: t("commands.start"), icon: "play", says: t("commands.cycle_start_begins_the_program") },
  { verb: "hold", label: t("commands.hold"), icon: "pause", says: t("commands.feed_hold") },
  { verb: "resume", label: t("commands.resume"), icon: "resume", says: t("commands.goes_on_after_a_pause") },
  { verb: "stop", label: t("commands.stop"), icon: "stop", says: t("commands.slows_down_on_the_path") },
  { verb: "reset", label: t("commands.reset"), icon: "reset", says: t("commands.ends_the_run_cancels_open") },
  { verb: "abort", label: t("commands.abort"), icon: "abort", says: t("commands.brakes_each_motor_at_once") },
];
/** States in which a reset ends a run. */
const IN_RUN = new Set(["WAIT", "FEED_HOLD", "PROGRAM_STOPPED", "OPTIONAL_STOP", "INTERRUPTED"]);

/** @type {import("../main.js").View} */
export const commands = {
  place: "footer",
  create(app) {
    const buttons = COMMANDS.map(({ verb, label, icon: name, says }) => {
      const onclick = () => press(app, verb);
      return { verb, says, element: button({ class: `command ${verb}`, onclick }, icon(name), h("span", {}, label)) };
    });
    const render = () => {
      for (const { verb, says, element: one } of buttons) {
        disableFor(one, whyNot(app.model, verb === "start" ? startVerb(app.model) : verb), says);
      }
    };
    const element = h("div", { class: "commands", role: "group", "aria-label": t("commands.commands") }, ...buttons.map((one) => one.element));
    return { element, render };
  },
};

/** @param {import("../main.js").App} app @param {import("../types.d.ts").Verb} verb */
export async function press(app, verb) {
  const { model } = app;
  if (verb === "start" || verb === "resume") {
    const sent = verb === "start" ? startVerb(model) : verb;
    if (sent === "start" && !(await acceptsRisks(app))) return;
    return app.go(sent);
  }
  const state = model.current?.state;
  if (verb === "reset" && state && IN_RUN.has(state.execution)) {
    const open = model.current?.pending?.outputs.map((output) => `M${output.m}`) ?? [];
    const sure = await app.confirm({
      title: state.run_kind === "mdi" ? t("commands.end_mdi") : t("commands.end_program", { program: programName(state.program) }),
      text: open.length > 0 ? t("commands.ends_and_cancels", { codes: listed(open) }) : t("commands.ends"),
      yes: t("commands.end_the_run"),
      no: t("commands.keep_the_run"),
    });
    if (!sure) return;
  }
  return app.command(verb);
}
