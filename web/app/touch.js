// Size of touch targets: 60 px on a touched screen, unless the operator chooses; this browser stores the choice.

const KEY = "tandem-touch";
const coarse = matchMedia("(pointer: coarse)");

/** @type {string | null} the operator's choice */
let chosen = stored();

/** Whether targets are large. */
export function isLarge() {
  return chosen === null ? coarse.matches : chosen === "large";
}

/** Applies the size, now and when another pointer is used. */
export function startTouch() {
  coarse.addEventListener("change", put);
  put();
}

/** @param {boolean} large */
export function chooseLarge(large) {
  chosen = large ? "large" : "small";
  try {
    localStorage.setItem(KEY, chosen);
  } catch {
    // without storage the choice lasts until the page is closed
  }
  put();
}

function put() {
  document.documentElement.dataset.touch = String(isLarge());
}

function stored() {
  try {
    return localStorage.getItem(KEY);
  } catch {
    return null;
  }
}
