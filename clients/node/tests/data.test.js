// Tests without a machine: addresses, parameters, mistakes, and invalid data.

import assert from "node:assert/strict";
import { spawnSync } from "node:child_process";
import { mkdtemp, readFile, rm, writeFile } from "node:fs/promises";
import { tmpdir } from "node:os";
import { join, resolve } from "node:path";
import { test } from "node:test";

import { parseAddress } from "../src/address.js";
import { MCodeDeclaration } from "../src/m_code_declaration.js";
import { BACKLOG_MAX, Hub, TOPICS_MAX } from "../src/hub.js";
import { AddressError, Alarm, Params, ProgramError, SequenceProgram, UserAlarm } from "../src/index.js";
import { DEFAULT_CONFIG } from "../src/testing.js";
import { FILTERS, patternOf, whatIsWrong } from "../src/topics.js";

test("an address names brokers, user, prefix and machine", () => {
  const { nodes, user, password, root, shown, tls } = parseAddress("mqtts://anna:p%40ss@a,b:1884,[::1]/hall/3/mill-1");
  const expected = [
    { host: "a", port: 8883 },
    { host: "b", port: 1884 },
    { host: "::1", port: 8883 },
  ];
  assert.deepEqual(nodes, expected);
  assert.deepEqual([user, password, root, tls], ["anna", "p@ss", "hall/3/tandem/v1/mill-1", true]);
  assert.deepEqual(parseAddress("127.0.0.1/m").nodes, [{ host: "127.0.0.1", port: 1883 }]);
  assert.equal(shown, "mqtts://a,b:1884,[::1]/hall/3/mill-1");
});

const behindUser = ["host:1883", ":1883/m", "h:x/m", "h:0/m", "h/a/#/m", "h//m", "[::1/m", `${"a,".repeat(16)}a/m`];
for (const wrong of [...behindUser.map((rest) => `mqtt://u:secret@${rest}`), "mqtt://u:secret/@h/m", "mqtt://h,mqtt://u:secret@i/m"]) {
  test(`an address that is wrong is refused without the password: ${wrong.slice(0, 32)}`, () => {
    const refused = (/** @type {unknown} */ error) => error instanceof AddressError && !error.message.includes("secret");
    assert.throws(() => parseAddress(wrong), refused);
  });
}

test("parameters have ranges and whole numbers", () => {
  const params = new Params({ A: 24, B: 2.5, C: 0.1 * 30 });
  assert.deepEqual([params.whole("A", 1, 24, "the pocket"), params.real("B", 0, 2.5, "the force, kN"), params.whole("C", 1, 3, "parts")], [24, 2.5, 3]);
  const says = (/** @type {string} */ text) => (/** @type {unknown} */ error) => error instanceof Alarm && error.code === 9_997 && error.text === text;
  assert.throws(() => params.whole("A", 1, 23, "the pocket"), says("VA is 24: write the pocket, 1 to 23"));
  assert.throws(() => params.whole("B", 1, 3, "the side"), says("VB is 2.5: write the side, a whole number from 1 to 3"));
  assert.throws(() => params.real("H", 0, 1, "the way"), says("VH is missing: write the way, 0 to 1"));
  // @ts-expect-error: there is no VJ
  assert.throws(() => params.real("J", 0, 1, "x"), /write "A" to "H"/);
});

test("an alarm has number 10000 + code, and at most 1000 characters", () => {
  assert.deepEqual([new Alarm(17, "x").number, new Alarm(0, "é".repeat(2_000)).text.length], [10_017, 1_000]);
  for (const [code, text] of /** @type {[number, string][]} */ ([[-1, "x"], [10_000, "x"], [0.5, "x"], [1, ""]])) {
    assert.throws(() => new Alarm(code, text), RangeError);
  }
});

