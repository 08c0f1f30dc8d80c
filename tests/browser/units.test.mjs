// Numbers keep their meaning: steps, velocities, probe distances and typed values are bound to a unit, and no program changes the unit
// of jogging. On the real runtime: a mill in mm with a rotary axis, and a second coordinate system in inches.

import assert from "node:assert/strict";
import { after, afterEach, before, test } from "node:test";

import { withPage, withRuntime } from "./runtime.mjs";
import { until } from "./screen.mjs";

const MM_PER_INCH = 25.4;
const ROTARY = `
[[motor]]
number = 7
kind = "rotary"
max_velocity = 360.0
max_acceleration = 3600.0
`;
/** A program in inches that waits, with G20 in force; the operator confirms M100. */
const INCHES = "G20 G90 G54\nM100\nM30\n";
const BUTTON = '\n[[hmi.button]]\ntext = "Park"\nmdi = "G53 G00 X7"\n';

let browser;
let runtime;
let page;
let errors;
let screen;

withRuntime((made) => ({ runtime, browser } = made), async (made) => {
  await made.change("axes = { X = 1, Y = 2, Z = 3 }", "axes = { X = 1, Y = 2, Z = 3, A = 7 }");
  await made.change("axes = { X = 4, Z = 5 }", 'axes = { X = 4, Z = 5 }\nunits = "inch"');
  await made.add(ROTARY + BUTTON);
});

withPage(() => ({ runtime, browser }), (opened) => ({ page, errors, screen } = opened));

afterEach(async () => {
  await send("POST", "/cs/1/stop?wait=1", {});
  await send("POST", "/cs/1/reset?wait=1", {});
});

async function send(method, path, body) {
  const headers = { "Content-Type": typeof body === "string" ? "text/plain" : "application/json" };
  const answer = await fetch(`${runtime.url}/api/v1${path}`, { method, headers, body: typeof body === "string" ? body : JSON.stringify(body) });
  assert.ok(answer.ok, `${method} ${path}: ${await answer.text()}`);
}

async function read(path) {
  return (await fetch(`${runtime.url}/api/v1${path}`)).json();
}

const machine = async (axis, cs = 1) => (await read(`/cs/${cs}/position`)).machine[axis];
const near = (expected) => (value) => Math.abs(value - expected) < 1e-6;
const row = (name) => page.getByRole("radiogroup", { name, exact: true });
const pick = (group, name) => row(group).getByRole("radio", { name, exact: true });
const work = (axis) => page.locator(`tr[data-axis="${axis}"] td.work`);
/** Returns the choice in a row: a preset, or an own value. */
const chosen = (group) => row(group).evaluate((one) => one.querySelector('[aria-checked="true"]')?.textContent ?? one.querySelector(".own").value);

/** Runs a program that puts G20 into force, until it waits. */
async function programInInches() {
  await send("PUT", "/programs/20", INCHES);
  await send("POST", "/cs/1/load?wait=1", { program: 20 });
  await send("POST", "/cs/1/start", {});
  await screen.sees("WAIT");
  await page.locator('tr[data-axis="X"] small').getByText("in", { exact: true }).waitFor();
}

/** Presses the button of units until it shows a unit that the operator has chosen. */
async function chooseUnit(name) {
  const units = page.locator(".icon-button.units");
  await until(async () => {
    const says = await units.getAttribute("aria-label");
    if (says === `Units: ${name}`) return true;
    await units.click();
    return false;
  }, true, "the unit");
}

async function setUp(name) {
  await page.getByRole("tab", { name: "Set up" }).click();
  await page.getByRole("radiogroup", { name: "Set up" }).getByRole("radio", { name, exact: true }).click();
}

test("a program in inches leaves steps and velocities of jogging as they are", async () => {
  await screen.openByHand();
  await pick("Step, mm", "0.1").click();
  await programInInches();
  assert.equal(await chosen("Step, mm"), "0.1");
  assert.equal(await chosen("Velocity, mm/min"), "500");
  assert.match(await page.locator(".icon-button.units").getAttribute("aria-label"), /^Units: in, as the program has them; jogging: mm$/);
  await screen.confirmByHand(100);
  await screen.sees("PROGRAM_COMPLETED");
  const begin = await machine("Z");
  await page.getByRole("button", { name: "Jog Z plus: one step of 0.1 mm" }).click();
  await until(() => machine("Z"), near(begin + 0.1), "Z");
  await screen.sees("READY");
  assert.ok(near(begin + 0.1)(await machine("Z")));
});

