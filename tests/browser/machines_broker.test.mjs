// Machines that share a broker are shown on one page of each machine, without typing an address. Three runtimes and one
// Mosquitto.

import assert from "node:assert/strict";
import { after, afterEach, before, test } from "node:test";

import { launch, openPage } from "./browser.mjs";
import { Mosquitto } from "./mosquitto.mjs";
import { picture, SCHEMES, SIZES } from "./pictures.mjs";
import { Runtime } from "./runtime.mjs";
import { until } from "./screen.mjs";

let broker;
let [here, second, third] = [];
let browser;
let page;
let errors;
let close;

before(async () => {
  broker = await Mosquitto.create();
  await broker.start();
  [here, second, third] = await Promise.all([1, 2, 3].map((number) => atBroker(number)));
  // one machine publishes its address, the other does not
  await second.add(`public_url = "${second.url}"`, "http");
  await Promise.all([here.start(), second.start(), third.start()]);
  browser = await launch();
});
after(async () => {
  await browser?.close();
  await Promise.all([here?.remove(), second?.remove(), third?.remove()]);
  await broker?.remove();
});
afterEach(async () => {
  await close();
  assert.deepEqual(errors.filter((text) => !/net::ERR_|CORS policy|WebSocket connection|status of 40[13]/.test(text)), []);
});

/** The machine `mill-N` at the broker; its presence expires after 3 s. */
async function atBroker(number) {
  const one = await Runtime.create();
  await one.change('name = "mill-1"', `name = "mill-${number}"\npresence_expires_ms = 3000`);
  await one.change(/listen = "127.0.0.1:\d+"/.exec(await one.configuration())[0], `broker = "${broker.url}"`);
  return one;
}

async function open(path = "/machines") {
  ({ page, errors, close } = await openPage(browser));
  page.setDefaultTimeout(15_000);
  await page.goto(`${here.url}${path}`);
}

const tile = (name) => page.locator(`.machine-tile[data-machine="${name}"]`);
const says = (name, link) => until(() => tile(name).getAttribute("data-link"), link, name);

function ask(machine, method, path, body) {
  return fetch(`${machine.url}/api/v1${path}`, { method, body: body && JSON.stringify(body), headers: { "Content-Type": "application/json" } });
}

test("a machine at the shared broker has a tile with state, sentence, program, progress and alarms, and leads to its own screen", async () => {
  await open();
  await says("mill-2", "online");
  await says("mill-3", "online");
  assert.equal(await tile("mill-1").count(), 0, "this machine is there by its address");
  await tile("mill-3").getByText("No program is loaded").first().waitFor();
  await ask(third, "POST", "/cs/1/load?wait=1", { program: 2 });
  await ask(third, "POST", "/cs/1/start", {});
  const first = tile("mill-3").locator(".machine-system").first();
  await first.getByText("ACTIVE", { exact: true }).waitFor();
  await first.getByText("Program O0002 runs.").waitFor();
  await until(() => first.locator(".machine-left").textContent(), /^\d+ s left$/);
  assert.ok(await first.locator("progress").isVisible());
  await until(() => tile("mill-3").getAttribute("data-tone"), "active");
  await ask(second, "POST", "/alarms", { cs: 2, code: 7, text: "The oil is low." });
  await tile("mill-2").getByText("1 alarm", { exact: true }).waitFor();
  await until(() => tile("mill-2").getAttribute("data-tone"), "alarm");
  await tile("mill-2").getByText(/The oil is low\./).waitFor();
  await pictures();
  assert.equal(await tile("mill-3").locator("a[href]").count(), 0, "it has not said where its screen is");
  assert.equal(await tile("mill-2").locator("a").getAttribute("href"), `${second.url}/`);
  await ask(third, "POST", "/cs/1/stop?wait=1", {});
});

async function pictures() {
  for (const [width, height] of SIZES) {
    await page.setViewportSize({ width, height });
    for (const colorScheme of SCHEMES) {
      await page.emulateMedia({ colorScheme });
      await picture(page, `machines_broker-${width}-${colorScheme}`, { fullPage: true });
    }
    assert.ok(await page.evaluate(() => document.documentElement.scrollWidth <= innerWidth), `nothing is wider than ${width}`);
  }
}

test("a question of a machine at the broker is on its tile, in the operator's colour", async () => {
  await open();
  await says("mill-3", "online");
  await ask(third, "POST", "/cs/1/reset?wait=1", {});
  await ask(third, "POST", "/cs/1/mdi", { text: "M100 VA5" });
  const first = tile("mill-3").locator(".machine-system").first();
  await first.getByText(/WAIT|TOOL_LOAD/).first().waitFor();
  await until(() => tile("mill-3").getAttribute("data-tone"), "attention", "nobody has taken M100");
  const { outputs } = await (await ask(third, "GET", "/cs/1/m_codes")).json();
  const { boot_id } = await (await ask(third, "GET", "/machine")).json();
  await ask(third, "PUT", "/handlers/cell", { online: true, instance: "a", expires_ms: 60_000 });
  const said = { boot_id, handler_id: "cell", instance: "a" };
  const claim = await ask(third, "POST", `/cs/1/m_codes/${outputs[0].seq}/claim`, said);
  assert.ok(claim.ok, await claim.text());
  await ask(third, "POST", `/cs/1/m_codes/${outputs[0].seq}/ask`, { ...said, question_id: "q", text: "Is the drill sharp?", choices: ["yes", "no"] });
  await first.getByText(/Is the drill sharp\?/).waitFor();
  await first.getByText(/· a question$/).waitFor();
  await ask(third, "POST", "/cs/1/abort?wait=1", {});
});

test("a machine that is killed is grey, and so are all when the broker is away, until they are heard again", async () => {
  await open();
  await says("mill-2", "online");
  await third.kill();
  await says("mill-3", "offline");
  assert.equal(await tile("mill-3").getAttribute("data-tone"), "away");
  await tile("mill-3").getByText("The machine is offline").waitFor();
  await picture(page, "machines_broker-gone-1280-light");
  await broker.kill();
  await says("mill-2", "unheard");
  await broker.start();
  await third.start();
  await says("mill-2", "online");
  await says("mill-3", "online");
});

test("the addresses of the configuration are on the page, and a machine that is there twice has one tile", async () => {
  await here.stop();
  await here.add(`[hmi]\nmachines = ["${second.url}"]\n`);
  await here.start();
  await open();
  await says("mill-2", "online");
  const byAddress = page.locator(`.machine-tile[data-address="${second.url}"]`);
  await until(() => byAddress.getAttribute("data-link"), "refused", "it does not allow this page");
  await until(() => byAddress.isVisible(), false, "what the broker tells of it is more");
  assert.equal(await byAddress.getByRole("button", { name: "Remove" }).count(), 0);
});
