// What axe-core finds wrong for people who do not see, hear or point as others do.

import assert from "node:assert/strict";
import { readFile } from "node:fs/promises";
import { createRequire } from "node:module";
import { after, before, test } from "node:test";

import { launch, openPage } from "./browser.mjs";
import { now, ORIGIN, ScriptedMachine } from "./scripted_machine.mjs";
import { Screen } from "./screen.mjs";

const AXE = await readFile(createRequire(import.meta.url).resolve("axe-core/axe.min.js"), "utf8");

const line = (event, t_s, more) => ({ event, t_s, ts: new Date(Date.UTC(2026, 0, 1) + t_s * 1000).toISOString(), cs: 1, boot_id: "boot-1", n: t_s, ...more });
/** The journal of a run with one wait. */
const RUN = [line("start", 1, { program: 1, run_id: "1-1" }), line("output", 2, { seq: 1, m: 100, line: 2, timing: "after_motion" }), line("reset", 5, { seq: 1, m: 100, handler_id: "magazine" }), line("end", 7, { outcome: "PROGRAM_COMPLETED" })];

let browser;
before(async () => {
  browser = await launch();
});
after(() => browser?.close());

/** What opens each part of the screen. @type {Record<string, (page, machine) => Promise<void>>} */
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
  async "past alarms"(page, machine) {
    const alarm = { id: 1, severity: "alarm", number: 102, text: "X would go to 960.000000", cs: 1, program: 1, line: 3, raised_at: now(9000), cleared_at: now(2000), acknowledged_by: null, remedy: "Move less." };
    machine.answers.set("GET /alarms/history", { status: 200, body: { alarms: [alarm] } });
    await page.getByRole("button", { name: "History" }).click();
    await page.getByRole("radio", { name: "Past alarms" }).click();
    await page.getByText("X would go to 960.000", { exact: true }).waitFor();
  },
  async editor(page) {
    await page.getByRole("button", { name: "Edit O0001" }).click();
    await page.getByRole("dialog").waitFor();
  },
};

for (const colorScheme of ["light", "dark"]) {
  for (const [name, show] of Object.entries(PARTS)) {
    test(`axe finds nothing wrong: ${name}, ${colorScheme}`, async () => {
      const { page, close } = await openPage(browser, { colorScheme });
      const machine = new ScriptedMachine();
      machine.programs.set(1, "// One\nM100 VA5\nM30\n");
      machine.programList = [{ number: 1, title: "ONE", bytes: 24, errors: 1, warnings: 0 }];
      machine.answers.set("GET /tools", { status: 200, body: { tools: [{ id: 1, length: 10, radius: 2 }] } });
      machine.start();
      await machine.attach(page);
      await page.goto(`${ORIGIN}/`);
      await new Screen(page).sees("READY");
      await show(page, machine);
      await page.evaluate(AXE);
      const found = await page.evaluate(async () => {
        const { violations } = await globalThis.axe.run(document);
        return violations.flatMap(({ id, nodes }) => nodes.map((node) => `${id}: ${node.html.slice(0, 120)} ${node.failureSummary ?? ""}`));
      });
      await close();
      assert.deepEqual(found, []);
    });
  }
}
