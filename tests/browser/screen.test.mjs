// The HMI on a scripted machine: states that a real machine shows rarely, and the structure
// of the screen.

import assert from "node:assert/strict";
import { after, afterEach, before, beforeEach, test } from "node:test";

import { launch, openPage } from "./browser.mjs";
import { now, ORIGIN, ScriptedMachine } from "./scripted_machine.mjs";
import { disabled, enabled, Screen, until } from "./screen.mjs";

let browser;
let page;
let errors;
let close;
let expected;
let machine;
let screen;

before(async () => {
  browser = await launch();
});
after(() => browser?.close());

/** A new page on a new machine at its start position. */
async function open(options) {
  ({ page, errors, close } = await openPage(browser, options));
  expected = [];
  screen = new Screen(page);
  machine = new ScriptedMachine();
  machine.programs.set(1, "// One\nM100 VA5\nM30\n");
  machine.programList = [{ number: 1, title: "ONE", bytes: 24, errors: 0, warnings: 0 }];
  machine.start();
  await machine.attach(page);
  await page.goto(`${ORIGIN}/`);
  await screen.sees("READY");
}

beforeEach(() => open());
afterEach(async () => {
  await close();
  const unexpected = errors.filter((text) => !expected.some((pattern) => pattern.test(text)));
  assert.deepEqual(unexpected, [], "the browser's console shows no errors");
  assert.deepEqual(machine.wrong, [], "the scripted machine speaks as a real one does");
});

/** Lines of the console that the test provokes. */
function expectErrors(pattern) {
  expected.push(pattern);
}

/** M100 of seq 12, owned by `handler`. */
function output(handler, change = {}) {
  return {
    id: "boot-1-1-12", seq: 12, run_id: "r", m: 100, params: { A: 5 }, timing: "after_motion", program: 1, line: 2, attempt: 1,
    redelivered: false, lost: false, state: handler ? "CLAIMED" : "OUTPUT", handler_id: handler, since: now(12000), ...change,
  };
}

/** Waits for it. */
function waitForM100(handler, change = {}) {
  const open = output(handler, change);
  machine.say("cs/1/m_code/pending", { outputs: [open] });
  const waiting_on = { m: 100, seq: 12, since: open.since, ...(open.progress && { progress: open.progress }) };
  machine.state(1, { execution: "WAIT", wait_state: "TOOL_LOAD", waiting_on, run_id: "r" });
}

async function requestsUntil(count) {
  await until(() => machine.requests.length, (sent) => sent >= count, "the number of requests");
  return machine.requests;
}

/** An obstacle of a start as a machine publishes it. */
const obstacle = (kind, change = {}) => ({ kind, text: "", detail: "", refuses: true, m_codes: [], at: null, ...change });

test("the sentence and the Start button have one source: what prevents a start", async () => {
  const say = (...obstacles) => machine.say("cs/1/start_conditions", { obstacles });
  const start = page.getByRole("button", { name: "Start", exact: true });
  const sentence = page.locator(".sentence");
  say();
  await sentence.getByText("Program O0001 is loaded, at line 1. Press Start.").waitFor();
  await enabled(start);
  for (const [one, words] of [
    [obstacle("interlock", { detail: "the door is open" }), "The interlock is on: the door is open."],
    [obstacle("start_lock", { detail: "no blank" }), "The start lock is on: no blank."],
    [obstacle("lease", { detail: "cell" }), "cell"],
    [obstacle("program", { detail: "it has 2 errors" }), "The program does not run: it has 2 errors."],
  ]) {
    say(one, obstacle("m_code", { refuses: false, m_codes: [77] }));
    // the sentence of the previous obstacle begins with the same words
    await sentence.getByText(words).waitFor();
    const said = await sentence.textContent();
    assert.ok(said.startsWith("Program O0001 is loaded.") && !said.includes("Press Start"), said);
    await disabled(start);
    assert.equal(said.replace("Program O0001 is loaded. ", ""), await start.getAttribute("title"));
  }
  for (const [one, words] of [
    [obstacle("m_code", { refuses: false, m_codes: [77, 78] }), "No handler is online for M77, M78: an alarm would end the run there."],
    [obstacle("prediction", { refuses: false, detail: "Soft limit: axis X", at: { program: 1, line: 3 } }), "The rehearsal ends in an alarm in line 3: Soft limit: axis X"],
  ]) {
    say(one);
    await sentence.getByText(words).waitFor();
    machine.requests.length = 0;
    await start.click();
    await page.getByRole("dialog").getByText(words).waitFor();
    await page.getByRole("button", { name: "Do not start" }).click();
    assert.deepEqual(machine.requests, [], "nothing is sent before it is confirmed");
  }
  machine.state(1, { execution: "PROGRAM_COMPLETED" });
  await sentence.getByText("Program O0001 is complete. The rehearsal ends").waitFor();
});

