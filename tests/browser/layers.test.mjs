// Drawing of a path in each frame: only the lines that the graphics card completes in time, and none while
// it is still drawing.

import assert from "node:assert/strict";
import { test } from "node:test";

import { readPath } from "../../web/path/bytes.js";
import { Layers } from "../../web/path/layers.js";
import { plannedPath } from "./planned.mjs";

const SIGNALED = 1;
/** Number of lines in the first order to a card, see `BUDGET`. */
const FIRST = 4_000;

/** A graphics card that reports the end of its work and the lines that it was ordered to draw. */
function card() {
  const drawn = [];
  const order = [];
  const told = { isDone: true };
  const gl = new Proxy({ drawingBufferWidth: 800, blitFramebuffer: () => order.push("copy"), drawingBufferHeight: 400, SIGNALED, getSyncParameter: () => (told.isDone ? SIGNALED : 0) }, {
    get: (known, name) => known[name] ?? (() => ({})),
  });
  const lines = { drawn: { calls: 0, lines: 0 }, begin() {}, clear: () => order.push("clear"), draw: (_, first, count) => drawn.push({ first, count }) };
  const layers = new Layers(gl, lines);
  const frame = (scene) => {
    [drawn.length, order.length] = [0, 0];
    const isMore = layers.draw(scene, () => order.push("tool"));
    return { isMore, order: [...order], lines: drawn.reduce((sum, { count }) => sum + count, 0), drawn: [...drawn] };
  };
  return { told, layers, frame };
}

/** A piece of this number of lines of 0.001 mm, each of one second. */
function piece(lines) {
  const path = readPath(new Uint8Array(plannedPath(1, 1, Array.from({ length: lines + 1 }, (_, i) => [i / 1000, 0, 0, 1, i]))).buffer);
  return path.chunks[0].levels[0];
}

const scene = (wanted, coarse = wanted, now = -1, matrix = [1]) => ({ key: "", view: { matrix, scale: 1, ratio: 1 }, wanted, coarse, now, staticLayer() {} });

test("a path of more lines than a card draws in time is shown coarse at first, and exact after some frames", () => {
  const { layers, frame } = card();
  const [fine, coarse] = [[piece(60_000)], [piece(100)]];
  const first = frame(scene(fine, coarse));
  assert.deepEqual([first.lines, first.isMore, layers.lines], [100, true, 100]);
  let [frames, lines, isMore] = [0, 0, true];
  while (isMore && frames < 100) {
    const one = frame(scene(fine, coarse));
    assert.ok(one.lines <= FIRST * 1.5 ** (frames + 1), `${one.lines} lines in frame ${frames}`);
    [frames, lines, isMore] = [frames + 1, lines + one.lines, one.isMore];
  }
  assert.deepEqual([lines, layers.lines], [60_000, 60_000]);
  assert.ok(frames > 1, `${frames} frames`);
});

test("nothing is drawn while the card draws what it was given", () => {
  const { told, frame } = card();
  const path = [piece(10)];
  frame(scene(path));
  told.isDone = false;
  assert.deepEqual(frame(scene(path, path, 5)), { isMore: true, order: [], lines: 0, drawn: [] });
  told.isDone = true;
  assert.ok(frame(scene(path, path, 5)).lines > 0);
});

test("while the tool moves only those lines are drawn that are done since; what is done again is drawn anew", () => {
  const { frame } = card();
  const path = [piece(1_000)];
  frame(scene(path, path, 0));
  assert.deepEqual(frame(scene(path, path, 100)).drawn, [{ first: 0, count: 100 }]);
  assert.deepEqual(frame(scene(path, path, 102.5)).drawn, [{ first: 99, count: 4 }]);
  assert.equal(frame(scene(path, path, 102.5)).lines, 0);
  assert.equal(frame(scene(path, path, 50)).lines, 1_000);
});

test("a view that changes in each frame is shown all the same, each time when it is complete", () => {
  const { layers, frame } = card();
  const path = [piece(30_000)];
  for (let i = 0; i < 8; i += 1) frame(scene(path, path, -1, [i]));
  assert.equal(layers.lines, 30_000);
});

test("the screen is cleared before the picture is copied to it, since the browser clears it at what is drawn first, and the tool comes last", () => {
  const { frame } = card();
  const path = [piece(10)];
  frame(scene(path));
  for (const now of [-1, 3]) assert.deepEqual(frame(scene(path, path, now)).order, ["clear", "copy", "tool"]);
});
