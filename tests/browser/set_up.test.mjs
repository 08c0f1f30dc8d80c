// Setting up a part, and the programs of the store, on the real runtime.

import assert from "node:assert/strict";
import { test } from "node:test";

import { withPage, withRuntime } from "./runtime.mjs";
import { disabled, enabled, until } from "./screen.mjs";

let browser;
let runtime;
let page;
let screen;

withRuntime((made) => ({ runtime, browser } = made));

withPage(() => ({ runtime, browser }), (opened) => ({ page, screen } = opened));

async function read(path) {
  return (await fetch(`${runtime.url}/api/v1${path}`)).json();
}

const offset = async (name, axis) => (await read("/cs/1/work_offsets")).work_offsets[name][axis];

/** Waits for a work offset; after a time-out, the messages of the screen may show the reason. */
async function offsetIs(name, axis, value) {
  await until(() => offset(name, axis), value, `${name} ${axis}`).catch(async (error) => {
    assert.fail(`${error.message}; notices: ${await screen.notices()}`);
  });
}

async function section(name) {
  await page.getByRole("tab", { name: "Set up" }).click();
  await page.getByRole("radiogroup", { name: "Set up" }).getByRole("radio", { name, exact: true }).click();
}

async function moveTo(text) {
  const answer = await fetch(`${runtime.url}/api/v1/cs/1/mdi?wait=1`, { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify({ text }) });
  assert.equal(answer.status, 200);
}

test("simulated drives know their positions from the start: each axis is homed", async () => {
  for (const axis of ["X", "Y", "Z"]) await page.locator(".positions").getByRole("rowheader", { name: `${axis} is homed` }).waitFor();
});

test("a work offset is changed, zero is set where the tool stands, and the last change is taken back", async () => {
  await moveTo("G53 G00 X30 Y20");
  await section("Offsets");
  await page.getByRole("radio", { name: "G55" }).click();
  const field = page.getByLabel("Offset X", { exact: true });
  await field.fill("12.5");
  await field.press("Enter");
  await offsetIs("G55", "X", 12.5);
  await page.getByRole("button", { name: "X = 0" }).click();
  await offsetIs("G55", "X", 30);
  const undo = page.getByRole("button", { name: "Undo" });
  await undo.click();
  await offsetIs("G55", "X", 12.5);
  await undo.click();
  await offsetIs("G55", "X", 0);
});

test("a typed offset stays while a silent machine disables its field, and goes with another offset", async () => {
  await section("Offsets");
  await page.getByRole("radio", { name: "G56" }).click();
  const field = page.getByLabel("Offset X", { exact: true });
  await field.fill("12.5");
  runtime.pause();
  await until(() => field.isDisabled(), true, "a silent machine");
  runtime.resume();
  await until(() => field.isEnabled(), true, "a machine that is heard");
  assert.equal(await field.inputValue(), "12.5");
  await page.getByRole("radio", { name: "G57" }).click();
  await until(() => field.inputValue(), "0.000", "the offset of G57");
  assert.equal(await offset("G56", "X"), 0);
});

test("an edge that is touched gets its position, also when it is touched twice", async () => {
  await moveTo("G54 G53 G00 X30");
  await section("Offsets");
  const before = await offset("G54", "X");
  const here = page.getByLabel("X is here");
  await here.fill("-3");
  await here.press("Enter");
  await offsetIs("G54", "X", 33);
  await here.fill("-5");
  await here.press("Enter");
  await offsetIs("G54", "X", 35);
  await page.getByRole("button", { name: "Use G54" }).click();
  await until(() => screen.workPosition("X"), -5, "the work position");
  for (const value of [33, before]) {
    await page.getByRole("button", { name: "Undo" }).click();
    await until(() => offset("G54", "X"), value, "the offset");
  }
});

test("with a tool length in force Z is set at the tip of the tool, and where nobody knows the length it is not set", async () => {
  const put = async (path, body) => assert.ok((await fetch(`${runtime.url}/api/v1${path}`, { method: "PUT", headers: { "Content-Type": "application/json" }, body: JSON.stringify(body) })).ok);
  await put("/tools", { tools: [{ id: 7, length: 50, radius: 3 }] });
  await put("/cs/1/tool", { id: 7 });
  await moveTo("G54 G53 G00 Z-40");
  await section("Offsets");
  await page.getByText(/No tool length is in force: Z refers to the spindle\./).waitFor();
  await moveTo("G43");
  await page.getByText(/G43 is in force: the length of T7, 50\.000 mm, is included, so that Z refers to the tip of the tool\./).waitFor();
  await until(() => page.locator('tr[data-axis="Z"] td').nth(1).textContent(), "-40.000", "the machine position");
  await page.getByRole("button", { name: "Z = 0" }).click();
  await offsetIs("G54", "Z", -90);
  await page.getByRole("button", { name: "Use G54" }).click();
  await until(() => screen.workPosition("Z"), 0, "the work position of the tip");
  await page.getByRole("button", { name: "Undo" }).click();
  await until(async () => (await offset("G54", "Z")) === -90, false, "what it was before");
  await moveTo("G49");
});