test("values are marked as stale within a second after the last heartbeat", async () => {
  const banner = page.locator(".offline");
  const isStale = () => page.evaluate(() => document.body.hasAttribute("data-stale"));
  const beats = setInterval(() => machine.say("heartbeat", { cycle: 1 }), 100);
  try {
    await page.waitForTimeout(1500);
    assert.equal(await isStale(), false);
  } finally {
    clearInterval(beats);
  }
  const since = Date.now();
  await banner.getByText("No message from the machine for").waitFor();
  assert.ok(Date.now() - since < 2000, `${Date.now() - since} ms`);
  assert.equal(await isStale(), true);
  machine.say("heartbeat", { cycle: 2 });
  await banner.waitFor({ state: "hidden" });
  assert.equal(await isStale(), false);
});

test("of a run no other plan is shown, and a time left that is not known is not told", async () => {
  machine.paths.set(1, [[0, 0, 0, 1, 0, false], [100, 0, 0, 1, 1, false]]);
  const lines = () => page.locator(".path-lines").evaluate((canvas) => canvas.statistics().lines);
  await page.reload();
  await screen.sees("READY");
  await page.locator(".path-summary").getByText("Cycle").waitFor();
  await page.locator(".path-note").waitFor({ state: "hidden" });
  await page.waitForTimeout(500);
  const drawn = await lines();
  machine.plans.set(1, { run_id: "r0" });
  machine.rehearsals.set(1, { run_id: "r0" });
  machine.state(1, { execution: "ACTIVE", run_id: "r1", run_kind: "program" });
  await page.locator(".path-note").getByText("Not planned yet.").waitFor();
  await page.locator(".path-summary").getByText("Not planned yet.").waitFor();
  await until(lines, (count) => count < drawn, "lines drawn of another plan");
  machine.plans.delete(1);
  machine.rehearsals.set(1, { run: { at_s: 1, left_s: null, progress: 0.25 } });
  await page.locator(".path-summary").getByText("25 %, time left unknown, 0.0 s in total").waitFor();
  await until(lines, (count) => count >= drawn, "lines drawn of the plan of the run");
  machine.state(1, { reason: "OVERRIDE_ZERO" });
  await page.locator(".sentence").getByText("Program O0001 does not move: the override is 0 %. Raise it to continue.").waitFor();
});

test("sentence names the M code, its parameters, the handler and its progress", async () => {
  waitForM100("demo", { progress: { text: "moving the magazine", percent: 60 } });
  await page.getByText(/^Waiting 1\d s for M100 \(TOOL_LOAD\), VA=5: handler demo works: moving the magazine \(60\s%\)\.$/).waitFor();
});

test("reset of an output that a handler owns asks first; Escape keeps waiting", async () => {
  waitForM100("demo");
  const reset = page.getByRole("button", { name: "Confirm M100 by hand" });
  await reset.click();
  const dialog = page.getByRole("dialog", { name: "Confirm M100 by hand?" });
  await dialog.waitFor();
  await until(() => page.evaluate(() => document.activeElement?.textContent), "Keep waiting", "what has the focus");
  await page.keyboard.press("Escape");
  await dialog.waitFor({ state: "detached" });
  assert.deepEqual(machine.requests, []);

  await reset.click();
  await dialog.getByRole("button", { name: "M100 is done" }).click();
  assert.deepEqual(await requestsUntil(1), [
    { method: "POST", path: "/cs/1/m_codes/12/reset", body: { boot_id: "boot-1", handler_id: "hmi", result: "ok", force: true } },
  ]);
});

test("stop can be pressed while a question is open", async () => {
  waitForM100("demo");
  await page.getByRole("button", { name: "Confirm M100 by hand" }).click();
  await page.getByRole("dialog").waitFor();
  await screen.command("Stop").click();
  assert.deepEqual(await requestsUntil(1), [{ method: "POST", path: "/cs/1/stop", body: {} }]);
});

