// Touching with a probe on the real runtime: cycles are previewed before they run, and their result becomes a zero
// point or a tool length.

import assert from "node:assert/strict";
import { after, afterEach, before, beforeEach, test } from "node:test";

import { cycleOf, foundBy } from "../../web/set_up/cycles.js";
import { launch, openPage } from "./browser.mjs";
import { picture, pictures, SCHEMES, SIZES } from "./pictures.mjs";
import { Runtime } from "./runtime.mjs";
import { Screen, disabled, enabled, until } from "./screen.mjs";

const BORE = { x: 41.25, y: -17.5, diameter: 30 };
const BOSS = { x: -52.125, y: 33.75, diameter: 24 };
const BALL = 4;
/** Position at which the ball touches the top of the part, and a tool without length touches the setter. */
const TOP = -80.5;
const SETTER = -200;

const round = (kind, { x, y, diameter }, below) => `
[[simulated_round]]
coordinate_system = 1
kind = "${kind}"
x = ${x}
y = ${y}
diameter = ${diameter}
ball = ${BALL}
below = ${below}
`;
const skip = (motor, side, at) => `
[[simulated_skip]]
motor = ${motor}
${side} = ${at}
`;

let browser;
let page;
let errors;
let close;
let screen;
/** A machine with a bore and one with a boss, and the machine on the screen. */
const machines = {};
let runtime;

before(async () => {
  browser = await launch();
  for (const [name, lines] of [["bore", round("bore", BORE, -10) + skip(3, "below", TOP)], ["boss", round("boss", BOSS, -15) + skip(1, "above", 200) + skip(2, "above", 150)]]) {
    machines[name] = await Runtime.create();
    await machines[name].add(lines);
    await machines[name].start();
  }
});

after(async () => {
  await browser?.close();
  for (const machine of Object.values(machines)) await machine.remove();
});

beforeEach(async () => {
  ({ page, errors, close } = await openPage(browser));
  screen = new Screen(page);
});

afterEach(async () => {
  await close();
  // the browser reports a failed cycle that missed its touch
  const told = errors.filter((text) => !/status of 409/.test(text));
  assert.deepEqual(told, [], "the browser's console shows no errors");
});

async function open(name, kind) {
  runtime = machines[name];
  await page.goto(runtime.url);
  await page.getByText("Connected", { exact: true }).waitFor();
  await page.getByRole("tab", { name: "Set up" }).click();
  await page.getByRole("radiogroup", { name: "Set up" }).getByRole("radio", { name: "Probe", exact: true }).click();
  await page.getByRole("radiogroup", { name: "Cycle" }).getByRole("radio", { name: kind, exact: true }).click();
}

async function read(path) {
  return (await fetch(`${runtime.url}/api/v1${path}`)).json();
}

const machineAt = async (axis) => (await read("/cs/1/position")).machine[axis];
const offset = async (name, axis) => (await read("/cs/1/work_offsets")).work_offsets[name][axis];
const button = (name) => page.getByRole("button", { name, exact: true });
const tool = async (id) => (await read("/tools")).tools.find((one) => one.id === id);

/** Moves by hand, and waits for the end of the motion. */
async function moveTo(places) {
  for (const text of places) {
    const answer = await fetch(`${runtime.url}/api/v1/cs/1/mdi?wait=1`, { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify({ text: `G53 G00 ${text}` }) });
    assert.equal(answer.status, 200, await answer.text());
    await until(async () => (await read("/cs/1/state")).run_kind, null, "what runs");
  }
  // a preview is valid for the position that the page knows
  const { machine } = await read("/cs/1/position");
  for (const [axis, at] of Object.entries(machine)) await until(async () => Number(await page.locator(`tr[data-axis="${axis}"] td`).nth(1).textContent()), Number(at.toFixed(3)), `the machine position of ${axis}`);
}

async function fill(values) {
  for (const [label, value] of Object.entries(values)) await page.getByLabel(label).fill(String(value));
}

/** Previews the cycle, and runs it. */
async function touch() {
  await button("Preview").click();
  await enabled(button("Run the cycle"));
  await button("Run the cycle").click();
}

