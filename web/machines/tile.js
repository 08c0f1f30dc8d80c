// The tile of a machine: its frame has the colour of its state, and its name opens its own screen.

import { button, fill, h, setAttr, setText } from "../dom.js";
import { duration, programName } from "../format.js";
import { icon, setIcon } from "../icons.js";
import { t } from "../language.js";
import { brief, look, sentence } from "../sentence.js";

/** Tones of a machine of several coordinate systems, the first that one of them has: what asks for a person, then what runs. */
const URGENCY = ["alarm", "attention", "wait", "active", "ended", "done", "ready"];
/** Characters of the sentence. */
const SENTENCE_CHARS = 110;

/** Why nothing is heard of it, by its link. @type {Record<import("./watched.js").LinkState, import("../language.js").Key | null>} */
const TROUBLES = {
  online: null, connecting: "machines.connecting", silent: "machines.silent", unreachable: "machines.unreachable", refused: "machines.refused", login: "machines.login", insecure: "machines.insecure",
};

/** @param {import("./watched.js").Watched} machine @param {(() => void) | null} remove null: it stays */
export function tile(machine, remove) {
  const { address, model } = machine;
  const name = h("a", { class: "machine-open", href: `${address}/` });
  const away = remove && button({ class: "icon-button", onclick: remove }, icon("trash"));
  const trouble = h("p", { class: "machine-trouble", role: "status" });
  const logIn = logInForm(machine);
  const list = h("ul", { class: "machine-systems" });
  const element = h(
    "section",
    { class: "machine-tile", "data-address": address },
    h("header", {}, h("h2", {}, name), h("span", { class: "muted machine-address" }, address.replace(/^\w+:\/\//, "")), away),
    trouble,
    logIn.element,
    list,
  );
  /** @type {Map<number, ReturnType<typeof row>>} */
  let rows = new Map();
  const render = () => {
    const called = model.birth?.machine ?? address.replace(/^\w+:\/\//, "");
    setText(name, called);
    setAttr(name, "aria-label", t("machines.open", { machine: called }));
    if (away) setAttr(away, "aria-label", t("machines.remove", { machine: called }));
    if ([...rows.keys()].join() !== [...model.systems.keys()].join()) {
      rows = new Map([...model.systems.keys()].map((cs) => [cs, row(cs)]));
      fill(list, ...[...rows.values()].map((one) => one.element));
    }
    const tones = [...rows].map(([cs, one]) => one.render(machine, cs));
    const why = TROUBLES[machine.link];
    setText(trouble, why === null ? "" : t(why, why === "machines.refused" ? { origin: location.origin } : {}));
    setAttr(trouble, "hidden", why === null);
    setAttr(element, "data-link", machine.link);
    setAttr(element, "data-tone", machine.link === "online" ? (URGENCY.find((tone) => tones.includes(/** @type {any} */ (tone))) ?? "ready") : machine.link === "connecting" ? "ready" : "attention");
    setAttr(logIn.element, "hidden", machine.link !== "login");
  };
  return { element, render, machine };
}

/** A coordinate system. @param {number} cs */
function row(cs) {
  const sign = icon("ready");
  const word = h("strong", {});
  const left = h("span", { class: "machine-left" });
  const said = h("p", {});
  const program = h("p", { class: "muted" });
  const element = h("li", { class: "machine-system" }, h("div", { class: "machine-state" }, sign, word, h("span", { class: "muted" }, t("common.cs", { cs })), left), said, program);
  return {
    element,
    /** @param {import("./watched.js").Watched} machine @param {number} number */
    render({ model, left: times }, number) {
      const system = model.systems.get(number);
      const state = system?.state;
      setAttr(element, "hidden", !state);
      if (!system || !state) return "ready";
      const { tone, icon: sort, word: text } = look(state, system.pending?.outputs);
      setAttr(element, "data-tone", tone);
      setIcon(sign, sort);
      setText(word, text);
      setText(said, brief(sentence(system, model.alarms, (ts) => model.ageMs(ts), model.birth), SENTENCE_CHARS));
      setText(program, state.program === null ? "" : system.place?.line ? t("common.program_line", { program: programName(state.program), line: system.place.line }) : programName(state.program));
      const time = times.get(number);
      setText(left, time === undefined ? "" : t("machines.left", { time: duration(time * 1000) }));
      return tone;
    },
  };
}

/** @param {import("./watched.js").Watched} machine */
function logInForm(machine) {
  const field = (/** @type {string} */ label, /** @type {string} */ type, /** @type {AutoFill} */ autocomplete) => h("input", { type, class: "input grow", autocomplete, "aria-label": label, placeholder: label });
  const [user, pin, token] = [field(t("token.user"), "text", "username"), field("PIN", "password", "current-password"), field(t("token.token"), "password", "off")];
  const problem = h("p", { role: "alert" });
  const element = h("form", { class: "machine-login", hidden: true }, user, pin, h("span", { class: "muted" }, t("token.or_a_token_of_this")), token, button({ type: "submit" }, t("token.enter")), problem);
  element.addEventListener("submit", async (event) => {
    event.preventDefault();
    setText(problem, "");
    try {
      await machine.logIn({ user: user.value.trim(), pin: pin.value, token: token.value.trim() });
      setText(problem, machine.link === "login" ? t("token.the_machine_does_not_know") : "");
    } catch (error) {
      setText(problem, error instanceof Error ? error.message : String(error));
    }
  });
  return { element };
}
