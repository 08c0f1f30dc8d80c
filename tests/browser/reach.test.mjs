// Elements that must always be visible and usable, on phone and panel: the commands, and questions to the operator.

import assert from "node:assert/strict";
import { after, afterEach, before, beforeEach, test } from "node:test";

import { launch, openPage } from "./browser.mjs";
import { BIRTH, now, ORIGIN, ScriptedMachine } from "./scripted_machine.mjs";
import { Screen, until } from "./screen.mjs";

const PHONE = { width: 390, height: 844 };
const PANEL = { width: 1280, height: 800 };
const SIZES = [PHONE, { width: 768, height: 1024 }, PANEL];
/** The longest question of a handler: 200 characters. */
const LONG_QUESTION = "Is the pocket clean, and has it been measured cold and warm? ".repeat(4).slice(0, 200);

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

beforeEach(async () => {
  ({ page, errors, close } = await openPage(browser));
  screen = new Screen(page);
  machine = new ScriptedMachine();
  machine.programs.set(1, "// One\nM60 VA5\nM30\n".repeat(20));
  machine.programList = [{ number: 1, title: "ONE", bytes: 24, errors: 0, warnings: 0 }];
  machine.start();
  await machine.attach(page);
  await page.goto(`${ORIGIN}/`);
  await screen.sees("READY");
});
afterEach(async () => {
  await close();
  assert.deepEqual(errors.filter((text) => !/status of 4\d\d/.test(text)), [], "the browser's console shows no errors");
  assert.deepEqual(machine.wrong, [], "the scripted machine speaks as a real one does");
});

/** The program waits for M60; `change` is the change by its handler. */
function waitForM60(change = {}) {
  const open = {
    seq: 12, run_id: "r", m: 60, params: { A: 5 }, timing: "after_motion", program: 1, line: 2, attempt: 1,
    redelivered: false, lost: false, state: "OUTPUT", handler_id: null, since: now(12000), ...change,
  };
  machine.say("cs/1/m_code/pending", { outputs: [open] });
  const { question, progress } = open;
  const waiting_on = { m: 60, seq: 12, since: open.since, ...(progress && { progress }), ...(question && { question }) };
  machine.state(1, { execution: "WAIT", wait_state: "INSPECTION", waiting_on, run_id: "r" });
}

/** The handler of M60 asks, and reports its progress. */
async function ask(text, choices) {
  const question = { id: "q-1", text, choices, since: now(2000) };
  waitForM60({ state: "CLAIMED", handler_id: "measure", question, progress: { text: "probing the third pocket", percent: 37.5 } });
  await page.locator(".asked").getByRole("button", { name: choices.at(-1), exact: true }).waitFor({ state: "attached" });
}

function alarm(id, cs, text) {
  return { id, severity: "alarm", number: 10000 + id, text, cs, program: 1, line: 3, raised_at: now(), cleared_at: null, acknowledged_by: null };
}

/** An alarm in each coordinate system. */
async function alarmInEach(count, text) {
  machine.say("alarm/active", { alarms: Array.from({ length: count }, (_, i) => alarm(i + 1, i + 1, text)) });
  for (let cs = 1; cs <= count; cs += 1) machine.state(cs, { execution: "STOPPED", reason: "ALARM", alarm_count: 1 });
  await page.locator(".alarm").nth(count - 1).waitFor({ state: "attached" });
}

/** Returns those of the elements that are not fully on the screen, or are covered, after the layout is complete. */
function hidden(locator) {
  return locator.evaluateAll((elements) => elements.filter((element) => {
    const { x, y, right, bottom, width, height } = element.getBoundingClientRect();
    if (x < 0 || y < 0 || right > innerWidth + 0.5 || bottom > innerHeight + 0.5) return true;
    const corners = [[x + 6, y + 6], [right - 6, bottom - 6], [x + width / 2, y + height / 2]];
    return corners.some(([left, top]) => !element.contains(document.elementFromPoint(left, top)));
  }).map((element) => element.textContent));
}

/** Waits until there are such elements and all of them are visible. */
async function seen(locator, what) {
  await locator.first().waitFor();
  await until(() => hidden(locator), [], `what is hidden of ${what}`);
}

const commands = () => page.getByRole("group", { name: "Commands" }).getByRole("button");

