// Driver for the actions of `behaviours.toml`, by tandem-plc: `node driver.mjs ADDRESS REDELIVERY RETURNS_WITHIN_MS
// ENDS_WITHIN_MS`.

import { createInterface } from "node:readline";

import { OutputEnded, RequestRefused, SequenceProgram, TandemError, UserAlarm } from "../../../clients/node/src/index.js";

const [address, redelivery, returnsWithinMs, endsWithinMs] = process.argv.slice(2);
const EMPTY = new UserAlarm(23, "the tank is empty", {
  remedy: "Fill the tank.",
  languages: { de: { text: "der Tank ist leer", remedy: "Tank füllen." } },
});
const say = (text) => process.stdout.write(`> ${text}\n`);
const pocket = (params) => params.real("A", 1, 24, "the pocket");

/** Handlers that wait for `go`, and `go`s that arrived before a handler waited. */
const waiting = [];
let told = 0;

function go() {
  const next = waiting.shift();
  if (next === undefined) told += 1;
  else next();
}

async function untilGo(signal) {
  if (told > 0) {
    told -= 1;
    return;
  }
  await new Promise((resolve, reject) => {
    waiting.push(resolve);
    signal.addEventListener("abort", () => {
      waiting.splice(waiting.indexOf(resolve), 1);
      reject(signal.reason);
    });
  });
}

async function work(output) {
  output.progress("it works", 50);
  say(output.redelivered ? "work M22 verify" : "work M22");
  try {
    await untilGo(output.signal);
  } catch (error) {
    if (error instanceof OutputEnded) say(`cancelled M22 ${error.reason}`);
    throw error;
  }
  say("done M22");
}

async function wash(output) {
  const done = output.lastCheckpoint ?? 0;
  output.checkpoint(done + 3);
  output.progress(`noted ${done + 3}`);
  say(`work M25 from ${done}`);
  await untilGo(output.signal);
  say("done M25");
}

const program = new SequenceProgram("driver", redelivery === "none" ? {} : { redelivery })
  .on(20, ({ params }) => say(`work M20 VA${pocket(params)}${params.B === undefined ? "" : ` VB${params.B}`}`), { validate: pocket })
  .on(21, async (output) => say(`answer ${await output.ask("Shall it go on?", ["yes", "no"])}`))
  .on(22, work)
  .on(25, wash, { redelivery: "redo" })
  .on(23, () => {
    throw EMPTY.alarm();
  })
  .on(24, () => {
    throw new TypeError("a mistake of the handler");
  })
  .alarms(EMPTY);

async function carryOut(mill, verb, rest) {
  if (verb === "load") return mill.load(Number(rest));
  if (verb === "mdi") return mill.mdi(rest);
  if (verb === "start") return mill.start(rest === "" ? {} : { commandId: rest });
  return mill.command(verb);
}

/** `NAME on|off|NUMBER` writes an output, `wait on|off` waits for the lamp. */
async function withIo(plc, name, word) {
  if (name === "wait") {
    const value = await plc.ioOut("lamp").waitUntil((now) => now === (word === "on"));
    return say(value ? "io on" : "io off");
  }
  try {
    await plc.ioOut(name).set(word === "on" || word === "off" ? word === "on" : Number(word));
    return say("io set");
  } catch (error) {
    if (error instanceof RequestRefused) return say("io refused");
    throw error;
  }
}

async function hear(plc, line) {
  const [verb, ...words] = line.split(" ");
  const rest = words.join(" ");
  const mill = plc.cs(1);
  if (verb === "go") return go();
  if (verb === "io") return withIo(plc, ...words);
  try {
    if (verb === "interlock") {
      await mill.setInterlock(rest === "on", "the door is open", { source: "door" });
      return say("interlock set");
    }
    await carryOut(mill, verb, rest);
    return say(`${verb} done`);
  } catch (error) {
    if (error instanceof RequestRefused) return say(`${verb} refused ${error.code}`);
    if (error instanceof TandemError) return say(`${verb} failed ${error.message}`);
    throw error;
  }
}

const serving = await program.serve(address);
const lines = createInterface({ input: process.stdin });
await new Promise((resolve, reject) => {
  const times = { returnsWithinMs: Number(returnsWithinMs), endsWithinMs: Number(endsWithinMs) };
  lines.on("line", (line) => {
    if (line === "end") resolve(undefined);
    else if (line === "leave") serving.leave(times).then(resolve, reject);
    else void hear(serving.plc, line);
  });
});
lines.close();
await serving.close();
say("ended");
