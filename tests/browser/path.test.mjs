// The planned path on the real runtime: drawn before anything moves, followed while it runs, chosen by a click.

import assert from "node:assert/strict";
import { afterEach, beforeEach, test } from "node:test";

import { locateWord, readPath } from "../../web/path/bytes.js";
import { Camera } from "../../web/path/camera.js";
import { corners } from "../../web/path/extent.js";
import { pick } from "../../web/path/find.js";
import { Live } from "../../web/path/live.js";
import { isShown } from "../../web/path/shown.js";
import { openPage } from "./browser.mjs";
import { picture, SCHEMES, SIZES } from "./pictures.mjs";
import { plannedPath } from "./planned.mjs";
import { withRuntime } from "./runtime.mjs";
import { Screen, until } from "./screen.mjs";

/** Rounded corners, a helix and a pocket, for the picture. */
const PART = `// Part
G54 G90 G00 X0 Y0 Z5
G01 Z-2 F2400
G64 X60 F9000
G03 X80 Y20 R20
G01 Y60
G03 X60 Y80 R20
G01 X0
G03 X-20 Y60 R20
G01 Y20
G03 X0 Y0 R20
G00 Z5
X30 Y40
G02 X30 Y40 I10 J0 Z-1 F6000
G02 I10 J0 Z-2
G02 I10 J0
G00 Z20
M30
`;

test("a path is fitted by what it does at a feedrate: neither rapids nor a wait at the tool change count", () => {
  const fitted = (vertices) => corners(readPath(new Uint8Array(plannedPath(1, 1, vertices)).buffer));
  const rapid = true;
  assert.deepEqual(fitted([[0, 0, 0, 1, 0], [500, 400, 300, 2, 1, rapid], [500, 400, 300, 3, 5], [10, 10, 5, 4, 6, rapid], [10, 10, -2, 5, 7], [60, 30, -2, 6, 8], [0, 0, 90, 7, 9, rapid]]), [[10, 10, -2], [60, 30, 5]]);
  assert.deepEqual(fitted([[0, 0, 0, 1, 0], [500, 400, 300, 2, 1, rapid]]), [[0, 0, 0], [500, 400, 300]], "of rapids alone all of them count");
});

test("a click on a line that stands for several blocks finds the block that is there", () => {
  const read = (vertices) => readPath(new Uint8Array(plannedPath(1, 1, vertices)).buffer);
  const path = read([[0, 0, 0, 1, 0], [10, 0, 0, 2, 1], [20, 0, 0, 3, 2], [30, 0, 0, 4, 3]]);
  path.chunks[0].levels[3] = read([[0, 0, 0, 1, 0], [30, 0, 0, 4, 3]]).chunks[0].levels[3];
  const camera = new Camera();
  [camera.width, camera.height] = [400, 200];
  camera.look("XY");
  camera.fit([0, 0, 0], [30, 0, 0]);
  const [x, y] = camera.project([15, 0, 0]);
  const found = pick(path, camera, x, y + 3, 12, 3);
  assert.equal(locateWord(found.word, path.programs).line, 3);
  assert.ok(Math.abs(found.time - 1.5) < 1e-6 && Math.abs(found.off - 3) < 1e-6, JSON.stringify(found));
  assert.equal(pick(path, camera, x, y + 13, 12, 3), null);
});

test("of a run only its own plan is shown, and else only the plan of the text that a start would run", () => {
  const plan = (runId, hash) => ({ runId, hash });
  const run = { run_kind: "program", run_id: "r2", hash: "b" };
  for (const [state, of, shown] of [
    [run, plan("r2", "b"), true],
    [run, plan("r1", "b"), false],
    [run, plan(null, "b"), false],
    [{ ...run, run_kind: null }, plan("r2", "b"), true],
    [{ ...run, run_kind: null }, plan(null, "b"), true],
    [{ ...run, run_kind: null }, plan(null, "a"), false],
    [{ ...run, run_kind: "jog" }, plan(null, "b"), true],
    [{ ...run, run_kind: null, hash: null }, plan(null, null), false],
    [null, plan(null, "b"), false],
    [run, null, false],
  ]) assert.equal(isShown(state, of), shown, JSON.stringify([state, of]));
  const read = readPath(new Uint8Array(plannedPath(1, 1, [], { run_id: "r2", hash: "b", called: null, inputs: "0" })).buffer);
  assert.deepEqual([read.runId, read.hash], ["r2", "b"]);
});

/** A circle of 10 mm at 100 mm/s, in lines that are off by less than a thousandth of it. */
function circle() {
  const [radius, lines, length] = [10, 400, (2 * Math.PI * 10) / 100];
  const at = (angle) => [radius * Math.cos(angle), radius * Math.sin(angle), 0];
  const vertices = Array.from({ length: lines + 1 }, (_, i) => [...at((2 * Math.PI * i) / lines), 2, (length * i) / lines]);
  return { radius, at, path: readPath(new Uint8Array(plannedPath(1, 1, vertices)).buffer) };
}

