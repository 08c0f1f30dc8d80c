// Additions of a machine builder without a build, on the real runtime: pages of a folder, buttons and cards of the
// configuration, pages of another server, and the package for them.

import assert from "node:assert/strict";
import { readFile } from "node:fs/promises";
import { createServer } from "node:http";
import { createRequire } from "node:module";
import { test } from "node:test";

import { openPage } from "./browser.mjs";
import { picture, pictures, SCHEMES, SIZES, takePictures } from "./pictures.mjs";
import { Runtime, withRuntime } from "./runtime.mjs";
import { disabled, enabled, Screen, until } from "./screen.mjs";

const AXE = await readFile(createRequire(import.meta.url).resolve("axe-core/axe.min.js"), "utf8");
const EXAMPLE = new URL("../../examples/hmi", import.meta.url).pathname;

/** Additions of the machine builder to the HMI. */
const ADDED = `
[hmi]
dir = "${EXAMPLE}"
[[hmi.button]]
text = "Lamp"
icon = "lamp.svg"
m_code = 100
confirm = "Turn the lamp on? It is bright."
[[hmi.button]]
text = "Park"
mdi = "G53 G00 X5 Y5"
states = ["READY", "PROGRAM_COMPLETED"]
[[hmi.button]]
text = "Oil is full"
variable = "P100"
value = 0
[[hmi.button]]
text = "Loader optional stop"
input = "optional_stop"
cs = 2
[[hmi.card]]
text = "Strokes"
variable = "P100"
unit = "strokes"
[[hmi.card]]
text = "Parts"
variable = "P101"
[[variables.published]]
from = "P101"
[[hmi.card]]
text = "Lamp"
m_code = 100
[[hmi.card]]
text = "Loader optional stop"
input = "optional_stop"
cs = 2
[[hmi.card]]
text = "Oil"
icon = "lamp.svg"
module = "oil.js"
`;

let browser;
let runtime;
withRuntime((made) => ({ runtime, browser } = made), (made) => made.add(ADDED));
async function send(method, path, body) {
  const answer = await fetch(`${runtime.url}/api/v1${path}`, { method, headers: { "Content-Type": "application/json" }, body: JSON.stringify(body) });
  assert.ok(answer.ok, `${path}: ${answer.status}`);
  return answer;
}

const p100 = async () => (await (await fetch(`${runtime.url}/api/v1/variables/p?from=100&count=1`)).json()).values[0];

async function findings(page) {
  await page.evaluate(AXE);
  const { violations } = await page.evaluate(() => globalThis.axe.run());
  return violations.map(({ id, nodes }) => `${id}: ${nodes.map(({ html }) => html).join(" ")}`);
}

test("the example page of a folder shows the machine by elements, commands it, and connects again by itself", async () => {
  const { page, errors, close } = await openPage(browser);
  await send("POST", "/cs/1/load?wait=1", { program: 1 });
  await page.goto(`${runtime.url}/hmi/`);
  const state = page.locator("tandem-state");
  await state.getByText("READY", { exact: true }).waitFor();
  assert.equal(await page.title(), "Mill: READY");
  await until(() => page.locator("tandem-dro dd").allTextContents(), (values) => values.length === 3 && values.every((value) => /^-?\d+\.\d{3}$/.test(value)), "the positions");
  await page.getByRole("button", { name: "Start" }).click();
  await page.locator("tandem-m-codes li", { hasText: "M8" }).waitFor();
  await state.getByText("WAIT", { exact: true }).waitFor();
  const drawn = () => page.locator("tandem-path").evaluate((path) => path.picture.statistics.lines);
  await until(drawn, (lines) => lines > 0, "the lines that are drawn");
  // an element removed from a page stops drawing, and draws again when inserted
  await page.evaluate(() => {
    globalThis.taken = document.querySelector("tandem-path");
    globalThis.holder = globalThis.taken.parentElement;
    globalThis.taken.remove();
  });
  await until(() => page.workers().length, 0, "workers of a page without a path");
  await page.evaluate(() => globalThis.holder.append(globalThis.taken));
  await until(() => page.workers().length, 1, "workers of a page with a path");
  await until(drawn, (lines) => lines > 0, "the lines that are drawn again");
  for (const scheme of SCHEMES) {
    await page.emulateMedia({ colorScheme: scheme });
    assert.deepEqual(await findings(page), [], `axe, ${scheme}`);
    for (const [width, height] of SIZES) {
      await page.setViewportSize({ width, height });
      await picture(page, `own-page-${width}-${scheme}`);
      assert.ok(await page.evaluate(() => document.documentElement.scrollWidth <= innerWidth), `sideways scroll at ${width}`);
    }
  }
  await page.getByRole("button", { name: "Resume" }).click();
  await page.getByText("WAIT, and resume is allowed in").or(page.locator("#said", { hasText: /\w/ })).first().waitFor();
  await runtime.kill();
  await page.locator("tandem-state:not([online])").getByText("Not connected").waitFor();
  await runtime.start();
  await page.locator("tandem-state[online]").getByText("STOPPED", { exact: true }).waitFor();
  await close();
  // messages of the browser itself about the refused command and the lost connection
  assert.deepEqual(errors.filter((error) => !/409|ERR_CONNECTION|WebSocket/.test(error)), []);
});

