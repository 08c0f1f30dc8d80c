// Large targets for fingers and gloves: targets are at least 60 px wide and high, in every view and at every size.

import assert from "node:assert/strict";
import { after, before, test } from "node:test";

import { launch, openPage } from "./browser.mjs";
import { picture, SCHEMES, SIZES } from "./pictures.mjs";
import { now, ORIGIN, ScriptedMachine } from "./scripted_machine.mjs";
import { Screen, until } from "./screen.mjs";

const TARGET_PX = 60;

let browser;
before(async () => {
  browser = await launch();
});
after(() => browser?.close());

/** Opens each part. */
const PARTS = {
  async programs() {},
  async "by-hand"(page) {
    await page.getByRole("tab", { name: "By hand" }).click();
  },
  async added(page) {
    await page.getByRole("tab", { name: "Machine" }).click();
    await page.getByRole("button", { name: "Oil" }).waitFor();
  },
  async offsets(page) {
    await page.getByRole("tab", { name: "Set up" }).click();
    await page.getByLabel("Offset X", { exact: true }).waitFor();
  },
  async tools(page) {
    await page.getByRole("radio", { name: "Tools" }).click();
  },
  async history(page) {
    await page.getByRole("button", { name: "History" }).click();
    await page.getByRole("dialog").waitFor();
  },
  async journal(page) {
    await page.getByRole("radio", { name: "Journal" }).click();
  },
  async curves(page) {
    await page.getByRole("radio", { name: "Curves" }).click();
  },
  async editor(page) {
    await page.keyboard.press("Escape");
    await page.getByRole("tab", { name: "Programs" }).click();
    await page.getByRole("button", { name: "Edit O0001" }).click();
    await page.getByRole("button", { name: "Find" }).click();
    await page.getByPlaceholder("Replace").waitFor();
  },
  async user(page) {
    await page.keyboard.press("Escape");
    await page.getByRole("button", { name: "Close", exact: true }).click();
    await page.getByRole("button", { name: /^No login/ }).click();
  },
};

/** Returns the visible buttons and fields that are smaller; a checkbox includes its label. */
function small(page) {
  return page.locator("button:visible, input:visible, select:visible, a:visible").evaluateAll((all, least) => all.flatMap((one) => {
    const { width, height } = (one.type === "checkbox" ? one.closest("label") : one).getBoundingClientRect();
    return Math.min(width, height) >= least - 0.5 ? [] : [`${one.getAttribute("aria-label") ?? one.textContent ?? one.name}: ${Math.round(width)} x ${Math.round(height)}`];
  }), TARGET_PX);
}

/** Returns the targets that extend beyond their card, which cuts them off. */
function cut(page) {
  return page.locator(".card button:visible, .card input:visible, .card select:visible").evaluateAll((all) => all.flatMap((one) => {
    const [mine, card] = [one, one.closest(".card")].map((each) => each.getBoundingClientRect());
    return mine.right <= card.right + 0.5 && mine.left >= card.left - 0.5 ? [] : [one.getAttribute("aria-label") ?? one.textContent];
  }));
}

for (const [width, height] of SIZES) {
  test(`at ${width} px every target is ${TARGET_PX} px large where the screen is touched, and nothing is cut off`, async () => {
    const { page, errors, close } = await openPage(browser, { viewport: { width, height }, hasTouch: true, isMobile: true });
    const machine = new ScriptedMachine();
    machine.programs.set(1, "// One\nM100 VA5\nM30\n");
    machine.programList = [{ number: 1, title: "ONE", bytes: 24, errors: 0, warnings: 0 }];
    const added = { jog_step_max: 10, buttons: [{ text: "Oil", m_code: 60 }, { text: "Chips away", input: "dry_run" }], cards: [{ text: "Strokes", m_code: 60 }] };
    machine.answers.set("GET /hmi", { status: 200, body: added });
    machine.answers.set("GET /tools", { status: 200, body: { tools: [{ id: 1, length: 10, radius: 2 }] } });
    const alarm = { id: 1, severity: "warning", number: 401, text: "A warning", cs: 1, program: 1, line: 1, raised_at: now(), cleared_at: null, acknowledged_by: null };
    machine.start();
    machine.say("alarm/active", { alarms: [alarm] });
    await machine.attach(page);
    await page.goto(`${ORIGIN}/`);
    await new Screen(page).sees("READY");
    for (const [name, show] of Object.entries(PARTS)) {
      await show(page);
      await until(() => small(page), [], `what is too small in ${name}`);
      await until(() => cut(page), [], `what is cut off in ${name}`);
      await until(() => page.evaluate(() => document.documentElement.scrollWidth - innerWidth), (over) => over <= 0, `how much ${name} is too wide`);
      for (const colorScheme of SCHEMES) {
        await page.emulateMedia({ colorScheme });
        await picture(page, `touch-${name}-${width}-${colorScheme}`);
      }
    }
    assert.deepEqual(errors, []);
    await close();
  });
}

