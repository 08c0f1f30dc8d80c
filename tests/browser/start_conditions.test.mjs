// Obstacles to a start, on the real runtime: the sentence, the Start button and the tiles of other machines read one
// list. Data older than a second is grey and marked as stale, on the screen and on the tiles.

import assert from "node:assert/strict";
import { after, afterEach, before, test } from "node:test";
import { setTimeout as sleep } from "node:timers/promises";

import { launch, openPage } from "./browser.mjs";
import { Mosquitto } from "./mosquitto.mjs";
import { Runtime } from "./runtime.mjs";
import { disabled, enabled, Screen, until } from "./screen.mjs";

/** Age from which data must be marked as stale, ms. */
const STALE_MS = 1000;
const ROUNDS = 3;
/** M60 has no handler, and would end the run with an alarm. */
const UNHANDLED = "G90 G54\nG00 X10\nM60\nM30\n";
/** Beyond the soft limit of 500 mm. */
const BEYOND = "G90\nG01 X900 F6000\nM30\n";
const SOUND = "G90 G54\nG01 X10 F6000\nM30\n";

let broker;
/** The watched machine, and one that receives its messages at the broker. */
let machine;
let other;
let browser;
/** Pages that are open. */
let pages = [];

before(async () => {
  broker = await Mosquitto.create();
  await broker.start();
  [machine, other] = await Promise.all([1, 2].map(async (number) => {
    const one = await Runtime.create();
    await one.change('name = "mill-1"', `name = "mill-${number}"`);
    await one.change(/listen = "127.0.0.1:\d+"/.exec(await one.configuration())[0], `broker = "${broker.url}"`);
    return one;
  }));
  await machine.add('\n[input.interlock.source.door]\non_loss = "keep"\n');
  await Promise.all([machine.start(), other.start()]);
  for (const [number, text] of [[30, UNHANDLED], [31, BEYOND], [32, SOUND]]) await send("PUT", `/programs/${number}`, text);
  browser = await launch();
});

after(async () => {
  await browser?.close();
  await Promise.all([machine?.remove(), other?.remove()]);
  await broker?.remove();
});

afterEach(async () => {
  for (const { close } of pages) await close();
  const errors = pages.flatMap((one) => one.errors).filter((text) => !/net::ERR_|WebSocket connection|status of 409/.test(text));
  pages = [];
  assert.deepEqual(errors, []);
});

async function send(method, path, body) {
  const headers = { "Content-Type": typeof body === "string" ? "text/plain" : "application/json" };
  const answer = await fetch(`${machine.url}/api/v1${path}`, { method, headers, body: typeof body === "string" ? body : JSON.stringify(body) });
  assert.ok(answer.ok, `${method} ${path}: ${await answer.text()}`);
}

async function openAt(url) {
  const one = await openPage(browser);
  one.page.setDefaultTimeout(15_000);
  pages.push(one);
  await one.page.goto(url);
  return one.page;
}

/** Opens the machine's own screen, and its tiles: on its own page, by address, and on the other machine's page by
 * broker. */
async function openAll() {
  const screen = new Screen(await openAt(machine.url));
  await screen.page.getByText("Connected", { exact: true }).waitFor();
  const byAddress = await openAt(`${machine.url}/machines`);
  const byBroker = await openAt(`${other.url}/machines`);
  const tiles = [byAddress.locator(`.machine-tile[data-address="${machine.url}"]`), byBroker.locator('.machine-tile[data-machine="mill-1"]')];
  for (const tile of tiles) await until(() => tile.getAttribute("data-link"), "online", "the link of the tile");
  return { screen, tiles };
}

/** Returns the sentences of screen and tiles about coordinate system 1. */
async function sentences({ screen, tiles }) {
  const said = tiles.map((tile) => tile.locator(".machine-system").first().locator("p").first().textContent());
  return Promise.all([screen.page.locator(".sentence").textContent(), ...said]);
}

/** Waits until all sentences are equal and contain the words; a tile shortens a long sentence. */
async function allSay(all, words) {
  const isSame = ([first, ...others]) => others.every((one) => first.startsWith(one.replace(/ …$/, "")));
  await until(() => sentences(all), (said) => said.every((one) => one.includes(words)) && isSame(said), `the sentences with "${words}"`);
}

async function load(number) {
  await send("POST", "/cs/1/reset?wait=1", {});
  await send("POST", "/cs/1/load?wait=1", { program: number });
}

