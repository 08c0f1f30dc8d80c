// Open outputs: their M codes, handlers and age; questions, confirmation by hand and redelivery.

import { button, card, fill, h, setAttr, setText } from "../dom.js";
import { duration, params, plain, programName } from "../format.js";
import { icon } from "../icons.js";
import { disableFor, whyNotNow } from "../why_not.js";

/** @type {Record<string, string>} */
const STATES = { QUEUED: "queued", OUTPUT: "no handler yet", CLAIMED: "in work" };

/** @type {import("../main.js").View} */
export const mCodes = {
  place: "now",
  create(app) {
    const count = h("span", { class: "muted" });
    const list = h("ul", { class: "list", "aria-label": "Open M codes" });
    /** @type {Map<string, ReturnType<typeof entry>>} */
    let shown = new Map();

    const render = () => {
      const { model } = app;
      const waited = model.current?.state?.waiting_on?.seq;
      // the one that the program waits for comes first
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
      setText(count, outputs.length > 0 ? `${outputs.length} open` : model.current?.pending ? "No M code is open." : "");
    };
    return { element: card("m-codes-card", "M codes", [count], list), render };
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
    void app.attempt(() => app.api.redeliver(selected, bootId ?? "", seq, how));
  };
  const reset = button({ class: "button reset-output", onclick: () => void confirmByHand(app, output) }, icon("done"), "Confirm");
  const redo = button({ onclick: () => redeliver("redo") }, "Redo");
  const verify = button({ onclick: () => redeliver("verify") }, "Verify");
  const redeliveries = h("span", { class: "row", role: "group", "aria-label": "Redeliver" }, redo, verify);
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
    const said = declared(model, now.m);
    setText(name, `M${now.m}${said?.name ? ` ${said.name}` : ""}`);
    setText(badge, now.lost ? "handler lost" : (STATES[now.state] ?? now.state));
    setAttr(badge, "data-tone", now.lost ? "attention" : now.state === "CLAIMED" ? "wait" : "ready");
    setText(age, duration(model.ageMs(now.since)));
    setText(given, inWords(now.params, said?.params));
    setText(from, `${programName(now.program)} line ${now.line} · seq ${now.seq}${now.attempt > 1 ? ` · attempt ${now.attempt}` : ""}`);
    setText(handler, now.lost ? lostText(now) : handlerText(now));
    setAttr(handler, "hidden", !handler.textContent);
    setAttr(bar, "hidden", now.progress?.percent === undefined);
    if (now.progress?.percent !== undefined) bar.value = now.progress.percent;
    setAttr(bar, "aria-label", `Progress of M${now.m}`);
    setAttr(redeliveries, "hidden", !now.lost);
    setAttr(reset, "aria-label", `Confirm M${now.m} by hand`);
    setAttr(redo, "aria-label", `Redeliver M${now.m}: do it again from the start`);
    setAttr(verify, "aria-label", `Redeliver M${now.m}: look at the machine first`);
    asked.render(now);
    disableFor(reset, whyNotNow(model, "reset"), `M${now.m} is done: the program goes on`);
    for (const one of [redo, verify]) disableFor(one, whyNotNow(model));
  };
  return { element, render };
}

/** What the handler asks, with a button for each choice. @param {import("../main.js").App} app @param {number} seq */
function question(app, seq) {
  const text = h("p", { class: "question" });
  const choices = h("div", { class: "choices", role: "group", "aria-label": "Answer" });
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
        void app.attempt(() => app.api.answer(selected, bootId ?? "", seq, asked.id, choice));
      };
      fill(choices, ...asked.choices.map((choice) => button({ onclick: () => answer(choice) }, choice)));
    }
    shown = asked?.id ?? "";
    for (const one of choices.querySelectorAll("button")) disableFor(one, whyNotNow(app.model));
  };
  return { element, render };
}

/**
 * What the sequence side, or else the configuration, says of an M code.
 * @param {import("../model.js").Model} model @param {number} m
 */
function declared({ birth, selected }, m) {
  const served = birth?.serves?.find((one) => one.m === m && one.cs.includes(selected) && (one.name || one.params));
  return served ?? birth?.m_codes[m];
}

/**
 * Parameters in the words in which they are declared: `force 5 kN`; others as the program writes them.
 * @param {import("../types.d.ts").Params} given @param {NonNullable<import("../types.d.ts").MCodeDeclaration["params"]>} [said]
 */
function inWords(given, said = {}) {
  const words = Object.entries(given).map(([letter, value]) => {
    const { name, unit } = said[/** @type {keyof typeof said} */ (letter)] ?? {};
    const number = name ? `${name} ${plain(value)}` : params({ [letter]: value });
    return unit ? `${number}\u00a0${unit}` : number;
  });
  return words.join("  ");
}

/** @param {import("../types.d.ts").PendingOutput} output */
function handlerText({ handler_id, progress }) {
  if (!handler_id) return progress?.text ?? "";
  const percent = progress?.percent === undefined ? "" : `, ${Math.round(progress.percent)}\u00a0%`;
  return progress ? `${handler_id}: ${progress.text}${percent}` : handler_id;
}

/** @param {import("../types.d.ts").PendingOutput} output */
function lostText({ how }) {
  if (how) return `Waits for its handler, which is asked to ${how === "redo" ? "do it again" : "verify it"}.`;
  return "Redo starts the handler anew; Verify lets it look at the machine first.";
}

/** @param {import("../main.js").App} app @param {import("../types.d.ts").PendingOutput | null} output */
async function confirmByHand(app, output) {
  if (!output) return;
  const { selected, bootId } = app.model;
  if (output.handler_id) {
    const sure = await app.confirm({
      title: `Confirm M${output.m} by hand?`,
      text: `Handler ${output.handler_id} is working on it. The program goes on at once, whether the machine has finished or not. The handler is told that its work is cancelled.`,
      yes: `Confirm M${output.m}`,
      no: "Keep waiting",
    });
    if (!sure) return;
  }
  await app.attempt(() => app.api.resetOutput(selected, bootId ?? "", output.seq));
}
