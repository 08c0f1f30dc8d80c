// A start from a line on the real runtime: selected in the text, previewed, and only then executed.

import assert from "node:assert/strict";
import { afterEach, beforeEach, test } from "node:test";

import { openPage } from "./browser.mjs";
import { pictures, SIZES, takePictures } from "./pictures.mjs";
import { withRuntime } from "./runtime.mjs";
import { Screen, until } from "./screen.mjs";

/** M03 is restored, M60 is not; after line 5 the axes are at X30 Y10. */
const PART = `G90 G54
M03 S900
M60
G00 X10 Y10
G01 X30 F6000
Y20
L1 = 0
while (L1 < 2) {
L1 = L1 + 1
G91 G01 X1
}
M30
`;

let browser;
let runtime;
let page;
let errors;
let close;
let screen;

const line = (number) => page.locator(".line").filter({ has: page.locator(".line-number", { hasText: new RegExp(`^${number}$`) }) });
const dialog = () => page.getByRole("dialog");

withRuntime(async (made) => {
  ({ runtime, browser } = made);
  const put = await fetch(`${runtime.url}/api/v1/programs/6`, { method: "PUT", body: PART, headers: { "Content-Type": "text/plain" } });
  assert.ok(put.ok);
});

beforeEach(async () => {
  ({ page, errors, close } = await openPage(browser, { viewport: { width: 1920, height: 1080 } }));
  screen = new Screen(page);
  await page.goto(runtime.url);
  await page.getByText("Connected", { exact: true }).waitFor();
  const loaded = page.waitForResponse((answer) => answer.url().endsWith("/cs/1/load?wait=1"));
  await screen.load("O0006");
  assert.equal((await loaded).status(), 200);
  await page.locator(".line", { hasText: "M03 S900" }).waitFor();
  await screen.sees("READY");
});

afterEach(async () => {
  await close();
  assert.deepEqual(errors, [], "the browser's console shows no errors, and all is of its form");
});

async function choose(number) {
  await line(number).locator(".line-number").click();
  await page.getByRole("button", { name: `Start at line ${number}…` }).click();
}

test("what is in force at the line is seen before anything moves, and the run begins there", async () => {
  await choose(6);
  await dialog().getByText("M03 (line 2)").waitFor();
  await dialog().getByText("Check the machine: M60 (line 3) was issued").waitFor();
  await dialog().getByRole("row", { name: /^X 30\.000/ }).waitFor();
  assert.equal(await screen.workPosition("X"), 0, "nothing has moved");
  await dialog().getByRole("button", { name: "Start at line 6" }).click();
  // as with Start
  await dialog().getByText("No handler is online for M60: an alarm would end the run there.").waitFor();
  assert.equal(await screen.workPosition("X"), 0, "nothing has moved");
  await dialog().getByRole("button", { name: "Start anyway" }).click();
  await screen.sees("PROGRAM_COMPLETED");
  assert.equal(await screen.workPosition("Y"), 20);
  assert.equal(await screen.workPosition("X"), 32);
});

test("a line of a loop asks which time the program comes there", async () => {
  await choose(10);
  await dialog().getByText(/line 10 2 times/).waitFor();
  const start = dialog().getByRole("button", { name: "Start at line 10" });
  assert.ok(await start.isDisabled());
  await dialog().getByLabel("Which time the program reaches this line").fill("2");
  await dialog().getByLabel("Which time the program reaches this line").press("Tab");
  await dialog().getByRole("row", { name: /^X 31\.000/ }).waitFor();
  assert.ok(await start.isEnabled());
  await dialog().getByRole("button", { name: "Leave it" }).click();
  await screen.sees("READY");
  // the browser itself reports refused requests
  errors.splice(0, errors.length, ...errors.filter((text) => !text.includes("status of 422")));
});

test("where the last run was cut short is offered by one button, beside another line that is chosen, too", async () => {
  const post = (path, body = {}) => fetch(`${runtime.url}/api/v1/cs/1${path}`, { method: "POST", body: JSON.stringify(body), headers: { "Content-Type": "application/json" } });
  await post("/load?wait=1", { program: 2 });
  await screen.sees("READY");
  await screen.command("Start").click();
  await screen.sees("ACTIVE");
  await until(async () => (await (await fetch(`${runtime.url}/api/v1/cs/1/program`)).json()).line, 3, "the long way");
  await post("/stop?wait=1");
  await post("/reset?wait=1");
  await screen.sees("READY");
  const offer = page.getByRole("button", { name: "Cut short in line 3…" });
  await offer.waitFor();
  for (const [width, height] of SIZES) {
    await page.setViewportSize({ width, height });
    const apart = () => page.locator(".program-card .card-head").evaluate((head) => {
      const parts = [head.querySelector("h2"), ...head.querySelectorAll(".card-tools > :not([hidden])")].map((part) => part.getBoundingClientRect());
      return parts.every(({ left, right }, at) => left >= (parts[at - 1]?.right ?? 0) - 0.5 && right <= head.getBoundingClientRect().right);
    });
    await until(apart, true, `at ${width} px the parts of the head of the program stand beside each other:`);
  }
  await page.setViewportSize({ width: 1920, height: 1080 });
  await offer.click();
  await dialog().getByText("Here the last run was cut short.").waitFor();
  await dialog().getByRole("button", { name: "Leave it" }).click();
  await choose(4);
  await dialog().getByRole("button", { name: "Where the last run was cut short: line 3" }).click();
  const start = dialog().getByRole("button", { name: "Start at line 3" });
  await start.waitFor();
  await until(() => start.isEnabled(), true);
  await start.click();
  await screen.sees("ACTIVE");
  await post("/stop?wait=1");
  await post("/reset?wait=1");
});

pictures("a start from a line", async () => {
  const said = await takePictures(browser, runtime.url, { "line-start": async (shown) => {
    const tab = shown.getByRole("tab", { name: "Program" });
    if (await tab.count()) await tab.click();
    const five = shown.locator(".line").filter({ has: shown.locator(".line-number", { hasText: /^6$/ }) });
    await five.locator(".line-number").click();
    await shown.getByRole("button", { name: "Start at line 6…" }).click();
    await shown.getByText("M03 (line 2)").waitFor();
  } });
  assert.deepEqual(said, []);
});
