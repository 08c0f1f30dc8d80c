// By hand on the real runtime: jog, MDI, locks, and programs that the operator brings.

import assert from "node:assert/strict";
import { appendFile } from "node:fs/promises";
import { join } from "node:path";
import { afterEach, beforeEach, test } from "node:test";
import { setTimeout as sleep } from "node:timers/promises";

import { openPage } from "./browser.mjs";
import { withRuntime } from "./runtime.mjs";
import { disabled, Screen, until } from "./screen.mjs";

/** Longest time between the last refresh and rest, ms: 200 to notice, braking, and the way of messages on a busy computer. */
const STOP_MS = 1500;

/** Number of held jogs, none of which may end early. */
const HELD_TRIES = 3;

let browser;
let runtime;
let page;
let errors;
let close;
let screen;

withRuntime((made) => ({ runtime, browser } = made));

beforeEach(async () => {
  ({ page, errors, close } = await openPage(browser));
  screen = new Screen(page);
  await page.goto(runtime.url);
  await page.getByText("Connected", { exact: true }).waitFor();
  await screen.openByHand();
});

afterEach(async () => {
  await close();
  // the browser reports a refresh that was in transit when its jog ended, and was therefore
  // refused
  const told = errors.filter((text) => !/status of 409/.test(text));
  assert.deepEqual(told, [], "the browser's console shows no errors");
});

const jog = (axis, direction) => page.getByRole("button", { name: `Jog ${axis} ${direction}: hold` });
const mdi = () => page.getByLabel("NC text to run at once (MDI)");

/** Waits until a field holds the text. */
const holds = (field, text) => until(() => field.inputValue(), text, "the field");

/** The commanded position of the runtime itself. */
async function machine(axis) {
  return (await (await fetch(`${runtime.url}/api/v1/cs/1/position`)).json()).machine[axis];
}

async function at(axis, position) {
  await until(() => machine(axis), (now) => Math.abs(now - position) < 1e-6, `${axis}, which goes to ${position},`);
}

/** Waits for standstill within the time limit, and returns the position. A jog moves more than 2 mm during the
 * sleep. */
async function atRest(axis) {
  const end = Date.now() + STOP_MS;
  for (let position = await machine(axis); ;) {
    await sleep(300);
    const before = position;
    position = await machine(axis);
    if (position === before) return position;
    assert.ok(Date.now() < end, `${axis} still moves, from ${before} to ${position}`);
  }
}

test("an axis moves while its button is held, and stops when it is released", async () => {
  await jog("X", "plus").hover();
  // on a busy computer a late refresh may end the jog, which is then held again
  for (let tries = 1; ; tries += 1) {
    const begin = await machine("X");
    await page.mouse.down();
    await screen.sees("ACTIVE");
    // far longer than the validity of one refresh
    await sleep(900);
    const isHeld = await jog("Y", "plus").isDisabled();
    const held = await machine("X");
    await page.mouse.up();
    await screen.sees("READY");
    assert.ok((await atRest("X")) >= held);
    if (!isHeld && tries < HELD_TRIES) continue;
    assert.ok(isHeld, "it moves as long as it is held");
    assert.ok(held > begin + 2, `${begin} to ${held}`);
    return;
  }
});

test("on release an axis brakes at once, and does not run on until its refresh is missed", async () => {
  await page.getByRole("radiogroup", { name: "Velocity, mm/min" }).getByRole("radio", { name: "6000" }).click();
  await jog("X", "minus").hover();
  await page.mouse.down();
  await screen.sees("ACTIVE");
  await screen.says(/Jog: axis X moves by hand/);
  await page.locator('tr[data-axis="X"]').getByText("jog", { exact: true }).waitFor();
  await sleep(500);
  const released = await page.evaluate(() => {
    const { fetch } = globalThis;
    return new Promise((resolve) => {
      globalThis.fetch = (resource, init) => {
        const sent = performance.now();
        const answer = fetch(resource, init);
        if (String(init?.body).includes('"end":true')) void answer.then((one) => resolve({ status: one.status, ms: performance.now() - sent }));
        return answer;
      };
      globalThis.setTimeout(() => resolve(null), 5000);
      document.querySelector('[data-jog="X-"]')?.dispatchEvent(new PointerEvent("lostpointercapture"));
    });
  });
  assert.equal(released?.status, 202, "the end of the jog is sent and accepted");
  await screen.sees("READY");
  await page.mouse.up();
  await atRest("X");
});

