// The past: the timeline of runs from the journal, by rule and on the real runtime; the journal with filters; past
// alarms.

import assert from "node:assert/strict";
import { readFile } from "node:fs/promises";
import { test } from "node:test";

import { csvOf as runsCsv } from "../../web/history/runs_view.js";
import { describe, losses, timelineOf } from "../../web/history/timeline.js";
import { csvOf, drawn, SAMPLES_MAX, Trace } from "../../web/history/trace.js";
import { rounded } from "../../web/text/format.js";
import { pictures, takePictures } from "./pictures.mjs";
import { withPage, withRuntime } from "./runtime.mjs";
import { until } from "./screen.mjs";

const BEGIN = Date.UTC(2026, 0, 1);
const line = (event, t_s, more = {}) => ({ event, t_s, ts: new Date(BEGIN + t_s * 1000).toISOString(), cs: 1, boot_id: "a", ...more });
const output = (t_s, seq, m, more = {}) => line("output", t_s, { seq, m, line: 10 * seq, timing: "after_motion", ...more });
/** Formats spans as `kind from-to text`, in seconds since the beginning. */
const spans = (lines, now = 100) => timelineOf(lines, BEGIN + now * 1000).map((run) => run.spans.map(({ kind, from, to, says }) => `${kind} ${(from - BEGIN) / 1000}-${(to - BEGIN) / 1000} ${says}`));

test("a run moves, waits for an M code until its reset, and moves on", () => {
  assert.deepEqual(spans([line("start", 1, { program: 7 }), output(3, 1, 100), line("claim", 3, { seq: 1, handler_id: "magazine" }), line("reset", 8, { seq: 1 }), line("end", 9, { outcome: "PROGRAM_COMPLETED" })]), [["moving 1-3 moves", "waiting 3-8 M100", "moving 8-9 moves"]]);
});

test("an M code beside the motion is no wait", () => {
  assert.deepEqual(spans([line("start", 1, { program: 7 }), output(2, 1, 8, { timing: "with_motion" }), line("end", 4, { outcome: "PROGRAM_COMPLETED" })]), [["moving 1-4 moves"]]);
});

test("held from the command or its reason to the resume, also while an M code is open; then it waits again", () => {
  const lines = [line("start", 0, { program: 7 }), output(1, 1, 100), line("command", 2, { verb: "hold" }), line("command", 4, { verb: "resume" }), line("resume", 4), line("reset", 6, { seq: 1 }), line("hold", 7, { reason: "BUS_LOST" }), line("resume", 8), line("end", 9, { outcome: "STOPPED" })];
  assert.deepEqual(spans(lines), [["moving 0-1 moves", "waiting 1-2 M100", "held 2-4 hold", "waiting 4-6 M100", "moving 6-7 moves", "held 7-8 bus lost", "moving 8-9 moves"]]);
});

test("a stop in the program, and a question to the operator, are told apart from waits", () => {
  const lines = [line("start", 0, { program: 7 }), line("stop", 1, { m: 1 }), line("resume", 2), line("stop", 3, { reason: "SINGLE_BLOCK" }), line("resume", 4), output(5, 1, 60), line("question", 6, { seq: 1 }), line("answer", 8, { seq: 1 }), line("reset", 9, { seq: 1 }), line("end", 9, { outcome: "PROGRAM_COMPLETED" })];
  assert.deepEqual(spans(lines), [["moving 0-1 moves", "stopped 1-2 M01", "moving 2-3 moves", "stopped 3-4 single block", "moving 4-5 moves", "waiting 5-6 M60", "asked 6-8 M60", "waiting 8-9 M60"]]);
});

test("a run that goes on lasts until now, and one that a kill cut short until the last line before it", () => {
  assert.deepEqual(spans([line("start", 1, { program: 7 }), output(3, 1, 100)], 20), [["moving 1-3 moves", "waiting 3-20 M100"]]);
  const killed = timelineOf([line("start", 1, { program: 7 }), output(3, 1, 100), line("claim", 5, { seq: 1, handler_id: "x" }), { ...line("boot", 0, { boot_id: "b" }), ts: new Date(BEGIN + 60_000).toISOString() }], BEGIN + 90_000);
  assert.deepEqual(killed.map((run) => [run.spans.length, (run.to - BEGIN) / 1000, run.ended]), [[2, 5, "cut short by the end of the runtime"]]);
});

test("times follow the machine's running clock, although the clock of the day is set meanwhile", () => {
  const set = [line("start", 1, { program: 7 }), { ...output(3, 1, 100), ts: new Date(BEGIN + 5_000_000).toISOString() }, { ...line("end", 4, { outcome: "STOPPED" }), ts: new Date(BEGIN - 5_000_000).toISOString() }];
  assert.deepEqual(spans(set), [["moving 1-3 moves", "waiting 3-4 M100"]]);
});

