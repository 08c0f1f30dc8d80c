// Large targets for fingers and gloves: what is pressed is 60 px wide and high at least, in every view and at every size.

import assert from "node:assert/strict";
import { after, before, test } from "node:test";

import { launch, openPage } from "./browser.mjs";
import { picture, SCHEMES, SIZES } from "./pictures.mjs";
import { now, ORIGIN, ScriptedMachine } from "./scripted_machine.mjs";
import { Screen } from "./screen.mjs";

const TARGET_PX = 60;

let browser;
before(async () => {
  browser = await launch();
});
after(() => browser?.close());

/** What opens each part. */
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

/** Buttons and fields that are seen and smaller; a box to tick counts with its label. */
function small(page) {
  return page.locator("button:visible, input:visible, select:visible, a:visible").evaluateAll((all, least) => all.flatMap((one) => {
    const { width, height } = (one.type === "checkbox" ? one.closest("label") : one).getBoundingClientRect();
    return Math.min(width, height) >= least - 0.5 ? [] : [`${one.getAttribute("aria-label") ?? one.textContent ?? one.name}: ${Math.round(width)} x ${Math.round(height)}`];
  }), TARGET_PX);
}

for (const [width, height] of SIZES) {
  test(`at ${width} px every target is ${TARGET_PX} px large where the screen is touched, and nothing is cut off`, async () => {
    for (const colorScheme of SCHEMES) {
      const { page, errors, close } = await openPage(browser, { viewport: { width, height }, hasTouch: true, isMobile: true, colorScheme });
      const machine = new ScriptedMachine();
      machine.programs.set(1, "// One\nM100 VA5\nM30\n");
      machine.programList = [{ number: 1, title: "ONE", bytes: 24, errors: 0, warnings: 0 }];
      const added = { buttons: [{ text: "Oil", m_code: 60 }, { text: "Chips away", input: "dry_run" }], cards: [{ text: "Strokes", m_code: 60 }] };
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
        await page.waitForTimeout(100);
        assert.deepEqual(await small(page), [], `too small in ${name}`);
        const over = await page.evaluate(() => document.documentElement.scrollWidth - innerWidth);
        assert.ok(over <= 0, `${name} is ${over} px too wide`);
        await picture(page, `touch-${name}-${width}-${colorScheme}`);
      }
      assert.deepEqual(errors, []);
      await close();
    }
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