test("program text that could not be read is read again", async () => {
  machine.answers.set("GET /programs/2", { status: 503, body: { detail: "the store is busy" } });
  machine.state(1, { program: 2 });
  await page.locator(".program-card").getByText("The store is busy.").waitFor();
  machine.answers.clear();
  machine.programs.set(2, "// Two\nM30\n");
  await page.locator(".line", { hasText: "// Two" }).waitFor();
  expectErrors(/status of 503/);
});

test("reset that comes too late says what became of it", async () => {
  machine.answers.set("POST /cs/1/m_codes/12/reset", { status: 409, body: { code: "stale", detail: "output 12: it was cancelled; nothing was changed" } });
  waitForM100(null);
  await screen.confirmByHand(100);
  await page.getByText("Output 12: it was cancelled; nothing was changed.").waitFor();
  expectErrors(/status of 409/);
});

test("lost handler is said in words and can be redelivered", async () => {
  waitForM100(null, { redelivered: true, lost: true, attempt: 2 });
  machine.state(1, { reason: "HANDLER_LOST" });
  await page.getByText(/The handler of M100 \(TOOL_LOAD\) is lost/).first().waitFor();
  await page.getByRole("button", { name: /Redeliver M100: look/ }).click();
  assert.deepEqual(await requestsUntil(1), [
    { method: "POST", path: "/cs/1/m_codes/12/redeliver", body: { boot_id: "boot-1", how: "verify" } },
  ]);
});

test("a handler's question is answered by a button for each choice", async () => {
  const question = { id: "q-1", text: "Is the part clean?", choices: ["yes", "no"], since: now(2000) };
  waitForM100("measure", { question });
  await page.locator(".output .question").getByText("Is the part clean?").waitFor();
  await page.getByRole("group", { name: "Answer" }).getByRole("button", { name: "no" }).click();
  assert.deepEqual(await requestsUntil(1), [
    { method: "POST", path: "/cs/1/m_codes/12/answer", body: { boot_id: "boot-1", question_id: "q-1", choice: "no", client_id: "hmi" } },
  ]);
  waitForM100("measure", { question: { ...question, answer: "no" } });
  await page.locator(".output .question").waitFor({ state: "hidden" });
});

test("a held jog is refreshed under one name, and no more when the connection is lost", async () => {
  await screen.openByHand();
  await page.getByRole("button", { name: "Jog X minus: hold" }).hover();
  await page.mouse.down();
  const jogs = (await requestsUntil(4)).slice(0, 4);
  assert.equal(jogs.length, 4);
  const { refresh_id } = jogs[0].body;
  for (const one of jogs) assert.deepEqual(one, { method: "POST", path: "/cs/1/jog", body: { axis: "X", velocity: -500, refresh_id } });
  machine.setReachable(false);
  await page.getByText(/Not connected to the machine/).waitFor();
  machine.setReachable(true);
  await page.getByText("Connected", { exact: true }).waitFor();
  const sent = machine.requests.length;
  await page.waitForTimeout(400);
  assert.equal(machine.requests.length, sent, "still pressed, but the hold has ended");
  expectErrors(/ERR_FAILED|WebSocket/);
});

test("a machine whose presence has grown too old is shown as lost, although its connection is open and speaks", async () => {
  const presence = machine.topics.get("presence");
  machine.takesSockets = false;
  machine.say("presence", { ...presence, expires_ms: 700 });
  const speaking = setInterval(() => machine.say("cs/1/position", machine.topics.get("cs/1/position")), 200);
  try {
    await page.getByText("Not connected to the machine. The values on the screen are stale.").waitFor();
  } finally {
    clearInterval(speaking);
  }
  machine.takesSockets = true;
  machine.say("presence", presence);
  await page.getByText("Connected", { exact: true }).waitFor();
});

test("a refused jog says why, and ends", async () => {
  machine.answers.set("POST /cs/1/jog", { status: 409, body: { detail: "axis X is at its soft limit; jog the other way" } });
  await screen.openByHand();
  await page.getByRole("button", { name: "Jog X plus: hold" }).hover();
  await page.mouse.down();
  await page.getByText("Axis X is at its soft limit; jog the other way.").waitFor();
  await page.waitForTimeout(300);
  assert.equal(machine.requests.length, 1);
  expectErrors(/status of 409/);
});

