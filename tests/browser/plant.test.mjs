// Inputs and outputs of the plant: shown with their owners, forced after a question, and named while they are
// forced.

import assert from "node:assert/strict";
import { after, afterEach, before, test } from "node:test";

import { launch, openPage } from "./browser.mjs";
import { picture, SCHEMES, SIZES } from "./pictures.mjs";
import { BIRTH, ORIGIN, ScriptedMachine } from "./scripted_machine.mjs";
import { disabled, Screen, until } from "./screen.mjs";

const PLANT = {
  in: { door_closed: { kind: "bool", on_loss: false, text: "Door of the cell" }, coolant_level: { kind: "number", on_loss: 0, unit: "l", min: 0, max: 60 } },
  out: { coolant_valve: { kind: "bool", on_loss: false } },
};
const NOBODYS = { owner: null, lost: false, forced: null };

let browser;
let page;
let errors;
let close;
let machine;

before(async () => {
  browser = await launch();
});
after(() => browser?.close());

async function open(options, io = PLANT, role = "admin") {
  ({ page, errors, close } = await openPage(browser, options));
  machine = new ScriptedMachine();
  machine.answers.set("GET /login", { status: 200, body: { user: "anna", role, is_login: true } });
  for (const path of ["in/door_closed", "in/coolant_level"]) machine.answers.set(`PUT /io/${path}/force`, { status: 204 });
  machine.programs.set(1, "M30\n");
  machine.start();
  machine.say("birth", { ...BIRTH, io });
  machine.say("io/in/door_closed", { value: true, written: true, owner: "gateway", lost: false, forced: null });
  machine.say("io/in/coolant_level", { value: 42.5, written: 42.5, ...NOBODYS });
  machine.say("io/out/coolant_valve", { value: false, written: false, owner: "cell", lost: true, forced: null });
  await machine.attach(page);
  await page.goto(`${ORIGIN}/`);
  await new Screen(page).sees("READY");
}

afterEach(async () => {
  await close();
  assert.deepEqual(errors, [], "the browser's console shows no errors");
  assert.deepEqual(machine.wrong, [], "the scripted machine speaks as a real one does");
});

const tab = () => page.getByRole("tab", { name: "Plant" });

/** Opens the panel. While the page loads, tabs appear, so that a click may meet another one. */
const show = () => until(async () => {
  await tab().click();
  return tab().getAttribute("aria-selected");
}, "true");
const point = (topic) => page.locator(`[data-io="${topic}"]`);
const force = (name) => page.getByRole("button", { name: `Force ${name}`, exact: true });
const note = () => page.locator(".forced-note");

test("the panel lists inputs and outputs with values, units and owners", async () => {
  await open();
  await show();
  await until(() => point("io/in/door_closed").innerText(), /Door of the cell\s+on\s+handler gateway/);
  await until(() => point("io/in/coolant_level").innerText(), /coolant_level\s+42\.5 l\s+no owner/);
  await until(() => point("io/out/coolant_valve").innerText(), /off\s+handler cell, which is lost/);
  machine.say("io/in/coolant_level", { value: 41, written: 41, ...NOBODYS });
  await until(() => point("io/in/coolant_level").innerText(), /41 l/);
});

test("a machine without inputs and outputs has no such panel", async () => {
  await open({}, { in: {}, out: {} });
  await until(() => tab().count(), 0);
});

test("one is forced and released after a question, and is named on the screen meanwhile", async () => {
  await open();
  await show();
  await force("Door of the cell").click();
  await page.getByRole("button", { name: "Keep" }).click();
  assert.deepEqual(machine.requests, [], "nothing has been asked yet");
  await force("Door of the cell").click();
  await page.getByRole("button", { name: "Force off", exact: true }).click();
  const path = "/io/in/door_closed/force";
  await until(() => machine.requests, [{ method: "PUT", path, body: { value: false, by: "hmi" } }]);
  machine.say("io/in/door_closed", { value: false, written: true, owner: "gateway", lost: false, forced: { value: false, by: "anna" } });
  await until(() => point("io/in/door_closed").innerText(), /forced by anna; written: on/);
  await page.getByRole("tab", { name: "Programs" }).click();
  await until(() => note().innerText(), /Forced: Door of the cell off\./);
  await page.getByRole("button", { name: "Show", exact: true }).click();
  await page.getByRole("button", { name: "Release Door of the cell", exact: true }).click();
  await page.getByRole("button", { name: "Release", exact: true }).last().click();
  await until(() => machine.requests.length, 2);
  assert.deepEqual(machine.requests[1].body, { value: null, by: "hmi" });
  machine.say("io/in/door_closed", { value: true, written: true, owner: "gateway", lost: false, forced: null });
  await note().waitFor({ state: "hidden" });
});

test("a number is forced within its range", async () => {
  await open();
  await show();
  await force("coolant_level").click();
  const field = page.getByLabel("Value", { exact: true });
  await field.fill("61");
  await page.getByRole("button", { name: "Force", exact: true }).last().click();
  assert.deepEqual(machine.requests, [], "the field says what is wrong");
  await field.fill("12.5");
  await page.getByRole("button", { name: "Force", exact: true }).last().click();
  await until(() => machine.requests.map(({ body }) => body.value), [12.5]);
});

test("a number that is typed is not forced if the unit of its input has changed meanwhile", async () => {
  await open();
  await show();
  await force("coolant_level").click();
  const dialog = page.getByRole("dialog");
  await dialog.getByLabel("Value").fill("20");
  const { coolant_level: level } = PLANT.in;
  machine.say("birth", { ...BIRTH, io: { ...PLANT, in: { ...PLANT.in, coolant_level: { ...level, unit: "gal" } } } });
  await until(() => point("io/in/coolant_level").innerText(), /42\.5 gal/);
  await dialog.getByRole("button", { name: "Force" }).click();
  await page.getByText("20 l was not stored, because the unit of coolant_level is now gal. Type it again.").waitFor();
  assert.deepEqual(machine.requests, []);
});

test("who may only look forces nothing", async () => {
  await open({}, PLANT, "view");
  await show();
  await disabled(force("Door of the cell"));
});

test("on a phone as on a panel nothing of it is cut off", async () => {
  await open();
  machine.say("io/out/coolant_valve", { value: true, written: false, owner: "cell", lost: true, forced: { value: true, by: "anna" } });
  await show();
  await until(() => note().innerText(), /coolant_valve on/);
  for (const [width, height] of SIZES) {
    await page.setViewportSize({ width, height });
    const wide = () => page.evaluate(() => [...document.querySelectorAll(".plant, .plant *, .forced-note, .forced-note *")].filter((one) => one.getBoundingClientRect().right > innerWidth + 0.5).map((one) => one.className));
    await until(wide, [], `what is cut at ${width}`);
    assert.equal(await page.evaluate(() => document.documentElement.scrollWidth <= innerWidth), true);
    for (const colorScheme of SCHEMES) {
      await page.emulateMedia({ colorScheme });
      await picture(page, `plant-${width}-${colorScheme}`);
    }
  }
});
