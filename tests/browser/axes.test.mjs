// Machines with many axes and coordinate systems, in inches, seen from three metres, and set up by an
// operator.

import assert from "node:assert/strict";
import { after, afterEach, before, test } from "node:test";

import { launch, openPage } from "./browser.mjs";
import { inPictures, picture, SCHEMES, SIZES } from "./pictures.mjs";
import { BIRTH, ORIGIN, ScriptedMachine } from "./scripted_machine.mjs";
import { Screen, until } from "./screen.mjs";

const LETTERS = [..."XYZABCUV"];
const NUMBERS = [1, 2, 3, 4, 5, 6, 7, 8];
/** Eight coordinate systems of eight axes. */
const LARGE = {
  ...BIRTH,
  coordinate_systems: NUMBERS.map((number) => ({ number, axes: Object.fromEntries(LETTERS.map((letter, at) => [letter, at + 1])), spindle: 9, dialect: "nj", units: "mm" })),
  motors: LETTERS.map((letter, at) => ({ number: at + 1, kind: "ABC".includes(letter) ? "rotary" : "linear", soft_limits: [-500, 500], max_velocity: 500 })),
};

let browser;
let page;
let errors;
let close;
let machine;
let screen;

before(async () => {
  browser = await launch();
});
after(() => browser?.close());

async function open(birth, options) {
  ({ page, errors, close } = await openPage(browser, options));
  screen = new Screen(page);
  machine = new ScriptedMachine();
  machine.programs.set(1, "// One\nM30\n");
  machine.programList = [{ number: 1, title: "ONE", bytes: 24, errors: 0, warnings: 0 }];
  machine.start();
  machine.say("birth", birth);
  for (const { number, axes } of birth.coordinate_systems) {
    const at = Object.fromEntries(Object.keys(axes).map((axis, i) => [axis, 25.4 * (i + 1)]));
    machine.say(`cs/${number}/position`, { machine: at, work: at, distance_to_go: at, actual: at, homed: Object.fromEntries(Object.keys(axes).map((axis) => [axis, true])), following_error: at, feedrate: 508, spindle_rpm: 0 });
    machine.state(number, {});
  }
  await machine.attach(page);
  await page.goto(`${ORIGIN}/`);
  await screen.sees("READY");
}

afterEach(async () => {
  await close();
  assert.deepEqual(errors, [], "the browser's console shows no errors");
  assert.deepEqual(machine.wrong, [], "the scripted machine speaks as a real one does");
});

for (const [width, height] of SIZES) {
  test(`at ${width}x${height} all eight axes of eight coordinate systems are seen`, async () => {
    await open(LARGE, { viewport: { width, height } });
    const inBothSchemes = async (name) => {
      for (const colorScheme of SCHEMES) {
        await page.emulateMedia({ colorScheme });
        await picture(page, `${name}-${width}-${colorScheme}`);
      }
    };
    await page.locator('tr[data-axis="V"] td.work').getByText("203.200").waitFor();
    await until(() => page.locator(".positions tr").evaluateAll((rows) => rows.filter((row) => {
      const [box, card] = [row.getBoundingClientRect(), row.closest(".card").getBoundingClientRect()];
      return box.bottom > card.bottom + 1 || row.scrollWidth > row.clientWidth + 1;
    }).map((row) => row.textContent)), [], "the axes that are cut");
    await until(() => page.locator(".tab").evaluateAll((tabs) => tabs.filter((tab) => {
      const { left, right } = tab.getBoundingClientRect();
      return left < 0 || right > innerWidth;
    }).length), 0, "the tabs out of sight");
    await until(() => page.evaluate(() => document.documentElement.scrollWidth <= innerWidth), true, "no sideways scroll:");
    await inBothSchemes("axes");
    await screen.openByHand();
    const canvas = await page.locator(".path-card").boundingBox();
    assert.ok(canvas && canvas.height >= 200, `By hand leaves the path ${canvas?.height} px`);
    await page.getByRole("button", { name: "Jog V plus: hold" }).scrollIntoViewIfNeeded();
    await inBothSchemes("by-hand");
    await page.keyboard.press("f");
    await page.locator(".far-axes").getByText("203.200").waitFor();
    const size = await page.locator(".far-state").evaluate((one) => parseFloat(getComputedStyle(one).fontSize));
    assert.ok(size >= Math.min(width * 0.088, height * 0.125), `the state is ${size} px high`);
    await until(() => page.evaluate(() => document.documentElement.scrollWidth <= innerWidth), true, "no sideways scroll:");
    for (const label of ["Hold", "Stop", "Abort"]) assert.ok(await screen.command(label).isVisible());
    await inBothSchemes("far");
    await page.keyboard.press("Escape");
    await page.locator(".positions").waitFor();
  });
}

