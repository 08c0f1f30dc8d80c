// Debian's Chromium, driven by playwright-core; a page that records all errors.

import { chromium } from "playwright-core";

import { wrongAnswer, wrongAsked, wrongFrame } from "./schemas.mjs";

const FLAGS = [
  "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
  "--disable-component-update", "--disable-sync",
];

export function launch() {
  return chromium.launch({ executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium", args: FLAGS });
}

/** Contexts of each browser by their options, each with a blank tab that keeps the process for the following pages. */
const contexts = new WeakMap();

async function contextOf(browser, options) {
  const known = contexts.get(browser) ?? new Map();
  contexts.set(browser, known);
  const key = JSON.stringify(options);
  if (!known.has(key)) {
    const context = await browser.newContext(options);
    const storage = await context.newCDPSession(await context.newPage());
    known.set(key, { context, storage });
  }
  return known.get(key);
}

/**
 * A new page, with the list of its errors: what the console complains about, and each frame, request and answer that is not of the
 * form which the machine's documents name. `close` waits for the answers that are being read, and forgets all that the page stored.
 */
export async function openPage(browser, { viewport = { width: 1280, height: 800 }, colorScheme = "light", ...options } = {}) {
  const { context, storage } = await contextOf(browser, options);
  const page = await context.newPage();
  await Promise.all([page.setViewportSize(viewport), page.emulateMedia({ colorScheme })]);
  const errors = [];
  const origins = new Set();
  page.on("framenavigated", (frame) => origins.add(new URL(frame.url()).origin));
  page.on("console", (message) => {
    if (message.type() === "error") errors.push(`${message.text()} ${message.location().url}`);
  });
  page.on("pageerror", (error) => errors.push(String(error)));
  const checked = await checkForms(page, (problem) => errors.push(problem));
  await page.addInitScript(() => {
    addEventListener("securitypolicyviolation", (event) => console.error(`CSP: ${event.violatedDirective} ${event.blockedURI}`));
  });
  const close = async () => {
    await page.evaluate(() => globalThis.answersRead?.()).catch(() => {});
    await page.close();
    for (const origin of origins) if (origin !== "null") await storage.send("Storage.clearDataForOrigin", { origin, storageTypes: "all" });
  };
  return { page, errors, checked, close };
}

/** Counts frames and answers, and reports those with an invalid form. */
async function checkForms(page, tell) {
  const checked = { frames: 0, asked: 0, answers: 0 };
  const see = (kind, problem) => {
    checked[kind] += 1;
    if (problem) tell(`not of its form: ${problem}`);
  };
  page.on("websocket", (socket) => {
    socket.on("framereceived", ({ payload }) => see("frames", wrongFrame(payload)));
    socket.on("framesent", ({ payload }) => see("asked", wrongAsked(payload)));
  });
  await page.exposeFunction("answered", (answer) => see("answers", wrongAnswer(answer)));
  await page.addInitScript(copyAnswers);
  return checked;
}

/** In the page: reads a copy of each answer, even if the page does not read it; an answer without an end is ignored. */
function copyAnswers() {
  const reading = [];
  const read = async (method, path, sent, response) => {
    const [type, body] = [response.headers.get("content-type") ?? "", await response.text()];
    await globalThis.answered({ method, path, sent, status: response.status, type, body });
  };
  const { fetch } = globalThis;
  globalThis.fetch = async (resource, init = {}) => {
    const response = await fetch(resource, init);
    const path = new URL(resource, location.href).pathname;
    const sent = typeof init.body === "string" ? init.body : null;
    if (path.startsWith("/api/v1/") && response.type !== "opaque") reading.push(read(init.method ?? "GET", path, sent, response.clone()).catch(() => {}));
    return response;
  };
  globalThis.answersRead = () => Promise.all(reading);
}
