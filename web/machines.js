// Several machines on one page, a tile for each. The page only reads; commands are given on the machine's own screen.
// It shows this machine, the machines at configured or typed addresses, and those found at the broker that this machine
// shares with them.

import { startTheme } from "./app/theme.js";
import { startTouch } from "./app/touch.js";
import { addressOf, keepOthers, MACHINES_MAX, others } from "./machines/addresses.js";
import { PeerMachineList } from "./machines/peer_machine_list.js";
import { tile } from "./machines/tile.js";
import { WatchedMachine } from "./machines/watched_machine.js";
import { language, t } from "./text/language.js";
import { button, fill, h, setAttr, setText } from "./ui/dom.js";

/** Interval at which running times are shown, ms. */
const TICK_MS = 250;

const list = h("div", { class: "machine-tiles" });
const typed = h("input", { type: "text", class: "input grow", inputmode: "url", autocomplete: "url", autocapitalize: "none", spellcheck: "false", "aria-label": t("machines.address"), placeholder: t("machines.address") });
const problem = h("p", { role: "alert", class: "machine-trouble", hidden: true });
const form = h("form", { class: "machine-add" }, typed, button({ type: "submit" }, t("machines.add")), problem);

/** Machines by their addresses: this one first. @type {(ReturnType<typeof tile> & {machine: WatchedMachine, isTyped: boolean})[]} */
let tiles = [];
/** Machines at the broker, by name. @type {Map<string, ReturnType<typeof tile>>} */
let peerTiles = new Map();
let framePending = false;

function invalidate() {
  if (framePending) return;
  framePending = true;
  requestAnimationFrame(() => {
    framePending = false;
    showPeers();
    for (const one of tiles) one.render();
    for (const one of peerTiles.values()) one.render();
    showOnce();
  });
}

/** @param {string} address @param {boolean} isTyped */
function show(address, isTyped) {
  const machine = new WatchedMachine(address, invalidate);
  const one = { ...tile(machine, isTyped ? () => remove(address) : null), machine, isTyped };
  tiles.push(one);
  list.append(one.element);
  invalidate();
  return machine;
}

/** Shows the machines that this one reports, and the addresses of its configuration. */
function showPeers() {
  for (const address of peers.addresses) if (!isHere(address) && tiles.length < MACHINES_MAX) show(address, false);
  if ([...peerTiles.keys()].join() === [...peers.machines.keys()].join()) return;
  for (const { element } of peerTiles.values()) element.remove();
  peerTiles = new Map([...peers.machines].map(([name, machine]) => [name, peerTiles.get(name) ?? tile(machine, null)]));
  list.append(...[...peerTiles.values()].map(({ element }) => element));
}

/** Merges the tiles of a machine that is known by its address and at the broker: the one by its address while that can be read. */
function showOnce() {
  const read = new Set(tiles.filter(({ machine }) => machine.link === "online").flatMap(({ machine }) => [machine.address, machine.name]));
  const atBroker = new Set();
  for (const [name, { element, machine }] of peerTiles) {
    const isRead = read.has(name) || read.has(machine.address);
    setAttr(element, "hidden", isRead);
    if (!isRead && machine.address) atBroker.add(machine.address);
  }
  for (const { element, machine } of tiles) setAttr(element, "hidden", atBroker.has(machine.address));
}

/** @param {string} address */
function isHere(address) {
  return tiles.some(({ machine }) => machine.address === address);
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
  keepOthers(tiles.filter(({ isTyped }) => isTyped).map(({ machine }) => machine.address));
}

/** Returns the reason why an address cannot be added; null if it can. @param {string | null} address */
function whyNot(address) {
  if (address === null) return t("machines.not_an_address");
  if (isHere(address)) return t("machines.is_here", { address });
  return tiles.length >= MACHINES_MAX ? t("machines.most", { count: MACHINES_MAX }) : null;
}

form.addEventListener("submit", (event) => {
  event.preventDefault();
  const address = addressOf(typed.value);
  const why = whyNot(address);
  setText(problem, why ?? "");
  setAttr(problem, "hidden", why === null);
  if (why !== null || address === null) return;
  show(address, true);
  keep();
  typed.value = "";
});

document.documentElement.lang = language;
document.title = t("machines.machines");
document.body.className = "machines";
fill(document.body, h("main", {}, h("h1", {}, t("machines.machines")), list, form, h("p", { class: "muted" }, t("machines.about", { origin: location.origin }))));
startTheme(invalidate);
startTouch();
const here = show(location.origin, false);
const peers = new PeerMachineList(() => here.peerMachines(), invalidate);
for (const address of others()) if (!isHere(address)) show(address, true);
setInterval(invalidate, TICK_MS);