test("inches are shown when the program has them in force, except for jogging, or when the operator wants them", async () => {
  await open(BIRTH);
  const work = page.locator('tr[data-axis="X"] td.work');
  await work.getByText("25.400", { exact: true }).waitFor();
  machine.say("cs/1/modal", { ...machine.topics.get("cs/1/modal"), g: { "01": "G01", "06": "G20" }, f: 508 });
  await work.getByText("1.0000", { exact: true }).waitFor();
  await page.locator(".feed-card").getByText("20.0", { exact: true }).waitFor();
  await page.locator(".feed-card").getByText("in/min", { exact: true }).waitFor();
  await screen.openByHand();
  await page.getByRole("radiogroup", { name: "Velocity, mm/min" }).waitFor();
  await page.getByRole("button", { name: /^Units: in/ }).click();
  await work.getByText("25.400", { exact: true }).waitFor();
  await page.getByRole("button", { name: "Units: mm" }).click();
  await work.getByText("1.0000", { exact: true }).waitFor();
  await page.getByRole("radiogroup", { name: "Velocity, in/min" }).waitFor();
});

for (const [width, height] of inPictures(SIZES)) {
  test(`at ${width}x${height} an axis that is not homed says so, and what to do`, async () => {
    await open(BIRTH, { viewport: { width, height } });
    const said = machine.topics.get("cs/1/position");
    machine.say("cs/1/position", { ...said, homed: { X: true, Y: false, Z: true } });
    const axis = (letter, says) => page.locator(".positions").getByRole("rowheader", { name: says }).and(page.locator(`[data-axis="${letter}"] th`)).waitFor();
    await axis("X", "X is homed");
    await axis("Y", "Y is not homed");
    const isCut = () => page.locator(".positions tr").evaluateAll((rows) => rows.filter((row) => row.scrollWidth > row.clientWidth + 1).map((row) => row.textContent));
    await until(isCut, [], "the axes that are cut");
    await screen.openByHand();
    const note = page.getByRole("status").filter({ hasText: "Y is not homed: its drive does not know its position" });
    await note.scrollIntoViewIfNeeded();
    for (const colorScheme of SCHEMES) {
      await page.emulateMedia({ colorScheme });
      await picture(page, `homed-${width}-${colorScheme}`);
    }
    await note.getByRole("button", { name: "Explain Alarm 208" }).waitFor();
    machine.say("cs/1/position", { ...said, homed: { X: true, Y: true, Z: true } });
    await note.waitFor({ state: "hidden" });
    await axis("Y", "Y is homed");
  });
}

test("a machine that does not tell whether its axes are homed shows no sign", async () => {
  await open(BIRTH);
  await until(() => page.locator(".homed-sign:visible").count(), 3, "the signs");
  machine.say("cs/1/position", { ...machine.topics.get("cs/1/position"), homed: {} });
  await until(() => page.locator(".homed-sign:visible").count(), 0, "the signs");
});

test("an own speed and an own step are taken as they are typed", async () => {
  await open(BIRTH);
  await screen.openByHand();
  await page.getByLabel("Own velocity, mm/min").fill("1234");
  await page.getByLabel("Own step, mm").fill("0.25");
  const sent = page.waitForRequest((request) => request.url().endsWith("/cs/1/jog"));
  await page.getByRole("button", { name: "Jog X plus: one step of 0.25 mm" }).click();
  const { axis, velocity, distance } = (await sent).postDataJSON();
  assert.deepEqual({ axis, velocity, distance }, { axis: "X", velocity: 1234, distance: 0.25 });
});

test("following the running line survives that the screen is turned", async () => {
  await open(BIRTH, { viewport: { width: 1920, height: 1080 } });
  machine.programs.set(9, Array.from({ length: 900 }, (_, i) => `N${i + 1} X1`).join("\n"));
  machine.say("cs/1/program", { number: 9, nest_level: 0, stack: [], line: 895, block: "", interpreted_line: 896 });
  machine.state(1, { execution: "ACTIVE", program: 9, run_id: "r", run_kind: "program" });
  await page.locator('.line[aria-current="step"]').getByText("N895", { exact: true }).waitFor();
  for (const [width, height] of [[820, 1180], [1920, 1080], [390, 844]]) {
    await page.setViewportSize({ width, height });
    await page.waitForTimeout(300);
    assert.equal(await page.getByRole("button", { name: "Follow" }).getAttribute("aria-pressed"), "true", `${width}x${height}`);
  }
});

test("Escape closes a dialog also if what had the focus in it is gone", async () => {
  await open(BIRTH);
  await page.keyboard.press("?");
  const dialog = page.getByRole("dialog");
  await dialog.waitFor();
  await page.evaluate(() => document.activeElement.blur());
  await page.keyboard.press("Escape");
  await dialog.waitFor({ state: "detached" });
});

test("shortcuts are listed under the question mark, and none works while something is typed", async () => {
  await open(BIRTH);
  await page.keyboard.press("?");
  const dialog = page.getByRole("dialog", { name: "Shortcuts" });
  await dialog.getByText("read from three metres, and back").waitFor();
  await page.keyboard.press("Escape");
  await dialog.waitFor({ state: "detached" });
  await page.keyboard.press("s");
  await page.getByRole("tab", { name: "Set up", selected: true }).waitFor();
  await page.keyboard.press("p");
  await page.getByLabel("Search programs").fill("fsb?");
  assert.equal(await page.getByRole("tab", { name: "Programs", selected: true }).count(), 1);
  await page.getByText("No program is called “fsb?”.").waitFor();
});
