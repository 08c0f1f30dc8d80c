// Costs of the screen: delay of a press, script time of a frame, memory over hours. Clocks of a busy computer are
// sometimes late, so the median is compared.

import assert from "node:assert/strict";
import { test } from "node:test";

import { openPage } from "./browser.mjs";
import { withRuntime } from "./runtime.mjs";
import { ORIGIN, ScriptedMachine } from "./scripted_machine.mjs";
import { Screen, until } from "./screen.mjs";

/** Only in the long run of all tests, like the pictures. */
const LONG = process.env.TANDEM_PICTURES === "1";
const PRESSED_MS = 100;
const PRESSES = 7;
const FRAME_MS = 4;
/** Positions arrive ten times a second: for two minutes, in the long run for an hour. */
const POSITIONS = LONG ? 36_000 : 1_200;
/** Until then the page allocates memory for its first drawings; after an hour the trail of the tool has its maximum length. */
const POSITIONS_BEFORE = LONG ? 6_000 : 400;
const GROWTH_BYTES = 1_000_000;
/** The limits, the zero point, the tool and its trail. */
const CARD_KEEPS = 4;

let browser;
let runtime;
withRuntime((made) => ({ runtime, browser } = made));

const median = (values) => values.toSorted((a, b) => a - b)[Math.floor(values.length / 2)];

async function post(path, body = {}) {
  const answer = await fetch(`${runtime.url}/api/v1/cs/1${path}`, { method: "POST", body: JSON.stringify(body), headers: { "Content-Type": "application/json" } });
  assert.ok(answer.ok, `${path}: ${await answer.text()}`);
}

/** Returns the browser's counters of a page: script, memory, elements. */
async function counters(page) {
  const cdp = await page.context().newCDPSession(page);
  await cdp.send("Performance.enable");
  return async () => {
    await cdp.send("HeapProfiler.collectGarbage");
    return Object.fromEntries((await cdp.send("Performance.getMetrics")).metrics.map(({ name, value }) => [name, value]));
  };
}

/** In the page: presses a button, and returns the time until the state arrives, ms. */
function pressed([label, execution]) {
  const status = document.querySelector(".status");
  return new Promise((resolve) => {
    const began = performance.now();
    new MutationObserver((_, observer) => {
      if (status.dataset.execution !== execution) return;
      observer.disconnect();
      resolve(performance.now() - began);
    }).observe(status, { attributes: true });
    document.querySelector(`.command.${label}`).click();
  });
}

test("a press is seen as the state that it leads to in time, and a frame costs little while the program runs", async () => {
  const { page, errors, close } = await openPage(browser);
  const screen = new Screen(page);
  await post("/load?wait=1", { program: 2 });
  await page.goto(runtime.url);
  await screen.sees("READY");
  const took = [];
  for (let press = 0; press < PRESSES; press += 1) {
    took.push(await page.evaluate(pressed, [press === 0 ? "start" : "resume", "ACTIVE"]));
    await screen.command("Hold").click();
    await page.locator('.status[data-execution="FEED_HOLD"]:not(:has-text("slowing down"))').waitFor();
  }
  assert.ok(median(took) < PRESSED_MS, `from the press to the state: ${took.map(Math.round)} ms`);

  await screen.command("Resume").click();
  await screen.sees("ACTIVE");
  const count = await counters(page);
  const before = await count();
  const frames = await page.evaluate(() => new Promise((resolve) => {
    const end = performance.now() + 2000;
    let seen = 0;
    const step = () => (performance.now() > end ? resolve(seen) : ((seen += 1), requestAnimationFrame(step)));
    requestAnimationFrame(step);
  }));
  const perFrame = (1000 * ((await count()).ScriptDuration - before.ScriptDuration)) / frames;
  assert.ok(frames > 40 && perFrame < FRAME_MS, `${perFrame} ms of script in each of ${frames} frames`);
  await post("/stop?wait=1");
  await post("/reset?wait=1");
  await close();
  assert.deepEqual(errors, []);
});

test("memory, elements and listeners stay as they are however many positions come", async () => {
  const { page, errors, close } = await openPage(browser);
  const machine = new ScriptedMachine();
  machine.programs.set(1, "G01 X1\nM30\n");
  machine.start();
  await machine.attach(page);
  await page.goto(`${ORIGIN}/`);
  await new Screen(page).sees("READY");
  machine.state(1, { execution: "ACTIVE", run_id: "r", run_kind: "program" });
  const said = machine.topics.get("cs/1/position");
  let at = 0;
  const move = async (count) => {
    for (const end = at + count; at < end; at += 1) {
      const place = { X: 100 * Math.sin(at / 40), Y: 100 * Math.cos(at / 33), Z: at % 50 };
      machine.say("cs/1/position", { ...said, machine: place, work: place, actual: place });
      if (at % 200 === 199) await page.evaluate(() => new Promise((done) => requestAnimationFrame(done)));
    }
    await until(() => page.locator('tr[data-axis="Z"] td.work').textContent(), `${((at - 1) % 50).toFixed(3)}`, "the last position");
  };
  await move(POSITIONS_BEFORE);
  const count = await counters(page);
  const before = await count();
  await move(POSITIONS);
  const now = await count();
  const growth = now.JSHeapUsedSize - before.JSHeapUsedSize;
  assert.ok(growth < GROWTH_BYTES, `${growth} bytes more after ${POSITIONS} positions`);
  assert.ok(now.Nodes <= before.Nodes + 50, `${before.Nodes} elements, then ${now.Nodes}`);
  assert.ok(now.JSEventListeners <= before.JSEventListeners + 5, `${before.JSEventListeners} listeners, then ${now.JSEventListeners}`);
  const { kept } = await page.evaluate(() => document.querySelector(".path-lines").statistics());
  assert.ok(kept <= CARD_KEEPS, `${kept} sets of lines on the graphics card`);
  await close();
  assert.deepEqual(errors, []);
});
