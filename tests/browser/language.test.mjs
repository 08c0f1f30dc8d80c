// The screen in German and Japanese on the real runtime: no word of English is left in any view, and nothing overflows.

import assert from "node:assert/strict";
import { test } from "node:test";

import de from "../../web/language/de.js";
import en from "../../web/language/en.js";
import ja from "../../web/language/ja.js";
import { openPage } from "./browser.mjs";
import { picture } from "./pictures.mjs";
import { withRuntime } from "./runtime.mjs";
import { until } from "./screen.mjs";

const TABLES = { en, de, ja };
/** The parts of the screen are opened in the last size. */
const SIZES = [[390, 844], [1280, 800]];
/** Texts that are equal in every language. */
const SHARED = new Set("tandem mill json mqtt iso sha ctrl page".split(" "));

let runtime;
let browser;
withRuntime((made) => ({ runtime, browser } = made));

/** Words of three letters or more. */
function words(text) {
  return text.toLowerCase().match(/[a-z]{3,}/g) ?? [];
}

/** All words of a table. */
function wordsOf(table) {
  const forms = Object.values(table).flatMap((text) => (typeof text === "string" ? [text] : Object.values(text)));
  return new Set(forms.flatMap((form) => words(form.replace(/\{\w+\}/g, " "))));
}

/** Records the runtime's texts in messages and answers, which are shown unchanged. */
function listen(page) {
  const said = new Set();
  const take = (value) => {
    if (typeof value === "string") said.add(value);
    else if (value && typeof value === "object") for (const [name, part] of Object.entries(value)) take(name) ?? take(part);
  };
  const read = (text) => {
    try {
      take(JSON.parse(text));
    } catch {
      for (const line of text.split("\n")) said.add(line);
    }
  };
  page.on("websocket", (socket) => socket.on("framereceived", ({ payload }) => read(String(payload))));
  page.on("response", async (response) => {
    if (response.url().includes("/api/v1/")) read(await response.text().catch(() => ""));
  });
  return said;
}

/** In the page: returns texts that are visible or read aloud, and elements that extend beyond the screen or their button. */
function look() {
  const texts = [];
  const outside = [];
  const isSeen = (element) => element.checkVisibility({ visibilityProperty: true }) && element.getClientRects().length > 0;
  const scrolls = (element) => {
    for (let one = element; one; one = one.parentElement) if (/auto|scroll/.test(getComputedStyle(one).overflowX) && one.scrollWidth > one.clientWidth) return true;
    return false;
  };
  const see = (root) => {
    for (const element of root.querySelectorAll("*")) {
      if (element.shadowRoot) see(element.shadowRoot);
      if (!isSeen(element) || element.closest(".program-text, .cm-content, kbd, .hash")) continue;
      for (const name of ["aria-label", "aria-description", "aria-valuetext", "title", "placeholder", "alt"]) if (element.hasAttribute(name)) texts.push(element.getAttribute(name));
      for (const node of element.childNodes) {
        if (node.nodeType !== Node.TEXT_NODE || node.data.trim() === "") continue;
        texts.push(node.data);
        const range = document.createRange();
        range.selectNodeContents(node);
        const { left, right, width } = range.getBoundingClientRect();
        const box = element.closest("button, .tab, .badge, .chip, th")?.getBoundingClientRect();
        const isCut = getComputedStyle(element).textOverflow === "ellipsis" || element.closest(".visually-hidden, option, [hidden]");
        if (width === 0 || isCut || scrolls(element)) continue;
        if (left < -1 || right > innerWidth + 1) outside.push(`${node.data}: ${Math.round(left)} to ${Math.round(right)} of ${innerWidth}`);
        if (box && (left < box.left - 1 || right > box.right + 1)) outside.push(`${node.data}: ${Math.round(right - left)} in ${Math.round(box.width)} of <${element.closest("button, .tab, .badge, .chip, th").className}>`);
      }
    }
  };
  see(document.body);
  if (document.documentElement.scrollWidth > innerWidth) outside.push(`the page is ${document.documentElement.scrollWidth} of ${innerWidth} wide`);
  return { texts: [document.title, ...texts], outside: [...new Set(outside)] };
}

