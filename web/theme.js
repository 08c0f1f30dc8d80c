// Light or dark: the system's choice, until the operator makes one of their own, which this browser remembers.

const KEY = "tandem-theme";
const dark = matchMedia("(prefers-color-scheme: dark)");

/** @type {string | null} the operator's choice */
let chosen = stored();

/** @returns {"light" | "dark"} */
export function theme() {
  if (chosen === "light" || chosen === "dark") return chosen;
  return dark.matches ? "dark" : "light";
}

/** Puts the scheme in force, now and when the system's changes. @param {() => void} changed */
export function startTheme(changed) {
  const put = () => {
    document.documentElement.dataset.theme = theme();
    changed();
  };
  dark.addEventListener("change", put);
  put();
}

/** Takes the other one. */
export function toggleTheme() {
  chosen = theme() === "dark" ? "light" : "dark";
  try {
    localStorage.setItem(KEY, chosen);
  } catch {
    // a browser that keeps nothing still shows the choice until the page is left
  }
  document.documentElement.dataset.theme = chosen;
}

function stored() {
  try {
    return localStorage.getItem(KEY);
  } catch {
    return null;
  }
}
