// The token of this screen, if the machine requires one. It is kept until the browser window is closed.

import { openDialog } from "./dialog.js";
import { button, h } from "./dom.js";

const KEY = "tandem-token";

function token() {
  return sessionStorage.getItem(KEY);
}

/** The headers of a request. @returns {Record<string, string>} */
export function authorization() {
  const known = token();
  return known === null ? {} : { Authorization: `Bearer ${known}` };
}

/** The sub-protocols of a WebSocket, which cannot have that header. @returns {string[]} */
export function protocols() {
  const known = token();
  return known === null ? [] : ["tandem.v1", `bearer.${known}`];
}

/** The next request is one of nobody. */
export function forgetToken() {
  sessionStorage.removeItem(KEY);
}

/** Asks for a token until the machine accepts it or needs none. */
export async function signedIn() {
  while (await isRefused()) await ask();
}

async function isRefused() {
  try {
    const response = await fetch("/api/v1/machine", { cache: "no-store", headers: authorization() });
    return response.status === 401;
  } catch {
    return false;
  }
}

/** @returns {Promise<void>} */
function ask() {
  return new Promise((resolve) => {
    const user = field("User", "text", "username");
    const pin = field("PIN", "password", "current-password");
    const shown = field("Token", "password", "off");
    const problem = h("p", { role: "alert" }, token() === null ? "" : "The machine does not know this token.");
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
  sessionStorage.setItem(KEY, given);
  return null;
}

/**
 * Asks for a token with a name and a PIN.
 * @param {string} user @param {string} pin @returns {Promise<string | null>} why there is none
 */
async function logIn(user, pin) {
  try {
    const response = await fetch("/api/v1/login", {
      method: "POST",
      headers: { "Content-Type": "application/json" },
      body: JSON.stringify({ user, pin }),
    });
    const answer = await response.json();
    return response.ok ? keep(answer.token) : answer.detail;
  } catch {
    return "The machine does not answer; try again.";
  }
}
