// Open outputs: their M codes, handlers and age; questions, confirmation by hand and redelivery.

import { disableFor, whyNotNow } from "../access/why_not.js";
import { declared, inWords } from "../text/declared.js";
import { duration, programName } from "../text/format.js";
import { t } from "../text/language.js";
import { button, card, fill, h, setAttr, setText } from "../ui/dom.js";
import { icon } from "../ui/icons.js";

/** @type {Record<string, string>} */
const STATES = { QUEUED: t("m_codes.queued"), OUTPUT: t("m_codes.no_handler"), CLAIMED: t("m_codes.in_work") };

/** @type {import("../main.js").View} */
export const mCodes = {
  place: "now",
  create(app) {
    const count = h("span", { class: "muted" });
    const list = h("ul", { class: "list", "aria-label": t("elements.open_m_codes") });
    /** @type {Map<string, ReturnType<typeof entry>>} */
    let shown = new Map();

    const render = () => {
      const { model } = app;
      const waited = model.current?.state?.waiting_on?.seq;
      // the awaited output is first
      const outputs = [...(model.current?.pending?.outputs ?? [])].sort((a, b) => Number(b.seq === waited) - Number(a.seq === waited) || a.seq - b.seq);
      const keys = outputs.map((output) => `${model.bootId} ${model.selected} ${output.seq}`);
      if (keys.join() !== [...shown.keys()].join()) {
        shown = new Map(keys.map((key, i) => [key, shown.get(key) ?? entry(app, outputs[i]?.seq ?? 0)]));
        fill(list, ...[...shown.values()].map((one) => one.element));
      }
      for (const [i, key] of keys.entries()) {
        const output = outputs[i];
        if (output) shown.get(key)?.render(output);
      }
      setText(count, outputs.length > 0 ? t("m_codes.open", { count: outputs.length }) : model.current?.pending ? t("elements.no_m_code_is_open") : "");
    };
    return { element: card("m-codes-card", t("m_buttons.m_codes"), [count], list), render };
  },
};

/** @param {import("../main.js").App} app @param {number} seq */
function entry(app, seq) {
  const name = h("strong", { class: "m" });
  const badge = h("span", { class: "chip" });
  const age = h("span", { class: "age" });
  const given = h("span", { class: "params" });
  const from = h("span", { class: "muted" });
  const handler = h("p", { class: "handler" });
  const bar = h("progress", { max: 100, hidden: true });
  const redeliver = (/** @type {"redo" | "verify"} */ how) => {
    const { selected, bootId } = app.model;
    return app.attempt(() => app.api.redeliver(selected, bootId ?? "", seq, how));
  };
  const confirm = h("span");
  const reset = button({ class: "button reset-output", onclick: () => confirmByHand(app, output) }, icon("done"), confirm);
  const redo = button({ onclick: () => redeliver("redo") }, t("m_codes.redo"));
  const verify = button({ class: "button verify-output", onclick: () => redeliver("verify") }, t("m_codes.verify"));
  const redeliveries = h("span", { class: "row", role: "group", "aria-label": t("m_codes.redeliver") }, verify, redo);
  const asked = question(app, seq);
  const element = h(
    "li",
    { class: "output", "data-seq": seq },
    h("div", { class: "row" }, name, badge, h("span", { class: "spring" }), age),
    h("div", { class: "row wrap end" }, h("div", { class: "work" }, h("p", {}, given, from), handler, bar), redeliveries, reset),
    asked.element,
  );
  /** @type {import("../types.d.ts").PendingOutput | null} */
  let output = null;

  /** @param {import("../types.d.ts").PendingOutput} now */
  const render = (now) => {
    output = now;
    const { model } = app;
    const said = declared(model.birth, model.selected, now.m);
    setText(name, codeName(app, now));
    setText(badge, now.lost ? t("reason.HANDLER_LOST") : (STATES[now.state] ?? now.state));
    setAttr(badge, "data-tone", now.lost ? "attention" : now.state === "CLAIMED" ? "wait" : "ready");
    setText(age, duration(model.ageMs(now.since)));
    setText(given, inWords(now.params, said?.params).join("  "));
    const where = t("common.program_line", { program: programName(now.program), line: now.line });
    setText(from, [where, `seq ${now.seq}`, now.attempt > 1 && t("m_codes.attempt", { attempt: now.attempt })].filter(Boolean).join(" · "));
    setText(handler, now.lost ? lostText(now) : handlerText(now));
    setAttr(handler, "hidden", !handler.textContent);
    setAttr(bar, "hidden", now.progress?.percent === undefined);
    if (now.progress?.percent !== undefined) bar.value = now.progress.percent;
    setAttr(bar, "aria-label", t("elements.progress_of_m", { m: now.m }));
    setAttr(redeliveries, "hidden", !now.lost);
    setText(confirm, t("m_codes.confirm_m", { m: now.m }));
    setAttr(reset, "aria-label", t("m_codes.confirm_m_by_hand", { m: now.m }));
    setAttr(redo, "aria-label", t("m_codes.redeliver_m_do_it_again", { m: now.m }));
    setAttr(verify, "aria-label", t("m_codes.redeliver_m_look_at_the", { m: now.m }));
    asked.render(now);
    disableFor(reset, whyNotNow(model, "reset"), t("m_codes.m_is_done_the_program", { m: now.m }));
    for (const one of [redo, verify]) disableFor(one, whyNotNow(model));
  };
  return { element, render };
}

