// The token of this screen, where the machine asks for one. It is kept until the browser window is closed.

import { openDialog } from "./dialog.js";
import { h } from "./dom.js";

const KEY = "tandem-token";

function token() {
  return sessionStorage.getItem(KEY);
}

/** What a request carries. @returns {Record<string, string>} */
export function authorization() {
  const known = token();
  return known === null ? {} : { Authorization: `Bearer ${known}` };
}

/** What a WebSocket carries, which cannot have that header. @returns {string[]} */
export function protocols() {
  const known = token();
  return known === null ? [] : ["tandem.v1", `bearer.${known}`];
}

/** Asks for a token as long as the machine wants one and has not been given a right one. */
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
    const input = h("input", { type: "password", class: "input grow", autocomplete: "off", "aria-label": "Token", autofocus: true });
    const enter = h("button", { type: "submit", class: "button" }, "Enter");
    const form = h("form", { method: "dialog" }, h("div", { class: "row end" }, input, enter));
    const text = token() === null ? "This machine asks who uses it." : "The machine does not know this token.";
    const dialog = openDialog("token", "Token", [h("p", {}, text), form], () => resolve());
    form.addEventListener("submit", (event) => {
      event.preventDefault();
      sessionStorage.setItem(KEY, input.value.trim());
      dialog.close("");
    });
  });
}
