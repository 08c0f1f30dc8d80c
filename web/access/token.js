// The token of this screen, if the machine requires one. It is kept until the browser window is closed.

import { machine } from "../machine/machine.js";
import { Refusal, storedToken, storeToken } from "../tandem.js";
import { t } from "../text/language.js";
import { openDialog } from "../ui/dialog.js";
import { button, h } from "../ui/dom.js";

/** Sends the next request without a token. */
export function forgetToken() {
  storeToken(null);
}

/** Asks for a token until the machine accepts it or needs none. */
export async function signedIn() {
  while (await isRefused()) await ask();
}

async function isRefused() {
  try {
    await machine.get("/machine");
    return false;
  } catch (error) {
    if (!(error instanceof Refusal)) return false;
    // wrong tokens of this host may have used up its rate; a screen without a token must still ask for one
    const isLimited = storedToken() === null && (error.problem.status === 401 || error.problem.status === 429);
    return isLimited || error.problem.code === "unauthorized";
  }
}

/** Highest number of coordinate systems of a machine. */
const SYSTEMS = [1, 2, 3, 4, 5, 6, 7, 8];

/** True if the machine accepts hold, stop and abort without a login. */
async function stopsWithoutLogin() {
  try {
    return (await machine.get("/health")).stop_without_login === true;
  } catch {
    return false;
  }
}

/** Returns the buttons for hold, stop and abort of all coordinate systems. @param {HTMLElement} problem */
function stops(problem) {
  /** @param {string} verb */
  const send = async (verb) => {
    const sent = await Promise.allSettled(SYSTEMS.map((cs) => machine.request("POST", `/cs/${cs}/${verb}`)));
    const failed = sent.flatMap((one) => (one.status === "rejected" && !isMissing(one.reason) ? [String(one.reason?.message ?? one.reason)] : []));
    problem.textContent = failed[0] ?? t("token.sent_to_all");
  };
  /** @param {string} verb @param {string} says */
  const one = (verb, says) => button({ onclick: () => void send(verb) }, says);
  return h("div", { class: "row" }, one("hold", t("token.hold_all")), one("stop", t("token.stop_all")), one("abort", t("token.abort_all")));
}

/** Returns true for the answer that the coordinate system does not exist. @param {unknown} error */
function isMissing(error) {
  return error instanceof Refusal && error.problem.code === "not_found";
}

/** @returns {Promise<void>} */
async function ask() {
  const canStop = await stopsWithoutLogin();
  return new Promise((resolve) => {
    const user = field(t("token.user"), "text", "username");
    const pin = field("PIN", "password", "current-password");
    const shown = field(t("token.token"), "password", "off");
    const problem = h("p", { role: "alert" }, storedToken() === null ? "" : t("token.the_machine_does_not_know"));
    const form = h(
      "form",
      { method: "dialog" },
      h("div", { class: "row end" }, user, pin),
      h("p", {}, t("token.or_a_token_of_this")),
      h("div", { class: "row end" }, shown, button({ type: "submit" }, t("token.enter"))),
    );
    const dialog = openDialog("token", t("token.log_in"), [h("p", {}, t("token.this_machine_asks_who_uses")), canStop && stops(problem), form, problem], () => resolve());
    form.addEventListener("submit", async (event) => {
      event.preventDefault();
      const given = shown.value.trim();
      const refusal = given === "" ? await logIn(user.value.trim(), pin.value) : keep(given);
      if (refusal === null) dialog.close("");
      else problem.textContent = refusal;
    });
  });
}

/** @param {string} label @param {string} type @param {AutoFill} autocomplete */
function field(label, type, autocomplete) {
  return h("input", { type, class: "input grow", autocomplete, "aria-label": label, placeholder: label });
}

/** @param {string} given */
function keep(given) {
  storeToken(given);
  return null;
}

/**
 * Asks for a token with a name and a PIN.
 * @param {string} user @param {string} pin @returns {Promise<string | null>} why there is none
 */
async function logIn(user, pin) {
  try {
    const response = await machine.request("POST", "/login", { body: { user, pin } });
    return keep((await response.json()).token);
  } catch (error) {
    return error instanceof Refusal ? error.message : String(error);
  }
}