test("by a mouse targets are as they were, until the operator wants them large, which is remembered", async () => {
  const { page, close } = await openPage(browser);
  const machine = new ScriptedMachine();
  machine.start();
  await machine.attach(page);
  await page.goto(`${ORIGIN}/`);
  const touch = () => page.evaluate(() => document.documentElement.dataset.touch);
  await new Screen(page).sees("READY");
  assert.equal(await touch(), "false");
  await page.getByRole("button", { name: /^No login/ }).click();
  await page.getByRole("button", { name: "Large targets" }).click();
  await page.getByRole("button", { name: "Large targets", pressed: true }).waitFor();
  await page.reload();
  await new Screen(page).sees("READY");
  assert.equal(await touch(), "true");
  await close();
});

test("fingers on the path: one turns it, two move and zoom it, and the page does not scroll", async () => {
  const { page, errors, close } = await openPage(browser, { viewport: { width: 820, height: 1180 }, hasTouch: true, isMobile: true });
  const machine = new ScriptedMachine();
  machine.programs.set(1, "G01 X100\nG01 Y100\nM30\n");
  machine.programList = [{ number: 1, title: "ONE", bytes: 24, errors: 0, warnings: 0, folder: "" }];
  machine.paths.set(1, [[0, 0, 0, 1, 0, false], [100, 0, 0, 1, 1, false], [100, 100, 0, 2, 2, false]]);
  machine.start();
  await machine.attach(page);
  await page.goto(`${ORIGIN}/`);
  await new Screen(page).sees("READY");
  const canvas = page.locator(".path-lines");
  const seen = () => canvas.evaluate((one) => one.statistics().seen);
  const isDrawn = () => canvas.evaluate((one) => one.statistics().lines > 0);
  await until(isDrawn, true, "the path is drawn");
  await canvas.scrollIntoViewIfNeeded();
  const { x, y, width, height } = await canvas.boundingBox();
  const [cx, cy] = [x + width / 2, y + height / 2];
  const cdp = await page.context().newCDPSession(page);
  /** Fingers at these positions, one after the other. */
  const fingers = async (...steps) => {
    for (const [i, places] of steps.entries()) {
      const touchPoints = places.map(([px, py], id) => ({ x: px, y: py, id }));
      await cdp.send("Input.dispatchTouchEvent", { type: i === 0 ? "touchStart" : "touchMove", touchPoints });
    }
    await cdp.send("Input.dispatchTouchEvent", { type: "touchEnd", touchPoints: [] });
  };
  const top = await page.evaluate(() => scrollY);
  const first = await seen();
  await fingers([[cx, cy]], [[cx + 30, cy]], [[cx + 60, cy + 20]]);
  const turned = await seen();
  assert.notEqual(turned.turn, first.turn, "one finger turns the picture");
  assert.notEqual(turned.tilt, first.tilt);
  assert.deepEqual([turned.scale, turned.centre], [first.scale, first.centre], "and neither moves nor zooms it");
  await fingers([[cx - 40, cy], [cx + 40, cy]], [[cx - 60, cy], [cx + 60, cy]], [[cx - 80, cy], [cx + 80, cy]]);
  const zoomed = await seen();
  assert.ok(Math.abs(zoomed.scale / turned.scale - 2) < 0.15, `twice as far apart is twice as large, not ${zoomed.scale / turned.scale} times`);
  assert.equal(zoomed.turn, turned.turn, "two fingers do not turn it");
  await fingers([[cx - 40, cy], [cx + 40, cy]], [[cx - 10, cy], [cx + 70, cy]], [[cx + 20, cy], [cx + 100, cy]]);
  const moved = await seen();
  assert.notDeepEqual(moved.centre, zoomed.centre, "two fingers move it");
  assert.ok(Math.abs(moved.scale / zoomed.scale - 1) < 0.02, `and at the same distance do not zoom it: ${moved.scale / zoomed.scale}`);
  assert.equal(await page.evaluate(() => scrollY), top, "the page does not scroll");
  assert.deepEqual(errors, []);
  await close();
});
