// Modules of the HMI that need no browser.

import assert from "node:assert/strict";
import { readFile } from "node:fs/promises";
import { test } from "node:test";

import { look, sentence } from "../../web/machine/sentence.js";
import { POINTS_MAX, Trail } from "../../web/machine/trail.js";
import { cells } from "../../web/path/runs.js";
import { NcText } from "../../web/programs/nc_text.js";
import { partsSaid } from "../../web/programs/order.js";
import { AgeLimits } from "../../web/tandem/age_limits.js";
import { isLimited } from "../../web/tandem/requests.js";
import { duration, position, programName, readNumber, whole } from "../../web/text/format.js";
import { STATE } from "./scripted_machine.mjs";

const STATES = {
  READY: [null], ACTIVE: [null], WAIT: [null, "HANDLER_LOST"], FEED_HOLD: [null, "BUS_LOST", "SERVO_LATE", "CLIENT_LOST"], PROGRAM_STOPPED: [null],
  OPTIONAL_STOP: [null], INTERRUPTED: ["SINGLE_BLOCK", "INTERLOCK"],
  STOPPED: ["ALARM", "STOP", "ABORTED", "NO_PROGRAM", "RESTARTED"], PROGRAM_COMPLETED: [null],
};

/** The sentence of a state. */
function said(change, { pending = null, alarms = [] } = {}) {
  const system = { info: { number: 1 }, state: { ...STATE, ...change }, place: null, pending };
  return sentence(system, alarms, () => 12000);
}

test("every state has a look of its own and a whole sentence", () => {
  for (const [execution, reasons] of Object.entries(STATES)) {
    for (const reason of reasons) {
      const text = said({ execution, reason });
      assert.match(text, /^[A-Z].*\.$/, `${execution} ${reason}: ${text}`);
      assert.doesNotMatch(text, /undefined|null|NaN/, `${execution} ${reason}`);
      assert.ok(look({ ...STATE, execution, reason }).icon);
    }
  }
});

test("no program: says what to do", () => {
  assert.equal(said({ execution: "STOPPED", reason: "NO_PROGRAM", program: null }), "No program is loaded: choose one from the list and press Load.");
});

test("alarm: the sentence is the alarm's own text", () => {
  const alarms = [{ severity: "alarm", number: 10007, text: "Clamp does not close", cs: 1 }];
  assert.equal(said({ execution: "STOPPED", reason: "ALARM" }, { alarms }), "Alarm 10007: Clamp does not close. Remove the cause, then press Reset.");
});

test("a long text keeps its beginning in the sentence, and what to do its place; a screen reader's is no longer", () => {
  const text = "word ".repeat(100).trim();
  const alarms = [{ severity: "alarm", number: 10007, text, cs: 1 }];
  const alarm = said({ execution: "STOPPED", reason: "ALARM" }, { alarms });
  assert.match(alarm, /^Alarm 10007: (word )+… Remove the cause, then press Reset\.$/);
  const question = { id: "q", text, choices: ["yes"], since: "2026-01-01T00:00:00Z" };
  const asked = said({ execution: "WAIT", waiting_on: { m: 60, seq: 1, since: question.since, question } });
  assert.match(asked, /^M60 asks: (word )+… Answer it next to M60\.$/);
  for (const sentence of [alarm, asked]) assert.ok(sentence.length < 200, `${sentence.length} characters`);
});

test("a wait says parameters in the words in which they are declared, others as the program writes them", () => {
  const output = { seq: 1, m: 60, params: { A: 5, B: 0.25 }, state: "OUTPUT", handler_id: null };
  const waits = { execution: "WAIT", waiting_on: { m: 60, seq: 1, since: "2026-01-01T00:00:00Z" } };
  const of = (birth) => sentence({ info: { number: 1 }, state: { ...STATE, ...waits }, pending: { outputs: [output] } }, [], () => 1000, birth);
  const served = { m: 60, cs: [1], params: { A: { name: "force", unit: "kN" } } };
  assert.equal(of({ serves: [served], m_codes: {} }), "Waiting 1 s for M60, force 5\u00a0kN, VB=0.25.");
  assert.equal(of({ serves: [{ ...served, cs: [2] }], m_codes: { 60: { params: { B: { name: "depth" } } } } }), "Waiting 1 s for M60, VA=5, depth 0.25.");
  assert.equal(of(null), "Waiting 1 s for M60, VA=5, VB=0.25.");
});

test("an alarm of another coordinate system is not taken for this one's", () => {
  const alarms = [{ severity: "alarm", number: 10007, text: "Clamp does not close", cs: 2 }];
  assert.equal(said({ execution: "STOPPED", reason: "ALARM" }, { alarms }), "Stopped by an alarm. Remove the cause, then press Reset.");
});