test("nothing moves by hand while a program runs or an alarm is active", async () => {
  await screen.openByHand();
  const byHand = ["Jog X plus: hold", "Home X", "Home all axes", "Run"].map((name) => page.getByRole("button", { name, exact: true }));
  for (const [change, may] of [
    [{ execution: "ACTIVE" }, false], [{ execution: "STOPPED", reason: "STOP" }, true], [{ execution: "FEED_HOLD", reason: null }, false],
    [{ execution: "PROGRAM_COMPLETED" }, true], [{ execution: "STOPPED", reason: "ALARM" }, false],
  ]) {
    machine.state(1, change);
    await screen.sees(change.execution);
    for (const button of byHand) {
      await (may ? enabled(button) : disabled(button));
    }
  }
});

test("the run that a restart cut short is told", async () => {
  const last_run = { boot_id: "boot-0", run_id: "r", program: 1, running: 1, line: 2, execution: "WAIT", outputs: [output(null)], at: now() };
  machine.answers.set("GET /cs/1/last_run", { status: 200, body: { last_run } });
  machine.state(1, { execution: "STOPPED", reason: "RESTARTED" });
  await page.reload();
  await page.getByText(/The run of O0001 was cut short in line 2, with M100 open\. Press Reset/).first().waitFor();
});

test("Start commands only the state that is on the screen, and says so when it has moved on", async () => {
  const sent = page.waitForRequest((request) => request.url().endsWith("/cs/1/start"));
  machine.answers.set("POST /cs/1/start", { status: 412, body: { detail: "the state has changed in the meantime; its rev is now 9", code: "precondition_failed" } });
  await screen.command("Start").click();
  assert.match((await sent).headers()["if-match"], /^"\d+", "boot:boot-1"$/);
  await page.locator(".toast p").getByText("The state has changed in the meantime, so nothing was done. Look at the state, then press again.").waitFor();
  expectErrors(/status of 412/);
});

test("a wait for a person is amber, a wait for a machine is blue, and stopped does not look like ready", async () => {
  const tone = () => page.locator(".status").getAttribute("data-tone");
  waitForM100("demo");
  await until(tone, "wait", "a handler works:");
  waitForM100(null);
  await until(tone, "attention", "nobody works:");
  machine.say("cs/1/m_code/pending", { outputs: [] });
  machine.state(1, { execution: "STOPPED", reason: "STOP", waiting_on: null });
  await until(tone, "ended", "stopped:");
  machine.state(1, { execution: "READY", reason: null });
  await until(tone, "ready", "ready:");
});

test("what is forbidden is disabled and says why", async () => {
  const start = screen.command("Start");
  for (const [topic, lock, why] of [
    ["cs/1/input/start_lock/state", { value: true, text: "door open", sources: [] }, /^The start lock is on: door open\.$/],
    ["cs/1/input/interlock/state", { value: true, text: "", sources: [] }, /^The interlock is on\.$/],
    ["cs/1/lease/state", { holder: "mes-1", fence: 7, expires_at: now(-30000) }, /^mes-1 has the control/],
  ]) {
    machine.say(topic, lock);
    await disabled(start);
    await until(() => start.getAttribute("aria-description"), why, "why");
    machine.say(topic, topic.endsWith("lease/state") ? { holder: null, fence: null, expires_at: null } : { value: false, text: "", sources: [] });
    await enabled(start);
  }
  await page.getByRole("button", { name: /^No login/ }).click();
  await page.getByRole("button", { name: "View mode" }).click();
  await disabled(start);
  await disabled(page.getByRole("button", { name: "Load O0001" }));
  for (const label of ["Hold", "Stop", "Abort"]) await enabled(screen.command(label));
});

test("who is logged in is seen, with the role, and a role that may only look has no buttons to press", async () => {
  machine.answers.set("GET /login", { status: 200, body: { user: "anna", role: "view", is_login: true } });
  machine.answers.set("DELETE /login", { status: 204 });
  await page.reload();
  await page.getByText("anna, view", { exact: true }).waitFor();
  for (const label of ["Start", "Hold", "Stop"]) {
    await disabled(screen.command(label));
    await until(() => screen.command(label).getAttribute("aria-description"), "anna is logged in with the role view, which may read, but not command.", "why");
  }
  await page.getByRole("button", { name: "Logged in: anna, view" }).click();
  const left = page.waitForRequest((request) => request.method() === "DELETE" && request.url().endsWith("/api/v1/login"));
  await page.getByRole("button", { name: "Log out" }).click();
  await left;
});

