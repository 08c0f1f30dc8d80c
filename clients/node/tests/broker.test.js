// A program at a broker that behaves wrongly.

import assert from "node:assert/strict";
import { test } from "node:test";
import { setTimeout as delay } from "node:timers/promises";

import { SequenceProgram } from "../src/index.js";
import { limits } from "../src/link.js";
import { FakeBroker, PRESENCE } from "./fake_broker.js";

limits.silenceMs = 500;
limits.lookMs = 50;

/** Log entries. @type {string[]} */
const said = [];
const log = { debug: () => {}, warn: (/** @type {any[]} */ ...words) => said.push(words.join(" ")), error: () => {} };
const program = () => new SequenceProgram("cell").on(20, () => {});

test("a broker that acknowledges nothing is left for the next node", async () => {
  const silent = await FakeBroker.open({ acknowledges: false, accepts: false });
  const sound = await FakeBroker.open();
  const serving = await program().serve(`mqtt://${silent.node},${sound.node}/mill-1`, { log });
  assert.ok(silent.topics.includes(PRESENCE) && sound.topics.includes(PRESENCE));
  assert.ok(said.some((words) => words.includes(`${silent.node}: the broker has acknowledged nothing for 0.5 s`)), said.join("\n"));
  await serving.close();
  await serving.ended;
  [silent, sound].forEach((broker) => broker.close());
});

test("a broker is not left while nothing waits for it", async () => {
  said.length = 0;
  const sound = await FakeBroker.open();
  const serving = await program().serve(`mqtt://${sound.node}/mill-1`, { log });
  await delay(3 * limits.silenceMs);
  await serving.close();
  assert.deepEqual(said, []);
  sound.close();
});

test("what a missed machine said is read anew when it is heard again", async () => {
  said.length = 0;
  const broker = await FakeBroker.open();
  broker.publish("presence", { expires_ms: 300 });
  const serving = await program().serve(`mqtt://${broker.node}/mill-1`, { log });
  while (!said.some((words) => words.includes("treated as offline"))) await delay(10);
  broker.publish("presence", {});
  while (broker.connections < 2) await delay(10);
  assert.equal(broker.goodbyes, 1, "without one its last will would lose the handler's outputs");
  await serving.close();
  broker.close();
});

test("a task begins when the machine knows the handlers, and not when the broker does", async () => {
  const broker = await FakeBroker.open({ accepts: false });
  let hasBegun = false;
  const tasked = program().task(async () => {
    hasBegun = true;
  });
  const serve = tasked.serve(`mqtt://${broker.node}/mill-1`, { log });
  // goes offline first and online afterwards: the broker has received both
  while (broker.topics.filter((topic) => topic === PRESENCE).length < 2) await delay(10);
  await delay(100);
  assert.ok(!hasBegun);
  broker.accept();
  const serving = await serve;
  assert.ok(hasBegun);
  await serving.close();
  broker.close();
});