/** Opens each part of the screen, one after the other; `say` returns a text in the language of the screen. */
const PARTS = {
  async programs() {},
  async by_hand(page) {
    await page.locator("#panel-tab-by-hand").click();
  },
  async offsets(page, say) {
    await page.locator("#panel-tab-set-up").click();
    await page.getByRole("radio", { name: say("offsets.offsets"), exact: true }).click();
    await page.locator(".offset-row").first().waitFor();
  },
  async tools(page, say) {
    await page.getByRole("radio", { name: say("tools.tools"), exact: true }).click();
  },
  async variables(page, say) {
    await page.getByRole("radio", { name: say("variables.variables"), exact: true }).click();
  },
  async m_buttons(page, say) {
    await page.getByRole("radio", { name: say("m_buttons.m_codes"), exact: true }).click();
  },
  async far(page) {
    await page.keyboard.press("f");
    await page.locator(".far").waitFor();
  },
  async shortcuts(page) {
    await page.keyboard.press("f");
    await page.keyboard.press("?");
  },
  async user(page) {
    await page.keyboard.press("Escape");
    await page.locator("button.user").click();
  },
  async history(page) {
    await page.keyboard.press("Escape");
    await page.keyboard.press("t");
    await page.locator(".dialog.history").waitFor();
  },
  async journal(page, say) {
    await page.getByRole("radio", { name: say("history.journal"), exact: true }).click();
    await page.locator(".history-table tbody tr").first().waitFor();
  },
  async curves(page, say) {
    await page.getByRole("radio", { name: say("history.curves"), exact: true }).click();
  },
  async past_alarms(page, say) {
    await page.getByRole("radio", { name: say("history.past_alarms"), exact: true }).click();
  },
  async editor(page, say) {
    await page.keyboard.press("Escape");
    await page.keyboard.press("p");
    await page.getByRole("button", { name: say("programs.edit", { program: "O0001" }) }).click();
    await page.getByRole("button", { name: say("editor.find"), exact: true }).click();
  },
  async rename(page, say) {
    await page.locator(".editor-foot button").first().click();
    await page.getByRole("button", { name: say("programs.rename", { program: "O0002" }) }).click();
  },
  async order(page, say) {
    await page.keyboard.press("Escape");
    await page.getByRole("button", { name: say("programs.run_parts", { program: "O0002" }) }).click();
  },
  async remove(page, say) {
    await page.keyboard.press("Escape");
    await page.getByRole("button", { name: say("programs.delete", { program: "O0002" }) }).click();
  },
  async loaded(page, say) {
    await page.keyboard.press("Escape");
    await page.getByRole("button", { name: say("programs.load", { program: "O0001" }) }).click();
    await page.locator('.status[data-execution="READY"]').waitFor();
    await page.getByRole("button", { name: say("rehearse.times"), exact: true }).waitFor();
    await page.locator(".path-summary").filter({ hasText: /\d/ }).waitFor();
  },
  async times(page, say) {
    await page.getByRole("button", { name: say("rehearse.times"), exact: true }).click();
    await page.locator(".rehearsal-table").first().waitFor();
  },
  async from_a_line(page) {
    await page.keyboard.press("Escape");
    await page.locator(".line .line-number").nth(4).click();
    await page.locator(".program-card .card-tools button").first().click();
    await page.locator(".line-state .facts").waitFor();
  },
  async waiting(page) {
    await page.keyboard.press("Escape");
    await page.locator(".command.start").click();
    await page.locator('.status[data-execution="WAIT"]').waitFor();
    await page.locator(".output").first().waitFor();
  },
  async ending(page) {
    await page.locator(".command.reset").click();
    await page.locator(".dialog.confirm").waitFor();
  },
  async stopped(page) {
    await page.keyboard.press("Escape");
    await page.locator(".command.stop").click();
    await page.locator('.status[data-execution="STOPPED"]').waitFor();
    await page.locator(".command.reset").click();
    await page.locator('.status[data-execution="READY"]').waitFor();
  },
  async machines(page) {
    await page.evaluate(() => localStorage.setItem("tandem-machines", '["http://127.0.0.1:9"]'));
    await page.goto(`${runtime.url}/machines`);
    await page.locator('.machine-tile[data-link="online"] .machine-system').first().waitFor();
    await page.locator('.machine-tile[data-link="unreachable"]').waitFor();
  },
};

