// Saves a file on the computer of the browser.

import { h } from "../ui/dom.js";

/** Time in which the browser begins to save the file, ms. */
const TAKEN_MS = 10_000;

/** @param {string} name @param {string} text CSV */
export function saveCsv(name, text) {
  const link = h("a", { href: URL.createObjectURL(new Blob([text], { type: "text/csv" })), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), TAKEN_MS);
}
