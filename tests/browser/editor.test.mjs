// Programs on the real runtime: written with colours, search, help and findings in the margin; compared, renamed, shown when they
// are too long to be edited.

import assert from "node:assert/strict";
import { test } from "node:test";

import { pictures, takePictures } from "./pictures.mjs";
import { withPage, withRuntime } from "./runtime.mjs";
import { until } from "./screen.mjs";

const LONG_LINES = 100_000;

let runtime;
let browser;
let page;
let errors;
let screen;

withRuntime((made) => ({ runtime, browser } = made));
withPage(() => ({ runtime, browser }), (opened) => ({ page, errors, screen } = opened));
const dialog = () => page.getByRole("dialog", { name: "Program" });
const text = () => dialog().getByRole("textbox", { name: "Program text" });
const tool = (name) => dialog().getByRole("button", { name, exact: true });

async function store(number, program) {
  const answer = await fetch(`${runtime.url}/api/v1/programs/${number}`, { method: "PUT", body: program, headers: { "Content-Type": "text/plain" } });
  assert.ok(answer.ok, await answer.text());
}

async function stored(number) {
  const answer = await fetch(`${runtime.url}/api/v1/programs/${number}`);
  return answer.ok ? answer.text() : null;
}

async function edit(name) {
  await page.getByRole("button", { name: "Read again" }).click();
  await page.getByRole("button", { name: `Edit ${name}` }).click();
  await text().waitFor();
}

/** Writes a text in the place of the whole one. */
async function write(program) {
  await text().click();
  await page.keyboard.press("Control+A");
  await page.keyboard.press("Delete");
  await page.keyboard.insertText(program);
}

/** Text of the parts of a kind on a line, by their colour's variable. */
async function coloured(line) {
  return text().locator(".cm-line").nth(line).locator("span").allTextContents();
}

test("words have the colours of their kind, comments over several lines too, and line numbers stand beside them", async () => {
  await store(40, "// One\nN10 G01 X10 F500 // cut\n/1 M100 VA5\nwhile (L0 < 3) {\nL0 = L0 + 1\n}\n/* two\nG01 X9 */ M30\n");
  await edit("O0040");
  assert.deepEqual(await coloured(1), ["N10", "G01", "X", "// cut"]);
  assert.deepEqual(await coloured(2), ["/1", "M100", "VA"]);
  assert.deepEqual(await coloured(3), ["while", "L0"]);
  assert.deepEqual(await coloured(7), ["G01 X9 */", "M30"]);
  assert.equal(await dialog().locator(".cm-lineNumbers .cm-gutterElement").nth(8).textContent(), "8");
});

test("findings stand in the margin with their help, move with the text, and go when the text is right", async () => {
  await store(41, "G90\nG01 X1 X2 F500\nM30\n");
  await edit("O0041");
  await dialog().locator(".cm-lint-marker-error").hover();
  await dialog().locator(".cm-tooltip").getByText("X appears twice in the block").waitFor();
  await dialog().getByText("Line 2, column 8").waitFor();
  await text().click();
  await page.keyboard.press("Control+Home");
  await page.keyboard.type("// first\n// second\n");
  await tool("Go to line 2").click();
  await until(() => dialog().locator(".cm-activeLine").textContent(), "// second", "the line as the runtime counted it");
  await write("G90\nG01 X1 F500\nM30\n");
  await tool("Store").click();
  await dialog().getByText("O0041 is stored: no findings.").waitFor();
  assert.equal(await dialog().locator(".cm-lint-marker").count(), 0);
  assert.equal(await stored(41), "G90\nG01 X1 F500\nM30\n");
});