test("between two positions the tool is drawn on the path, and not on the line between them", () => {
  const { radius, at, path } = circle();
  const live = new Live();
  // 10 mm of path between two messages: the straight line between them is off by 1.2 mm
  for (let i = 0; i < 6; i += 1) {
    live.addPosition(path, "run", {}, at(i), 100 * i);
    for (const ms of [0, 25, 50, 75, 99]) {
      const [x, y] = live.at(path, 100 * i + ms);
      assert.ok(Math.abs(Math.hypot(x, y) - radius) < 0.001, `${i}, ${ms} ms: ${x} ${y}`);
      const angle = i === 0 ? 0 : i - 1 + ms / 100;
      assert.ok(Math.hypot(x - at(angle)[0], y - at(angle)[1]) < 0.01, `${i}, ${ms} ms: ${x} ${y}, the path is at ${at(angle)}`);
    }
  }
});

test("off the plan by more than the tolerance the tool is where the machine says; without a run there is no plan to be on", () => {
  const { at, path } = circle();
  const live = new Live();
  live.addPosition(path, "run", {}, at(1), 0);
  assert.ok(live.onPlan);
  const [x, y] = at(1.5);
  // the tolerance of the level is 0.01 mm, that of a position 0.05
  live.addPosition(path, "run", {}, [x * 1.005, y * 1.005, 0], 100);
  assert.ok(live.onPlan, "0.05 mm beside the path");
  live.addPosition(path, "run", {}, [x * 1.01, y * 1.01, 0], 200);
  assert.deepEqual([live.onPlan, live.at(path, 250)], [false, null], "0.1 mm beside the path");
  live.addPosition(path, null, {}, at(1.5), 300);
  assert.ok(!live.onPlan);
});

let browser;
let runtime;
let page;
let errors;
let close;
let screen;

const statistics = () => page.evaluate(() => document.querySelector(".path-lines").statistics());
const put = (path, body, type = "application/json") =>
  fetch(`${runtime.url}/api/v1${path}`, { method: "PUT", body, headers: { "Content-Type": type } });

withRuntime(async (made) => {
  ({ runtime, browser } = made);
  await put("/programs/5", PART, "text/plain");
});

async function open(options) {
  ({ page, errors, close } = await openPage(browser, options));
  screen = new Screen(page);
  await page.goto(runtime.url);
  await page.getByText("Connected", { exact: true }).waitFor();
}

beforeEach(() => open());

afterEach(async () => {
  await close();
  assert.deepEqual(errors, [], "the browser's console shows no errors, and all is of its form");
});

async function ready(program) {
  await screen.command("Stop").click();
  await page.locator('.status:is([data-execution="STOPPED"], [data-execution="READY"], [data-execution="PROGRAM_COMPLETED"])').waitFor();
  if (await page.locator('.status[data-execution="STOPPED"]').count()) await screen.command("Reset").click();
  await screen.load(program);
  await screen.sees("READY");
  // the part, and around it the limits, the zero and the tool
  await until(statistics, ({ lines }) => lines > 90, "what is drawn of a loaded program");
}

test("the whole path is there before anything moves, and nothing is uploaded while it runs", async () => {
  await ready("O0005");
  await page.getByText(/^Cycle \d+\.\d s$/).waitFor();
  await screen.command("Start").click();
  await screen.sees("ACTIVE");
  await page.getByText(/\d+ %, .* left of/).waitFor();
  const first = await statistics();
  const took = [];
  for (let i = 0; i < 15; i += 1) {
    await page.waitForTimeout(100);
    took.push((await statistics()).tookMs);
  }
  const later = await statistics();
  assert.ok(later.frames - first.frames > 20, `${later.frames - first.frames} frames in 1.5 s`);
  assert.equal(later.uploaded, first.uploaded, "bytes uploaded while the program runs");
  assert.ok(later.calls <= 6, `${later.calls} draw calls`);
  // a busy computer delays some frames
  const median = took.toSorted((a, b) => a - b)[7];
  assert.ok(median < 4, `${took} ms of script`);
  await screen.sees("PROGRAM_COMPLETED");
});

test("a worker draws, and the page itself where the browser gives it none for a canvas, or starts none", async () => {
  const drawn = async (workers) => {
    await ready("O0005");
    assert.deepEqual(page.workers().map((worker) => new URL(worker.url()).pathname), workers);
    const { frames, calls } = await statistics();
    assert.ok(frames > 0 && calls > 0, `${frames} frames, ${calls} calls`);
  };
  await drawn(["/path/renderer_worker.js"]);
  const without = [
    () => delete HTMLCanvasElement.prototype.transferControlToOffscreen,
    () => {
      globalThis.Worker = class {
        constructor() {
          throw new DOMException("of another origin", "SecurityError");
        }
      };
    },
    () => {
      globalThis.Worker = class {
        constructor() {
          setTimeout(() => this.onerror(new Event("error", { cancelable: true })), 100);
        }
        terminate() {}
      };
    },
  ];
  for (const [i, init] of without.entries()) {
    await close();
    ({ page, errors, close } = await openPage(browser));
    await page.addInitScript(init);
    screen = new Screen(page);
    await page.goto(runtime.url);
    await drawn([]);
    if (i === 0) await picture(page, "path-without-worker");
  }
});

