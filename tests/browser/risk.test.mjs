// Controls that move the machine require care according to the risk: confirming by hand, overrides, labels.

import assert from "node:assert/strict";
import { after, afterEach, before, test } from "node:test";

import { launch, openPage } from "./browser.mjs";
import { now, ORIGIN, ScriptedMachine } from "./scripted_machine.mjs";
import { Screen, until } from "./screen.mjs";

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

async function open(options) {
  ({ page, errors, close } = await openPage(browser, options));
  screen = new Screen(page);
  machine = new ScriptedMachine();
  machine.programs.set(1, "// One\nM62 VA5\nM30\n");
  machine.programList = [{ number: 1, title: "ONE", bytes: 24, errors: 0, warnings: 0 }];
  machine.answers.set("PUT /cs/1/overrides", { status: 204 });
  machine.start();
  await machine.attach(page);
  await page.goto(`${ORIGIN}/`);
  await screen.sees("READY");
}

afterEach(async () => {
  await close();
  assert.deepEqual(errors, [], "the browser's console shows no errors");
  assert.deepEqual(machine.wrong, [], "the scripted machine speaks as a real one does");
});

/** The program waits for M62, which its handler calls "turn pallet". */
function waitForM62(change) {
  const output = {
    id: "boot-1-1-12", seq: 12, run_id: "r", m: 62, params: { A: 5 }, timing: "after_motion", program: 1, line: 2, attempt: 1,
    redelivered: false, lost: false, state: "OUTPUT", handler_id: null, since: now(12000), ...change,
  };
  machine.say("cs/1/m_code/pending", { outputs: [output] });
  machine.state(1, { execution: "WAIT", waiting_on: { m: 62, seq: 12, since: output.since }, run_id: "r" });
}

const HALF = { text: "90 of 180 degrees", percent: 50 };
const OUTPUTS = {
  "of a handler": [{ state: "CLAIMED", handler_id: "pallet", progress: HALF }, /M62 turn pallet.*90 of 180 degrees, 50\s%.*pallet is working/],
  "that lost its handler": [{ lost: true, progress: HALF }, /M62 turn pallet.*90 of 180 degrees, 50\s%.*is lost/],
  "that no handler has claimed": [{}, /M62 turn pallet.*No progress.*No handler has claimed/],
};

for (const [which, [change, words]] of Object.entries(OUTPUTS)) {
  test(`confirming an M code ${which} asks, with name, work and progress`, async () => {
    await open();
    const birth = machine.topics.get("birth");
    machine.say("birth", { ...birth, serves: [{ m: 62, cs: [1], handler_id: "pallet", name: "turn pallet" }] });
    // the handler that declared the name may be lost
    if (change.lost) machine.say("birth", birth);
    waitForM62(change);
    await page.getByRole("button", { name: "Confirm M62 by hand" }).click();
    const dialog = page.getByRole("dialog", { name: "Confirm M62 by hand?" });
    await until(async () => (await dialog.locator("p").textContent()) ?? "", words, "the question");
    assert.deepEqual(machine.requests, [], "nothing is sent before the answer");
    await dialog.getByRole("button", { name: "Keep waiting" }).click();
    await dialog.waitFor({ state: "detached" });
    assert.deepEqual(machine.requests, []);
    await page.getByRole("button", { name: "Confirm M62 by hand" }).click();
    await dialog.getByRole("button", { name: "M62 is done" }).click();
    await until(() => machine.requests.map(({ path }) => path), ["/cs/1/m_codes/12/reset"], "what is sent");
  });
}

test("the primary button of a lost M code is Verify, and Confirm is never primary", async () => {
  await open();
  const ground = (name) => page.getByRole("button", { name }).evaluate((one) => getComputedStyle(one).backgroundColor);
  for (const [change] of Object.values(OUTPUTS)) {
    waitForM62(change);
    await page.getByRole("button", { name: "Confirm M62 by hand" }).waitFor();
    const primary = await screen.command("Start").evaluate(() => {
      const sample = document.body.appendChild(document.createElement("i"));
      sample.style.background = "var(--accent)";
      const { backgroundColor } = getComputedStyle(sample);
      sample.remove();
      return backgroundColor;
    });
    assert.notEqual(await ground("Confirm M62 by hand"), primary);
    if (change.lost) assert.equal(await ground(/^Redeliver M62: look/), primary);
  }
});

const slider = () => page.getByRole("slider", { name: "Feed override, percent" });
const shown = async () => Number(await slider().inputValue());
const sent = () => machine.requests.filter(({ path }) => path === "/cs/1/overrides").map(({ body }) => body.feed);

/** Returns the position of a slider's value on the screen, where its thumb is. */
async function placeOf(percent) {
  const { x, y, width, height } = await slider().boundingBox();
  const thumb = await page.evaluate(() => Number.parseFloat(getComputedStyle(document.documentElement).getPropertyValue("--thumb")));
  return { x: x + thumb / 2 + ((width - thumb) * percent) / 200, y: y + height / 2 };
}