test("while somebody types, findings stand in the margin with their help, and nothing is stored", async () => {
  await store(60, "G90\nG01 X1 F500\nM30\n");
  await edit("O0060");
  await text().click();
  await page.keyboard.press("Control+Home");
  await page.keyboard.type("G01 X1 X2\n");
  await dialog().locator(".cm-lint-marker-error").hover();
  await dialog().locator(".cm-tooltip").getByText("X appears twice in the block").waitFor();
  await dialog().getByText("Current text: 1 error.").waitFor();
  await page.keyboard.press("Control+Home");
  for (let i = 0; i < 3; i += 1) await page.keyboard.press("Control+Delete");
  await page.keyboard.press("Control+Shift+K");
  await dialog().getByText("Current text: no findings.").waitFor();
  await dialog().locator(".cm-lint-marker").waitFor({ state: "detached" });
  assert.equal(await stored(60), "G90\nG01 X1 F500\nM30\n");
});

test("the meaning of a word is shown where the pointer rests, in the editor and in the program; nobody explains what has none", async () => {
  await store(61, "G90\nG01 X1 F500\nM30\n");
  await edit("O0061");
  await text().locator(".cm-line").nth(1).locator("span", { hasText: "G01" }).hover();
  await dialog().locator(".meaning-tip").getByText("Linear Interpolation").waitFor();
  await text().locator(".cm-line").nth(0).locator("span", { hasText: "G90" }).hover();
  await dialog().locator(".meaning-tip").getByText("Absolute command").waitFor();
  await tool("Close").click();
  await page.getByRole("button", { name: "Load O0061" }).click();
  const code = page.locator(".program-text .nc-g", { hasText: "G01" });
  await code.hover();
  await page.getByRole("tooltip").getByText("Linear Interpolation").waitFor();
  await page.mouse.move(5, 5);
  await page.getByRole("tooltip").waitFor({ state: "hidden" });
  await page.locator(".program-text .line-number").nth(1).click();
  await page.locator(".program-text .line[data-chosen]", { hasText: "G01" }).waitFor();
  await page.locator(".program-text").focus();
  await page.keyboard.press("F1");
  await page.getByRole("dialog", { name: /G01/ }).waitFor();
});

test("programs lie in folders: moved by a dialog and by dragging, closed, found in all, and kept by a new number", async () => {
  await page.setViewportSize({ width: 1280, height: 1600 });
  for (const number of [62, 63, 64]) await store(number, `// Part ${number}\nG90\nM30\n`);
  await page.getByRole("button", { name: "Read again" }).click();
  await page.getByRole("button", { name: "Move O0062 to a folder" }).click();
  const form = page.getByRole("dialog", { name: "Folder of O0062" });
  await form.getByLabel("Folder").fill("a//b");
  await form.getByRole("button", { name: "Move" }).click();
  await page.locator(".toast", { hasText: "write names with / between them" }).waitFor();
  await form.getByLabel("Folder").fill("parts/left");
  await form.getByRole("button", { name: "Move" }).click();
  const head = page.getByRole("button", { name: /^parts\/left/ });
  await head.waitFor();
  const folderOf = async (number) => (await (await fetch(`${runtime.url}/api/v1/programs`)).json()).programs.find((one) => one.number === number)?.folder;
  assert.equal(await folderOf(62), "parts/left");
  await page.getByLabel("Search programs").fill("part");
  await page.locator('[data-number="63"] .title').first().dragTo(head);
  await until(() => folderOf(63), "parts/left", "the folder of O0063");
  await page.getByLabel("Search programs").fill("");
  await head.click();
  await page.locator('[data-number="62"]').waitFor({ state: "detached" });
  await page.getByLabel("Search programs").fill("left part 62");
  await page.locator('[data-number="62"]').waitFor();
  await page.getByRole("button", { name: "Rename O0062" }).click();
  const renamed = page.getByRole("dialog", { name: "Rename O0062" });
  await renamed.getByLabel("New number").fill("65");
  await renamed.getByRole("button", { name: "Rename" }).click();
  await until(() => folderOf(65), "parts/left", "the folder of O0065");
  errors.splice(0, errors.length, ...errors.filter((line) => !/status of 400/.test(line)));
});

