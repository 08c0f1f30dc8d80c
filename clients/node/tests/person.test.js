// Requests of a person carry the age limit of their press.

import assert from "node:assert/strict";
import { test } from "node:test";

import { NotConnected } from "../src/index.js";
import { Plc } from "../src/plc.js";

/** Returns a connection that records the messages sent. @param {object | undefined} heartbeat */
function noting(heartbeat) {
  /** @type {[string, any][]} */
  const sent = [];
  const connection = {
    clientId: "js-1",
    isConnected: true,
    hub: { last: (/** @type {string} */ topic) => (topic === "heartbeat" ? heartbeat : undefined) },
    request: async (/** @type {string} */ path, /** @type {any} */ payload) => {
      sent.push([path, payload]);
      return { status: "done", code: "ok", text: "" };
    },
  };
  return { sent, plc: new Plc(/** @type {any} */ (connection)) };
}

test("each request of a person's handle carries the heartbeat of the press", async () => {
  const heartbeat = { boot_id: "b", cycle: 7 };
  const { sent, plc } = noting(heartbeat);
  const person = plc.forPerson({ withinMs: 500 });
  heartbeat.cycle = 99;
  await person.cs(1).start();
  await person.cs(1).setOverrides({ feed: 50 });
  await person.cs(1).setInterlock(false);
  await person.writeP(0, [1]);
  await person.ioOut("lamp").force(true);
  const limit = { boot_id: "b", heartbeat: 7, within_ms: 500 };
  assert.equal(sent.length, 5);
  for (const [path, payload] of sent) assert.deepEqual(payload.not_after, limit, path);
});

test("a program's own requests and what cannot move anything carry no age limit", async () => {
  const { sent, plc } = noting({ boot_id: "b", cycle: 7 });
  await plc.cs(1).start();
  await plc.forPerson().readP(0).catch(() => {});
  for (const [path, payload] of sent) assert.equal(payload.not_after, undefined, path);
  const ids = sent.map(([, payload]) => payload.command_id);
  assert.equal(new Set(ids).size, ids.length, "command ids differ");
});

test("a person's request without any heartbeat is not sent", () => {
  assert.throws(() => noting(undefined).plc.forPerson(), NotConnected);
});