test("the keyboard jogs only while it is switched on, and a key that is released ends it", async () => {
  const begin = await machine("Y");
  await page.locator("body").press("ArrowUp");
  assert.equal(await machine("Y"), begin);
  const keys = page.getByRole("switch", { name: "Jog by keyboard and gamepad" });
  await keys.click();
  await page.locator(".pad-note").getByText(/Arrows/).waitFor();
  await page.keyboard.down("ArrowUp");
  await screen.sees("ACTIVE");
  await sleep(300);
  await page.keyboard.up("ArrowUp");
  await screen.sees("READY");
  const end = await atRest("Y");
  assert.ok(end > begin, `${begin} ${end}`);
  await keys.click();
  let asked = 0;
  page.on("request", (request) => (asked += request.url().endsWith("/jog") ? 1 : 0));
  await page.keyboard.press("ArrowUp");
  assert.equal(await atRest("Y"), end, "switched off");
  assert.equal(asked, 0, "and asks for no jog");
});

test("a gamepad jogs while it is switched on and its stick is deflected", async () => {
  await page.evaluate(() => {
    globalThis.pad = { id: "Test pad", axes: [0, 0, 0, 0], buttons: [] };
    navigator.getGamepads = () => [globalThis.pad];
  });
  const begin = await machine("X");
  await page.getByRole("switch", { name: "Jog by keyboard and gamepad" }).click();
  await page.locator(".pad-note").getByText(/Test pad/).waitFor();
  await page.evaluate(() => (globalThis.pad.axes = [1, 0, 0, 0]));
  await screen.sees("ACTIVE");
  await sleep(300);
  await page.evaluate(() => (globalThis.pad.axes = [0, 0, 0, 0]));
  await screen.sees("READY");
  assert.ok((await atRest("X")) > begin);
});

test("the keyboard jogs, and an axis stops when its button loses the focus", async () => {
  const begin = await machine("Y");
  await jog("Y", "minus").focus();
  await page.keyboard.down("Space");
  await screen.sees("ACTIVE");
  await sleep(600);
  await page.evaluate(() => /** @type {HTMLElement} */ (document.activeElement).blur());
  await screen.sees("READY");
  assert.ok((await atRest("Y")) < begin - 1);
  await page.keyboard.up("Space");
});

test("an axis stops when the screen that held it is gone", async () => {
  await jog("X", "plus").hover();
  await page.mouse.down();
  await screen.sees("ACTIVE");
  await close();
  await atRest("X");
});

test("a step is done in full by one click", async () => {
  const begin = await machine("Z");
  await page.getByRole("radiogroup", { name: "Step, mm" }).getByRole("radio", { name: "1", exact: true }).click();
  const step = page.getByRole("button", { name: "Jog Z plus: one step of 1 mm" });
  await step.click();
  await at("Z", begin + 1);
  await screen.sees("READY");
  assert.ok(Math.abs((await atRest("Z")) - begin - 1) < 1e-6);
  // a held key makes only one step
  await step.hover();
  await page.mouse.down();
  await at("Z", begin + 2);
  await sleep(600);
  await page.mouse.up();
  assert.ok(Math.abs((await atRest("Z")) - begin - 2) < 1e-6);
  assert.equal(await screen.notices(), "", "a refresh that comes after the end is nothing to tell");
  errors.splice(0, errors.length, ...errors.filter((text) => !/status of 409/.test(text)));
});

