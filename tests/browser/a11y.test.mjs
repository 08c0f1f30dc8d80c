// Accessibility faults found by axe-core.

import assert from "node:assert/strict";
import { readFile } from "node:fs/promises";
import { createRequire } from "node:module";
import { after, before, test } from "node:test";

import { launch, openPage } from "./browser.mjs";
import { now, ORIGIN, ScriptedMachine } from "./scripted_machine.mjs";
import { Screen } from "./screen.mjs";

const AXE = await readFile(createRequire(import.meta.url).resolve("axe-core/axe.min.js"), "utf8");

const DIAGNOSTIC = { code: "E0104", severity: "error", line: 2, column: 1, end_line: 2, end_column: 3, message: "M has no value", help: "Write a number." };
const line = (event, t_s, more) => ({ event, t_s, ts: new Date(Date.UTC(2026, 0, 1) + t_s * 1000).toISOString(), cs: 1, boot_id: "boot-1", n: t_s, ...more });
/** The journal of a run with one wait. */
const RUN = [line("start", 1, { program: 1, run_id: "1-1" }), line("output", 2, { seq: 1, m: 100, line: 2, timing: "after_motion" }), line("reset", 5, { seq: 1, m: 100, handler_id: "magazine" }), line("end", 7, { outcome: "PROGRAM_COMPLETED" })];

let browser;
before(async () => {
  browser = await launch();
});
after(() => browser?.close());

/** Opens each part of the screen. @type {Record<string, (page, machine) => Promise<void>>} */
const PARTS = {
  async Programs() {},
  async "By hand"(page) {
    await page.getByRole("tab", { name: "By hand" }).click();
  },
  async "Set up"(page) {
    await page.getByRole("tab", { name: "Set up" }).click();
    await page.getByLabel("Offset X", { exact: true }).waitFor();
  },
  async Tools(page) {
    await page.getByRole("tab", { name: "Set up" }).click();
    await page.getByRole("radio", { name: "Tools" }).click();
  },
  async "three metres"(page) {
    await page.keyboard.press("f");
    await page.locator(".far").waitFor();
  },
  async shortcuts(page) {
    await page.keyboard.press("?");
    await page.getByRole("dialog").waitFor();
  },
  async "a wait and an alarm"(page, machine) {
    const open = {
      seq: 12, run_id: "r", m: 100, params: { A: 5 }, timing: "after_motion", program: 1, line: 2, attempt: 1,
      redelivered: false, lost: false, state: "OUTPUT", handler_id: null, since: now(12000),
    };
    machine.say("cs/1/m_code/pending", { outputs: [open] });
    machine.say("alarm/active", { alarms: [{ id: 1, severity: "alarm", number: 10001, text: "Clamp", cs: 1, program: 1, line: 1, raised_at: now(), cleared_at: null, acknowledged_by: null }] });
    machine.state(1, { execution: "WAIT", waiting_on: { m: 100, seq: 12, since: open.since } });
    await page.locator(".alarm").waitFor();
  },
  async Variables(page) {
    await page.getByRole("tab", { name: "Set up" }).click();
    await page.getByRole("radio", { name: "Variables" }).click();
  },
  async "M codes"(page) {
    await page.getByRole("tab", { name: "Set up" }).click();
    await page.getByRole("radio", { name: "M codes" }).click();
  },
  async user(page) {
    await page.getByRole("button", { name: /^No login/ }).click();
    await page.getByRole("button", { name: "Sound" }).waitFor();
  },
  async rename(page) {
    await page.getByRole("button", { name: "Rename O0002" }).click();
    await page.getByLabel("New number").waitFor();
  },
  async "a question before something is deleted"(page) {
    await page.getByRole("button", { name: "Delete O0002" }).click();
    await page.getByRole("dialog").waitFor();
  },
  async "who holds a lock"(page, machine) {
    const source = { source: "door", text: "The door is open", value: true, handler_id: "cell", lost: false };
    machine.say("cs/1/input/interlock/state", { value: true, text: "The door is open", sources: [source, { ...source, source: "mat", value: false, forced_by: "anna" }] });
    await page.getByRole("tab", { name: "By hand" }).click();
    await page.getByRole("switch", { name: "Interlock" }).click();
    await page.getByRole("button", { name: "Clear door by force" }).waitFor();
  },
  async "a machine that is not there"(page, machine) {
    machine.setReachable(false);
    await page.getByText("Not connected", { exact: true }).waitFor();
  },
  async "large targets"(page) {
    await page.evaluate(() => (document.documentElement.dataset.touch = "true"));
  },
  async "times of a run"(page) {
    await page.getByRole("button", { name: "Times" }).click();
    await page.getByRole("dialog").waitFor();
  },
  async "a meaning"(page, machine) {
    machine.answers.set("GET /explain/READY", { status: 200, body: { what: "READY", text: "READY\n\nThe program can be started." } });
    await page.getByRole("button", { name: /^Explain/ }).first().click();
    await page.getByRole("dialog").waitFor();
  },
  async timeline(page, machine) {
    machine.answers.set("GET /journal", { status: 200, body: { lines: RUN } });
    await page.getByRole("button", { name: "History" }).click();
    await page.locator(".span-waiting").waitFor();
  },
  async journal(page, machine) {
    machine.answers.set("GET /journal", { status: 200, body: { lines: RUN } });
    await page.getByRole("button", { name: "History" }).click();
    await page.getByRole("radio", { name: "Journal" }).click();
    await page.getByRole("cell", { name: "output" }).waitFor();
  },
  async curves(page, machine) {
    machine.say("cs/1/position", machine.topics.get("cs/1/position"));
    await page.getByRole("button", { name: "History" }).click();
    await page.getByRole("radio", { name: "Curves" }).click();
    await page.locator('.curve[d*="L"]').first().waitFor({ state: "attached" });
  },
  async "past alarms"(page, machine) {
    const alarm = { id: 1, severity: "alarm", number: 102, text: "X would move to 960.000000", cs: 1, program: 1, line: 3, raised_at: now(9000), cleared_at: now(2000), acknowledged_by: null, remedy: "Move less." };
    machine.answers.set("GET /alarms/history", { status: 200, body: { alarms: [alarm] } });
    await page.getByRole("button", { name: "History" }).click();
    await page.getByRole("radio", { name: "Past alarms" }).click();
    await page.getByText("X would move to 960.000", { exact: true }).waitFor();
  },
  async editor(page) {
    await page.getByRole("button", { name: "Edit O0001" }).click();
    await page.getByRole("dialog").waitFor();
  },
};