test("refusal shows the machine's own words", async () => {
  machine.answers.set("POST /cs/1/start", { status: 409, body: { detail: "the start lock is on: door open", code: "start_locked" } });
  await screen.command("Start").click();
  await page.getByText("The start lock is on: door open.", { exact: true }).waitFor();
  expectErrors(/status of 409/);
});

test("who holds the control lease is shown, and Start says why it cannot be pressed", async () => {
  machine.say("cs/1/lease/state", { holder: "mes-1", fence: 7, expires_at: now(-30000) });
  await page.locator(".detail").getByText("control lease: mes-1").waitFor();
  await disabled(screen.command("Start"));
  await screen.command("Start").click({ force: true });
  await page.locator(".toast p").getByText(/^mes-1 has the control of this coordinate system/).waitFor();
  assert.deepEqual(machine.requests, []);
  machine.say("cs/1/lease/state", { holder: null, fence: null, expires_at: null });
  await page.locator(".detail:not(:has-text('control lease'))").waitFor();
});

test("broken program that is loaded shows all its errors", async () => {
  const diagnostics = [2, 5, 9].map((line) => ({ code: "E0104", severity: "error", line, column: 4, end_line: line, end_column: 5, message: `X has no value in line ${line}`, help: "Write a number." }));
  machine.answers.set("POST /cs/1/load", { status: 422, body: { detail: "program 1 has 3 errors", code: "program_has_errors", diagnostics } });
  await screen.load("O0001");
  const dialog = page.getByRole("dialog", { name: "O0001: 3 errors" });
  await dialog.waitFor();
  for (const { message } of diagnostics) await dialog.getByText(message).waitFor();
  await page.keyboard.press("Enter");
  await dialog.waitFor({ state: "detached" });
  expectErrors(/status of 422/);
});

test("findings of a program in the list open as a list", async () => {
  machine.programList = [{ number: 1, title: "ONE", bytes: 24, errors: 0, warnings: 1 }];
  const diagnostics = [{ code: "W0201", severity: "warning", line: 2, column: 1, end_line: 2, end_column: 5, message: "M100 has no handler", help: "" }];
  const body = { diagnostics, m_codes: [100], programs: [], dialect: "nj", hash: "5".repeat(64), o_number: null, signature: null };
  machine.answers.set("POST /programs/1/check", { status: 200, body });
  await page.getByRole("button", { name: "Read again" }).click();
  await page.getByRole("button", { name: "1 warning in O0001: show" }).click();
  await page.getByRole("dialog", { name: "O0001: 1 warning" }).getByText("M100 has no handler").waitFor();
});

test("text of programs, handlers and alarms is never read as markup", async () => {
  const evil = '<img src=x onerror="document.title=1"><b>bold</b>';
  machine.programs.set(1, `// ${evil}\n`);
  machine.programList = [{ number: 1, title: evil, bytes: 1, errors: 0, warnings: 0 }];
  machine.say("alarm/active", { alarms: [{ id: 1, severity: "alarm", number: 10001, text: evil, cs: 1, program: 1, line: 1, raised_at: now(), cleared_at: null, acknowledged_by: null }] });
  waitForM100(evil, { progress: { text: evil } });
  await page.getByRole("button", { name: "Read again" }).click();
  await page.locator(".alarm", { hasText: evil }).waitFor();
  await page.locator(".stored", { hasText: evil }).waitFor();
  assert.equal(await page.locator("img, b").count(), 0);
});

test("program of a million lines costs no more elements than a short one, and its line is in view", async () => {
  const lines = 1_000_000;
  machine.programs.set(9, Array.from({ length: lines }, (_, i) => `N${i + 1} X${i % 100}`).join("\n"));
  machine.say("cs/1/program", { number: 9, nest_level: 0, stack: [], line: 765432, block: "", interpreted_line: 765440 });
  machine.state(1, { execution: "ACTIVE", program: 9, run_id: "long" });
  const running = page.locator('.line[aria-current="step"]');
  await running.getByText("N765432", { exact: true }).waitFor();
  await until(() => inside(running, page.locator(".program-text")), true, "the line in view");
  assert.ok((await page.locator(".line").count()) < 100);
  machine.say("cs/1/program", { number: 9, nest_level: 0, stack: [], line: lines, block: "", interpreted_line: lines });
  await running.getByText(`N${lines}`, { exact: true }).waitFor();
  await until(() => inside(running, page.locator(".program-text")), true, "the line in view");
});