test("the word at the cursor is explained without leaving the editor", async () => {
  await store(42, "G90\nG01 X1 F500\nM30\n");
  await edit("O0042");
  await text().click();
  await page.keyboard.press("Control+Home");
  await page.keyboard.press("ArrowDown");
  await page.keyboard.press("F1");
  await dialog().getByRole("region", { name: "Meaning" }).getByText(/G01/).first().waitFor();
  await tool("Close the meaning").click();
  await text().click();
  assert.ok(await text().isVisible());
});

test("a word is searched and replaced; Escape closes the search and not the editor", async () => {
  await store(43, "G90\nG01 X1 F500\nG01 X2\nM30\n");
  await edit("O0043");
  await tool("Find").click();
  await dialog().getByPlaceholder("Find").fill("G01");
  await dialog().getByPlaceholder("Replace").fill("G00");
  await dialog().getByRole("button", { name: "replace all" }).click();
  await page.keyboard.press("Escape");
  await dialog().getByPlaceholder("Find").waitFor({ state: "detached" });
  await page.keyboard.press("Escape");
  await dialog().getByText("Not stored yet.").waitFor();
  await tool("Store").click();
  await dialog().getByText(/O0043 is stored/).waitFor();
  assert.equal(await stored(43), "G90\nG00 X1 F500\nG00 X2\nM30\n");
});

test("what is written is compared with the program in the store, and places are gone to", async () => {
  await store(44, `G90\n${"G01 X1 F500\n".repeat(60)}M30\n`);
  await edit("O0044");
  await text().click();
  await page.keyboard.press("Control+Home");
  await page.keyboard.type("// new\n");
  await tool("Compare").click();
  await dialog().getByText("1 difference from O0044 in the store").waitFor();
  await dialog().locator(".cm-changedLine", { hasText: "// new" }).waitFor();
  await dialog().getByText(/unchanged lines/).waitFor();
  await tool("Next difference").click();
  await tool("Compare").click();
  await dialog().locator(".cm-changedLine").waitFor({ state: "detached" });
});

test("a program that somebody else has stored meanwhile is not replaced; comparing shows what they did", async () => {
  await store(45, "G90\nM30\n");
  await edit("O0045");
  await store(45, "G91\nM30\n");
  await write("G90\nG04 P1\nM30\n");
  await tool("Store").click();
  await page.locator(".toast", { hasText: "which does not meet the condition" }).waitFor();
  assert.equal(await stored(45), "G91\nM30\n");
  await tool("Compare").click();
  await dialog().getByText(/differences? from O0045/).waitFor();
  errors.splice(0, errors.length, ...errors.filter((line) => !/status of 412/.test(line)));
});

test("a program gets another number, if that is free", async () => {
  await store(46, "// Moves\nG90\nM30\n");
  await store(47, "G91\nM30\n");
  await page.getByRole("button", { name: "Read again" }).click();
  await page.getByRole("button", { name: "Rename O0046" }).click();
  const form = page.getByRole("dialog", { name: "Rename O0046" });
  await form.getByLabel("New number").fill("47");
  await form.getByRole("button", { name: "Rename" }).click();
  await page.locator(".toast", { hasText: "which does not meet the condition" }).waitFor();
  await form.getByLabel("New number").fill("48");
  await form.getByRole("button", { name: "Rename" }).click();
  await page.getByText("O0046 is O0048 now.").waitFor();
  assert.deepEqual([await stored(46), await stored(47), await stored(48)], [null, "G91\nM30\n", "// Moves\nG90\nM30\n"]);
  errors.splice(0, errors.length, ...errors.filter((line) => !/status of 412/.test(line)));
});

test("a program that is loaded keeps its number", async () => {
  await screen.load("O0002");
  await screen.sees("READY");
  await page.getByRole("button", { name: "Rename O0002" }).click();
  await page.locator(".toast", { hasText: "O0002 is loaded in coordinate system 1" }).waitFor();
});