test("what is said of alarms is checked where it is written", () => {
  const words = { text: "y" };
  const many = Object.fromEntries([...Array(9).keys()].map((n) => [`d${n}`, words]));
  const alarms = [...Array(257).keys()].map((n) => new UserAlarm(n, "x"));
  /** @type {[() => unknown, RegExp][]} */
  const mistakes = [
    [() => new UserAlarm(10_000, "x"), /alarm 10000: write 0 to 9999/],
    [() => new UserAlarm(1, ""), /alarm 1: text and remedy: write 1 to 1000 characters/],
    [() => new UserAlarm(1, "x", { remedy: "" }), /alarm 1: text and remedy/],
    [() => new UserAlarm(1, "x", { languages: { d: words } }), /language "d": write a tag/],
    [() => new UserAlarm(1, "x", { languages: many }), /9 languages: write up to 8/],
    [() => new SequenceProgram("p").alarms(new UserAlarm(1, "x"), new UserAlarm(1, "y")), /alarm 1 has two texts: "x" and "y"/],
    [() => new SequenceProgram("p").alarms(...alarms), /257 alarms: write up to 256/],
    // @ts-expect-error: there is no such redelivery
    [() => new SequenceProgram("p", { redelivery: "twice" }), /write ask, redo, verify/],
  ];
  for (const [make, message] of mistakes) assert.throws(make, (error) => error instanceof ProgramError && message.test(error.message));
});

test("what a program serves is known without it by its file", async () => {
  const program = new SequenceProgram("clamp")
    .on(13, () => {}, { cs: 1 })
    .on(12, () => {}, { name: "clamp", params: { A: { name: "force", unit: "kN", min: 1, max: 20 } } });
  const folder = await mkdtemp(join(tmpdir(), "tandem-served-"));
  const write = (/** @type {string} */ name, /** @type {string} */ text) => writeFile(join(folder, name), text);
  await write("served.json", program.served());
  await write("tandem.toml", DEFAULT_CONFIG.replace("[machine]", '[machine]\nserved = "served.json"'));
  await write("1.nc", "M12 VA50\nM13\nM14\nM30\n");
  const command = resolve(process.env.TANDEM_BIN ?? "tandem");
  const { stdout, stderr } = spawnSync(command, ["check", "--config", "tandem.toml", "1.nc"], { cwd: folder, encoding: "utf8" });
  const said = stdout + stderr;
  assert.match(said, /M12 clamp: VA \(force\) is 50 kN; write 1 to 20 kN/);
  assert.deepEqual(said.match(/no handler serves M\d+/g), ["no handler serves M14"]);
  await rm(folder, { recursive: true });
});

test("mistakes of a program are said in a sentence", () => {
  const handler = () => {};
  const program = new SequenceProgram("p").on([6, 20, 21], handler).on(6, handler, { cs: 2 });
  /** @type {[() => unknown, RegExp][]} */
  const mistakes = [
    [() => program.on(21, handler), /M21 has two handlers/],
    [() => program.on(6, handler, { cs: 2 }), /M6 in coordinate system 2 has two handlers/],
    [() => program.on(30, handler), /M30: the runtime handles this M code itself/],
    [() => program.on(192, handler), /M192: M codes are 0 to 191/],
    [() => program.on([], handler), /no M code is named/],
    // @ts-expect-error: no function
    [() => program.on(8, "clamp"), /the handler is not a function/],
    // @ts-expect-error: no redelivery
    [() => program.on(8, handler, { redelivery: "twice" }), /redelivery "twice": write ask, redo, verify/],
    [() => new SequenceProgram("a/b"), /write 1 to 64 characters/],
    [() => program.on(9, handler, { params: /** @type {object} */ ({ VA: {} }) }), /"VA" is not a parameter/],
    [() => program.on(9, handler, { params: { A: { min: 2, max: 1 } } }), /VA: min 2 is above max 1/],
    [() => program.on(9, handler, { params: { A: { unit: "" } } }), /VA: unit "": write 1 to 16 characters/],
    [() => void (program.interlock(1, "door", "open"), program.interlock(1, "door", "open")), /interlock door of coordinate system 1 is declared twice/],
  ];
  for (const [mistake, says] of mistakes) assert.throws(mistake, (error) => error instanceof ProgramError && says.test(error.message));
});

test("a program with a check and no handler does not begin", async () => {
  const program = new SequenceProgram("p").on(6, () => {}).validate([7], () => {});
  await assert.rejects(program.run("mqtt://127.0.0.1:9/m"), /M7 is validated and has no handler/);
});

test("parameters that are not as declared are an alarm that says what to write", () => {
  const declared = new MCodeDeclaration("clamp", { A: { name: "force", unit: "kN", min: 1, max: 20 }, B: { whole: true, min: 1, max: 2, optional: true } });
  declared.check(12, new Params({ A: 20, B: 0.1 * 20 }));
  const wrong = (/** @type {import("../src/messages.d.ts").Params} */ given) => {
    try {
      declared.check(12, new Params(given));
    } catch (error) {
      return error instanceof Alarm ? error.text : "";
    }
    return "";
  };
  assert.equal(wrong({ A: 50 }), "M12 clamp: VA (force) is 50 kN; write 1 to 20 kN");
  assert.equal(wrong({}), "M12 clamp needs VA (force, 1 to 20 kN)");
  assert.equal(wrong({ A: 5, B: 1.5 }), "M12 clamp: VB is 1.5; write a whole number, 1 to 2");
  assert.match(wrong({ A: 5, C: 1 }), /^M12 clamp takes no VC; it takes VA \(force, 1 to 20 kN\), VB \(a whole number, 1 to 2; may be left out\)/);
});