/**
 * Shows the handler's question, with a button for each choice.
 * @param {import("../main.js").App} app @param {number} seq
 */
function question(app, seq) {
  const text = h("p", { class: "question" });
  const choices = h("div", { class: "choices", role: "group", "aria-label": t("common.answer") });
  const element = h("div", { class: "asked", hidden: true }, text, choices);
  let shown = "";

  /** @param {import("../types.d.ts").PendingOutput} now */
  const render = (now) => {
    const asked = now.question?.answer === undefined ? now.question : undefined;
    setAttr(element, "hidden", !asked);
    if (asked && asked.id !== shown) {
      setText(text, asked.text);
      const answer = (/** @type {string} */ choice) => {
        const { selected, bootId } = app.model;
        return app.attempt(() => app.api.answer(selected, bootId ?? "", seq, asked.id, choice));
      };
      fill(choices, ...asked.choices.map((choice) => button({ onclick: () => answer(choice) }, choice)));
    }
    shown = asked?.id ?? "";
    for (const one of choices.querySelectorAll("button")) disableFor(one, whyNotNow(app.model));
  };
  return { element, render };
}

/** @param {import("../types.d.ts").PendingOutput} output */
function handlerText({ handler_id, progress }) {
  if (!handler_id) return progress?.text ?? "";
  const percent = progress?.percent === undefined ? "" : `, ${Math.round(progress.percent)}\u00a0%`;
  return progress ? `${handler_id}: ${progress.text}${percent}` : handler_id;
}

/** @param {import("../types.d.ts").PendingOutput} output */
function lostText({ how }) {
  if (how) return how === "redo" ? t("m_codes.waits_redo") : t("m_codes.waits_verify");
  return t("m_codes.redo_starts_the_handler_anew");
}

/** The M code with its declared name. @param {import("../main.js").App} app @param {import("../types.d.ts").PendingOutput} output */
function codeName({ model }, { m }) {
  const name = declared(model.birth, model.selected, m)?.name;
  return `M${m}${name ? ` ${name}` : ""}`;
}

/** The M code, its parameters and its last progress. @param {import("../main.js").App} app @param {import("../types.d.ts").PendingOutput} output */
function workOf(app, output) {
  const { progress } = output;
  const given = inWords(output.params, declared(app.model.birth, app.model.selected, output.m)?.params).join(" ");
  const percent = progress?.percent === undefined ? "" : `, ${Math.round(progress.percent)}\u00a0%`;
  const reached = progress ? t("m_codes.progress_reached", { progress: `${progress.text}${percent}` }) : t("m_codes.no_progress");
  return [`${[codeName(app, output), given].filter(Boolean).join(", ")}.`, reached].join(" ");
}

/** Returns the client responsible for the output. @param {import("../types.d.ts").PendingOutput} output */
function responsible({ lost, handler_id }) {
  if (lost) return t("m_codes.confirm_lost");
  return handler_id ? t("m_codes.confirm_about", { handler: handler_id }) : t("m_codes.confirm_unclaimed");
}

/**
 * Asks in every state of the output, because the program then continues and axes can move, also if the machine has not finished.
 * @param {import("../main.js").App} app @param {import("../types.d.ts").PendingOutput | null} output
 */
async function confirmByHand(app, output) {
  if (!output) return;
  const { selected, bootId } = app.model;
  const sure = await app.confirm({
    title: t("m_codes.ask_to_confirm", { m: output.m }),
    text: `${workOf(app, output)} ${responsible(output)}`,
    yes: t("m_codes.is_done", { m: output.m }),
    no: t("m_codes.keep_waiting"),
  });
  if (sure) await app.attempt(() => app.api.resetOutput(selected, bootId ?? "", output.seq));
}