test("MDI in inches leaves the unit of jogging as it is", async () => {
  await screen.openByHand();
  await pick("Step, mm", "1").click();
  await send("POST", "/cs/1/mdi?wait=1", { text: "G20" });
  await page.locator(".mdi").getByText("MDI, in", { exact: true }).waitFor();
  const begin = await machine("Z");
  await page.getByRole("button", { name: "Jog Z minus: one step of 1 mm" }).click();
  await until(() => machine("Z"), near(begin - 1), "Z");
  await screen.sees("READY");
});

test("a unit that the operator chooses keeps the chosen step and velocity", async () => {
  await screen.openByHand();
  await pick("Step, mm", "10").click();
  await pick("Velocity, mm/min", "2000").click();
  await chooseUnit("in");
  assert.equal(await chosen("Step, in"), "0.393701");
  assert.ok(Math.abs(Number(await chosen("Velocity, in/min")) * MM_PER_INCH - 2000) < 1e-3);
  const begin = await machine("Y");
  await page.getByRole("button", { name: "Jog Y plus: one step of 0.393701 in" }).click();
  await until(() => machine("Y"), near(begin + 10), "Y");
  await screen.sees("READY");
  await chooseUnit("mm");
  assert.equal(await chosen("Step, mm"), "10");
  assert.equal(await chosen("Velocity, mm/min"), "2000");
});

test("presets in inches are presets of inches, and a typed step keeps its length", async () => {
  await screen.openByHand();
  await chooseUnit("in");
  assert.equal(await chosen("Velocity, in/min"), "20");
  assert.deepEqual(await row("Step, in").getByRole("radio").allTextContents(), ["Continuous", "0.001", "0.01", "0.1", "0.25"]);
  await pick("Step, in", "0.25").click();
  const begin = await machine("Y");
  await page.getByRole("button", { name: "Jog Y minus: one step of 0.25 in" }).click();
  await until(() => machine("Y"), near(begin - 0.25 * MM_PER_INCH), "Y");
  await screen.sees("READY");
  await page.getByLabel("Own step, in").fill("0.2");
  await chooseUnit("mm");
  assert.equal(await chosen("Step, mm"), "5.08");
  await page.getByLabel("Own step, mm").fill("nothing");
  await chooseUnit("in");
  assert.equal(await chosen("Step, in"), "0.2", "what was typed wrongly is discarded, and what was chosen before stays");
});

test("a rotary axis is jogged in degrees, whatever the unit of lengths is", async () => {
  await screen.openByHand();
  await chooseUnit("in");
  await pick("Step, deg", "10°").click();
  const request = page.waitForRequest((one) => one.url().endsWith("/cs/1/jog"));
  const begin = await machine("A");
  await page.getByRole("button", { name: "Jog A plus: one step of 10 deg" }).click();
  const { velocity, distance } = (await request).postDataJSON();
  assert.deepEqual({ velocity, distance }, { velocity: 500, distance: 10 });
  await until(() => machine("A"), near(begin + 10), "A");
  await screen.sees("READY");
  assert.equal(await chosen("Step, in"), "Continuous", "the step of linear axes is another one");
});

test("a coordinate system whose configuration is in inches is jogged in inches", async () => {
  await screen.openByHand();
  await pick("Step, mm", "1").click();
  await screen.tab(2).click();
  await row("Step, in").waitFor();
  assert.equal(await chosen("Step, in"), "0.03937", "1 mm stays 1 mm");
  await row("Step, deg").waitFor({ state: "hidden" });
  const begin = await machine("X", 2);
  await pick("Step, in", "0.1").click();
  await page.getByRole("button", { name: "Jog X plus: one step of 0.1 in" }).click();
  await until(() => machine("X", 2), near(begin + 2.54), "X");
  await until(async () => (await read("/cs/2/state")).execution, "READY");
  await screen.tab(1).click();
  assert.equal(await chosen("Step, mm"), "2.54");
});

