// The HMI on the real runtime: the actions of an operator in the first minutes.

import assert from "node:assert/strict";
import { afterEach, beforeEach, test } from "node:test";
import { setTimeout as sleep } from "node:timers/promises";

import { openPage } from "./browser.mjs";
import { picture } from "./pictures.mjs";
import { withRuntime } from "./runtime.mjs";
import { disabled, Screen, until } from "./screen.mjs";

/** File of the picture in the README; written on request. */

let browser;
let runtime;
let page;
let errors;
let checked;
let close;
let screen;

withRuntime((made) => ({ runtime, browser } = made));

beforeEach(async () => {
  ({ page, errors, checked, close } = await openPage(browser));
  screen = new Screen(page);
  await page.goto(runtime.url);
  await page.getByText("Connected", { exact: true }).waitFor();
});

afterEach(async () => {
  await close();
  assert.deepEqual(errors, [], "the browser's console shows no errors, and all is of its form");
  assert.ok(checked.frames > 10 && checked.asked > 0 && checked.answers > 0, "frames and answers were checked");
});

/** Ends any run, and loads a program. */
async function ready(program) {
  await screen.command("Stop").click();
  await page.locator('.status:is([data-execution="STOPPED"], [data-execution="READY"], [data-execution="PROGRAM_COMPLETED"])').waitFor();
  if (await page.locator('.status[data-execution="STOPPED"]').count()) await screen.command("Reset").click();
  await screen.load(program);
  await screen.says(new RegExp(`${program} is loaded`));
}

test("page is served with a policy that allows no inline script or style", async () => {
  const answer = await fetch(runtime.url);
  const policy = answer.headers.get("content-security-policy") ?? "";
  assert.match(policy, /default-src 'self'/);
  assert.doesNotMatch(policy, /unsafe/);
  assert.match(answer.headers.get("content-type") ?? "", /text\/html/);
});

test("program runs, waits for an M code, is reset by the button and completes", async () => {
  await screen.load("O0001");
  await screen.sees("READY");
  await screen.says(/O0001 is loaded, at line 1\. Press Start/);
  await screen.command("Start").click();
  await screen.sees("ACTIVE");
  await screen.sees("WAIT");
  await page.getByText(/Waiting \d+ s for M100 \(TOOL_LOAD\), VA=5, VB=0\.25/).waitFor();
  await page.locator('.line[aria-current="step"]', { hasText: "N120 M100" }).waitFor();
  await page.getByText("Waiting 2 s for").waitFor();
  await picture(page, "hmi");

  await screen.confirmByHand(8);
  await page.getByText("1 open", { exact: true }).waitFor();
  await screen.confirmByHand(100);
  await screen.sees("ACTIVE");
  await screen.sees("PROGRAM_COMPLETED");
  await page.getByText("No M code is open.").waitFor();
  // positions come ten times a second, so the last one follows the state
  for (const [axis, end] of [["X", "10.000"], ["Y", "40.000"], ["Z", "50.000"]]) {
    await page.locator(`tr[data-axis="${axis}"] td.work`).getByText(end, { exact: true }).waitFor();
  }
});

test("feed hold stops on the path, resume goes on, stop ends the run, reset makes ready", async () => {
  await ready("O0002");
  await screen.command("Start").click();
  await screen.sees("ACTIVE");
  await screen.command("Hold").click();
  await screen.sees("FEED_HOLD");
  await page.locator(".status:not(:has-text('slowing down'))").waitFor();
  await sleep(300);
  const held = await screen.workPosition("X");
  await sleep(500);
  assert.equal(await screen.workPosition("X"), held, "at rest while held");

  await screen.command("Resume").click();
  await screen.sees("ACTIVE");
  await page.waitForFunction((x) => Number(document.querySelector('tr[data-axis="X"] td.work')?.textContent) - x > 0.5, held);

  await screen.command("Stop").click();
  await screen.sees("STOPPED");
  await screen.says(/Press Reset/);
  await screen.command("Reset").click();
  await screen.sees("READY");
});

test("Start goes on after a hold, too, and Reset of a run asks first", async () => {
  await ready("O0002");
  await screen.command("Start").click();
  await screen.sees("ACTIVE");
  await screen.command("Hold").click();
  await screen.sees("FEED_HOLD");
  await page.locator(".status:not(:has-text('slowing down'))").waitFor();
  await screen.command("Start").click();
  await screen.sees("ACTIVE");
  await screen.command("Hold").click();
  await screen.sees("FEED_HOLD");
  await page.locator(".status:not(:has-text('slowing down'))").waitFor();
  await screen.command("Reset").click();
  const dialog = page.getByRole("dialog", { name: "End the run of O0002?" });
  await dialog.getByRole("button", { name: "Keep the run" }).click();
  await screen.sees("FEED_HOLD");
  await screen.command("Reset").click();
  await dialog.getByRole("button", { name: "End the run" }).click();
  await screen.sees("READY");
});

