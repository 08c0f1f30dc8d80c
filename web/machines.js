// Several machines on one page: a tile for each address. This page only reads; what is commanded is commanded on the machine's own screen.

import { button, fill, h, setAttr, setText } from "./dom.js";
import { language, t } from "./language.js";
import { addressOf, keepOthers, MACHINES_MAX, others } from "./machines/addresses.js";
import { tile } from "./machines/tile.js";
import { Watched } from "./machines/watched.js";
import { startTheme } from "./theme.js";
import { startTouch } from "./touch.js";

/** Interval at which running times are shown, ms. */
const TICK_MS = 500;

const list = h("div", { class: "machine-tiles" });
const typed = h("input", { type: "text", class: "input grow", inputmode: "url", autocomplete: "url", autocapitalize: "none", spellcheck: "false", "aria-label": t("machines.address"), placeholder: t("machines.address") });
const problem = h("p", { role: "alert", class: "machine-trouble", hidden: true });
const form = h("form", { class: "machine-add" }, typed, button({ type: "submit" }, t("machines.add")), problem);

/** @type {ReturnType<typeof tile>[]} */
let tiles = [];
let framePending = false;

function invalidate() {
  if (framePending) return;
  framePending = true;
  requestAnimationFrame(() => {
    framePending = false;
    for (const one of tiles) one.render();
  });
}

/** @param {string} address @param {boolean} stays */
function show(address, stays) {
  const one = tile(new Watched(address, invalidate), stays ? null : () => remove(address));
  tiles.push(one);
  list.append(one.element);
  invalidate();
}

/** @param {string} address */
function remove(address) {
  const gone = tiles.find(({ machine }) => machine.address === address);
  gone?.machine.close();
  gone?.element.remove();
  tiles = tiles.filter((one) => one !== gone);
  keep();
  typed.focus();
}

function keep() {
  keepOthers(tiles.map(({ machine }) => machine.address).filter((address) => address !== location.origin));
}

/** Why an address cannot be added; null: it can. @param {string | null} address */
function whyNot(address) {
  if (address === null) return t("machines.not_an_address");
  if (tiles.some(({ machine }) => machine.address === address)) return t("machines.is_here", { address });
  return tiles.length >= MACHINES_MAX ? t("machines.most", { count: MACHINES_MAX }) : null;
}

form.addEventListener("submit", (event) => {
  event.preventDefault();
  const address = addressOf(typed.value);
  const why = whyNot(address);
  setText(problem, why ?? "");
  setAttr(problem, "hidden", why === null);
  if (why !== null || address === null) return;
  show(address, false);
  keep();
  typed.value = "";
});

document.documentElement.lang = language;
document.title = t("machines.machines");
document.body.className = "machines";
fill(document.body, h("main", {}, h("h1", {}, t("machines.machines")), list, form, h("p", { class: "muted" }, t("machines.about", { origin: location.origin }))));
startTheme(invalidate);
startTouch();
show(location.origin, true);
for (const address of others()) if (address !== location.origin) show(address, false);
setInterval(invalidate, TICK_MS);