test("a page without a connection loads and sets with an age limit", async () => {
  const { page, close } = await openPage(browser);
  const bodies = [];
  page.on("request", (request) => {
    if (request.method() !== "GET") bodies.push([new URL(request.url()).pathname, request.postDataJSON()]);
  });
  await page.goto(`${runtime.url}/tandem.js`);
  const used = await page.evaluate(async () => {
    const { Tandem } = await import("/tandem.js");
    const machine = new Tandem();
    const { status } = await machine.command(1, "load", { program: 2 });
    await machine.put("/cs/1/work_offsets", { work_offsets: { G55: { X: 1 } } });
    await machine.put("/tools", { tools: [{ id: 7, length: 10, radius: 1 }] });
    const refused = async (path, body) => (await machine.request("POST", path, { body }).catch((error) => error)).problem.code;
    return { status, alarm: await refused("/alarms/999999/acknowledge", {}), stored: await refused("/stored_data/answer", { decision: "accept" }) };
  });
  assert.deepEqual(used, { status: "done", alarm: "not_found", stored: "not_allowed" });
  const paths = bodies.map(([path]) => path.slice("/api/v1".length));
  assert.deepEqual(paths, ["/cs/1/load", "/cs/1/load", "/cs/1/work_offsets", "/tools", "/alarms/999999/acknowledge", "/stored_data/answer"]);
  for (const [path, { not_after }] of bodies) {
    const atMost = path.endsWith("/load") ? 5000 : 1000;
    assert.ok(not_after?.within_ms > 0 && not_after.within_ms <= atMost, `${path}: ${JSON.stringify(not_after)}`);
  }
  await close();
});

test("a page that cannot read a heartbeat in time sends nothing", async () => {
  const { page, close } = await openPage(browser);
  const sent = [];
  page.on("request", (request) => request.method() !== "GET" && sent.push(request.url()));
  await page.goto(`${runtime.url}/tandem.js`);
  await page.route("**/api/v1/heartbeat", () => {});
  const text = await page.evaluate(async () => {
    const { Tandem } = await import("/tandem.js");
    return new Tandem().put("/tools", { tools: [] }).catch((error) => error.message);
  });
  assert.match(text, /The request did not reach the machine/);
  assert.deepEqual(sent, []);
  await close();
});