test("on a slow network a step is done in full, and quick clicks add up or are reported as not made", async () => {
  const network = await page.context().newCDPSession(page);
  await network.send("Network.emulateNetworkConditions", { offline: false, latency: 300, downloadThroughput: -1, uploadThroughput: -1 });
  const steps = page.getByRole("radiogroup", { name: "Step, mm" });
  const begin = await machine("Z");
  await steps.getByRole("radio", { name: "10", exact: true }).click();
  await page.getByRole("button", { name: "Jog Z plus: one step of 10 mm" }).click();
  await at("Z", begin + 10);
  await screen.sees("READY");
  assert.equal(await screen.notices(), "");
  // a notice disappears after some time, and its count grows until a step begins while no
  // other step waits
  await page.evaluate(() => {
    globalThis.notMade = 0;
    let last = 0;
    let text = "";
    new MutationObserver(() => {
      const now = document.querySelector('.toast[data-kind="jog.not_made"]')?.textContent ?? text;
      if (now === text) return;
      text = now;
      const count = Number(/(\d+) steps? (was|were) not made/.exec(text)[1]);
      globalThis.notMade += count > last ? count - last : count;
      last = count;
    }).observe(document.body, { childList: true, subtree: true });
  });
  // five clicks, 300 ms apart; one step takes 1.2 s and the network
  const back = page.getByRole("button", { name: "Jog Z minus: one step of 10 mm" });
  for (let click = 0; click < 5; click += 1) {
    await back.click();
    await sleep(300);
  }
  const notMade = () => page.evaluate(() => globalThis.notMade);
  const made = async () => Math.round((begin + 10 - (await machine("Z"))) / 10);
  await until(async () => (await made()) + (await notMade()), 5, "steps that were made and those that are reported");
  await screen.sees("READY");
  assert.ok((await made()) >= 1);
});

test("a step that ends early is reported with its distance and the cause", async () => {
  await page.getByRole("radiogroup", { name: "Step, mm" }).getByRole("radio", { name: "10", exact: true }).click();
  await page.getByRole("button", { name: "Jog Y plus: one step of 10 mm" }).click();
  await screen.sees("ACTIVE");
  assert.equal((await other("POST", "/cs/1/hold?wait=1", {})).status, 200);
  await page.getByText(/Step Y\+ ended after [\d.]+ of 10 mm: feed hold\./).waitFor();
  await screen.sees("READY");
});

test("codes that the next MDI line begins in stand next to it, and those of a macro do not", async () => {
  const inForce = page.locator(".mdi-carried");
  const run = async (text, macro) => assert.equal((await other("POST", "/cs/1/mdi?wait=1", { text, macro })).status, 200);
  await run("G90", false);
  await inForce.waitFor({ state: "hidden" });
  await run("G91 G20", false);
  await inForce.getByText("G91", { exact: true }).waitFor();
  await inForce.getByText("G20", { exact: true }).waitFor();
  await run("G90 G21 G68 R30 X0 Y0 F100", true);
  assert.equal(await inForce.getByText("G68", { exact: true }).count(), 0);
  await inForce.getByText("G91", { exact: true }).waitFor();
  await run("G90 G21", false);
  await inForce.waitFor({ state: "hidden" });
});

test("a line of MDI runs, and the history brings it back", async () => {
  for (const [text, end] of [["G53 G00 X20 Y20", 20], ["G53 G00 X10", 10]]) {
    await mdi().fill(text);
    await mdi().press("Enter");
    await at("X", end);
    await screen.sees("READY");
  }
  await mdi().press("ArrowUp");
  await holds(mdi(), "G53 G00 X10");
  await mdi().press("ArrowUp");
  await holds(mdi(), "G53 G00 X20 Y20");
  await mdi().press("ArrowDown");
  await mdi().press("ArrowDown");
  await holds(mdi(), "");
});

test("what is wrong with a line of MDI stands under it, and nothing moves", async () => {
  const begin = await machine("X");
  await mdi().fill("G00 X");
  await mdi().press("Enter");
  await page.locator("#mdi-findings").getByText("Line 1, column 5").waitFor();
  await holds(mdi(), "G00 X");
  assert.equal(await machine("X"), begin);
  errors.splice(0, errors.length, ...errors.filter((text) => !/status of 422/.test(text)));
});