/** Returns a result shown on the screen, by its name. */
async function found(name) {
  const value = page.locator(".probe-found div", { hasText: name }).locator("dd");
  await value.waitFor().catch(async () => assert.fail(`${name} is not found; ${await page.locator(".probe-said").textContent()}; notices: ${await screen.notices()}`));
  return Number.parseFloat(await value.textContent());
}

const near = (value, expected, what) => assert.ok(Math.abs(value - expected) < 1e-3, `${what} is ${value}, not ${expected}`);

test("a bore is measured from a place beside its centre, which becomes zero, and is taken back", async () => {
  await open("bore", "Bore");
  await moveTo(["X43.5 Y-15", "Z-20"]);
  await fill({ "Longest distance, mm": 25, "Diameter of the ball, mm": BALL, "Feed, mm/min": 6000 });
  await touch();
  near(await found("Diameter"), BORE.diameter, "the diameter");
  near(await found("X, machine"), BORE.x, "X");
  near(await found("Y, machine"), BORE.y, "Y");
  near(await machineAt("X"), BORE.x, "X of the tool");
  near(await machineAt("Y"), BORE.y, "Y of the tool");
  const before = await offset("G55", "X");
  await page.getByRole("combobox", { name: "Work offset" }).selectOption("G55");
  await button("Set zero of X Y").click();
  await until(async () => Math.abs((await offset("G55", "X")) - BORE.x) < 1e-3 && Math.abs((await offset("G55", "Y")) - BORE.y) < 1e-3, true, "zero is in the centre");
  await page.getByRole("button", { name: "Undo" }).click();
  await until(() => offset("G55", "X"), before, "G55 X");
});

test("a boss is measured on its four sides from above", async () => {
  await open("boss", "Boss");
  await moveTo(["Z-10", "X-51 Y35"]);
  await fill({ "Size of the boss, about, mm": 25, "Clearance, mm": 6, "Depth next to the boss, mm": 10, "Longest distance, mm": 8, "Diameter of the ball, mm": BALL, "Feed, mm/min": 6000 });
  await touch();
  near(await found("Diameter"), BOSS.diameter, "the diameter");
  near(await found("X, machine"), BOSS.x, "X");
  near(await found("Y, machine"), BOSS.y, "Y");
  near(await machineAt("Z"), -10, "Z of the tool, above the boss");
});

test("a corner is found by two touches in one step, and the tool is where it began", async () => {
  await open("boss", "Corner");
  await moveTo(["Z0", "X190 Y140"]);
  await page.getByRole("radio", { name: "X+ Y+" }).click();
  await fill({ "Longest distance, mm": 30, "Clearance, mm": 5, "Diameter of the ball, mm": BALL, "Feed, mm/min": 6000 });
  await touch();
  near(await found("X, machine"), 200 + BALL / 2, "X");
  near(await found("Y, machine"), 150 + BALL / 2, "Y");
  near(await machineAt("X"), 190, "X of the tool");
  near(await machineAt("Y"), 140, "Y of the tool");
});

test("a probe that does not touch says so, goes back, and nothing is written", async () => {
  await open("bore", "Top");
  await moveTo(["X0 Y0", "Z-60"]);
  const before = await read("/cs/1/work_offsets");
  const { g, f } = await read("/cs/1/modal");
  await fill({ "Longest distance, mm": 5, "Feed, mm/min": 6000 });
  await touch();
  await page.locator(".probe-said").getByText("The probe did not touch in its motion Z−. Nothing was written.").waitFor();
  assert.equal(await page.locator(".probe-found").count(), 0);
  near(await machineAt("Z"), -60, "Z");
  assert.deepEqual((await read("/cs/1/work_offsets")).work_offsets, before.work_offsets);
  await fill({ "Longest distance, mm": 30 });
  await touch();
  near(await found("Z, machine"), TOP, "Z");
  const after = await read("/cs/1/modal");
  assert.deepEqual([after.g, after.f], [g, f], "both cycles leave the operator's modal state as it was");
});

