// Light or dark: the system's choice, unless the operator makes another choice, which this browser remembers.

const KEY = "tandem-theme";
const dark = matchMedia("(prefers-color-scheme: dark)");
/** The system's choice, read in its change event, because a browser reports no change that has already been read. */
let isDark = dark.matches;

/** @type {string | null} the operator's choice */
let chosen = stored();

/** @returns {"light" | "dark"} */
export function theme() {
  if (chosen === "light" || chosen === "dark") return chosen;
  return isDark ? "dark" : "light";
}

/** Applies the scheme, now and when the system's changes. @param {() => void} changed */
export function startTheme(changed) {
  const put = () => {
    document.documentElement.dataset.theme = theme();
    changed();
  };
  dark.addEventListener("change", ({ matches }) => {
    isDark = matches;
    put();
  });
  put();
}

/** Switches to the other scheme. */
export function toggleTheme() {
  chosen = theme() === "dark" ? "light" : "dark";
  try {
    localStorage.setItem(KEY, chosen);
  } catch {
    // without storage the choice lasts until the page is closed
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
