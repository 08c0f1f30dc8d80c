// The tile of a machine: its frame has the colour of its state, and its name opens its own screen.

import { asked, brief, look, sentence } from "../machine/sentence.js";
import { runsProgram } from "../path/shown.js";
import { duration, programName, seconds } from "../text/format.js";
import { t } from "../text/language.js";
import { button, fill, h, setAttr, setText } from "../ui/dom.js";
import { icon, setIcon } from "../ui/icons.js";
import { WatchedMachine } from "./watched_machine.js";

/** @typedef {WatchedMachine | import("./peer_machine.js").PeerMachine} Machine */

/** Order of tones: a machine shows the first that one of its coordinate systems has; attention is before motion. */
const URGENCY = ["alarm", "attention", "wait", "active", "ended", "done", "ready"];
/** Link states in which the tile is stale, and no action here can help. */
const AWAY = ["silent", "offline", "unheard"];
/** Most characters of the sentence. */
const SENTENCE_CHARS = 110;

/**
 * Reasons why a machine is silent, by its link state.
 * @type {Record<import("./watched_machine.js").LinkState, import("../text/language.js").Key | null>}
 */
const TROUBLES = {
  online: null, connecting: "machines.connecting", silent: "machines.silent", unreachable: "machines.unreachable", refused: "machines.refused", login: "machines.login", insecure: "machines.insecure",
  offline: "machines.offline", unheard: "machines.unheard",
};

/** @param {Machine} machine @param {(() => void) | null} remove null: the tile cannot be removed */
export function tile(machine, remove) {
  const isPeer = !(machine instanceof WatchedMachine);
  const name = h("a", { class: "machine-open" });
  const place = h("span", { class: "muted machine-address" });
  const away = remove && button({ class: "icon-button", onclick: remove }, icon("trash"));
  const trouble = h("p", { class: "machine-trouble", role: "status" });
  const alarms = h("p", { class: "machine-alarms" }, icon("alarm"));
  const count = h("span", {});
  alarms.append(count);
  const logIn = isPeer ? null : logInForm(machine);
  const list = h("ul", { class: "machine-systems" });
  const element = h("section", { class: "machine-tile" }, h("header", {}, h("h2", {}, name), place, away), trouble, logIn, alarms, list);
  setAttr(element, "data-machine", isPeer ? machine.name : null);
  /** @type {Map<number, ReturnType<typeof row>>} */
  let rows = new Map();
  const render = () => {
    const { address, link } = machine;
    const host = address?.replace(/^\w+:\/\//, "") ?? "";
    const called = machine.name ?? host;
    setText(name, called);
    setAttr(name, "href", address && `${address}/`);
    setAttr(name, "aria-label", address && t("machines.open", { machine: called }));
    setText(place, isPeer ? t("machines.by_broker") : host);
    setAttr(element, "data-address", isPeer ? null : address);
    if (away) setAttr(away, "aria-label", t("machines.remove", { machine: called }));
    if ([...rows.keys()].join() !== [...machine.systems.keys()].join()) {
      rows = new Map([...machine.systems.keys()].map((cs) => [cs, row(cs)]));
      fill(list, ...[...rows.values()].map((one) => one.element));
    }
    const tones = [...rows].map(([cs, one]) => one.render(machine, cs));
    const why = TROUBLES[link];
    const { staleMs } = machine;
    const stale = why === null && staleMs > 0 ? t("connection.stale", { seconds: seconds(staleMs / 1000, 1) }) : "";
    setText(trouble, why === null ? stale : t(why, why === "machines.refused" ? { origin: location.origin } : {}));
    setAttr(trouble, "hidden", why === null && stale === "");
    setAttr(element, "data-stale", stale !== "");
    setText(count, t("machines.alarms", { count: machine.alarmCount }));
    setAttr(alarms, "hidden", machine.alarmCount === 0);
    setAttr(element, "data-link", link);
    setAttr(element, "data-tone", frameTone(link, tones));
    if (logIn) setAttr(logIn, "hidden", link !== "login");
  };
  return { element, render, machine };
}

/** @param {import("./watched_machine.js").LinkState} link @param {string[]} tones */
function frameTone(link, tones) {
  if (link === "online") return URGENCY.find((tone) => tones.includes(tone)) ?? "ready";
  if (AWAY.includes(link)) return "away";
  return link === "connecting" ? "ready" : "attention";
}

/** A coordinate system. @param {number} cs */
function row(cs) {
  const sign = icon("ready");
  const word = h("strong", {});
  const left = h("span", { class: "machine-left" });
  const said = h("p", {});
  const program = h("p", { class: "muted" });
  const done = h("progress", { max: 1, "aria-label": t("machines.done") });
  const element = h("li", { class: "machine-system" }, h("div", { class: "machine-state" }, sign, word, h("span", { class: "muted" }, t("common.cs", { cs })), left), done, said, program);
  return {
    element,
    /** @param {Machine} machine @param {number} number */
    render(machine, number) {
      const system = machine.systems.get(number);
      const state = system?.state;
      setAttr(element, "hidden", !state);
      if (!system || !state) return "ready";
      const { tone, icon: sort, word: text } = look(state, system.pending?.outputs);
      setAttr(element, "data-tone", tone);
      setIcon(sign, sort);
      setText(word, asked(state) ? t("machines.asks", { state: text }) : text);
      setText(said, brief(sentence(system, machine.alarms, machine.ageMs, machine.birth), SENTENCE_CHARS));
      setText(program, state.program === null ? "" : system.place?.line ? t("common.program_line", { program: programName(state.program), line: system.place.line }) : programName(state.program));
      const ofRun = runsProgram(state) && system.timeLeft?.run_id === state.run_id ? system.timeLeft : null;
      const { left_s: leftS = null, progress = null } = ofRun ?? {};
      setText(left, leftS === null ? "" : t("machines.left", { time: duration(leftS * 1000) }));
      setAttr(done, "hidden", progress === null);
      done.value = progress ?? 0;
      return tone;
    },
  };
}

/** @param {WatchedMachine} machine */
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
  return element;
}