test("a probe cycle finds the same place after MDI in inches and distances, and writes it in mm", async () => {
  await open("bore", "Top");
  await moveTo(["X0 Y0", "Z-60"]);
  await fill({ "Longest distance, mm": 30, "Feed, mm/min": 6000 });
  const mdi = async (text) => {
    const answer = await fetch(`${runtime.url}/api/v1/cs/1/mdi?wait=1`, { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify({ text }) });
    assert.equal(answer.status, 200, await answer.text());
  };
  await mdi("G91 G20");
  await until(() => page.getByLabel("Longest distance, in", { exact: true }).inputValue(), "1.1811", "the longest way");
  await touch();
  assert.equal(await found("Z, machine"), Math.round((TOP / 25.4) * 1e4) / 1e4);
  near(await machineAt("Z"), -60, "Z, where the touch began,");
  await button("Set zero of Z").click();
  await until(() => offset("G54", "Z"), (value) => Math.abs(value - TOP) < 1e-6, "G54 Z");
  await page.getByRole("button", { name: "Undo" }).click();
  await until(() => offset("G54", "Z"), (value) => Math.abs(value - TOP) > 1, "G54 Z");
  const { mdi: inForce } = await read("/cs/1/modal");
  assert.deepEqual(inForce.filter((code) => ["G91", "G20"].includes(code)), ["G91", "G20"], "the operator's codes are in force again");
  await mdi("G90 G21");
});

test("of a bore that a way misses, no further way is gone", async () => {
  await open("bore", "Bore");
  await moveTo(["Z-20", "X41 Y-17"]);
  await fill({ "Longest distance, mm": 10, "Diameter of the ball, mm": BALL });
  await touch();
  await page.locator(".probe-said").getByText("The probe did not touch in its motion X+. Nothing was written.").waitFor();
  near(await machineAt("X"), 41, "X");
});

test("a tool is measured on a setter, by hand and by touching; its length is written and taken back", async () => {
  await open("bore", "Tool length");
  await moveTo(["X0 Y0", "Z-50"]);
  await fill({ "Position of the setter, mm": SETTER, "Longest distance, mm": 60 });
  await until(() => page.locator('tr[data-axis="Z"] td').nth(1).textContent(), "-50.000", "the machine position");
  await button("It touches now").click();
  near(await found("Length of the tool"), 150, "the length by hand");
  await touch();
  await until(async () => Math.abs((await found("Length of the tool")) - (TOP - SETTER)) < 1e-3, true, "the length that was touched");
  await page.getByLabel("Number of the tool").fill("9");
  await button("Write into the tool table").click();
  await until(async () => (await tool(9))?.length, TOP - SETTER, "the length of T9");
  await page.getByRole("button", { name: "Undo" }).click();
  await until(() => tool(9), undefined, "T9");
});

test("a corner is touched by hand, one side after the other, and zero is where the tool's sides met it", async () => {
  await open("bore", "Corner");
  await fill({ "Diameter of the ball, mm": 10 });
  const next = (text) => page.getByText(text, { exact: true }).waitFor();
  const shows = (axis, text) => until(() => page.locator(`tr[data-axis="${axis}"] td`).nth(1).textContent(), text, "the machine position");
  await moveTo(["Z-20", "X12 Y3"]);
  await shows("X", "12.000");
  await next("By hand, touch 1 of 2: jog until the tool touches at X+.");
  await button("It touches now").click();
  await moveTo(["X30 Y-8"]);
  await shows("Y", "-8.000");
  await next("By hand, touch 2 of 2: jog until the tool touches at Y+.");
  assert.equal(await page.locator(".probe-found").count(), 0, "one side is no corner");
  await button("It touches now").click();
  near(await found("X, machine"), 17, "X, by the radius beside the tool");
  near(await found("Y, machine"), -3, "Y");
  await button("Set zero of X Y").click();
  await until(async () => (await read("/cs/1/work_offsets")).work_offsets.G54.X, 17, "G54 X");
  await page.getByRole("button", { name: "Undo" }).click();
  await until(async () => (await read("/cs/1/work_offsets")).work_offsets.G54.X === 17, false, "what it was before");
});