test("buttons and cards of the configuration are a panel: they run, ask, switch and show, and say why not", async () => {
  await send("POST", "/cs/1/reset?wait=1", {});
  const { page, errors, close } = await openPage(browser);
  const screen = new Screen(page);
  // published variables are not read
  await page.route(/variables\/p\?from=101/, (route) => route.abort());
  await page.goto(runtime.url);
  await page.getByRole("tab", { name: "Machine" }).click();
  const group = page.getByRole("group", { name: "Machine" });
  const card = (name) => page.getByRole("region", { name, exact: true });
  await send("PUT", "/variables/p?from=100", { values: [120] });
  await card("Strokes").getByText("120 strokes").waitFor();
  await card("Parts").getByText("0", { exact: true }).waitFor();
  await send("PUT", "/variables/p?from=101", { values: [7] });
  await card("Parts").getByText("7", { exact: true }).waitFor();
  await card("Oil").getByText("strokes left").waitFor();
  await card("Lamp").getByText("M100 is not open").waitFor();

  await group.getByRole("button", { name: "Oil is full" }).click();
  await until(p100, 0, "P100");
  await card("Strokes").getByText("0 strokes", { exact: true }).waitFor();

  const stop = group.getByRole("button", { name: "Loader optional stop" });
  await stop.click();
  await card("Loader optional stop").getByText("on", { exact: true }).waitFor();
  await stop.and(page.locator('[aria-pressed="true"]')).waitFor();

  const park = group.getByRole("button", { name: "Park" });
  await send("POST", "/cs/1/load?wait=1", { program: 2 });
  await enabled(park);
  await park.click();
  await until(async () => (await (await fetch(`${runtime.url}/api/v1/cs/1/position`)).json()).machine.X, 5, "X");

  const lamp = group.getByRole("button", { name: "Lamp" });
  await enabled(lamp);
  await lamp.click();
  await page.getByRole("dialog").getByText("It is bright").waitFor();
  await page.getByRole("dialog").getByRole("button", { name: "Lamp" }).click();
  await card("Lamp").getByText(/M100 is open/).waitFor();
  await disabled(park);
  assert.match(await park.getAttribute("aria-description"), /M code|run/);
  for (const scheme of SCHEMES) {
    await page.emulateMedia({ colorScheme: scheme });
    assert.deepEqual(await findings(page), [], `axe, ${scheme}`);
  }
  await close();
  assert.deepEqual(errors, []);
});

pictures("the panel of the machine builder", async () => {
  const show = async (page) => {
    await page.getByRole("tab", { name: "Machine" }).click();
    await page.getByText("strokes left").waitFor();
    assert.ok(await page.evaluate(() => document.documentElement.scrollWidth <= innerWidth), "sideways scroll");
  };
  assert.deepEqual(await takePictures(browser, runtime.url, { added: show }), []);
});

test("a page of another server uses the machine where its origin is allowed, with a token", async () => {
  const server = createServer((_, response) => response.setHeader("Content-Type", "text/html").end("<title>elsewhere</title>"));
  await new Promise((resolve) => server.listen(0, "127.0.0.1", resolve));
  const origin = `http://127.0.0.1:${server.address().port}`;
  const guarded = await Runtime.create();
  const token = await guarded.withToken("operate");
  await guarded.add(`allow_origins = ["${origin}"]`, "http");
  await guarded.add("websocket = true", "mqtt");
  try {
    await guarded.start();
    const { page, close } = await openPage(browser);
    await page.goto(origin);
    const used = await page.evaluate(async ({ url, token }) => {
      const { Tandem, Refusal } = await import(`${url}/tandem.js`);
      const stranger = new Tandem({ url, token: () => "guessed" });
      const refused = await stranger.get("/cs/1/state").catch((error) => error instanceof Refusal && error.problem.code);
      const machine = new Tandem({ url, token: () => token }).connect();
      const states = [];
      machine.on("cs/+/state", (state, topic) => states.push(`${topic} ${state.execution}`));
      const { hash } = await machine.command(1, "load", { program: 2 });
      while (!states.includes("cs/1/state READY")) await new Promise((resolve) => setTimeout(resolve, 20));
      machine.close();
      const socket = new WebSocket(`${url.replace("http", "ws")}/mqtt`, "mqtt");
      const opened = await new Promise((resolve) => {
        socket.onopen = () => resolve(true);
        socket.onerror = () => resolve(false);
      });
      return { refused, hash: hash.length, opened };
    }, { url: guarded.url, token });
    assert.deepEqual(used, { refused: "unauthorized", hash: 64, opened: true });
    await page.goto("about:blank");
    await close();
  } finally {
    server.close();
    await guarded.remove();
  }
});