async function drag(from, to) {
  const [begin, end] = [await placeOf(from), await placeOf(to)];
  await page.mouse.move(begin.x, begin.y);
  await page.mouse.down();
  await page.mouse.move((begin.x + end.x) / 2, begin.y, { steps: 4 });
  await page.mouse.move(end.x, end.y, { steps: 4 });
  await page.mouse.up();
}

async function overridesOf(feed) {
  machine.say("cs/1/override/state", { feed, rapid: 100, spindle: 100 });
  await until(shown, feed, "the slider");
}

test("a click beside the thumb of an override changes nothing, a drag does", async () => {
  await open();
  await overridesOf(60);
  for (const percent of [0, 100, 195]) {
    const { x, y } = await placeOf(percent);
    await page.mouse.click(x, y);
  }
  assert.equal(await shown(), 60);
  await drag(60, 30);
  await until(shown, 30, "the slider");
  await until(sent, (values) => values.at(-1) === 30, "what is sent");
  assert.ok(sent().every((value) => value <= 60), `${sent()}`);
});

test("one action ends at 100 percent, and the next goes above", async () => {
  await open();
  await overridesOf(60);
  await drag(60, 190);
  await until(shown, 100, "the slider");
  await until(sent, (values) => values.at(-1) === 100, "what is sent");
  await drag(100, 150);
  await until(shown, 150, "the slider");
  await until(sent, (values) => values.at(-1) === 150, "what is sent");
  assert.ok(sent().slice(0, sent().indexOf(100) + 1).every((value) => value <= 100), `${sent()}`);

  await overridesOf(95);
  const more = page.getByRole("button", { name: "Feed override: 10 percent more" });
  await more.click();
  await until(shown, 100, "the slider");
  await more.click();
  await until(shown, 110, "the slider");

  await overridesOf(90);
  await slider().focus();
  await page.keyboard.press("End");
  await until(shown, 100, "the slider");
  await page.keyboard.press("End");
  await until(shown, 200, "the slider");
});

for (const [width, height] of [[820, 1180], [390, 844]]) {
  test(`at ${width} px taps and scrolls across an override change nothing`, async () => {
    await open({ viewport: { width, height }, hasTouch: true, isMobile: true });
    await overridesOf(60);
    await slider().scrollIntoViewIfNeeded();
    const { x, y } = await placeOf(195);
    await page.touchscreen.tap(x, y);
    const input = await page.context().newCDPSession(page);
    for (const percent of [60, 100, 160]) {
      const at = await placeOf(percent);
      for (const yDistance of [-150, 150]) {
        await input.send("Input.synthesizeScrollGesture", { ...at, yDistance, gestureSourceType: "touch", speed: 1200 });
      }
    }
    await page.waitForTimeout(300);
    assert.equal(await shown(), 60);
    assert.deepEqual(sent(), []);
  });
}

/** Labels of the controls that can be pressed, each as often as it is on the screen. */
function labels() {
  return page.locator("button:visible, [role=radio]:visible, a:visible").evaluateAll((all) => all.map((one) => (one.getAttribute("aria-label") ?? one.textContent ?? "").trim()));
}

/** Returns the controls by their labels, as an operator in haste reads them. */
function words() {
  return page.locator("button:visible, [role=radio]:visible, a:visible").evaluateAll((all) => all.map((one) => (one.textContent ?? "").trim()).filter((text) => /\p{L}{2}/u.test(text)));
}

const twice = (all) => [...new Set(all.filter((one, at) => all.indexOf(one) !== at))];

const PANELS = ["Programs", "By hand", "Set up"];
for (const locale of ["en", "de", "ja"]) {
  test(`no two controls on the screen share a label (${locale})`, async () => {
    await open({ locale });
    const states = [{}, { execution: "ACTIVE", run_id: "r" }, { execution: "FEED_HOLD", run_id: "r" }, { execution: "STOPPED", reason: "ALARM" }];
    for (const change of states) {
      machine.state(1, change);
      for (const at of PANELS.keys()) {
        await page.locator(".panel-tab").nth(at).click();
        await page.waitForTimeout(50);
        assert.deepEqual(twice(await labels()), [], "by name");
        assert.deepEqual(twice(await words()), [], "by what is written on them");
      }
    }
  });
}

/** Opens each dialog, next to the controls of the screen. */
const DIALOGS = {
  "an order of parts": async () => {
    await page.locator(".panel-tab").nth(0).click();
    await page.locator('.stored[data-number="1"] .stored-tools button').first().click();
  },
  "a start in spite of an alarm": async () => {
    const at = { program: 1, line: 2 };
    machine.say("cs/1/start_conditions", { obstacles: [{ kind: "m_code", text: "no handler", detail: "", refuses: false, m_codes: [62], at }] });
    await page.locator(".command.start").click();
  },
  "a confirmation by hand": async () => {
    waitForM62({});
    await page.locator(".reset-output").click();
  },
};
for (const locale of ["en", "de", "ja"]) {
  for (const [which, openIt] of Object.entries(DIALOGS)) {
    test(`no two controls share a label while a dialog asks about ${which} (${locale})`, async () => {
      await open({ locale });
      await openIt();
      await page.getByRole("dialog").waitFor();
      assert.deepEqual(twice(await labels()), [], "by name");
      assert.deepEqual(twice(await words()), [], "by what is written on them");
    });
  }
}
