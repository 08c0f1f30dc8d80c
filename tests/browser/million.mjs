// Measures the cost of a program of a million blocks for the screen and the servo, in Chromium on the real runtime:
//   cargo build --release -p tandem-runtime --bin tandem
//   cd tests/browser && TANDEM_BIN=../../target/release/tandem node million.mjs [RUNS]
// It prints a line for each run and the medians, and fails if one is not below its bound. For the longest task it also
// prints the processor time, because a task waits on a busy computer. The results depend on the computer, so this is
// not a test.

import { readFileSync } from "node:fs";

import { launch } from "./browser.mjs";
import { Runtime } from "./runtime.mjs";
import { Screen, until } from "./screen.mjs";

const BLOCKS = 1_000_000;
/** Blocks of a row of the surface, and their path length, mm. */
const ROW = 1000;
const STEP_MM = 0.2;

/** Bounds of the medians. */
const BOUNDS = { firstPictureMs: 1000, longestTaskMs: 50, longestOwnMs: 50, pageMB: 200 };
const MB = 1e6;
const LOOKED_AT_MS = 1500;
const PLANNED_MS = 120_000;

/** A surface that is cut row by row, as a CAM system writes it. */
function surface() {
  const lines = ["// Surface of a million blocks", "G90 G54 G17", "G00 X0 Y0 Z10", "G64", "G01 Z0 F6000"];
  for (let i = 0; lines.length < BLOCKS - 1; i += 1) {
    const row = Math.floor(i / ROW);
    const along = row % 2 === 0 ? i % ROW : ROW - 1 - (i % ROW);
    const [x, y] = [along * STEP_MM, row * STEP_MM];
    lines.push(`G01 X${x.toFixed(3)} Y${y.toFixed(3)} Z${(-5 + 4 * Math.sin(x / 17) * Math.cos(y / 23)).toFixed(3)}`);
  }
  return `${[...lines, "M30"].join("\n")}\n`;
}

const median = (values) => values.toSorted((a, b) => a - b)[Math.floor(values.length / 2)];

/** Returns the servo's time statistics since the start. */
async function servo(runtime) {
  const text = await (await fetch(`${runtime.url}/api/v1/metrics`)).text();
  const of = (name) => Number(text.match(new RegExp(`^tandem_servo_${name} (\\S+)$`, "m"))?.[1] ?? NaN);
  return { overruns: of("overruns_total"), missed: of("missed_cycles_total"), lateMs: 1000 * of("wakeup_lateness_max_seconds"), computedMs: 1000 * of("cycle_max_seconds") };
}

/** Returns the longest task of the page, ms, and the largest processor time of a task. */
function longest(trace) {
  const { traceEvents } = JSON.parse(trace);
  const pages = new Set(traceEvents.filter(({ name, args }) => name === "thread_name" && args.name === "CrRendererMain").map(({ pid, tid }) => `${pid} ${tid}`));
  const tasks = traceEvents.filter(({ name, pid, tid }) => name.endsWith("RunTask") && pages.has(`${pid} ${tid}`));
  const most = (of) => tasks.reduce((long, task) => Math.max(long, (task[of] ?? 0) / 1000), 0);
  return { longestTaskMs: most("dur"), longestOwnMs: most("tdur"), longTasks: tasks.filter(({ dur }) => dur > 50_000).length };
}

/** Returns the memory of the page and its workers: script, elements, buffers, MB. */
async function memory(page) {
  const cdp = await page.context().newCDPSession(page);
  const answers = new Map();
  const workers = [];
  cdp.on("Target.attachedToTarget", ({ sessionId }) => workers.push(sessionId));
  cdp.on("Target.receivedMessageFromTarget", ({ sessionId, message }) => answers.get(sessionId)?.(JSON.parse(message).result));
  await cdp.send("Target.setAutoAttach", { autoAttach: true, waitForDebuggerOnStart: false, flatten: false });
  await cdp.send("HeapProfiler.collectGarbage");
  const used = [await cdp.send("Runtime.getHeapUsage")];
  for (const sessionId of workers) {
    const answer = new Promise((resolve) => answers.set(sessionId, resolve));
    await cdp.send("Target.sendMessageToTarget", { sessionId, message: JSON.stringify({ id: 1, method: "Runtime.getHeapUsage" }) });
    used.push(await answer);
  }
  await cdp.detach();
  return used.reduce((sum, { usedSize, embedderHeapUsedSize, backingStorageSize }) => sum + usedSize + embedderHeapUsedSize + backingStorageSize, 0) / MB;
}