test("line ends of Windows stay, and a text that is not touched is stored byte for byte", async () => {
  await store(49, "G90\r\nM30\r\n");
  await edit("O0049");
  await text().click();
  await page.keyboard.press("Control+Home");
  await page.keyboard.type("G17 ");
  await tool("Store").click();
  await dialog().getByText(/O0049 is stored/).waitFor();
  assert.equal(await stored(49), "G17 G90\r\nM30\r\n");
  await tool("Close").click();
  await store(50, "G90\r\nG91\nM30\r\n");
  await edit("O0050");
  await dialog().getByLabel("Number").fill("51");
  await tool("Store").click();
  await dialog().getByText(/O0051 is stored/).waitFor();
  assert.equal(await stored(51), "G90\r\nG91\nM30\r\n");
});

test(`${LONG_LINES} lines are edited at their end, with as few elements as a short program`, async () => {
  // what a page costs does not depend on how long a runtime that was built for debugging takes for a check
  const found = { diagnostics: [], dialect: "nj", hash: "0".repeat(64), m_codes: [], o_number: null, programs: [], signature: null };
  await page.route(/\/check_text/, (route) => route.fulfill({ json: found }));
  await store(52, `${"G01 X1.25 Y2.5 F500\n".repeat(LONG_LINES - 1)}M30\n`);
  await edit("O0052");
  await text().click();
  await page.keyboard.press("Control+End");
  await page.keyboard.type("// end\n");
  await until(() => dialog().locator(".cm-activeLineGutter").first().textContent(), String(LONG_LINES + 2), "the line with the cursor");
  const elements = await text().evaluate((content) => content.querySelectorAll("*").length);
  assert.ok(elements < 2000, `${elements} elements`);
  await page.evaluate(() => {
    globalThis.tasks = [0];
    new PerformanceObserver((list) => globalThis.tasks.push(...list.getEntries().map(({ duration }) => duration))).observe({ type: "longtask" });
  });
  const longest = [];
  for (const _ of "abc") {
    const checked = page.waitForResponse((answer) => answer.url().includes("/check_text"));
    await page.keyboard.type("x");
    await (await checked).finished();
    longest.push(await page.evaluate(() => Math.max(...globalThis.tasks.splice(1), 0)));
  }
  assert.ok(longest.sort((a, b) => a - b)[1] < 50, `while somebody types the longest tasks of the page take ${longest} ms`);
  for (const _ of "abc") await page.keyboard.press("Backspace");
  await tool("Store").click();
  await dialog().getByText(/O0052 is stored/).waitFor();
  assert.ok((await stored(52)).endsWith("M30\n// end\n"));
});

test("a text too long to be edited is shown, read-only, and stored as it is", async () => {
  const lines = 250_000;
  const huge = `${"G01 X1.25 Y2.5\n".repeat(lines - 1)}M30 // twenty characters\n`.padEnd(4_000_001, "\n");
  await page.locator("input[type=file]").setInputFiles({ name: "O0053.nc", mimeType: "text/plain", buffer: Buffer.from(huge) });
  await dialog().getByText(/characters is too long to be edited here/).waitFor();
  await text().click();
  await page.keyboard.press("Control+Home");
  await page.keyboard.type("X");
  await until(() => text().locator(".cm-line").first().textContent(), "G01 X1.25 Y2.5", "the first line");
  await tool("Store").click();
  await dialog().getByText(/O0053 is stored/).waitFor();
  assert.equal((await stored(53)).length, huge.length);
});

pictures("the editor", async () => {
  await store(54, `// Flange\nN10 G17 G64 G90 G54\n/1 M100 VA1    // end mill\nN90 G01 X1 X2 F900\nL0 = 0\nwhile (L0 > -6) {\n    L0 = L0 - 2\n    N220 G03 I-7 Z[L0] F1800\n}\n${"G01 X1 Y2\n".repeat(60)}M30\n`);
  const said = await takePictures(browser, runtime.url, { editor: async (one) => {
    await one.getByRole("button", { name: "Edit O0054" }).click();
    await one.locator(".cm-lint-marker").first().waitFor();
  } });
  assert.deepEqual(said, []);
});
