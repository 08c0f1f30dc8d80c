// Invalid data is found; the checks of all other tests depend on this.

import assert from "node:assert/strict";
import { test } from "node:test";

import { wrongAnswer, wrongAsked, wrongFrame } from "./schemas.mjs";

const FRAME = { topic: "cs/1/input/dry_run/state", v: 1, boot_id: "b", ts: "2026-01-01T00:00:00Z", rev: 1, value: true };
const ANSWER = { method: "GET", path: "/api/v1/health", sent: null, status: 200, type: "application/json", body: '{"status":"ok"}' };

test("a frame that is not of its form, or of a kind that no document names, is found", () => {
  assert.equal(wrongFrame(JSON.stringify(FRAME)), null);
  assert.equal(wrongFrame('{"error":"there is no topic"}'), null);
  for (const change of [{ value: "on" }, { v: 2 }, { boot_id: null }, { ts: "today" }, { more: 1 }, { topic: "cs/1/nothing" }]) {
    assert.notEqual(wrongFrame(JSON.stringify({ ...FRAME, ...change })), null, JSON.stringify(change));
  }
  for (const text of ["{}", '{"value":true}', "[]", "null", "{", Buffer.from("{}")]) assert.notEqual(wrongFrame(text), null, String(text));
});

test("a frame of the page that is not of its form is found", () => {
  assert.equal(wrongAsked('{"subscribe":["#"],"unsubscribe":["cs/1/state"]}'), null);
  for (const text of ['{"subscribe":"#"}', '{"publish":[]}', "{", Buffer.from("{}")]) assert.notEqual(wrongAsked(text), null, String(text));
});

test("an answer that is not of its form, or that no document names, is found", () => {
  assert.equal(wrongAnswer(ANSWER), null);
  const start = { ...ANSWER, method: "POST", path: "/api/v1/cs/1/load", status: 202, sent: '{"program":1}', body: '{"command_id":"a"}' };
  assert.equal(wrongAnswer(start), null);
  for (const change of [{ body: '{"status":"bad"}' }, { body: "" }, { status: 418 }, { type: "text/html" }, { path: "/api/v1/nothing" }, { method: "PUT" }]) {
    assert.notEqual(wrongAnswer({ ...ANSWER, ...change }), null, JSON.stringify(change));
  }
  assert.notEqual(wrongAnswer({ ...start, sent: '{"program":"one"}' }), null);
});