test("the language is the browser's until one is chosen, which stays; numbers are the browser's, and are typed with either sign", async () => {
  const { page, errors, close } = await openPage(browser, { locale: "de-CH" });
  await page.goto(runtime.url);
  await page.locator('tr[data-axis="X"] td.work').filter({ hasText: "." }).waitFor();
  await page.locator("#panel-tab-by-hand").click();
  await page.getByLabel("Eigener Schritt, mm").fill("0,25");
  await until(() => page.locator('[data-jog="X+"]').getAttribute("aria-label"), "X plus verfahren: ein Schritt von 0.25 mm");
  await close();

  const german = await openPage(browser, { locale: "de-DE" });
  await german.page.goto(runtime.url);
  await german.page.locator('tr[data-axis="X"] td.work').filter({ hasText: /^-?\d+,\d{3}$/ }).waitFor();
  await german.page.locator("#panel-tab-set-up").click();
  const stored = async () => (await (await fetch(`${runtime.url}/api/v1/cs/1/work_offsets`)).json()).work_offsets.G55.X;
  await german.page.getByRole("radio", { name: "G55" }).click();
  for (const [typed, value] of [["1,5", 1.5], ["-2.25", -2.25]]) {
    await german.page.getByLabel("Verschiebung X").fill(typed);
    await german.page.getByLabel("Verschiebung X").press("Enter");
    await until(stored, value);
  }
  await german.page.getByLabel("Verschiebung X").fill("1.234,5");
  await german.page.getByLabel("Verschiebung X").press("Enter");
  await until(() => german.page.getByLabel("Verschiebung X").inputValue(), "-2,250");
  assert.equal(await stored(), -2.25);
  await german.page.locator("button.user").click();
  await Promise.all([german.page.waitForEvent("load"), german.page.getByLabel("Sprache").selectOption("ja")]);
  for (let again = 0; again < 2; again += 1) {
    await german.page.getByText("接続中", { exact: true }).waitFor();
    assert.equal(await german.page.evaluate(() => document.documentElement.lang), "ja");
    await german.page.locator('tr[data-axis="X"] td.work').filter({ hasText: "," }).waitFor();
    await german.page.reload();
  }
  await german.close();
  assert.deepEqual([...errors, ...german.errors], []);
});

test("elements of a page of one's own speak the language of that page", async () => {
  const { page, errors, close } = await openPage(browser, { locale: "de" });
  await page.addInitScript(() => document.addEventListener("readystatechange", () => (document.documentElement.dataset.language = "ja"), { once: true }));
  await page.goto(runtime.url);
  const said = await page.evaluate(async () => {
    await import("/tandem/elements.js");
    const element = document.createElement("tandem-m-codes");
    document.body.append(element);
    return [element.lang, element.shadowRoot.textContent];
  });
  assert.equal(said[0], "ja");
  assert.ok(said[1].includes(ja["elements.no_m_code_is_open"]), said[1]);
  await close();
  assert.deepEqual(errors, []);
});

for (const language of ["de", "ja"]) {
  const table = TABLES[language];
  const own = wordsOf(table);
  const english = new Set([...wordsOf(en)].filter((word) => !own.has(word) && !SHARED.has(word)));
  const say = (key, values = {}) => table[key].replace(/\{(\w+)\}/g, (_, name) => values[name]);
  test(`no word of English is left, and nothing overflows: ${language}`, async () => {
    const { page, errors, close } = await openPage(browser, { locale: language });
    page.setDefaultTimeout(15_000);
    const said = listen(page);
    await page.goto(runtime.url);
    await page.locator(".link[data-online=true]").waitFor();
    assert.equal(await page.evaluate(() => document.documentElement.lang), language);
    const found = [];
    for (const [name, open] of Object.entries(PARTS)) {
      await open(page, say);
      for (const [width, height] of SIZES) {
        await page.setViewportSize({ width, height });
        await page.evaluate(() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done))));
        await picture(page, `language-${language}-${width}-${name}`);
        const { texts, outside } = await page.evaluate(look);
        found.push(...leftOver(texts, said, english).map((text) => `${name}: ${text}`), ...outside.map((text) => `${name} at ${width}: ${text}`));
      }
    }
    await close();
    assert.deepEqual([...new Set(found)], []);
    // the address of the second machine does not answer
    assert.deepEqual(errors.filter((text) => !text.includes("net::ERR_")), []);
  });
}

/** Returns texts with words that only English has and that do not come from the runtime. */
function leftOver(texts, said, english) {
  // the screen begins its sentences with a capital, and writes names without underscores
  const plain = (text) => text.toLowerCase().replaceAll("_", " ");
  const isEnglish = (text) => words(text).some((word) => english.has(word));
  const suspects = [...new Set(texts)].filter((text) => isEnglish(plain(text)));
  if (suspects.length === 0) return [];
  const told = [...said].map(plain).filter((text) => text.length > 2).sort((a, b) => b.length - a.length);
  return suspects.filter((text) => isEnglish(told.reduce((left, one) => (left.includes(one) ? left.replaceAll(one, " ") : left), plain(text))));
}