test("a click on the path shows the line, a click on a line marks its piece", async () => {
  await ready("O0005");
  await page.getByRole("button", { name: "XY", exact: true }).click();
  const box = await page.locator(".path-lines").boundingBox();
  // the long line at the bottom; the whole picture is searched for it
  let found = null;
  for (let y = 0.95; y > 0.4 && !found; y -= 0.02) {
    await page.mouse.click(box.x + box.width / 2, box.y + box.height * y);
    await page.waitForTimeout(60);
    if (await page.locator(".line[data-chosen]").count()) found = await page.locator(".line[data-chosen] .line-number").textContent();
  }
  assert.ok(found, "a line of the program is marked");
  await page.locator(".line", { hasText: "G03 X80 Y20 R20" }).locator(".line-number").click();
  await page.locator(".line[data-chosen]", { hasText: "G03 X80 Y20 R20" }).waitFor();
});

test("views of planes and in space, fit, orbit, pan and zoom by mouse and keys", async () => {
  await ready("O0005");
  for (const name of ["XY", "XZ", "YZ", "ISO"]) {
    await page.getByRole("button", { name, exact: true }).click();
    await page.getByRole("button", { name, exact: true, pressed: true }).waitFor();
  }
  const frames = async (act) => {
    const { frames: before } = await statistics();
    await act();
    await until(async () => (await statistics()).frames, (after) => after > before, "frames drawn");
  };
  const box = await page.locator(".path-lines").boundingBox();
  const [x, y] = [box.x + box.width / 2, box.y + box.height / 2];
  await page.mouse.move(x, y);
  await frames(() => page.mouse.wheel(0, -300));
  await frames(async () => {
    await page.mouse.down();
    await page.mouse.move(x + 60, y + 30, { steps: 5 });
    await page.mouse.up();
  });
  await page.getByRole("button", { name: "ISO", exact: true, pressed: false }).waitFor();
  await page.locator(".path-lines").focus();
  for (const key of ["ArrowLeft", "+", "-", "0"]) await frames(() => page.keyboard.press(key));
  await frames(() => page.getByRole("button", { name: "Fit", exact: true }).click());
});

test("a rehearsal moves the tool along by a slider, and tells times and ranges", async () => {
  await ready("O0005");
  await page.getByRole("button", { name: "Rehearse", exact: true }).click();
  const slider = page.getByRole("slider", { name: "Planned time shown" });
  const { frames } = await statistics();
  await slider.fill("3");
  await page.getByText(/^3\.00 s, line \d+$/).waitFor();
  await until(async () => (await statistics()).frames, (now) => now > frames, "frames drawn");
  await page.setViewportSize({ width: 1280, height: 480 });
  await page.getByRole("button", { name: "Times" }).click();
  const dialog = page.getByRole("dialog");
  await dialog.getByRole("heading").first().waitFor();
  assert.ok(await dialog.evaluate((one) => one.scrollHeight > one.clientHeight && one.scrollTop === 0), "a long dialog is read from its head");
  await dialog.getByText(/At 100 percent: .* at feedrate/).waitFor();
  await dialog.getByRole("cell", { name: "X mm", exact: true }).waitFor();
  await dialog.getByText(/^\d+ parts? completed$/).waitFor();
  await picture(page, "rehearsal");
  await dialog.getByRole("button", { name: "Close" }).click();
});

test("the plan follows offsets, and says from where on it depends on the run", async () => {
  await ready("O0005");
  const before = await statistics();
  await put("/cs/1/work_offsets", JSON.stringify({ work_offsets: { G54: { X: 60 } } }));
  await until(async () => (await statistics()).uploaded, (uploaded) => uploaded > before.uploaded, "bytes of another plan");
  await put("/programs/6", "G90 G00 X10\nG31 X40\nG01 X0 F2000\nM30\n", "text/plain");
  await page.reload();
  await screen.load("O0006");
  await page.getByText(/Dashed from line 2 on: the skip input determines the end of the motion\./).waitFor();
});

test("the foot of the path is one row at every size", async () => {
  await ready("O0005");
  await page.getByText(/^Cycle/).waitFor();
  for (const [width, height] of SIZES) {
    await page.setViewportSize({ width, height });
    await until(statistics, ({ lines }) => lines > 90, "what is drawn");
    for (const colorScheme of SCHEMES) {
      await page.emulateMedia({ colorScheme });
      await picture(page, `path-${width}-${colorScheme}`);
    }
    const apart = () => page.locator(".path-summary, .path-buttons button").evaluateAll((all) => {
      const middles = all.map((one) => one.getBoundingClientRect()).map(({ top, height }) => top + height / 2);
      return Math.max(...middles) - Math.min(...middles);
    });
    await until(apart, (px) => px <= 2.5, `how far the foot of the path is from one row at ${width}`);
    await until(() => page.evaluate(() => document.documentElement.scrollWidth - innerWidth), (px) => px <= 0, `how much the page is too wide at ${width}`);
  }
});
