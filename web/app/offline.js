// The page that is shown while the machine does not answer, in the language of the screen.

import { language, t } from "../text/language.js";

/** @typedef {import("../text/language.js").Key} Key */

/** Writes the texts of a page into the elements with `data-text`. @param {Document} page */
export function writeTexts(page) {
  page.documentElement.lang = language;
  for (const element of page.querySelectorAll("[data-text]")) element.textContent = t(/** @type {Key} */ (element.getAttribute("data-text")));
}

writeTexts(document);
