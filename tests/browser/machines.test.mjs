// Several machines on one page: the state of each, or the reason why its state is unknown. They are real runtimes,
// except for one that falls silent.

import assert from "node:assert/strict";
import { after, afterEach, before, test } from "node:test";

import { launch, openPage } from "./browser.mjs";
import { picture } from "./pictures.mjs";
import { Runtime } from "./runtime.mjs";
import { ORIGIN, ScriptedMachine } from "./scripted_machine.mjs";
import { until } from "./screen.mjs";


let here;
let other;
let token;
let browser;
let page;
let errors;
let close;

before(async () => {
  [here, other] = await Promise.all([Runtime.create(), Runtime.create()]);
  token = await other.withToken("operate");
  await other.add(`allow_origins = ["${here.url}"]`, "http");
  await Promise.all([here.start(), other.start()]);
  browser = await launch();
});
after(async () => {
  await browser?.close();
  await Promise.all([here?.remove(), other?.remove()]);
});
afterEach(async () => {
  await close();
  // browsers report unreachable or forbidden addresses in their own words
  assert.deepEqual(errors.filter((text) => !/net::ERR_|status of 40[13]|CORS policy|WebSocket connection/.test(text)), []);
});

async function open(url, options) {
  ({ page, errors, close } = await openPage(browser, options));
  page.setDefaultTimeout(15_000);
  await page.goto(`${url}/machines`);
  await page.locator('.machine-tile[data-link="online"]').first().waitFor();
}

const tile = (address) => page.locator(`.machine-tile[data-address="${address}"]`);

async function add(address) {
  await page.getByLabel("Address, such as").fill(address);
  await page.getByRole("button", { name: "Add machine" }).click();
}

const says = (address, link) => until(() => tile(address).getAttribute("data-link"), link, address);

async function logIn() {
  await says(other.url, "login");
  await tile(other.url).getByLabel("Token", { exact: true }).fill(token);
  await tile(other.url).getByRole("button", { name: "Enter" }).click();
  await says(other.url, "online");
}

function ask(method, path, body) {
  return fetch(`${other.url}/api/v1${path}`, { method, body: body && JSON.stringify(body), headers: { "Content-Type": "application/json", Authorization: `Bearer ${token}` } });
}

test("a tile says state, sentence, program and time left of each machine in the colour of its state; a click opens it", async () => {
  await open(here.url);
  await add(other.url.replace("http://", ""));
  await tile(other.url).getByText("This machine needs a login.").waitFor();
  await tile(other.url).getByLabel("Token", { exact: true }).fill("0".repeat(64));
  await tile(other.url).getByRole("button", { name: "Enter" }).click();
  await tile(other.url).getByText("The machine does not know this token.").waitFor();
  await logIn();
  await tile(other.url).getByText("No program is loaded").first().waitFor();
  assert.equal(await tile(other.url).locator(".machine-system").count(), 2);
  await ask("POST", "/cs/1/load?wait=1", { program: 2 });
  const first = tile(other.url).locator(".machine-system").first();
  await first.getByText(/Press Start\.$/).waitFor();
  await ask("PUT", "/cs/1/inputs/interlock", { value: true, text: "the door is open" });
  await first.getByText("Program O0002 is loaded. The interlock is on: the door is open.").waitFor();
  await ask("PUT", "/cs/1/inputs/interlock", { value: false, text: "" });
  await first.getByText(/Press Start\.$/).waitFor();
  await ask("POST", "/cs/1/start", {});
  await first.getByText("ACTIVE", { exact: true }).waitFor();
  await first.getByText(/^Program O0002 runs, line \d+\.$/).waitFor();
  await until(() => first.locator(".machine-left").textContent(), /^\d+ s left$/);
  await until(() => tile(other.url).getAttribute("data-tone"), "active", "what runs counts before what has stopped");
  for (const [width, height] of [[390, 844], [1280, 800]]) {
    await page.setViewportSize({ width, height });
    for (const colorScheme of ["light", "dark"]) {
      await page.emulateMedia({ colorScheme });
      await picture(page, `machines-${width}-${colorScheme}`, { fullPage: true });
    }
    assert.ok(await page.evaluate(() => document.documentElement.scrollWidth <= innerWidth), `nothing is wider than ${width}`);
  }
  // the whole tile is the link
  await tile(other.url).locator(".machine-system p").first().click({ force: true });
  await page.waitForURL(`${other.url}/`);
  await page.getByRole("dialog", { name: "Log in" }).waitFor();
  await ask("POST", "/cs/1/stop?wait=1", {});
});

test("machines are remembered and taken off; one that does not answer says so until it does, and what is no address is none", async () => {
  await open(here.url);
  await add("mill 2");
  await page.getByText("This is not the address of a machine").waitFor();
  await add(here.url);
  await page.getByText("is on this page already").waitFor();
  await add(other.url);
  await logIn();
  await other.kill();
  await says(other.url, "unreachable");
  await tile(other.url).getByText("The machine cannot be reached").waitFor();
  assert.equal(await tile(other.url).getAttribute("data-tone"), "attention");
  await page.reload();
  await says(here.url, "online");
  await says(other.url, "unreachable");
  await other.start();
  await says(other.url, "online");
  await tile(other.url).getByRole("button", { name: "Remove" }).click();
  await page.reload();
  await says(here.url, "online");
  assert.equal(await page.locator(".machine-tile").count(), 1);
});

test("a machine that has not said in time that it is there says so, above what it said last", async () => {
  ({ page, errors, close } = await openPage(browser));
  const machine = new ScriptedMachine();
  machine.start();
  await machine.attach(page);
  await page.goto(`${ORIGIN}/machines.html`);
  await says(ORIGIN, "online");
  machine.takesSockets = false;
  machine.say("presence", { ...machine.topics.get("presence"), expires_ms: 700 });
  await tile(ORIGIN).getByText("The presence of the machine has expired. The data below are stale.").waitFor();
  await tile(ORIGIN).getByText("READY").first().waitFor();
});

test("a machine that does not allow this page says what its configuration lacks", async () => {
  // another origin of the same machine, which the other machine does not allow
  const alias = here.url.replace("127.0.0.1", "localhost");
  await open(alias);
  await add(other.url);
  await says(other.url, "refused");
  await tile(other.url).getByText(`add "${alias}" to [http] allow_origins there`).waitFor();
});
