// Debian's Chromium, driven by playwright-core; a page that remembers everything it complained about.

import { chromium } from "playwright-core";

import { wrongAnswer, wrongAsked, wrongFrame } from "./schemas.mjs";

const FLAGS = [
  "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
  "--disable-component-update", "--disable-sync",
];

export function launch() {
  return chromium.launch({ executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium", args: FLAGS });
}

/**
 * A page in its own context, with the list of its errors: what the console complains about, and each frame, request and
 * answer that is not of the form which the machine's documents name. `close` waits for the answers that are being read.
 */
export async function openPage(browser, options = {}) {
  const context = await browser.newContext({ viewport: { width: 1280, height: 800 }, ...options });
  const page = await context.newPage();
  const errors = [];
  page.on("console", (message) => {
    if (message.type() === "error") errors.push(message.text());
  });
  page.on("pageerror", (error) => errors.push(String(error)));
  const checked = await checkForms(page, (problem) => errors.push(problem));
  await page.addInitScript(() => {
    addEventListener("securitypolicyviolation", (event) => console.error(`CSP: ${event.violatedDirective} ${event.blockedURI}`));
  });
  const close = async () => {
    await page.evaluate(() => globalThis.answersRead?.()).catch(() => {});
    await context.close();
  };
  return { page, errors, checked, close };
}

/** Counts frames and answers, and tells those that are not of their form. */
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

/** In the page: reads a copy of each answer, also of one that the page does not read; an answer without an end is none. */
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