/** Dialogs and panels, with the elements that must remain usable while each is open. */
const OPENED = {
  async editor() {
    await page.getByRole("button", { name: "Edit O0001" }).click();
    return page.getByRole("dialog").getByRole("button", { name: /Close|Store/ });
  },
  async "list of findings"() {
    const diagnostics = Array.from({ length: 40 }, (_, i) => ({ code: "E0104", severity: "error", line: i + 1, column: 4, end_line: i + 1, end_column: 5, message: `X has no value in line ${i + 1}`, help: "Write a number." }));
    machine.answers.set("POST /cs/1/load", { status: 422, body: { detail: "program 1 has errors", code: "program_has_errors", diagnostics } });
    await screen.load("O0001");
    return page.getByRole("dialog").getByRole("button", { name: "Close" });
  },
  async "question before a reset"() {
    waitForM60({ state: "CLAIMED", handler_id: "measure" });
    await page.getByRole("button", { name: "Confirm M60 by hand" }).click();
    return page.getByRole("dialog").getByRole("button");
  },
  async "stack of notices"() {
    for (const [label, detail] of [["Hold", "a"], ["Stop", "b"], ["Abort", "c"]]) {
      machine.answers.set(`POST /cs/1/${label.toLowerCase()}`, { status: 409, body: { detail: detail.repeat(200), code: "refused" } });
      await screen.command(label).click();
      await page.locator(".toast", { hasText: detail.toUpperCase() }).waitFor();
    }
    return page.getByRole("button", { name: "Close notice" });
  },
  async "card By hand"() {
    await screen.openByHand();
    return commands();
  },
};

/** Checks the open element at each size of the screen. */
async function atEachSize(check) {
  for (const size of SIZES) {
    await page.setViewportSize(size);
    await check(size).catch((error) => {
      error.message = `at ${size.width} px: ${error.message}`;
      throw error;
    });
  }
}

const noSidewaysScroll = () => until(() => page.evaluate(() => document.documentElement.scrollWidth <= innerWidth), true, "no sideways scroll:");

for (const [name, open] of Object.entries(OPENED)) {
  test(`an open ${name} leaves hold, stop and abort free`, async () => {
    const opened = await open();
    await atEachSize(async () => {
      machine.requests.length = 0;
      await seen(opened, name);
      await seen(commands(), "the commands");
      for (const label of ["Hold", "Stop", "Abort"]) await screen.command(label).click();
      await until(() => machine.requests.filter(({ path }) => /(hold|stop|abort)$/.test(path)).length, 3, "the number of commands sent");
    });
  });
}

test("a question is seen at once, with all its choices and the progress", async () => {
  const choices = ["yes", "no", "measure once more and then go on with it", "clean by hand", "skip this part", "end the batch", "call the setter", "abort"];
  await ask(LONG_QUESTION.slice(0, 120), choices);
  await atEachSize(async () => {
    await seen(page.locator(".asked button"), "the choices");
    await seen(page.locator(".asked .question"), "the question");
    await seen(page.locator(".output .handler", { hasText: "measure: probing the third pocket, 38\u00a0%" }), "the progress");
    await seen(commands(), "the commands");
  });
});

test("each choice of the longest question can be brought into view", async () => {
  await ask(LONG_QUESTION, Array.from({ length: 8 }, (_, i) => `${i} choice whose words take forty characters`.slice(0, 40)));
  await atEachSize(async () => {
    for (const choice of await page.locator(".asked button").all()) {
      // a notice that appears after the focus may cover the choice: the operator moves the focus to it again
      const hiddenWhenFocused = async () => {
        await choice.blur();
        await choice.focus();
        return hidden(choice);
      };
      await until(hiddenWhenFocused, [], "what is hidden of the choice");
    }
  });
});

test("an M code that waits for a person, or an alarm, is seen at once", async () => {
  waitForM60();
  await atEachSize(() => seen(page.getByRole("button", { name: "Confirm M60 by hand" }), "the button that resets it"));
  machine.say("cs/1/m_code/pending", { outputs: [] });
  await alarmInEach(2, "Clamp does not close");
  await atEachSize(() => seen(page.locator(".alarm"), "the alarms"));
});

for (const count of [2, 8]) {
  test(`the tabs of ${count} coordinate systems with an alarm each are whole`, async () => {
    if (count > 2) {
      machine.say("birth", { ...BIRTH, coordinate_systems: Array.from({ length: count }, (_, i) => ({ ...BIRTH.coordinate_systems[0], number: i + 1 })) });
      await screen.tab(count).waitFor();
    }
    await alarmInEach(count, "Clamp does not close");
    await atEachSize(async () => {
      await seen(page.locator(".tab"), "the tabs");
      await seen(page.locator(".tab-name, .tab .badge, .tab-alarms"), "what the tabs say");
      for (let cs = 1; cs <= count; cs += 1) await until(() => screen.tab(cs).textContent(), /STOPPED1\salarm/, "the tab");
      await noSidewaysScroll();
    });
  });
}

test("an alarm of 500 characters can be read to its end, and leaves room for the rest", async (t) => {
  // without heartbeats, the notice of a silent machine would take room, too
  const beats = setInterval(() => machine.say("heartbeat", { cycle: 1 }), 100);
  t.after(() => clearInterval(beats));
  await alarmInEach(1, `${"The clamp did not close in time. ".repeat(15)}End.`);
  await atEachSize(async ({ height }) => {
    await until(async () => {
      const banner = await page.locator(".place-banner").boundingBox();
      return banner && banner.height < height / 4 ? "less than a quarter" : `${banner?.height} of ${height} px`;
    }, "less than a quarter", "the state takes");
    const text = page.locator(".alarm p").first();
    await until(() => text.evaluate((p) => p.scrollWidth <= p.clientWidth && p.textContent?.endsWith("End.")), true, "the text is whole:");
    await page.getByText("Remove the cause, then press Reset.", { exact: true }).scrollIntoViewIfNeeded();
    await seen(page.getByText("Remove the cause, then press Reset.", { exact: true }), "its remedy");
  });
});