test("axe finds nothing wrong: the page of a machine that does not answer", async () => {
  const { page, close } = await openPage(browser);
  await new ScriptedMachine().attach(page);
  await page.goto(`${ORIGIN}/offline.html`);
  await page.evaluate(AXE);
  assert.deepEqual(await page.evaluate(async () => (await globalThis.axe.run(document)).violations.map(({ id }) => id).filter((id) => id !== "meta-refresh")), []);
  await close();
});

test("axe finds nothing wrong: several machines on one page", async () => {
  const { page, close } = await openPage(browser);
  const machine = new ScriptedMachine();
  machine.start();
  await machine.attach(page);
  await page.addInitScript(() => localStorage.setItem("tandem-machines", '["http://127.0.0.1:9"]'));
  await page.goto(`${ORIGIN}/machines.html`);
  await page.getByText("The machine cannot be reached").waitFor();
  await page.locator('.machine-tile[data-link="online"]').getByText("READY").first().waitFor();
  await page.evaluate(AXE);
  assert.deepEqual(await page.evaluate(async () => (await globalThis.axe.run(document)).violations.map(({ id, nodes }) => `${id}: ${nodes[0]?.html}`)), []);
  await close();
});

for (const [name, show] of Object.entries(PARTS)) {
  test(`axe finds nothing wrong in light and dark: ${name}`, async () => {
    const { page, close } = await openPage(browser);
    const machine = new ScriptedMachine();
    machine.programs.set(1, "// One\nM100 VA5\nM30\n");
    machine.programList = [{ number: 1, title: "ONE", bytes: 24, errors: 1, warnings: 0 }, { number: 2, title: "TWO", bytes: 24, errors: 0, warnings: 0 }];
    machine.answers.set("POST /programs/1/check", { status: 200, body: { diagnostics: [DIAGNOSTIC], dialect: "nj", hash: "5".repeat(64), m_codes: [], o_number: null, programs: [], signature: null } });
    machine.answers.set("GET /tools", { status: 200, body: { tools: [{ id: 1, length: 10, radius: 2 }] } });
    machine.start();
    await machine.attach(page);
    await page.goto(`${ORIGIN}/`);
    await new Screen(page).sees("READY");
    await show(page, machine);
    await page.evaluate(AXE);
    const found = {};
    for (const colorScheme of ["light", "dark"]) {
      await page.emulateMedia({ colorScheme });
      await page.locator(`html[data-theme="${colorScheme}"]`).waitFor();
      found[colorScheme] = await page.evaluate(async () => {
        const { violations } = await globalThis.axe.run(document);
        return violations.flatMap(({ id, nodes }) => nodes.map((node) => `${id}: ${node.html.slice(0, 120)} ${node.failureSummary ?? ""}`));
      });
    }
    await close();
    assert.deepEqual(found, { light: [], dark: [] });
  });
}