test("axes go home from the screen", async () => {
  await page.getByRole("button", { name: "Home X" }).click();
  await at("X", 0);
  await screen.sees("READY");
});

test("interlock holds the motion, says why, and lets it go on", async () => {
  await screen.load("O0002");
  await screen.sees("READY");
  await screen.openByHand();
  await screen.command("Start").click();
  await screen.sees("ACTIVE");
  await page.getByRole("switch", { name: "Interlock" }).click();
  await screen.sees("INTERRUPTED");
  await page.getByText(/The interlock is on \(set at the HMI\)/).first().waitFor();
  await page.getByRole("switch", { name: "Interlock" }).click();
  await page.getByText("The interlock is off again. Press Resume to continue.", { exact: true }).waitFor();
  await screen.command("Resume").click();
  await screen.sees("ACTIVE");
  await disabled(jog("X", "plus"));
  await page.getByRole("switch", { name: "Single block" }).click();
  await page.locator(".detail").getByText("single block").waitFor();
  await page.getByRole("switch", { name: "Single block" }).click();
  await page.locator(".detail:not(:has-text('single block'))").waitFor();
  await screen.command("Stop").click();
  await screen.sees("STOPPED");
});

test("a source that a handler watches is cleared by force only, which is asked and then said", async () => {
  await runtime.stop();
  const door = '\n[input.interlock.source.door]\non_loss = "on"\ncoordinate_systems = [1]\n';
  await appendFile(join(runtime.folder, "tandem.toml"), door);
  await runtime.start();
  await page.reload();
  await page.getByText("Connected", { exact: true }).waitFor();
  await screen.openByHand();
  const interlock = page.getByRole("switch", { name: "Interlock" });
  await interlock.and(page.locator('[aria-checked="true"]')).click();
  const dialog = page.getByRole("dialog", { name: "Interlock is held" });
  await dialog.getByText("door", { exact: true }).waitFor();
  await dialog.getByRole("button", { name: "Keep" }).click();
  assert.equal((await other("GET", "/cs/1/inputs/interlock")).body.value, true);
  await interlock.click();
  await dialog.getByRole("button", { name: "Clear door by force" }).click();
  await dialog.waitFor({ state: "detached" });
  await interlock.and(page.locator('[aria-checked="false"]')).waitFor();
  await page.getByText(/Interlock: door is cleared by force \(operator\)/).waitFor();
  // any user may clear a lock that a user has set, without a question
  await interlock.click();
  await interlock.and(page.locator('[aria-checked="true"]')).click();
  await interlock.and(page.locator('[aria-checked="false"]')).waitFor();
  errors.length = 0;
});

/** Sends a request of another client; returns the status. */
async function other(method, path, body, headers = {}) {
  const all = { "Content-Type": "application/json", ...headers };
  const answer = await fetch(`${runtime.url}/api/v1${path}`, { method, headers: all, body: body && JSON.stringify(body) });
  return { status: answer.status, body: await answer.json() };
}

test("while this screen has taken control it moves the machine and others do not; given back, they do", async () => {
  await page.getByRole("button", { name: "Take control" }).click();
  await page.locator(".detail").getByText(/control lease: HMI [0-9a-f]{4}/).waitFor();
  const refused = await other("POST", "/cs/1/mdi", { text: "G53 G00 X1" });
  assert.deepEqual([refused.status, refused.body.code], [409, "busy"]);
  await mdi().fill("G53 G00 X3");
  await mdi().press("Enter");
  await at("X", 3);
  await screen.sees("READY");
  const begin = await machine("X");
  await jog("X", "plus").hover();
  await page.mouse.down();
  await until(() => machine("X"), (now) => now > begin, "X, which is jogged,");
  await page.mouse.up();
  await page.getByRole("button", { name: "Give control back" }).click();
  await page.locator(".detail:not(:has-text('control lease'))").waitFor();
  await atRest("X");
  assert.equal((await other("POST", "/cs/1/mdi?wait=1", { text: "G53 G00 X2" })).status, 200);
});