test("where positions are turned zero is not set, and a local coordinate system is said", async () => {
  await moveTo("G54 G53 G00 X30 Y20");
  await section("Offsets");
  const zero = page.getByRole("button", { name: "X = 0" });
  const elsewhere = page.getByText(/The positions shown have another zero: G54 was changed since it was called, or a G52 is in force/);
  for (const [code, end] of [["G68 X0 Y0 R30", "G69"], ["G51 X0 Y0 P2", "G50"], ["G51.1 X0", "G50.1"]]) {
    await moveTo(code);
    await disabled(zero);
    await page.getByText(`is in force, which turns, scales or mirrors positions: run ${end}, then set zero.`, { exact: false }).waitFor();
    await moveTo(end);
    await enabled(zero);
  }
  await moveTo("G54");
  await until(() => elsewhere.count(), 0, "nothing is said where positions count from G54");
  await moveTo("G52 X5");
  await elsewhere.waitFor();
  await moveTo("G52");
  await until(() => elsewhere.count(), 0, "nothing is said once it has ended");
});

test("two edges that are touched put zero in the middle", async () => {
  await moveTo("G53 G00 X10");
  await section("Offsets");
  await page.getByRole("radio", { name: "G56" }).click();
  await until(() => page.locator('tr[data-axis="X"] td').nth(1).textContent(), "10.000", "the machine position");
  await page.getByRole("button", { name: "First edge of the middle of X" }).click();
  await moveTo("G53 G00 X30");
  await until(() => page.locator('tr[data-axis="X"] td').nth(1).textContent(), "30.000", "the machine position");
  await page.getByRole("button", { name: "Second edge of the middle of X: zero between both" }).click();
  await offsetIs("G56", "X", 20);
});

test("a tool is added, measured, and taken out", async () => {
  await section("Tools");
  await page.getByLabel("Number of the new tool").fill("7");
  await page.getByRole("button", { name: "Add tool" }).click();
  const radius = page.getByLabel("Radius of T7");
  await radius.fill("2.5");
  await radius.press("Enter");
  await until(async () => (await read("/tools")).tools.find(({ id }) => id === 7)?.radius, 2.5, "the radius");
  await page.getByRole("button", { name: "Remove T7 from the table" }).click();
  await until(async () => (await read("/tools")).tools.some(({ id }) => id === 7), false, "the tool");
  await page.getByRole("button", { name: "Undo" }).click();
  await until(async () => (await read("/tools")).tools.find(({ id }) => id === 7)?.radius, 2.5, "the radius");
});

test("a variable is found and changed", async () => {
  await section("Variables");
  await page.getByLabel("First variable").fill("100");
  await page.getByLabel("First variable").press("Enter");
  const field = page.getByLabel("P101", { exact: true });
  await field.fill("3.25");
  await field.press("Enter");
  await until(async () => (await read("/variables/p?from=101&count=1")).values[0], 3.25, "P101");
  await page.getByRole("switch", { name: "In use" }).click();
  await until(() => page.locator(".variable-row strong").allTextContents(), ["P101"], "the variables in use");
});

test("an M code of the machine's table is put out by its button", async () => {
  await section("M codes");
  await page.getByRole("group", { name: "M codes" }).getByRole("button", { name: /M100/ }).click();
  await screen.sees("WAIT");
  await screen.confirmByHand(100);
  await screen.sees("READY");
});

test("files that are dropped anywhere are stored; programs are found, sorted and deleted", async () => {
  const drop = (files) => page.evaluate((given) => {
    const data = new DataTransfer();
    for (const [name, text] of given) data.items.add(new File([text], name, { type: "text/plain" }));
    for (const type of ["dragover", "drop"]) document.querySelector(".feed-card")?.dispatchEvent(new DragEvent(type, { dataTransfer: data, bubbles: true, cancelable: true }));
  }, files);
  await drop([["O0801.nc", "// Zebra\nM30\n"], ["O0802.nc", "// Ant\nM30\n"]]);
  await page.getByText("O0802.nc is stored as O0802.").waitFor();
  const names = () => page.locator(".stored strong").allTextContents();
  await page.getByLabel("Search programs").fill("o08");
  await until(names, ["O0801", "O0802"], "what is found");
  await page.getByLabel("Order of programs").selectOption("by title");
  await until(names, ["O0802", "O0801"], "the order");
  const [download] = await Promise.all([page.waitForEvent("download"), page.getByRole("button", { name: "Save a copy of O0801" }).click()]);
  assert.equal(download.suggestedFilename(), "O0801.nc");
  await page.getByRole("button", { name: "Delete O0801" }).click();
  await page.getByRole("dialog", { name: "Delete O0801?" }).getByRole("button", { name: "Delete O0801" }).click();
  await until(names, ["O0802"], "what is found");
  await drop([["O0803.nc", "// One file\nM30\n"]]);
  await page.getByRole("dialog", { name: "Program" }).getByText("O0803 is new.").waitFor();
});