test("a step that was clicked before a change of the unit keeps its length", async () => {
  await screen.openByHand();
  await pick("Step, mm", "10").click();
  await pick("Velocity, mm/min", "2000").click();
  const begin = await machine("X");
  const sent = [];
  page.on("request", (one) => one.url().endsWith("/cs/1/jog") && sent.push(one.postDataJSON()));
  // two clicks and the change of the unit in one task: the second step is pending when the unit changes
  await page.evaluate(() => {
    const button = document.querySelector('[data-jog="X+"]');
    for (let click = 0; click < 2; click += 1) button?.dispatchEvent(new MouseEvent("click", { detail: 0, bubbles: true }));
    for (let press = 0; press < 2; press += 1) document.querySelector(".icon-button.units").click();
  });
  await row("Step, in").waitFor();
  await until(() => machine("X"), near(begin + 20), "X");
  await screen.sees("READY");
  assert.deepEqual(sent.map(({ velocity, distance }) => ({ velocity, distance })), Array(2).fill({ velocity: 2000, distance: 10 }));
  assert.equal(await screen.notices(), "");
});

test("an offset that is typed when the unit changes is discarded, and reported", async () => {
  await setUp("Offsets");
  const field = page.getByLabel("Offset X", { exact: true });
  const before = (await read("/cs/1/work_offsets")).work_offsets.G54.X;
  await field.fill("7");
  await programInInches();
  await page.getByText("7 mm was not stored, because the unit of Offset X is now in. Type it again.").waitFor();
  assert.equal(Number(await field.inputValue()), Math.round((before / MM_PER_INCH) * 1e4) / 1e4);
  await field.press("Enter");
  assert.equal((await read("/cs/1/work_offsets")).work_offsets.G54.X, before, "nothing is stored");
  await field.fill("2");
  await field.press("Enter");
  await until(async () => (await read("/cs/1/work_offsets")).work_offsets.G54.X, near(2 * MM_PER_INCH), "G54 X");
  await page.getByRole("button", { name: "Undo" }).click();
  await until(async () => (await read("/cs/1/work_offsets")).work_offsets.G54.X, near(before), "G54 X");
});

test("offsets of a rotary axis stay in degrees", async () => {
  await chooseUnit("in");
  await setUp("Offsets");
  const field = page.getByLabel("Offset A", { exact: true });
  await page.locator('.offset-row[data-axis="A"]').getByText("deg", { exact: true }).waitFor();
  await field.fill("30");
  await field.press("Enter");
  await until(async () => (await read("/cs/1/work_offsets")).work_offsets.G54.A, 30, "G54 A");
  await page.getByRole("button", { name: "Undo" }).click();
  await until(async () => (await read("/cs/1/work_offsets")).work_offsets.G54.A, 0, "G54 A");
});

test("a tool's length that is typed when the unit changes is discarded, and its value is converted", async () => {
  await send("PUT", "/tools", { tools: [{ id: 3, length: 50.8, radius: 2 }] });
  await setUp("Tools");
  const field = page.getByLabel("Length of T3");
  await until(() => field.inputValue(), "50.800", "the length");
  await field.fill("60");
  await programInInches();
  await page.getByText("60 mm was not stored, because the unit of Length of T3 is now in. Type it again.").waitFor();
  assert.equal(await field.inputValue(), "2.0000");
  await field.fill("3");
  await field.press("Enter");
  await until(async () => (await read("/tools")).tools.find(({ id }) => id === 3)?.length, near(3 * MM_PER_INCH), "the length");
});

test("a typed length stays when another client changes the tool table", async () => {
  await send("PUT", "/tools", { tools: [{ id: 3, length: 50.8, radius: 2 }] });
  await setUp("Tools");
  const field = page.getByLabel("Length of T3");
  await until(() => field.inputValue(), "50.800", "the length");
  await field.fill("60");
  await send("PUT", "/tools", { tools: [{ id: 3, length: 50.8, radius: 4 }, { id: 9, length: 1, radius: 1 }] });
  await until(() => page.getByLabel("Radius of T3").inputValue(), "4.000", "the radius");
  await page.getByLabel("Length of T9").waitFor();
  assert.equal(await field.inputValue(), "60");
  await page.keyboard.press("Enter");
  await until(async () => (await read("/tools")).tools.find(({ id }) => id === 3)?.length, 60, "the length");
  assert.equal((await read("/tools")).tools.find(({ id }) => id === 3)?.radius, 4);
});