test("of two that meet at an M code the first one waited for the second", () => {
  const other = (event, t_s, more) => line(event, t_s, { cs: 2, ...more });
  const runs = timelineOf([line("start", 0, { program: 3 }), other("start", 0, { program: 20 }), output(2, 1, 70), output(6, 2, 70, { cs: 2 }), line("reset", 6.5, { seq: 1 }), other("reset", 6.5, { seq: 2 }), line("end", 7, { outcome: "PROGRAM_COMPLETED" }), other("end", 9, { outcome: "PROGRAM_COMPLETED" })], BEGIN + 10_000);
  const waits = runs.map((run) => run.spans.find(({ m }) => m === 70));
  assert.deepEqual(waits.map(({ met }) => met), [2, null]);
  assert.equal(describe(waits[0]), "waits for M70, which coordinate system 2 reaches later, line 10");
  const { shares, causes } = losses(runs);
  assert.deepEqual([...shares], [[1, { moving: 2500, total: 7000 }], [2, { moving: 8500, total: 9000 }]]);
  assert.deepEqual(causes.map(({ cs, says, whom, total }) => [cs, says, whom, total]), [[1, "M70", "coordinate system 2", 4500], [2, "M70", "not claimed", 500]]);
});

test("numbers in texts have three decimals at most", () => {
  assert.equal(rounded("Axis X would move to 960.000000 (machine), beyond 500.12; 7 of 8"), "Axis X would move to 960.000 (machine), beyond 500.12; 7 of 8");
});

/** An answer of the machine: X at these places, sampled every 10 ms; the last one is 5 ms old. */
const answer = (first, xs, more = {}) => ({
  cs: 1, interval_s: 0.01, first, next: first + xs.length, now: new Date(BEGIN + (first + xs.length) * 10).toISOString(), now_s: (first + xs.length - 0.5) / 100,
  time_s: xs.map((_, i) => (first + i) / 100 - 0.01), feedrate: xs.map(() => 60), spindle_rpm: xs.map(() => 0),
  axes: { X: { position: xs, velocity: xs.map(() => 2), acceleration: xs.map(() => 5), following_error: xs.map(() => 0.25) } }, ...more,
});

test("curves: what is new joins what is known, velocity is per minute, the oldest goes first, and a machine that begins anew too", () => {
  const trace = new Trace();
  trace.show(1);
  assert.ok(trace.addAnswer(answer(0, [0, 1, 2])));
  assert.ok(trace.addAnswer(answer(3, [3])));
  assert.deepEqual(trace.of("position", "X"), [0, 1, 2, 3]);
  assert.deepEqual(trace.of("velocity", "X"), [120, 120, 120, 120]);
  assert.deepEqual(trace.of("error", "X"), [0.25, 0.25, 0.25, 0.25]);
  assert.equal(trace.next, 4);
  assert.equal(Math.round(trace.times[3] - trace.times[0]), 30);
  assert.equal(Math.round(trace.times[3]), BEGIN + 25, "the time of day of a sample is now less its age");
  const many = Array.from({ length: 2 * SAMPLES_MAX }, (_, i) => i);
  assert.ok(trace.addAnswer(answer(4, many)));
  assert.ok(trace.times.length >= SAMPLES_MAX && trace.times.length <= 1.1 * SAMPLES_MAX);
  assert.equal(trace.of("position", "X").at(-1), 2 * SAMPLES_MAX - 1);
  assert.equal(trace.addAnswer(answer(0, [7])), false);
  assert.deepEqual([trace.next, trace.times], [0, []]);
});

test("curves as a file: a column for each, a point as the decimal sign; drawn, no peak is lost", () => {
  assert.equal(csvOf([1000, 1010], [{ name: "X_error", values: [0.5, Number.NaN] }, { name: "Y_error", values: [1, 2.25] }]), "time_s,X_error,Y_error\n0,0.5,1\n0.01,,2.25\n");
  const values = Array.from({ length: 6000 }, (_, i) => (i === 1234 ? 9 : i === 4321 ? -9 : 0));
  const places = drawn(values.map((_, i) => i / 10), values);
  assert.ok(places.length < 2500 && places.includes(1234) && places.includes(4321), `${places.length} places`);
  assert.deepEqual(drawn([0, 10, 20], [1, 2, 3]), [0, 1, 2], "few are drawn as they are");
});

test("runs as a file: what holds a comma is in quotes", () => {
  const run = { id: "a-1-1", cs: 1, program: 7, parts: 2, parts_done: 1, began: "2026-01-01T00:00:00Z", took_s: 4.5, last_part_s: null, waits: [{ m: 100, count: 1, total_s: 2, longest_s: 2 }], alarms: [], end: { at: "2026-01-01T00:00:05Z", how: "refused", text: 'locked, says "door"', place: { program: 7, line: 12 } } };
  assert.equal(runsCsv([run]).split("\n")[1], '2026-01-01T00:00:00Z,2026-01-01T00:00:05Z,1,7,refused,"locked, says ""door""",2,1,4.5,,7,12,M100 2,,a-1-1');
});