async function inside(inner, outer) {
  const [a, b] = [await inner.boundingBox(), await outer.boundingBox()];
  return a !== null && b !== null && a.y >= b.y - 1 && a.y + a.height <= b.y + b.height + 1;
}

test("scrolling by hand ends following, the button takes it up again", async () => {
  machine.programs.set(1, Array.from({ length: 500 }, (_, i) => `N${i + 1} X1`).join("\n"));
  machine.say("cs/1/program", { number: 1, nest_level: 0, stack: [], line: 250, block: "", interpreted_line: 250 });
  machine.state(1, { execution: "ACTIVE", run_id: "r" });
  await page.locator('.line[aria-current="step"]').getByText("N250", { exact: true }).waitFor();
  await page.locator(".program-text").hover();
  // 100 lines of 24 px
  await page.mouse.wheel(0, -2400);
  await page.locator(".line").getByText("N150", { exact: true }).waitFor();
  const follow = page.getByRole("button", { name: "Follow" });
  await until(() => follow.getAttribute("aria-pressed"), "false", "the button that follows");
  await follow.click();
  await page.locator('.line[aria-current="step"]').getByText("N250", { exact: true }).waitFor();
});

test("path is drawn where the tool has been", async () => {
  const lines = () => page.evaluate(() => document.querySelector(".path-lines").statistics().lines);
  await until(lines, (count) => count > 0, "the tool and the work zero are drawn");
  const before = await lines();
  machine.say("cs/1/modal", { g: { "01": "G01" }, f: 600, s: 0, ta: 100, td: 100, ts_ms: 50, tool: 0, work_offset: "G54", mdi: [] });
  for (const [X, Y] of [[50, 0], [50, 30], [0, 30]]) {
    machine.say("cs/1/position", { ...machine.topics.get("cs/1/position"), machine: { X, Y, Z: 0 } });
  }
  await until(lines, before + 3, "the number of lines drawn: those between four positions, and the rest");
  await page.getByRole("img", { name: "now at X 0.000 mm, Y 30.000 mm" }).waitFor();
});

test("another boot is noticed: old values go, the new ones are shown", async () => {
  waitForM100("demo");
  await screen.sees("WAIT");
  machine.setReachable(false);
  await page.getByText(/Not connected to the machine\. The values on the screen are stale\./).waitFor();
  machine.bootId = "boot-2";
  machine.start();
  machine.state(1, { execution: "STOPPED", reason: "RESTARTED" });
  machine.setReachable(true);
  await screen.sees("STOPPED");
  await page.getByText("No M code is open.").waitFor();
  await page.locator(".toast", { hasText: "started again" }).waitFor();
  expectErrors(/ERR_FAILED|WebSocket/);
});

test("stop, hold and abort stay pressable without a connection, and fail aloud", async () => {
  machine.setReachable(false);
  await page.getByText(/Not connected to the machine/).waitFor();
  for (const label of ["Start", "Resume", "Reset"]) await disabled(screen.command(label));
  await screen.command("Stop").click();
  await page.locator(".toast", { hasText: "The machine did not answer" }).waitFor();
  expectErrors(/ERR_FAILED|WebSocket/);
});

test("state is announced to screen readers once, not with every second", async () => {
  waitForM100(null);
  const live = page.locator('.status [aria-live="polite"]');
  await page.waitForFunction(() => document.querySelector('.status [aria-live="polite"]')?.textContent?.includes("M100"));
  const before = await live.textContent();
  await page.waitForTimeout(1200);
  assert.equal(await live.textContent(), before);
});