test("probe distances keep their length when a program changes the unit", async () => {
  await setUp("Probe");
  await page.getByLabel("Longest distance, mm").fill("25.4");
  await page.getByLabel("Feed, mm/min").fill("254");
  await programInInches();
  assert.equal(await page.getByLabel("Longest distance, in", { exact: true }).inputValue(), "1.0000");
  assert.equal(await page.getByLabel("Feed, in/min").inputValue(), "10.0000");
  await page.reload();
  await page.getByLabel("Longest distance, in", { exact: true }).or(page.getByRole("tab", { name: "Set up" })).first().waitFor();
  const kept = await page.evaluate(() => JSON.parse(localStorage.getItem("tandem-probe")));
  assert.deepEqual([kept.distance, kept.feed], [25.4, 254], "what the browser remembers is in mm and mm/min");
});

test("an MDI line keeps the unit in which it was written, also from the history", async () => {
  await screen.openByHand();
  const mdi = page.getByLabel("NC text to run at once (MDI)");
  await page.locator(".mdi").getByText("MDI, mm", { exact: true }).waitFor();
  await mdi.fill("G53 G00 X5");
  await mdi.press("Enter");
  await until(() => machine("X"), near(5), "X");
  await screen.sees("READY");
  await mdi.fill("G53 G00 X6");
  await send("POST", "/cs/1/mdi?wait=1", { text: "G20" });
  await until(() => mdi.inputValue(), "G21 G53 G00 X6", "the line");
  await page.getByText("The unit of MDI is now in. The line in the field begins with G21 and keeps its unit.").waitFor();
  await mdi.press("Enter");
  await until(() => machine("X"), near(6), "X");
  await screen.sees("READY");
  await send("POST", "/cs/1/mdi?wait=1", { text: "G20" });
  await page.locator(".mdi").getByText("MDI, in", { exact: true }).waitFor();
  await mdi.press("ArrowUp");
  await until(() => mdi.inputValue(), "G21 G53 G00 X6", "the line before");
  await mdi.press("ArrowUp");
  await until(() => mdi.inputValue(), "G21 G53 G00 X5", "the first line, which was written in mm");
  await mdi.fill("G53 G00 X1");
  await mdi.press("Enter");
  await until(() => machine("X"), near(MM_PER_INCH), "X of a line that was written in inches");
  await screen.sees("READY");
});

test("an MDI line is not run in a state that the screen has not shown", async () => {
  await screen.openByHand();
  const mdi = page.getByLabel("NC text to run at once (MDI)");
  await mdi.fill("G53 G00 X9");
  const begin = await machine("X");
  // the screen is busy while another client changes the unit
  const url = `${runtime.url}/api/v1/cs/1/mdi?wait=1`;
  await page.evaluate(async (to) => {
    const answer = new XMLHttpRequest();
    answer.open("POST", to, false);
    answer.setRequestHeader("Content-Type", "application/json");
    answer.send(JSON.stringify({ text: "G20" }));
    document.querySelector(".mdi").requestSubmit();
  }, url);
  await page.getByText("The state has changed in the meantime, so nothing was done.").waitFor();
  assert.equal(await machine("X"), begin);
  errors.splice(0, errors.length, ...errors.filter((text) => !/status of 412/.test(text)));
});

test("a button of the machine builder means the same after MDI in inches and distances", async () => {
  await send("POST", "/cs/1/mdi?wait=1", { text: "G91 G20" });
  await page.getByRole("tab", { name: "Machine" }).click();
  await page.getByRole("button", { name: "Park" }).click();
  await until(() => machine("X"), near(7), "X");
  await screen.sees("READY");
  assert.ok(near(7)(await machine("X")));
  const { mdi } = await read("/cs/1/modal");
  assert.deepEqual(mdi.filter((code) => ["G91", "G20"].includes(code)), ["G91", "G20"], "the operator's codes are in force again");
});

test("positions of a start from a line name their units", async () => {
  await send("PUT", "/programs/21", "G90 G54\nG00 X25.4\nG01 A30 F500\nM30\n");
  await page.reload();
  await chooseUnit("in");
  await screen.load("O0021");
  await screen.sees("READY");
  await page.locator(".line-number").filter({ hasText: /^4$/ }).click();
  await page.getByRole("button", { name: "Start at line 4…" }).click();
  const dialog = page.getByRole("dialog");
  await dialog.getByRole("row", { name: /^X 1\.0000 .* in$/ }).waitFor();
  await dialog.getByRole("row", { name: /^A 30\.000 .* deg$/ }).waitFor();
  await dialog.getByText(/19\.68\d* in\/min/).waitFor();
  await dialog.getByRole("button", { name: "Leave it" }).click();
});
