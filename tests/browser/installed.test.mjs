// The screen as an installed app on the real runtime: manifest, a service worker that caches no screen, sound and
// notifications.

import assert from "node:assert/strict";
import { afterEach, beforeEach, test } from "node:test";

import de from "../../web/language/de.js";
import en from "../../web/language/en.js";
import ja from "../../web/language/ja.js";
import { openPage } from "./browser.mjs";
import { withRuntime } from "./runtime.mjs";
import { now, ORIGIN, ScriptedMachine } from "./scripted_machine.mjs";
import { Screen, until } from "./screen.mjs";

let runtime;
let browser;
let page;
let errors;
let close;

withRuntime((made) => ({ runtime, browser } = made));
beforeEach(() => open({ permissions: ["notifications"] }));
afterEach(() => close());

/** In the page: records each tone and each notification. */
function listen() {
  globalThis.told = { tones: 0, notices: [] };
  const { start } = OscillatorNode.prototype;
  OscillatorNode.prototype.start = function begin(...at) {
    globalThis.told.tones += 1;
    return start.apply(this, at);
  };
  if (!("Notification" in globalThis)) return;
  const Shown = globalThis.Notification;
  globalThis.Notification = class extends Shown {
    constructor(title, more) {
      super(title, more);
      globalThis.told.notices.push(`${title}: ${more.body}`);
    }
  };
}

/** A page that records its tones and notifications. */
async function open(options) {
  ({ page, errors, close } = await openPage(browser, options));
  await page.addInitScript(listen);
  await page.goto(runtime.url);
  await page.getByText("Connected", { exact: true }).waitFor();
}

const told = () => page.evaluate(() => globalThis.told);

async function setting(name) {
  await page.getByRole("button", { name: /^No login|^Logged in/ }).click();
  await page.getByRole("dialog", { name: "User" }).getByRole("button", { name }).click();
  await page.getByRole("dialog", { name: "User" }).getByRole("button", { name, pressed: true }).waitFor();
  await page.keyboard.press("Escape");
}

async function post(path, body = {}) {
  await (await fetch(`${runtime.url}/api/v1${path}`, { method: "POST", body: JSON.stringify(body), headers: { "Content-Type": "application/json" } })).text();
}

test("the manifest is served as one, and names an icon that is there", async () => {
  const answer = await fetch(`${runtime.url}/manifest.webmanifest`);
  assert.match(answer.headers.get("content-type"), /application\/manifest\+json/);
  const { icons, display, start_url } = await answer.json();
  assert.deepEqual([display, start_url], ["standalone", "/"]);
  for (const { src } of icons) assert.equal((await fetch(`${runtime.url}${src}`)).status, 200);
  assert.equal(await page.locator('link[rel="manifest"]').getAttribute("href"), "manifest.webmanifest");
  assert.deepEqual(errors, []);
});

test("each language has a manifest of its own, whose words are those of its table", async () => {
  const manifests = [];
  for (const [language, table] of Object.entries({ en, de, ja })) {
    const answer = await fetch(`${runtime.url}/manifest.${language === "en" ? "" : `${language}.`}webmanifest`);
    const manifest = await answer.json();
    assert.deepEqual([manifest.lang, manifest.id], [language, "/"], "one app in each language");
    assert.deepEqual(manifest.shortcuts, [{ name: table["machines.machines"], url: "/machines" }]);
    const { lang, description, shortcuts, ...same } = manifest;
    manifests.push({ description, same });
  }
  assert.equal(new Set(manifests.map(({ description }) => description)).size, 3);
  for (const { same } of manifests) assert.deepEqual(same, manifests[0].same, "the rest is the same");
  await close();
  ({ page, errors, close } = await openPage(browser, { locale: "de-DE" }));
  await page.goto(runtime.url);
  await page.getByText("Verbunden", { exact: true }).waitFor();
  assert.equal(await page.locator('link[rel="manifest"]').getAttribute("href"), "manifest.de.webmanifest");
});

/** Waits until exactly the files that the service worker shows are cached. */
async function keepsItsPage() {
  await page.evaluate(() => navigator.serviceWorker.ready);
  const kept = () => page.evaluate(async () => {
    const all = [];
    for (const name of await caches.keys()) for (const { url } of await (await caches.open(name)).keys()) all.push(new URL(url).pathname);
    return all.sort();
  });
  await until(kept, ["/icon.svg", "/offline.html", "/styles/offline.css"]);
}

test("the service worker keeps the page for a machine that does not answer, and nothing of the screen", async () => {
  await keepsItsPage();
  await page.reload();
  await page.getByText("Connected", { exact: true }).waitFor();
  await keepsItsPage();
  assert.deepEqual(errors, []);
});

test("while the machine does not answer a reload says so; when it answers again the screen comes by itself", async () => {
  await keepsItsPage();
  await runtime.kill();
  await page.reload();
  await page.getByRole("heading", { name: "The machine does not answer" }).waitFor();
  assert.equal(await page.locator(".commands").count(), 0);
  await runtime.start();
  await page.getByText("Connected", { exact: true }).waitFor();
});

test("without a word of the operator neither sounds nor notifies; switched on, an alarm does both, once, also after a reload", async () => {
  await post("/cs/1/reset?wait=1");
  await post("/cs/1/mdi?wait=1", { text: "G00 X900" });
  await page.locator(".alarms-card .alarm").waitFor();
  assert.deepEqual(await told(), { tones: 0, notices: [] });
  await post("/cs/1/reset?wait=1");
  await page.locator(".alarms-card .alarm").waitFor({ state: "detached" });
  await setting("Sound");
  await setting("Notifications");
  await page.reload();
  await page.getByText("Connected", { exact: true }).waitFor();
  await page.locator(".machine").click();
  await post("/cs/1/mdi?wait=1", { text: "G00 X900" });
  await page.locator(".alarms-card .alarm").waitFor();
  await until(async () => (await told()).notices, (notices) => notices.length === 1 && /^mill-1, CS 1: Alarm 102: /.test(notices[0]), "the notifications");
  await until(async () => (await told()).tones, 6, "the tones");
  await page.waitForTimeout(700);
  assert.equal((await told()).notices.length, 1);
  await post("/cs/1/reset?wait=1");
});

test("over plain HTTP from elsewhere the page says why there are no notifications; a question sounds all the same", async () => {
  await close();
  ({ page, errors, close } = await openPage(browser));
  await page.addInitScript(listen);
  const machine = new ScriptedMachine();
  machine.start();
  await machine.attach(page);
  await page.goto(`${ORIGIN}/`);
  await new Screen(page).sees("READY");
  await page.getByRole("button", { name: /^No login/ }).click();
  await page.getByText(/^Browsers allow notifications only over TLS/).waitFor();
  await page.getByRole("button", { name: "Sound" }).click();
  await page.getByRole("button", { name: "Sound", pressed: true }).waitFor();
  const { tones } = await told();
  const question = { id: "q1", text: "Is the part clean?", choices: ["yes", "no"], since: now() };
  machine.say("cs/1/m_code/pending", { outputs: [{ seq: 3, run_id: "r", m: 60, params: {}, timing: "after_motion", program: 1, line: 2, attempt: 1, redelivered: false, lost: false, state: "CLAIMED", handler_id: "measure", since: now(), question }] });
  await until(async () => (await told()).tones, tones + 2, "the tones");
});