test("an open door and a start lock prevent Start on the screen and on all tiles, each in the same words", async () => {
  const all = await openAll();
  const { screen } = all;
  const start = screen.command("Start");
  await load(32);
  await allSay(all, "Press Start.");
  await enabled(start);
  for (const [put, end, words] of [
    [() => send("PUT", "/cs/1/inputs/interlock", { value: true, text: "the door is open", source: "door" }), () => send("PUT", "/cs/1/inputs/interlock", { value: false, text: "", source: "door" }), "The interlock is on: the door is open."],
    [() => send("PUT", "/cs/1/inputs/start_lock", { value: true, text: "no blank" }), () => send("PUT", "/cs/1/inputs/start_lock", { value: false, text: "" }), "The start lock is on: no blank."],
  ]) {
    await put();
    await allSay(all, words);
    await disabled(start);
    assert.equal(await start.getAttribute("title"), words);
    assert.ok((await sentences(all)).every((said) => !said.includes("Press Start")));
    await end();
    await allSay(all, "Press Start.");
    await enabled(start);
  }
});

for (const [number, words, alarm] of [
  [30, "No handler is online for M60: an alarm would end the run there.", "an M code without a handler"],
  [31, "The rehearsal ends in an alarm in line 2:", "an alarm that the rehearsal predicts"],
]) {
  test(`${alarm} is said on the screen and on all tiles in place of "Press Start", and Start asks`, async () => {
    const all = await openAll();
    const { screen } = all;
    await load(number);
    await allSay(all, words);
    assert.ok((await sentences(all)).every((said) => !said.includes("Press Start")));
    await screen.command("Start").click();
    await screen.page.getByRole("dialog").getByText(words).waitFor();
    await screen.page.getByRole("button", { name: "Do not start" }).click();
    const { execution } = await (await fetch(`${machine.url}/api/v1/cs/1/state`)).json();
    assert.equal(execution, "READY");
    await load(32);
    await allSay(all, "Press Start.");
  });
}

test("what is older than a second is grey and marked as stale on the screen and on all tiles", async () => {
  const all = await openAll();
  const { screen, tiles } = all;
  await load(32);
  await allSay(all, "Press Start.");
  const isMarked = async () => Promise.all([screen.page.locator("body").getAttribute("data-stale"), ...tiles.map((tile) => tile.getAttribute("data-stale"))]);
  // nothing is stale while messages of the machine arrive
  for (const end = Date.now() + 2 * STALE_MS; Date.now() < end; await sleep(100)) assert.deepEqual(await isMarked(), [null, null, null]);
  const took = pages.map(() => []);
  for (let round = 0; round < ROUNDS; round += 1) {
    for (const { page } of pages) await page.evaluate(markedAt);
    const since = Date.now();
    machine.pause();
    try {
      await until(isMarked, (marks) => marks.every((mark) => mark !== null), "the marks");
      for (const [i, { page }] of pages.entries()) took[i].push((await page.evaluate(() => globalThis.markedAt)) - since);
      if (round === 0) await isGrey(all);
    } finally {
      machine.resume();
    }
    await until(isMarked, [null, null, null], "the marks");
  }
  // timers of a busy computer are sometimes late
  for (const times of took) assert.ok(Math.min(...times) <= STALE_MS, `marked after ${took.map((one) => one.join(", ")).join("; ")} ms`);
});

/** In the page: records the time at which the mark appears. */
function markedAt() {
  new MutationObserver((changes, observer) => {
    if (!changes.some(({ target }) => target.hasAttribute("data-stale"))) return;
    observer.disconnect();
    globalThis.markedAt = Date.now();
  }).observe(document.documentElement, { subtree: true, attributeFilter: ["data-stale"] });
}

async function isGrey({ screen, tiles }) {
  await screen.page.getByText("No message from the machine for").first().waitFor();
  for (const tile of tiles) await tile.getByText("No message from the machine for").waitFor();
  for (const element of [screen.page.locator(".status"), ...tiles.map((tile) => tile.locator(".machine-systems"))]) {
    assert.match(await element.evaluate((one) => getComputedStyle(one).filter), /grayscale\(1\)/);
  }
  await screen.page.keyboard.press("f");
  assert.match(await screen.page.locator(".far").evaluate((one) => getComputedStyle(one).filter), /grayscale\(1\)/);
}