test("what a load is accepted with stands beside the state until the start", async () => {
  const text = "// Without a handler\nM77\nM30\n";
  const stored = await fetch(`${runtime.url}/api/v1/programs/77`, { method: "PUT", headers: { "Content-Type": "text/plain" }, body: text });
  assert.ok(stored.ok);
  await page.getByRole("button", { name: "Read again" }).click();
  await ready("O0077");
  await page.locator(".load-note").getByText(/No handler is registered for M77/).waitFor();
  await ready("O0002");
  await until(() => page.locator(".load-note").textContent(), "", "the note");
});

test("both coordinate systems run at once, each with its own state", async () => {
  await ready("O0002");
  await screen.command("Start").click();
  await screen.sees("ACTIVE");
  await screen.tab(2).click();
  await ready("O0003");
  await screen.command("Start").click();
  await screen.sees("ACTIVE");
  await until(() => screen.tab(1).textContent(), /ACTIVE/, "the tab of coordinate system 1");
  await screen.sees("PROGRAM_COMPLETED");
  await until(() => screen.tab(1).textContent(), /ACTIVE/, "the tab of coordinate system 1");
  await screen.tab(1).click();
  await screen.command("Stop").click();
  await screen.sees("STOPPED");
});

test("keyboard alone loads, starts and stops", async () => {
  await ready("O0002");
  await screen.tab(1).focus();
  await page.keyboard.press("ArrowRight");
  await page.locator("#tab-2[aria-selected=true]:focus").waitFor();
  await page.keyboard.press("ArrowLeft");
  await page.locator("#tab-1[aria-selected=true]:focus").waitFor();
  await tabTo("Start");
  await page.keyboard.press("Enter");
  await screen.sees("ACTIVE");
  await tabTo("Stop");
  await page.keyboard.press("Space");
  await screen.sees("STOPPED");
});

/** Presses Tab until the button of that name has the focus, and checks that it shows. */
async function tabTo(label) {
  for (let presses = 0; presses < 80; presses += 1) {
    await page.keyboard.press("Tab");
    const focus = await page.evaluate(() => {
      const at = document.activeElement;
      return { text: at?.textContent ?? "", outline: at ? getComputedStyle(at).outlineStyle : "none" };
    });
    if (focus.text === label) return assert.equal(focus.outline, "solid", `${label} shows that it has the focus`);
  }
  assert.fail(`${label} is not reached by Tab`);
}

test("optional stop and block skip are set from the screen and come back from the machine", async () => {
  for (const name of ["Optional stop", "Skip blocks marked /3"]) {
    const one = page.getByRole("switch", { name });
    await one.click();
    await page.locator(`[role=switch][aria-label="${name}"][aria-checked=true]`).waitFor();
    await one.click();
    await page.locator(`[role=switch][aria-label="${name}"][aria-checked=false]`).waitFor();
  }
});

test("feed override of the machine follows the screen", async () => {
  await page.getByRole("button", { name: "Feed override: 10 percent less" }).click();
  const read = async () => (await (await fetch(`${runtime.url}/api/v1/cs/1/overrides`)).json()).feed;
  await until(read, 90, "the feed override");
  await page.getByRole("button", { name: "Feed override: 100 percent" }).click();
  await until(read, 100, "the feed override");
});

test("runtime killed and started again: the screen says so, and comes back by itself", async () => {
  await ready("O0002");
  await screen.command("Start").click();
  await screen.sees("ACTIVE");
  await runtime.kill();
  await page.getByText("Not connected to the machine. The values on the screen are stale.").waitFor();
  await disabled(screen.command("Start"));
  await runtime.start();
  await page.getByText("Connected", { exact: true }).waitFor();
  await page.getByText(/The runtime was started again/).first().waitFor();
  await screen.sees("STOPPED");
  await screen.says(/nothing moves without a command/);
  // the browser itself reports every failed connection
  const refused = errors.filter((text) => /ERR_CONNECTION|WebSocket connection/.test(text));
  errors.splice(0, errors.length, ...errors.filter((text) => !refused.includes(text)));
});

test("what is on the screen is explained by a press", async () => {
  await ready("O0002");
  const explanation = page.locator("dialog.explanation");
  await page.getByRole("button", { name: /^Explain [A-Z_]+$/ }).first().click();
  await explanation.getByText("How to continue:").waitFor();
  await explanation.getByRole("button", { name: "Close" }).click();
  await page.locator(".program-card .nc-g").first().click();
  await explanation.getByText("Example:").waitFor();
  await until(() => explanation.locator("img").evaluate((image) => image.complete && image.naturalWidth > 0), true, "the picture");
  await picture(page, "explanation");
  await page.keyboard.press("Escape");
  await explanation.waitFor({ state: "detached" });
});