let runtime;
let browser;
let page;
let screen;

withRuntime((made) => ({ runtime, browser } = made));
withPage(() => ({ runtime, browser }), (opened) => ({ page, screen } = opened));
const history = () => page.getByRole("dialog", { name: "History" });
const part = (name) => history().getByRole("radio", { name }).click();

async function post(path, body = {}) {
  const answer = await fetch(`${runtime.url}/api/v1${path}`, { method: "POST", body: JSON.stringify(body), headers: { "Content-Type": "application/json" } });
  assert.ok(answer.ok, `${path}: ${await answer.text()}`);
}

test("a run is seen while it goes on: it moves, is held, waits for its M code; tables beside say the same", async () => {
  await screen.load("O0001");
  await screen.sees("READY");
  await screen.command("Start").click();
  await screen.sees("ACTIVE");
  await screen.command("Hold").click();
  await screen.sees("FEED_HOLD");
  await page.keyboard.press("t");
  await history().locator(".span-held").waitFor();
  await screen.command("Resume").click();
  await screen.sees("WAIT");
  await history().locator(".span-waiting").waitFor();
  await history().getByRole("cell", { name: /waits for M100, not claimed, line 14/ }).waitFor();
  const chart = history().getByRole("group", { name: /^Timeline/ });
  await chart.focus();
  for (let i = 0; i < 4; i += 1) await page.keyboard.press("ArrowRight");
  await history().getByText(/CS 1, .*waits for M100/).waitFor();
  await post("/cs/1/stop?wait=1");
  await history().getByText(/CS 1 moved .* of /).waitFor();
  await until(() => history().getByLabel("Show").locator("option").allTextContents(), (names) => names.some((name) => /CS 1 O0001, .*stopped/.test(name)), "the runs to choose from");
  await page.keyboard.press("Escape");
  await history().waitFor({ state: "detached" });
});

test("the journal is filtered by M code, event and run, and says who did what", async () => {
  await page.getByRole("button", { name: "History" }).click();
  await part("Journal");
  await history().getByRole("cell", { name: "start", exact: true }).first().waitFor();
  await history().getByLabel("M code").fill("100");
  await until(() => history().locator("tbody tr").count(), (rows) => rows >= 1 && rows < 6, "the lines of M100");
  await history().getByLabel("M code").fill("");
  await history().getByLabel("Event").selectOption("command");
  await history().getByRole("cell", { name: /verb hold/ }).first().waitFor();
  assert.equal(await history().locator("tbody tr:not([data-event=command])").count(), 0);
  await history().getByLabel("User, client or handler").fill("nobody");
  await history().getByText("No line matches.").waitFor();
});

test("an alarm of the past is told with its help and how long it lasted", async () => {
  const raised = await fetch(`${runtime.url}/api/v1/cs/1/mdi?wait=1`, { method: "POST", body: JSON.stringify({ text: "G00 X900" }), headers: { "Content-Type": "application/json" } });
  await raised.text();
  await page.locator(".alarms-card .alarm").waitFor();
  await until(() => page.locator(".alarms-card .alarm").textContent(), (text) => !/\.\d{4}/.test(text), "the alarm's text");
  await screen.command("Reset").click();
  await page.locator(".alarms-card .alarm").waitFor({ state: "detached" });
  await page.getByRole("button", { name: "History" }).click();
  await part("Past alarms");
  await history().getByText(/lasted \d+\.\d s · coordinate system 1/).waitFor();
  await history().getByRole("button", { name: "Explain alarm 102" }).waitFor();
  await history().locator(".remedy").first().waitFor();
});