for (const [width, height] of [[1280, 800], [1920, 1080], [1024, 768], [820, 1180], [768, 1024], [390, 844]]) {
  test(`at ${width}x${height} nothing is cut off and every target is at least 44 px`, async () => {
    await page.setViewportSize({ width, height });
    waitForM100(null, { redelivered: true, lost: true });
    await screen.openByHand();
    const tooSmall = () => page.evaluate(() =>
      [...document.querySelectorAll("button, input, select")]
        .map((element) => ({ name: element.getAttribute("aria-label") ?? element.textContent, box: element.getBoundingClientRect() }))
        .filter(({ box }) => box.width > 0 && (box.width < 43.5 || box.height < 43.5))
        .map(({ name, box }) => `${name} ${box.width}x${box.height}`),
    );
    const noSidewaysScroll = () => page.evaluate(() => document.documentElement.scrollWidth <= innerWidth && [...document.querySelectorAll(".panel-content")].every((one) => one.scrollWidth <= one.clientWidth));
    for (const panel of ["Set up", "By hand", "Programs"]) {
      await page.getByRole("tab", { name: panel }).click();
      await until(noSidewaysScroll, true, `no sideways scroll with ${panel}:`);
      await until(tooSmall, [], `the list of targets of ${panel} that are too small`);
    }
    machine.programList = [{ number: 1, title: "ONE", bytes: 24, errors: 2, warnings: 1 }];
    await page.getByRole("button", { name: "Read again" }).click();
    machine.say("alarm/active", { alarms: [{ id: 1, severity: "warning", number: 310, text: "Coolant is low", cs: null, program: null, line: null, raised_at: now(), cleared_at: null, acknowledged_by: null }] });
    await page.getByRole("button", { name: "Acknowledge 310" }).waitFor();
    await until(() => page.evaluate(() => document.documentElement.scrollWidth <= innerWidth), true, "no sideways scroll:");
    await until(tooSmall, [], "the list of targets that are too small");
    for (const execution of ["ACTIVE", "FEED_HOLD", "PROGRAM_STOPPED", "OPTIONAL_STOP", "INTERRUPTED", "PROGRAM_COMPLETED"]) {
      machine.state(1, { execution });
      await screen.sees(execution);
      await until(() => page.evaluate(() => {
        const [word, box] = [".word", ".state-word"].map((one) => document.querySelector(one)?.getBoundingClientRect());
        return word && box && word.right <= box.right;
      }), true, `${execution} is within its box:`);
    }
    for (const label of ["Start", "Hold", "Resume", "Stop", "Reset", "Abort"]) {
      const shown = (box) => box && box.x >= 0 && box.x + box.width <= width && box.y + box.height <= height;
      await until(() => screen.command(label).boundingBox(), shown, `the place of ${label}`);
    }
  });
}

test("text stands out from its ground by 4.5 to 1 in the light and in the dark scheme", async () => {
  const tones = ["ready", "active", "wait", "attention", "alarm", "done", "ended"];
  const pairs = [["text", "card"], ["text", "bg"], ["muted", "card"], ["muted", "raised"], ["muted", "bg"], ["accent", "card"], ["on-accent", "accent"]]
    .concat(tones.flatMap((tone) => [["on-tone", tone], [tone, `${tone}-soft`], ["text", `${tone}-soft`], ["muted", `${tone}-soft`]]));
  for (const scheme of ["light", "dark"]) {
    await page.emulateMedia({ colorScheme: scheme });
    await until(() => page.evaluate(() => document.documentElement.dataset.theme), scheme, "the scheme");
    const colours = await page.evaluate((names) => {
      const style = getComputedStyle(document.documentElement);
      return Object.fromEntries(names.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
    }, [...new Set(pairs.flat())]);
    for (const [front, back] of pairs) {
      const ratio = contrast(colours[front], colours[back]);
      assert.ok(ratio >= 4.5, `${front} on ${back} in ${scheme}: ${ratio.toFixed(2)}`);
    }
  }
});

/** WCAG 2 contrast of two colours `#rrggbb`. */
function contrast(one, other) {
  const luminance = (colour) => {
    const [r, g, b] = [1, 3, 5].map((at) => parseInt(colour.slice(at, at + 2), 16) / 255)
      .map((c) => (c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4));
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const [dark, light] = [luminance(one), luminance(other)].sort((a, b) => a - b);
  return (light + 0.05) / (dark + 0.05);
}

test("the operator's choice of colours stays after the page is loaded again", async () => {
  const theme = () => page.evaluate(() => document.documentElement.dataset.theme);
  await until(theme, "light", "the scheme");
  await page.getByRole("button", { name: "Use dark colours" }).click();
  await until(theme, "dark", "the scheme");
  await page.reload();
  await screen.sees("READY");
  await until(theme, "dark", "the scheme");
});