/** Returns the messages of the contract that have an example, by path. @returns {Promise<[string, any][]>} */
async function examples() {
  const contract = new URL("../../../runtime/gateway/api/asyncapi.json", import.meta.url);
  const { channels, components } = JSON.parse(await readFile(contract, "utf8"));
  const path = (/** @type {string} */ address) =>
    address.replace("tandem/v1/{machine}/", "").replace("{cs}", "1").replace(/\{\w+\}/g, "6");
  return Object.values(channels).flatMap(({ address, messages }) =>
    Object.values(messages).flatMap((message) => {
      const { examples: given = [] } = message.$ref ? components.messages[message.$ref.split("/").at(-1)] : message;
      return given.map((/** @type {any} */ { payload }) => [path(address), payload]);
    }),
  );
}

test("each example of the contract is of its form, and without any of its members it is data that is passed over or refused", async () => {
  let known = 0;
  for (const [path, payload] of await examples()) {
    const pattern = patternOf(path);
    if (pattern === undefined || path.startsWith("handler/6/presence")) continue;
    known += 1;
    assert.equal(whatIsWrong(pattern, payload), null, path);
    for (const member of Object.keys(payload)) whatIsWrong(pattern, { ...payload, [member]: null });
  }
  assert.ok(known >= 4, `only ${known} examples`);
});

test("what is not of its form is said with the place", () => {
  const output = { id: "x", seq: 7, m: 6, state: "OUTPUT", attempt: 1, line: 1, program: 1, run_id: "r", params: { A: 5 } };
  const pending = (/** @type {object} */ more) => ({ boot_id: "b", outputs: [{ ...output, ...more }] });
  const look = (/** @type {unknown} */ message) => whatIsWrong("cs/+/m_code/pending", message);
  assert.equal(look(pending({})), null);
  assert.equal(look(pending({ params: { A: "5" } })), "the message.outputs[0].params.A is not a number");
  assert.equal(look(pending({ seq: null })), "the message.outputs[0].seq is not a number");
  assert.equal(look({ boot_id: "b", outputs: {} }), "the message.outputs is not a list");
  for (const none of [null, 1, "x", []]) assert.equal(look(none), "the message is not an object");
});

test("topics that this package does not use have no form", () => {
  assert.equal(patternOf("cs/1/m_code/6/result"), "cs/+/m_code/+/result");
  assert.equal(patternOf("reply/js-1"), "reply/+");
  for (const path of ["", "cs/1", "cs/1/m_code/6/output", "constructor", "__proto__/x", "alarm/raise"]) assert.equal(patternOf(path), undefined, path);
  assert.ok(FILTERS.includes("presence") && !FILTERS.some((filter) => filter.startsWith("handler/")));
});

test("a hub keeps a bounded number of topics, and a follower a bounded number of messages", async () => {
  const hub = new Hub();
  const messages = hub.follow("cs/1/state");
  for (let number = 0; number < BACKLOG_MAX + 10; number += 1) hub.publish("cs/1/state", { number });
  assert.deepEqual((await messages.next()).value, { number: 10 });
  for (let number = 0; number < TOPICS_MAX; number += 1) hub.publish(`cs/${number}/tool/state`, {});
  assert.equal(hub.last("cs/1/state"), undefined);
  await messages.return?.();
  assert.deepEqual(await messages.next(), { done: true, value: undefined });
});

test("what follows a topic ends with the connection, with its signal, and with its loop", async () => {
  const hub = new Hub();
  const aborted = new AbortController();
  const never = hub.find("x", () => undefined, aborted.signal);
  aborted.abort(new Error("not any more"));
  await assert.rejects(never, /not any more/);
  const closed = hub.find("x", () => undefined);
  hub.publish("x", 1);
  for await (const message of hub.follow("x")) {
    assert.equal(message, 1);
    break;
  }
  hub.close();
  assert.equal(await closed, undefined);
});
