// The HMI and the page of the interface on a machine that requires tokens.

import assert from "node:assert/strict";
import { after, before, test } from "node:test";

import { launch, openPage } from "./browser.mjs";
import { Runtime } from "./runtime.mjs";

let browser;
let runtime;
let token;

before(async () => {
  runtime = await Runtime.create();
  token = await runtime.withToken("operate");
  await runtime.withPerson("anna", "operate", "493021");
  await runtime.start();
  browser = await launch();
});

after(async () => {
  await browser?.close();
  await runtime?.remove();
});

test("the screen asks for a token until it has a right one, and then connects", async () => {
  const { page, errors, close } = await openPage(browser);
  await page.goto(runtime.url);
  const enter = async (text) => {
    await page.getByRole("textbox", { name: "Token" }).fill(text);
    await page.getByRole("button", { name: "Enter" }).click();
  };
  await enter("guessed");
  await page.getByText("does not know this token").waitFor();
  await enter(token);
  await page.getByText("Connected", { exact: true }).waitFor();
  await close();
  // two attempts without a valid token, which the browser itself reports
  assert.deepEqual(errors.filter((error) => !error.includes("401")), []);
});

test("the screen asks for a token also while the machine refuses too many requests", async () => {
  const { page, close } = await openPage(browser);
  const problem = { type: "about:blank", title: "too many", status: 429, code: "too_many_requests", detail: "send it again" };
  await page.route("**/api/v1/machine", (route) => route.fulfill({ status: 429, contentType: "application/problem+json", body: JSON.stringify(problem) }));
  await page.goto(runtime.url);
  await page.getByRole("textbox", { name: "Token" }).waitFor();
  await close();
});

test("a person logs in with a name and a PIN, and is told when the PIN is another", async () => {
  const { page, errors, close } = await openPage(browser);
  await page.goto(runtime.url);
  const enter = async (pin) => {
    await page.getByLabel("User", { exact: true }).fill("anna");
    await page.getByLabel("PIN", { exact: true }).fill(pin);
    await page.getByRole("button", { name: "Enter" }).click();
  };
  await enter("000000");
  await page.getByText("there is no such user with this PIN").waitFor();
  await enter("493021");
  await page.getByText("Connected", { exact: true }).waitFor();
  await close();
  assert.deepEqual(errors.filter((error) => !error.includes("401")), []);
});

test("the page of the interface shows routes and topics, and loads nothing from elsewhere", async () => {
  const { page, errors, close } = await openPage(browser);
  const hosts = new Set();
  page.on("request", (request) => hosts.add(new URL(request.url()).origin));
  await page.goto(`${runtime.url}/api`);
  const start = page.locator("details").filter({ has: page.getByText("/api/v1/cs/{cs}/start", { exact: true }) });
  await start.locator("summary").click();
  await start.getByText("Starts the loaded program, from its beginning or from a line.").waitFor();
  await page.getByText("tandem/v1/{machine}/cs/{cs}/state", { exact: true }).waitFor();
  await close();
  assert.deepEqual([...hosts], [runtime.url]);
  assert.deepEqual(errors, []);
});
