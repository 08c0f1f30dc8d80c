// The flow of examples/node-red works as its page describes: its buttons load and start a program; it receives the
// wait for M80 and resets it; the program is completed. Run by tests/node-red/run, in the folder of a served demo
// machine.

import assert from "node:assert/strict";
import { spawn } from "node:child_process";
import { mkdtempSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { createRequire } from "node:module";
import { createServer } from "node:net";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { after, before, test } from "node:test";
import { setTimeout as sleep } from "node:timers/promises";

const api = process.env.API;
const flow = new URL("../../examples/node-red/flow.json", import.meta.url);
const folder = mkdtempSync(join(tmpdir(), "node-red-"));
let broker;
let red;
let editor;
let log = "";

/** Returns a free port. */
async function freePort() {
  const server = createServer().listen(0, "127.0.0.1");
  await new Promise((listens) => server.once("listening", listens));
  const { port } = server.address();
  await new Promise((closed) => server.close(closed));
  return port;
}

/** Waits until a condition has a value, and returns the value. */
async function until(what, holds) {
  for (const end = Date.now() + 30_000; Date.now() < end; await sleep(50)) {
    const value = await holds();
    if (value) return value;
  }
  const now = await fetch(`${api}/cs/1/state`).then((answer) => answer.text());
  assert.fail(`${what} did not happen; the state is ${now}\n${log}`);
}

async function read(path) {
  const answer = await fetch(`${api}/${path}`);
  assert.ok(answer.ok, `${path}: ${answer.status}`);
  return answer.json();
}

const state = () => read("cs/1/state");

/** Presses the button of an inject node, as in the editor. */
async function press(id) {
  const answer = await fetch(`${editor}/inject/${id}`, { method: "POST" });
  assert.equal(answer.status, 200, `${id} is no button of the flow`);
}

before(async () => {
  const told = /mqtt:\/\/[^:]+:(\d+)/.exec(readFileSync("out", "utf8"));
  assert.ok(told, "the machine does not tell its broker");
  broker = told[0];
  const text = readFileSync(flow, "utf8").replace('"port": "1883"', `"port": "${told[1]}"`);
  writeFileSync(join(folder, "flows.json"), text);
  const port = await freePort();
  editor = `http://127.0.0.1:${port}`;
  const settings = { uiHost: "127.0.0.1", uiPort: port, flowFile: "flows.json", telemetry: { enabled: false } };
  writeFileSync(join(folder, "settings.js"), `module.exports = ${JSON.stringify(settings)};\n`);
  red = spawn(process.execPath, [process.env.NODE_RED, "--userDir", folder], { stdio: ["ignore", "pipe", "pipe"] });
  for (const output of [red.stdout, red.stderr]) output.on("data", (data) => (log += data));
  await until("the presence of the flow", async () => {
    assert.equal(red.exitCode, null, log);
    return (await read("handlers")).handlers["node-red"]?.online;
  });
});

after(() => {
  red?.kill();
  rmSync(folder, { recursive: true, force: true });
});

test("the flow loads, starts, resets M80 after its work, and the program is completed", async () => {
  const program = "G90 G54\nG01 X10 F3000\nM80\nG01 X0\nM80\nM30\n";
  const written = await fetch(`${api}/programs/80`, { method: "PUT", body: program });
  assert.ok(written.ok, await written.text());
  await press("load");
  await until("the load", async () => (await state()).program === 80);
  await press("start");
  await until("the wait for M80", async () => (await state()).waiting_on?.m === 80);
  const end = await until("the end", async () => {
    const now = await state();
    return ["PROGRAM_COMPLETED", "STOPPED"].includes(now.execution) && now;
  });
  assert.equal(end.execution, "PROGRAM_COMPLETED", JSON.stringify(end));
  // the journal is written after the events that it records
  const by = await until("both resets in the journal", async () => {
    const { lines } = await read("journal?m=80&count=20");
    const resets = lines.filter((line) => line.event === "reset");
    return resets.length >= 2 && resets.map((line) => line.handler_id);
  });
  assert.deepEqual(by, ["node-red", "node-red"]);
});

test("each tag of the page about SCADA is a member of a message", async () => {
  const page = readFileSync(new URL("../../docs/src/how-to/scada.md", import.meta.url), "utf8");
  const rows = page.split("\n").filter((line) => /^\| `(presence|cs|alarm)\//.test(line));
  const tags = rows.flatMap((row) => [...row.split("|")[1].matchAll(/`([^`]+)`/g)].map(([, tag]) => tag));
  assert.ok(tags.length > 10, `${tags.length} tags`);
  const mqtt = createRequire(process.env.NODE_RED)("mqtt");
  const client = mqtt.connect(broker);
  const root = "tandem/v1/mill-1/";
  const messages = new Map();
  client.on("message", (topic, payload) => messages.set(topic.slice(root.length), JSON.parse(payload.toString())));
  client.subscribe(`${root}#`, { qos: 1 });
  const isThere = (tag) => {
    const topic = [...messages.keys()].find((one) => tag.startsWith(`${one}/`));
    if (topic === undefined) return false;
    let value = messages.get(topic);
    for (const member of tag.slice(topic.length + 1).split("/")) {
      // a member that may be null is shown if it is not null
      if (value === null) return true;
      if (!(member in value)) return false;
      value = value[member];
    }
    return true;
  };
  const missing = () => tags.filter((tag) => !isThere(tag));
  for (const end = Date.now() + 10_000; missing().length > 0 && Date.now() < end; ) await sleep(50);
  client.end(true);
  assert.deepEqual(missing(), []);
});

test("a stop ends the work of the flow, and the next run is served again", async () => {
  await press("start");
  await until("the work", async () => (await read("cs/1/m_codes")).outputs?.[0]?.handler_id === "node-red");
  await press("stop");
  await until("the stop", async () => (await state()).execution === "STOPPED");
  await press("load");
  await until("the load", async () => (await state()).execution === "READY");
  await press("start");
  await until("the end", async () => (await state()).execution === "PROGRAM_COMPLETED");
});