test("the trail keeps the newest points, and never more than its limit", () => {
  const trail = new Trail();
  for (let i = 0; i < 3 * POINTS_MAX; i += 1) trail.add({ X: i, Y: 0 }, false);
  assert.ok(trail.points.length <= POINTS_MAX);
  assert.equal(trail.points.at(-1).at.X, 3 * POINTS_MAX - 1);
});

test("the trail keeps no point twice, and begins anew with a run", () => {
  const trail = new Trail();
  trail.add({ X: 1 }, false);
  trail.add({ X: 1.001 }, false);
  assert.equal(trail.points.length, 1);
  trail.add({ X: 2 }, false);
  trail.run("r1");
  assert.deepEqual(trail.points.map((p) => p.at.X), [2]);
});

test("a way between rapid and feed counts as rapid", () => {
  const trail = new Trail();
  for (const [X, rapid] of [[0, true], [10, false], [11, false], [30, true]]) trail.add({ X }, rapid);
  assert.deepEqual(trail.points.map((p) => p.rapid), [true, true, false, true]);
});

test("program text by lines: both line ends, with or without a last one", () => {
  for (const text of ["A\nB\n", "A\r\nB\r\n", "A\nB"]) {
    const nc = ncText(text, "nj");
    assert.equal(nc.lines, 2);
    assert.deepEqual([nc.line(1), nc.line(2), nc.line(3)], ["A", "B", ""]);
  }
});

test("parts of a line put together are the line", () => {
  const lines = ["ta60 TD60", "N10 G01 X10.5 Y-3 F100 // cut", "/1 M100 VA5 VB=P2", "G00Z5 /* up */ X(P1)", "/* no end", "X1", "", "X=P1+3 */ Y2"];
  const nc = ncText(lines.join("\n"), "nj");
  for (const [i, line] of lines.entries()) assert.equal(nc.parts(i + 1).map((p) => p.text).join(""), line);
  assert.deepEqual(kinds(nc, 1), []);
  assert.deepEqual(kinds(nc, 2), ["n:N10", "g:G01", "axis:X", "axis:Y", "comment:// cut"]);
  assert.deepEqual(kinds(nc, 3), ["n:/1", "m:M100", "m:VA", "m:VB"]);
  assert.deepEqual(kinds(nc, 4), ["g:G00", "axis:Z", "comment:/* up */", "axis:X"]);
});

test("a comment goes on over the ends of lines", () => {
  const nc = ncText("G00 /* one\nX1 two // */ X2\nX3 // /* X4\nX5", "nj");
  assert.deepEqual(kinds(nc, 1), ["g:G00", "comment:/* one"]);
  assert.deepEqual(kinds(nc, 2), ["comment:X1 two // */", "axis:X"]);
  assert.deepEqual(kinds(nc, 4), ["axis:X"]);
});

test("a comment that has no end goes on to the end of the text, and its letters are counted, not their bytes", () => {
  const nc = ncText("X1 /* Fräsen\näöü\n日本 X2", "nj");
  assert.deepEqual(kinds(nc, 1), ["axis:X", "comment:/* Fräsen"]);
  assert.deepEqual(kinds(nc, 2), ["comment:äöü"]);
  assert.deepEqual(kinds(nc, 3), ["comment:日本 X2"]);
  assert.deepEqual(kinds(ncText("/*/ X1\nX2 */ X3", "nj"), 2), ["comment:X2 */", "axis:X"]);
});

test("a line over the seam of two pieces of a long text is whole", () => {
  const line = "G01 X1.25 // Ö";
  const nc = new NcText("nj");
  const bytes = new TextEncoder().encode(`${line}\n`.repeat(150_000));
  nc.add(bytes);
  assert.equal(nc.lines, 150_000);
  for (const seam of [2 ** 20, 2 ** 21]) {
    const number = Math.floor(seam / (bytes.length / 150_000)) + 1;
    for (const near of [number - 1, number, number + 1]) assert.equal(nc.line(near), line);
  }
});

test("each dialect has its own comments", () => {
  assert.deepEqual(kinds(ncText("X1 (Y2) Z3", "dgshape"), 1), ["axis:X", "comment:(Y2)", "axis:Z"]);
  assert.deepEqual(kinds(ncText("X1 (Y2) Z3", "nj"), 1), ["axis:X", "axis:Y", "axis:Z"]);
});

/** In parts of one byte, as may happen in a network. */
function ncText(text, dialect) {
  const nc = new NcText(dialect);
  for (const byte of new TextEncoder().encode(text)) nc.add(Uint8Array.of(byte));
  return nc;
}

function kinds(nc, number) {
  return nc.parts(number).filter((part) => part.kind).map((part) => `${part.kind}:${part.text}`);
}