/** Private memory of the processes of the browser that show pages, the largest of them, MB. */
async function processMemory(browser) {
  const cdp = await browser.newBrowserCDPSession();
  const { processInfo } = await cdp.send("SystemInfo.getProcessInfo");
  await cdp.detach();
  const own = ({ id }) => [...readFileSync(`/proc/${id}/smaps_rollup`, "utf8").matchAll(/^Private_\w+: +(\d+) kB/gm)].reduce((sum, [, kB]) => sum + Number(kB) * 1024, 0) / MB;
  return Math.max(...processInfo.filter(({ type }) => type === "renderer").map(own));
}

/** Loads, looks at the path from near and far, chooses lines, scrolls the text, and runs for some seconds. */
async function measure(runtime, browser) {
  // without openPage, because it reads a copy of each answer
  const page = await browser.newPage({ viewport: { width: 1280, height: 800 } });
  const screen = new Screen(page);
  await page.goto(runtime.url);
  await screen.sees("READY");
  await page.getByRole("tab", { name: "Programs" }).click();
  await browser.startTracing(page, { categories: ["toplevel"] });
  const firstPictureMs = await page.evaluate(loaded);
  await page.getByText(/^Cycle /).waitFor({ timeout: PLANNED_MS });
  await until(() => page.locator(".line").count(), (count) => count > 5, "lines of the program");
  await lookAround(page);
  await screen.command("Start").click();
  await screen.sees("ACTIVE");
  await page.waitForTimeout(4 * LOOKED_AT_MS);
  const { calls, lines } = await page.evaluate(() => document.querySelector(".path-lines").statistics());
  const tasks = longest(await browser.stopTracing());
  const [pageMB, processMB] = [await memory(page), await processMemory(browser)];
  await screen.command("Stop").click();
  await screen.sees("STOPPED");
  await screen.command("Reset").click();
  await screen.sees("READY");
  await page.close();
  return { firstPictureMs, ...tasks, pageMB, processMB, callsOfAFrame: calls, linesSeen: lines };
}

async function lookAround(page) {
  const box = await page.locator(".path-lines").boundingBox();
  const [x, y] = [box.x + box.width / 2, box.y + box.height / 2];
  await page.mouse.move(x, y);
  for (let i = 0; i < 8; i += 1) {
    await page.mouse.wheel(0, -300);
    await page.waitForTimeout(150);
  }
  await page.mouse.down();
  await page.mouse.move(x + 80, y + 30, { steps: 20 });
  await page.mouse.up();
  await page.waitForTimeout(LOOKED_AT_MS);
  await page.mouse.click(x, y);
  await page.getByRole("button", { name: "Fit", exact: true }).click();
  await page.mouse.click(x, y);
  await page.waitForTimeout(LOOKED_AT_MS);
  for (const share of [0.25, 0.5, 0.99]) {
    await page.locator(".program-text").evaluate((one, part) => one.scrollTo(0, one.scrollHeight * part), share);
    await page.waitForTimeout(200);
  }
  await page.locator(".line .line-number").nth(2).click();
  await page.waitForTimeout(LOOKED_AT_MS);
}

/** In the page: loads the program, and returns the time until its path is drawn, ms. */
function loaded() {
  const lines = () => document.querySelector(".path-lines").statistics().lines;
  const before = lines();
  return new Promise((resolve) => {
    const began = performance.now();
    const look = () => (lines() > before + 500 ? resolve(performance.now() - began) : requestAnimationFrame(look));
    document.querySelector('[aria-label="Load O0009"]').click();
    requestAnimationFrame(look);
  });
}

const runtime = await Runtime.create();
await runtime.start();
const send = async (method, path, body, type) => {
  const answer = await fetch(`${runtime.url}/api/v1${path}`, { method, body, headers: { "Content-Type": type } });
  if (!answer.ok) throw new Error(await answer.text());
};
await send("PUT", "/programs/9", surface(), "text/plain");
const all = [];
for (let i = 0; i < Number(process.argv[2] ?? 3); i += 1) {
  await send("POST", "/cs/1/load?wait=1", JSON.stringify({ program: 1 }), "application/json");
  const before = await servo(runtime);
  const browser = await launch();
  const one = await measure(runtime, browser);
  await browser.close();
  const after = await servo(runtime);
  all.push(one);
  console.log(JSON.stringify({ ...one, servoMissed: after.missed - before.missed, servoLateMs: after.lateMs, servoComputedMs: after.computedMs }));
}
for (const [name, bound] of Object.entries(BOUNDS)) {
  const value = median(all.map((one) => one[name]));
  console.log(`${name}: ${value.toFixed(1)}, to be below ${bound}`);
  if (value >= bound) process.exitCode = 1;
}
await runtime.remove();
