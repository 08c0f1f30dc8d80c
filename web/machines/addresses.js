// Addresses of the machines on the page: this one first, then those that were typed in, which this browser remembers.

const KEY = "tandem-machines";
/** Most machines on one page. */
export const MACHINES_MAX = 32;

/** Addresses of other machines, in the order in which they were added. @returns {string[]} */
export function others() {
  try {
    const known = JSON.parse(localStorage.getItem(KEY) ?? "[]");
    return Array.isArray(known) ? known.filter((one) => typeof one === "string" && addressOf(one) === one).slice(0, MACHINES_MAX - 1) : [];
  } catch {
    return [];
  }
}

/** @param {string[]} addresses */
export function keepOthers(addresses) {
  try {
    localStorage.setItem(KEY, JSON.stringify(addresses));
  } catch {
    // without storage they are kept until the page is closed
  }
}

/** Returns the address of a machine from typed text, such as `mill-2:8080`; null if the text is no address. @param {string} typed */
export function addressOf(typed) {
  const text = typed.trim();
  if (text === "") return null;
  try {
    const { origin, protocol, username, hostname } = new URL(/^[a-z]+:\/\//i.test(text) ? text : `http://${text}`);
    const isHost = /^[\w.-]+$|^\[[\da-f:.]+\]$/i.test(hostname);
    return ["http:", "https:"].includes(protocol) && username === "" && isHost ? origin : null;
  } catch {
    return null;
  }
}

/** Returns the token for a machine, kept until this window is closed; for this machine the token of its HMI. @param {string} address */
export function tokenOf(address) {
  return sessionStorage.getItem(keyOf(address));
}

/** @param {string} address @param {string} token */
export function keepToken(address, token) {
  sessionStorage.setItem(keyOf(address), token);
}

/** @param {string} address */
function keyOf(address) {
  return address === location.origin ? "tandem-token" : `tandem-token ${address}`;
}