test("positions of metres do not run into each other", async () => {
  const far = { X: -1234.567, Y: 12345.678, Z: -0.001 };
  machine.say("cs/1/position", { ...machine.topics.get("cs/1/position"), work: far, machine: far, distance_to_go: far });
  await page.locator("td.work").getByText("12345.678").waitFor();
  await atEachSize(() => until(() => page.locator(".positions tr > *").evaluateAll((cells) => cells.filter((cell) => cell.scrollWidth > cell.clientWidth).map((cell) => cell.textContent)), [], "what is wider than its cell"));
});

test("the list of programs keeps long titles and findings apart", async () => {
  machine.programList = [{ number: 1, title: "A title that goes on and on, longer than a card of the screen has room for in a line", bytes: 24, errors: 12, warnings: 34 }];
  await page.getByRole("button", { name: "Read again" }).click();
  await page.getByRole("button", { name: "12 errors, 34 warnings in O0001: show" }).waitFor();
  await atEachSize(() => until(() => page.locator(".stored :is(strong, .chip, .title, .button, .icon-button)").evaluateAll((parts) => {
    const boxes = parts.map((part) => ({ name: part.textContent, ...part.getBoundingClientRect().toJSON() }));
    const meet = (a, b) => a.left < b.right - 1 && b.left < a.right - 1 && a.top < b.bottom - 1 && b.top < a.bottom - 1;
    return boxes.flatMap((a, at) => boxes.slice(at + 1).filter((b) => meet(a, b)).map((b) => `${a.name} and ${b.name}`));
  }), [], "what overlaps"));
});

test("nothing that has the focus is behind something else", async () => {
  await ask("Is the part clean?", ["yes", "no"]);
  await screen.openByHand();
  await atEachSize(async () => {
    const count = await page.locator(":is(button, input, select, textarea, [tabindex='0']):enabled:visible, [tabindex='0']:visible").count();
    for (let presses = 0; presses < count; presses += 1) {
      await page.keyboard.press("Tab");
      await until(() => page.evaluate(() => {
        // the thumb of a slider is on its input, and is a part of it
        const at = document.activeElement?.closest(".override-slider") ?? document.activeElement;
        if (!at || at === document.body) return null;
        const { x, y, width, height } = at.getBoundingClientRect();
        const top = document.elementFromPoint(x + width / 2, y + height / 2);
        return at.contains(top) || top?.contains(at) ? null : `${at.outerHTML.slice(0, 90)} under ${top?.outerHTML.slice(0, 60)}`;
      }), null, "what has the focus");
    }
  });
});

test("on a phone the state goes along, and leads back to the question", async () => {
  await page.setViewportSize(PHONE);
  await ask("Is the part clean?", ["yes", "no"]);
  await page.getByRole("button", { name: "Edit O0001" }).scrollIntoViewIfNeeded();
  await until(() => hidden(page.locator(".asked button")), ["yes", "no"], "the choices out of sight");
  await page.getByRole("button", { name: "Answer" }).click();
  await seen(page.locator(".asked button"), "the choices");
  await until(() => page.evaluate(() => document.activeElement?.textContent), "yes", "what has the focus");
});

test("a long program does not make the page long, and the card By hand is whole, also where the screen is low", async () => {
  machine.programs.set(9, "N1 G01 X1\n".repeat(50_000));
  machine.say("cs/1/program", { number: 9, nest_level: 0, stack: [], line: 43210, block: "", interpreted_line: 43220 });
  machine.state(1, { program: 9 });
  for (const size of [{ width: 1366, height: 600 }, { width: 1024, height: 600 }, PHONE]) {
    await page.setViewportSize(size);
    await page.locator('.line[aria-current="step"]').getByText("43210", { exact: true }).waitFor();
    const length = await page.evaluate(() => document.documentElement.scrollHeight);
    assert.ok(length < 2500, `the page has ${length} px at ${size.width} x ${size.height}`);
    await seen(commands(), "the commands");
    await screen.openByHand();
    const last = page.getByRole("switch", { name: "Start lock" });
    await last.focus();
    await seen(last, "its last switch");
    await page.getByRole("tab", { name: "Programs" }).click();
  }
});

test("on a phone in landscape the commands stay free", async () => {
  await page.setViewportSize({ width: 844, height: 390 });
  await page.getByRole("button", { name: "Edit O0001" }).click();
  await seen(commands(), "the commands");
  await page.getByRole("button", { name: "Store" }).focus();
  await seen(page.getByRole("button", { name: "Store" }), "what stores");
});