test("the control of another is ended by this screen only when the operator says so", async () => {
  assert.equal((await other("POST", "/cs/1/lease", { holder: "mes-1" })).status, 200);
  const end = page.getByRole("button", { name: "End control of mes-1" });
  await end.click();
  await page.getByRole("button", { name: "Leave it" }).click();
  await disabled(page.getByRole("button", { name: "Home X" }));
  await page.getByRole("button", { name: "Home X" }).click({ force: true });
  await page.getByText(/mes-1/).and(page.locator(".toast p")).waitFor();
  await end.click();
  await page.getByRole("button", { name: "End it" }).click();
  await page.getByRole("button", { name: "Take control" }).waitFor();
  await page.getByRole("button", { name: "Home X" }).click();
  await at("X", 0);
  errors.splice(0, errors.length, ...errors.filter((text) => !/status of 409/.test(text)));
});

test("a held program goes back along its path and forward again", async () => {
  const text = "G90 G54 G64 G500\nG01 X0 F6000\nX10 F600\nX20\nM30\n";
  const stored = await fetch(`${runtime.url}/api/v1/programs/78`, { method: "PUT", headers: { "Content-Type": "text/plain" }, body: text });
  assert.ok(stored.ok);
  await other("POST", "/cs/1/load?wait=1", { program: 78 });
  const back = page.getByRole("button", { name: "Back trace" });
  await disabled(back);
  await screen.command("Start").click();
  await until(() => screen.workPosition("X"), (now) => now > 4 && now < 20, "X on its way");
  await disabled(back);
  await screen.command("Hold").click();
  await screen.sees("FEED_HOLD");
  await back.click();
  await screen.says(/Moves back along its path/);
  await screen.says(/The back trace ends here/);
  await disabled(back);
  await screen.command("Resume").click();
  await screen.sees("PROGRAM_COMPLETED");
  await until(() => screen.workPosition("X"), 20, "X at the end");
});

test("dry run is switched at the screen, and said beside the program", async () => {
  await page.getByRole("switch", { name: "Dry run" }).click();
  await page.locator(".detail").getByText("dry run").waitFor();
  await page.getByRole("switch", { name: "Dry run" }).click();
  await page.locator(".detail:not(:has-text('dry run'))").waitFor();
});

test("a file is stored as a program; what is wrong with it is shown by lines, corrected, and then loads", async () => {
  const file = (name, text) => ({ name, mimeType: "text/plain", buffer: Buffer.from(text) });
  await page.locator("input[type=file]").setInputFiles(file("O0077.nc", "// From a file\nG90\nG00 X\nM30\n"));
  const dialog = page.getByRole("dialog", { name: "Program" });
  await holds(dialog.getByLabel("Number"), "77");
  await dialog.getByText("O0077 is new.").waitFor();
  await dialog.getByRole("button", { name: "Store" }).click();
  await dialog.getByText("O0077 is stored: 1 error.").waitFor();
  await dialog.getByText("Line 3, column 5").waitFor();
  await dialog.getByRole("button", { name: "Go to line 3" }).click();
  await until(() => dialog.locator(".cm-activeLine").textContent(), "G00 X", "the line with the cursor");

  await page.keyboard.press("End");
  await page.keyboard.type("1");
  await page.keyboard.press("Escape");
  await dialog.getByText("Not stored yet.").waitFor();
  await dialog.getByRole("button", { name: "Store" }).click();
  await dialog.getByText("O0077 is stored: no findings.").waitFor();
  await dialog.getByRole("button", { name: "Close" }).click();
  await screen.load("O0077");
  await screen.sees("READY");
  await page.getByRole("button", { name: "Edit O0077" }).click();
  await until(() => dialog.getByRole("textbox", { name: "Program text" }).textContent(), /G00 X1/, "the text");
});
