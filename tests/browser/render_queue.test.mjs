// Orders to a renderer in a worker: one at a time, only the last of the waiting ones, and each set of vertices once.

import assert from "node:assert/strict";
import { afterEach, test } from "node:test";

import { RenderQueue } from "../../web/path/render_queue.js";

/** A worker that answers at the times set by the test. */
class TestWorker {
  static last = null;
  sent = [];
  ended = false;
  constructor(url) {
    this.url = url;
    TestWorker.last = this;
  }
  postMessage(message) {
    this.sent.push(message);
  }
  terminate() {
    this.ended = true;
  }
  says(data) {
    this.onmessage({ data });
  }
}

const known = globalThis.Worker;
afterEach(() => {
  globalThis.Worker = known;
});

function renderQueue() {
  globalThis.Worker = TestWorker;
  const reports = [];
  const made = new RenderQueue({ transferControlToOffscreen: () => "canvas" }, (report) => reports.push(report));
  return { renderQueue: made, worker: TestWorker.last, reports };
}

const order = (now, change = {}) => ({ added: [], forgotten: [], pieces: null, now, ...change });

test("what is ordered before the worker is there is drawn when it is", () => {
  const { renderQueue: one, worker } = renderQueue();
  one.enqueue(order(1));
  assert.deepEqual(worker.sent, []);
  worker.says(null);
  assert.deepEqual(worker.sent, ["canvas", order(1)]);
});

test("an order goes when the one before is drawn; of those meanwhile the last counts, with the vertices and pieces of all", () => {
  const { renderQueue: one, worker, reports } = renderQueue();
  worker.says(null);
  one.enqueue(order(1));
  one.enqueue(order(2, { added: [{ id: 1 }], pieces: "pieces" }));
  one.enqueue(order(3, { added: [{ id: 2 }], forgotten: [7] }));
  assert.deepEqual(worker.sent.slice(1), [order(1)]);
  worker.says({ frames: 1 });
  assert.deepEqual(worker.sent.slice(2), [order(3, { added: [{ id: 1 }, { id: 2 }], forgotten: [7], pieces: "pieces" })]);
  worker.says({ frames: 2 });
  worker.says({ frames: 3 });
  assert.equal(worker.sent.length, 3, "nothing is drawn twice");
  assert.deepEqual(reports, [{ frames: 1 }, { frames: 2 }, { frames: 3 }]);
});

test("while nothing is drawn, however long, an order keeps no more than what is still to be seen", () => {
  const { renderQueue: one, worker } = renderQueue();
  worker.says(null);
  one.enqueue(order(0, { added: [{ id: 0 }] }));
  // the travelled path, created again with each position
  for (let id = 1; id <= 1000; id += 1) one.enqueue(order(id, { added: [{ id }], forgotten: [id - 1] }));
  worker.says({ frames: 1 });
  assert.deepEqual(worker.sent.slice(2), [order(1000, { added: [{ id: 1000 }], forgotten: [0] })]);
});

test("a stopped render queue draws nothing, and its worker ends", () => {
  const { renderQueue: one, worker } = renderQueue();
  worker.says(null);
  one.stop();
  one.enqueue(order(1));
  assert.deepEqual([worker.sent, worker.ended], [["canvas"], true]);
});
