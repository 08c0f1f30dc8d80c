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
    const input = h("input", { type: "password", class: "input grow", autocomplete: "off", "aria-label": "Token", autofocus: true });
    const enter = button({ type: "submit" }, "Enter");
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
