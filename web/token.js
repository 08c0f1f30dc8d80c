// The token of this screen, if the machine requires one. It is kept until the browser window is closed.

import { openDialog } from "./dialog.js";
import { button, h } from "./dom.js";
import { machine } from "./machine.js";
import { Refusal, storedToken, storeToken } from "./tandem.js";

/** The next request is one of nobody. */
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
    return error instanceof Refusal && error.problem.code === "unauthorized";
  }
}

/** @returns {Promise<void>} */
function ask() {
  return new Promise((resolve) => {
    const user = field("User", "text", "username");
    const pin = field("PIN", "password", "current-password");
    const shown = field("Token", "password", "off");
    const problem = h("p", { role: "alert" }, storedToken() === null ? "" : "The machine does not know this token.");
    const form = h(
      "form",
      { method: "dialog" },
      h("div", { class: "row end" }, user, pin),
      h("p", {}, "or a token of this screen:"),
      h("div", { class: "row end" }, shown, button({ type: "submit" }, "Enter")),
    );
    const dialog = openDialog("token", "Log in", [h("p", {}, "This machine asks who uses it."), form, problem], () => resolve());
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