test("numbers as the screen shows them", () => {
  assert.equal(position(-0.0001), "0.000");
  assert.equal(position(-12.3456), "-12.346");
  assert.equal(position(undefined), "–");
  assert.equal(whole(12345), "12\u202f345");
  assert.equal(duration(59_999), "59 s");
  assert.equal(duration(187_000), "3 min 07 s");
  assert.equal(programName(1), "O0001");
});

test("a number is typed with a point or a comma, and never with a sign between thousands", () => {
  const typed = { "1.5": 1.5, "1,5": 1.5, " -,25 ": -0.25, "\u22122": -2, "+3": 3, "1e-3": 0.001, "": NaN, "-": NaN, "1.234,5": NaN, "1,234,567": NaN, "1 000": NaN, "5 mm": NaN, Infinity: NaN };
  for (const [text, value] of Object.entries(typed)) assert.equal(readNumber(text), value, `"${text}"`);
});

test("a run tells how long it took, its parts, how it ended and for which M codes it waited", () => {
  const run = {
    id: "a-1-1", cs: 1, program: 7, hash: null, from_line: null, parts: 1, parts_done: 1, began: "2026-01-01T00:00:00Z",
    end: { at: "2026-01-01T00:00:05Z", how: "completed", text: "" }, took_s: 5, last_part_s: 5, waits_for: null, alarms: [],
    waits: [{ m: 6, count: 2, total_s: 2.5, longest_s: 2 }],
  };
  assert.deepEqual(cells(run).slice(1), ["completed", "5.0 s", "1", "M6 2.5 s"]);
  const cut = {
    ...run, parts: 10, parts_done: 3, took_s: 75, waits: [], alarms: [{ number: 101, text: "X is at its soft limit", line: 3 }],
    end: { ...run.end, how: "alarm" },
  };
  assert.deepEqual(cells(cut).slice(1), ["alarm: X is at its soft limit", "1 min 15 s", "3 of 10", "none"]);
  assert.equal(partsSaid(cut), "");
  assert.equal(partsSaid({ ...cut, end: null }), "part 4 of 10");
  assert.equal(partsSaid({ ...cut, end: null, waits_for: "the start lock is on: no blank" }), "part 4 of 10 waits: the start lock is on: no blank");
  assert.equal(partsSaid({ ...run, end: null }), "");
});

test("a request carries an age limit exactly if the machine accepts one", async () => {
  const { paths, components } = JSON.parse(await readFile(new URL("../../runtime/gateway/api/openapi.json", import.meta.url), "utf8"));
  const accepts = (schema = {}) => {
    if (schema.$ref) return accepts(components.schemas[schema.$ref.split("/").at(-1)]);
    return "not_after" in (schema.properties ?? {}) || ["allOf", "anyOf", "oneOf"].some((key) => (schema[key] ?? []).some(accepts));
  };
  const wrong = [];
  for (const [route, methods] of Object.entries(paths)) {
    for (const [method, { requestBody }] of Object.entries(methods)) {
      const path = route.replaceAll(/\{\w+\}/g, "1");
      const limited = method !== "get" && accepts(requestBody?.content?.["application/json"]?.schema);
      if (isLimited(method.toUpperCase(), path) !== limited) wrong.push(`${method} ${route}`);
    }
  }
  assert.deepEqual(wrong, []);
});

test("an age limit names the newest heartbeat at the press, and loses the read", async () => {
  let now = 10_000;
  const ages = new AgeLimits(() => now);
  assert.equal(ages.received(0, 1000), null, "without a heartbeat");
  // a page without a connection: the heartbeat is newer than the press, at most by the time of the read
  const read = (ms) => async () => {
    now += ms;
    return { boot_id: "b", cycle: 7 };
  };
  assert.deepEqual(await ages.read(0, 1000, read(40)), { boot_id: "b", heartbeat: 7, within_ms: 960 });
  assert.deepEqual(await ages.read(300, 1000, read(40.5)), { boot_id: "b", heartbeat: 7, within_ms: 659 });
  assert.equal(await ages.read(0, 1000, read(1000)), null, "the limit has passed while the heartbeat was read");
  assert.equal(await ages.read(3000, 1000, read(1)), null, "the press was too old");
  for (const cycle of [1, 2, 3]) {
    ages.receive({ boot_id: "b", cycle });
    now += 100;
  }
  assert.deepEqual(ages.received(0, 1000), { boot_id: "b", heartbeat: 3, within_ms: 1000 });
  assert.equal(ages.received(150, 5000).heartbeat, 2, "that of a press 150 ms ago");
  ages.clear();
  assert.equal(ages.received(0, 1000), null, "after the connection was lost");
});
