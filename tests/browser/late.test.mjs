// Late requests: through a proxy that holds its data, and from a suspended browser.

import assert from "node:assert/strict";
import { readFileSync, readdirSync } from "node:fs";
import { createServer, connect } from "node:net";
import { once } from "node:events";
import { after, afterEach, before, beforeEach, test } from "node:test";
import { setTimeout as sleep } from "node:timers/promises";

import { openPage } from "./browser.mjs";
import { freePort, withRuntime } from "./runtime.mjs";
import { Screen } from "./screen.mjs";

/** Longer than the age limit of a press, ms. */
const LATE_MS = 3000;

/** Forwards connections to the runtime under the runtime's address; while it is held, data waits in it. */
class Proxy {
  #held = false;
  /** @type {Set<import("node:net").Socket>} */
  #sockets = new Set();

  async open(target) {
    const { hostname, port } = new URL(target);
    this.server = createServer((near) => {
      const far = connect(Number(port), hostname);
      const own = `${hostname}:${this.server.address().port}`;
      for (const [one, other] of [[near, far], [far, near]]) {
        this.#sockets.add(one);
        // Host and Origin name the runtime
        one.on("data", (data) => other.write(data.toString("latin1").replaceAll(own, `${hostname}:${port}`), "latin1"));
        one.on("error", () => other.destroy());
        one.on("close", () => {
          this.#sockets.delete(one);
          other.end();
        });
        if (this.#held) one.pause();
      }
    });
    this.server.listen(await freePort(), "127.0.0.1");
    await once(this.server, "listening");
    this.url = `http://127.0.0.1:${this.server.address().port}`;
    return this;
  }

  hold() {
    this.#held = true;
    this.#sockets.forEach((socket) => socket.pause());
  }

  release() {
    this.#held = false;
    this.#sockets.forEach((socket) => socket.resume());
  }

  close() {
    this.#sockets.forEach((socket) => socket.destroy());
    this.server.close();
  }
}

let browser;
let runtime;
let proxy;
let page;
let close;
let screen;

withRuntime((made) => ({ runtime, browser } = made));

const read = async (path) => (await fetch(`${runtime.url}/api/v1${path}`)).json();
const message = () => page.getByText(/did not reach the machine/).first();

beforeEach(async () => {
  proxy = await new Proxy().open(runtime.url);
  ({ page, close } = await openPage(browser));
  screen = new Screen(page);
  await page.goto(proxy.url);
  await page.getByText("Connected", { exact: true }).waitFor();
  await screen.load("O0002");
  await screen.sees("READY");
});

afterEach(async () => {
  await fetch(`${runtime.url}/api/v1/cs/1/stop?wait=1`, { method: "POST" });
  await fetch(`${runtime.url}/api/v1/cs/1/reset?wait=1`, { method: "POST" });
  await close();
  proxy.close();
});

/** Presses Start while the connection to the machine is held, and checks the machine after the release. */
async function pressLate(hold, release) {
  const before = await read("/cs/1/state");
  await hold();
  const start = screen.command("Start");
  await start.click();
  await start.and(page.locator("[data-pending]")).waitFor();
  await sleep(LATE_MS);
  await release();
  await message().waitFor();
  await nothingMoved(before);
}

/** Checks for as long as the press was late that no run begins. */
async function nothingMoved(before) {
  await sleep(LATE_MS);
  const state = await read("/cs/1/state");
  assert.equal(state.execution, "READY", "nothing was started");
  assert.equal(state.run_id, before.run_id);
  assert.equal((await read("/cs/1/position")).machine.X, 0, "nothing has moved");
  await page.locator("[data-pending]").waitFor({ state: "detached" });
}

test("a Start that the network delivers 3 s late does not move the machine, and the page says so", async () => {
  await pressLate(() => proxy.hold(), () => proxy.release());
});

test("a Start that a suspended browser sends 3 s late does not move the machine, and the page says so", async () => {
  const network = networkProcess();
  await pressLate(() => process.kill(network, "SIGSTOP"), () => process.kill(network, "SIGCONT"));
});

test("a Start that is pressed while the page is suspended does not move the machine, and the page says so", async () => {
  const renderers = processes("--type=renderer");
  const before = await read("/cs/1/state");
  const { x, y, width, height } = await screen.command("Start").boundingBox();
  renderers.forEach((pid) => process.kill(pid, "SIGSTOP"));
  // the browser keeps the press until the page continues
  const pressed = page.mouse.click(x + width / 2, y + height / 2);
  await sleep(LATE_MS);
  renderers.forEach((pid) => process.kill(pid, "SIGCONT"));
  await pressed;
  await message().waitFor();
  await nothingMoved(before);
});

test("a press that the page handles 3 s late is 3 s old, though the page has received newer heartbeats", async () => {
  const session = await page.context().newCDPSession(page);
  const before = await read("/cs/1/state");
  const { x, y, width, height } = await screen.command("Start").boundingBox();
  // a press cannot be older than its page
  await page.waitForFunction((ms) => performance.now() > ms, 2 * LATE_MS);
  const at = { x: x + width / 2, y: y + height / 2, button: "left", clickCount: 1, timestamp: (Date.now() - LATE_MS) / 1000 };
  for (const type of ["mousePressed", "mouseReleased"]) await session.send("Input.dispatchMouseEvent", { type, ...at });
  await message().waitFor();
  await nothingMoved(before);
});

test("a Start that a frozen page has not sent does not move the machine after the page goes on", async () => {
  const session = await page.context().newCDPSession(page);
  const before = await read("/cs/1/state");
  await proxy.hold();
  await screen.command("Start").click();
  await session.send("Page.setWebLifecycleState", { state: "frozen" });
  await sleep(LATE_MS);
  proxy.release();
  await sleep(LATE_MS);
  await session.send("Page.setWebLifecycleState", { state: "active" });
  await message().waitFor();
  await nothingMoved(before);
});

test("a Start that reaches the machine at once runs, and is pending no longer", async () => {
  await screen.command("Start").click();
  await screen.sees("ACTIVE");
  await page.locator("[data-pending]").waitFor({ state: "detached" });
  assert.equal(await message().count(), 0);
});

/** The process of this browser that sends its requests. */
function networkProcess() {
  const [found] = processes("network.mojom.NetworkService");
  assert.ok(found, "the browser has a network process");
  return found;
}

/** Processes of this browser whose command lines have these words. */
function processes(words) {
  const children = new Map();
  for (const pid of readdirSync("/proc").filter((name) => /^\d+$/.test(name))) {
    try {
      const parent = readFileSync(`/proc/${pid}/stat`, "utf8").match(/\) \w (\d+)/)[1];
      children.set(Number(pid), { parent: Number(parent), line: readFileSync(`/proc/${pid}/cmdline`, "utf8") });
    } catch {
      // it has ended meanwhile
    }
  }
  const isOwn = (pid) => pid === process.pid || (children.has(pid) && isOwn(children.get(pid).parent));
  return [...children].filter(([pid, { line }]) => line.includes(words) && isOwn(pid)).map(([pid]) => pid);
}