test("nothing runs that was not looked at, or was looked at from elsewhere, or that locks forbid", async () => {
  await open("bore", "Edge");
  await moveTo(["Z0", "X0 Y0"]);
  const run = button("Run the cycle");
  await disabled(run);
  assert.match(await run.getAttribute("aria-description"), /Look at the preview first/);
  await button("Preview").click();
  await enabled(run);
  await page.locator(".path-note").getByText("Preview of the probe cycle").waitFor();
  assert.match(await page.getByLabel("NC text of the cycle").textContent(), /^G21 G17 G40 G49\nG50 G50.1 G69 G91\nG31 X/);
  near(await machineAt("X"), 0, "X");
  await fetch(`${runtime.url}/api/v1/cs/1/inputs/start_lock`, { method: "PUT", headers: { "Content-Type": "application/json" }, body: '{"value":true,"text":"the door is open"}' });
  await disabled(run);
  assert.match(await run.getAttribute("aria-description"), /the door is open/);
  await fetch(`${runtime.url}/api/v1/cs/1/inputs/start_lock`, { method: "PUT", headers: { "Content-Type": "application/json" }, body: '{"value":false,"text":""}' });
  await enabled(run);
  await moveTo(["X1"]);
  await disabled(run);
  await page.locator(".path-note", { hasText: "Preview" }).waitFor({ state: "hidden" });
});

test("a way beyond a soft limit is seen in the preview, and does not run", async () => {
  await open("bore", "Edge");
  await moveTo(["Z0", "X490 Y0"]);
  await page.getByRole("radio", { name: "X+", exact: true }).click();
  await fill({ "Longest distance, mm": 20 });
  await button("Preview").click();
  await page.locator(".probe-said").getByText(/500/).waitFor();
  await disabled(button("Run the cycle"));
  await moveTo(["X0"]);
});

test("values are in inches where the screen is", async () => {
  await open("bore", "Edge");
  await fill({ "Longest distance, mm": 25.4 });
  const units = page.getByRole("button", { name: /^Units/ });
  for (let presses = 0; presses < 3 && (await page.getByLabel("Longest distance, in", { exact: true }).count()) === 0; presses += 1) {
    await units.click();
    await page.waitForTimeout(100);
  }
  assert.equal(await page.getByLabel("Longest distance, in", { exact: true }).inputValue(), "1.0000");
});

test("a corner and an edge on any side are found on the side of the ball that touches", () => {
  const asked = { axis: "Y", x: -1, y: 1, distance: 20, feed: 500, ball: 6, clearance: 3, size: 0, depth: 0, tip: 0 };
  const start = { X: 10, Y: 5, Z: -3 };
  const corner = cycleOf("corner", start, asked, { X: 0, Y: 1, Z: 2 });
  assert.deepEqual(foundBy("corner", asked, corner.touches, [-4, 17]).zero, { X: -7, Y: 20 });
  assert.deepEqual(corner.touches.map(({ line }) => corner.text.split("\n")[line - 1]), ["G31 X-20", "G31 Y20"]);
  const edge = cycleOf("edge", start, asked, { X: 0, Y: 1, Z: 2 });
  assert.deepEqual(foundBy("edge", asked, edge.touches, [17]).zero, { Y: 20 });
});

for (const [width, height] of SIZES) {
  for (const colorScheme of SCHEMES) {
    pictures(`a probe cycle at ${width}x${height} in ${colorScheme}`, async () => {
      await close();
      ({ page, errors, close } = await openPage(browser, { viewport: { width, height }, colorScheme }));
      screen = new Screen(page);
      await open("bore", "Bore");
      await moveTo(["Z-20", "X43.5 Y-15"]);
      await fill({ "Longest distance, mm": 25, "Diameter of the ball, mm": BALL, "Feed, mm/min": 6000 });
      await button("Preview").click();
      await enabled(button("Run the cycle"));
      await picture(page, `probe-preview-${width}-${colorScheme}`);
      await button("Run the cycle").click();
      await found("Diameter");
      await button("Set zero of X Y").scrollIntoViewIfNeeded();
      await picture(page, `probe-found-${width}-${colorScheme}`);
    });
  }
}