test("curves show a motion from before the page was opened, with its speed and its acceleration, and give it as a file", async () => {
  await post("/cs/1/reset?wait=1");
  await post("/cs/1/mdi?wait=1", { text: "G91 G01 X20 F6000\nX-20" });
  await page.reload();
  await page.getByText("Connected", { exact: true }).waitFor();
  await page.getByRole("button", { name: "History" }).click();
  await part("Curves");
  const most = async (axis) => Number(await history().getByRole("row", { name: new RegExp(`^${axis} `) }).locator("td").nth(2).textContent());
  const columns = async (curve) => {
    await history().getByLabel("Curve of").selectOption(curve);
    await until(() => most("X"), (value) => value > 0, `the most of the ${curve} of X`);
    const [file] = await Promise.all([page.waitForEvent("download"), history().getByRole("button", { name: "Save as CSV" }).click()]);
    assert.equal(file.suggestedFilename(), `${curve}.csv`);
    const [head, ...lines] = (await readFile(await file.path(), "utf8")).trim().split("\n");
    assert.equal(head, `time_s,X_${curve},Y_${curve},Z_${curve}`);
    return lines.map((line) => line.split(",").map(Number));
  };
  const speeds = await columns("velocity");
  for (const wanted of [6000, -6000]) assert.ok(speeds.filter(([, x]) => Math.abs(x - wanted) < 0.01).length >= 5, `X moves at F ${wanted}`);
  const steps = speeds.slice(1).map(([time], i) => time - speeds[i][0]);
  assert.ok(steps.every((step) => Math.abs(step - 0.01) < 1e-6), "a sample every 10 ms");
  const accelerations = await columns("acceleration");
  assert.ok(accelerations.every(([, x]) => Math.abs(x) < 5001), "the limit of the motor bounds it");
});

test("curves follow a motion: an axis that is moved has another range than one that is not", async () => {
  await page.getByRole("button", { name: "History" }).click();
  await part("Curves");
  await history().getByLabel("Curve of").selectOption("position");
  await history().getByLabel("Over the last").selectOption("10000");
  await post("/cs/1/mdi?wait=1", { text: "G91 G01 X20 F1000\nX-20" });
  const range = async (axis) => Number(await history().getByRole("row", { name: new RegExp(`^${axis} `) }).locator("td").last().textContent());
  await until(() => range("X"), (moved) => moved > 15 && moved <= 20, "the range of X");
  await until(() => range("Y"), 0, "the range of Y");
  await history().getByRole("button", { name: "X", exact: true }).click();
  await history().getByRole("row", { name: /^X / }).waitFor({ state: "detached" });
});

test("all runs are listed: when, which program, how it ended and where; they are filtered, and saved", async () => {
  await post("/cs/1/reset?wait=1");
  await post("/cs/1/load?wait=1", { program: 2 });
  await post("/cs/1/start");
  await until(async () => (await (await fetch(`${runtime.url}/api/v1/cs/1/program`)).json()).line, 3, "the long way");
  await page.getByRole("button", { name: "History" }).click();
  await part("Runs");
  const rows = history().locator("tbody tr");
  await rows.first().getByText("running").waitFor();
  await rows.first().getByText("O0002").waitFor();
  await post("/cs/1/stop?wait=1");
  await rows.first().getByText("stopped").waitFor();
  await rows.first().getByText("O0002 line 3").waitFor();
  assert.ok(await rows.count() >= 2, "the bracket of before, too");
  await history().getByLabel("Program", { exact: true }).fill("2");
  await until(() => rows.count(), 1, "runs of program 2");
  await history().getByLabel("Ended").selectOption("completed");
  await history().getByText("No run matches.").waitFor();
  await history().getByLabel("Ended").selectOption("stopped");
  const [file] = await Promise.all([page.waitForEvent("download"), history().getByRole("button", { name: "Save as CSV" }).click()]);
  const [, line] = (await readFile(await file.path(), "utf8")).split("\n");
  assert.match(line, /,1,2,stopped,,1,0,[\d.]+,,2,3,/);
  await post("/cs/1/reset?wait=1");
});

pictures("curves", async () => {
  const said = await takePictures(browser, runtime.url, { curves: async (one) => {
    await one.getByRole("button", { name: "History" }).click();
    await one.getByRole("radio", { name: "Curves" }).click();
    await one.getByRole("dialog").getByLabel("Curve of").selectOption("velocity");
    await post("/cs/1/mdi?wait=1", { text: "G91 G01 X20 F2000\nY20\nX-20 Y-20\nZ-5\nZ5" });
    await one.getByRole("dialog").getByRole("rowheader", { name: "X", exact: true }).waitFor();
  } });
  assert.deepEqual(said, []);
});

pictures("the history", async () => {
  await post("/cs/1/load?wait=1", { program: 1 });
  await post("/cs/2/load?wait=1", { program: 3 });
  await post("/cs/1/start");
  await post("/cs/2/start");
  await until(async () => (await (await fetch(`${runtime.url}/api/v1/cs/1/state`)).json()).execution, "WAIT", "the bracket");
  const part = (name, wanted) => async (one) => {
    if (!(await one.getByRole("dialog").count())) await one.getByRole("button", { name: "History" }).click();
    await one.getByRole("radio", { name }).click();
    await one.getByRole("dialog").locator(wanted).first().waitFor();
  };
  const said = await takePictures(browser, runtime.url, {
    timeline: part("timeline", ".span-waiting"),
    runs: part("runs", "tbody tr"),
    journal: part("journal", "tbody tr"),
    "past-alarms": part("past alarms", ".alarm"),
  });
  assert.deepEqual(said, []);
});
