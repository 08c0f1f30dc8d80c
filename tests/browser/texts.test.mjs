// Every text of the HMI is in its tables, in each language.

import assert from "node:assert/strict";
import { readdir, readFile } from "node:fs/promises";
import { test } from "node:test";

import de from "../../web/language/de.js";
import en from "../../web/language/en.js";
import ja from "../../web/language/ja.js";
import { callsOfTexts, literalsIn, textsIn } from "./texts.mjs";

const WEB = new URL("../../web/", import.meta.url).pathname;
const TABLES = { en, de, ja };
/** Languages are called by their own names. */
const NAMES = ['"English"', '"Deutsch"'];

const files = (await readdir(WEB, { recursive: true })).filter((name) => name.endsWith(".js") && !/^(vendor|language)\//.test(name));
const sources = await Promise.all(files.map(async (name) => ({ name, source: await readFile(WEB + name, "utf8") })));

/** Returns the placeholders of a text, in all its forms. */
function places(text) {
  const forms = typeof text === "string" ? [text] : Object.values(text);
  return [...new Set(forms.flatMap((form) => [...form.matchAll(/\{(\w+)\}/g)].map(([, name]) => name)))].sort();
}

test("no text stands in the code", () => {
  const found = sources.flatMap(({ name, source }) => textsIn(name, source).filter(({ text }) => !NAMES.includes(text)).map(({ line, text }) => `${name}:${line} ${text}`));
  assert.deepEqual(found, []);
});

test("no text stands in the pages, but for a browser without scripts in every language", async () => {
  for (const page of ["index.html", "api.html", "machines.html", "offline.html"]) {
    const source = await readFile(WEB + page, "utf8");
    const [body = ""] = source.split(/<body[^>]*>/).slice(1);
    const shown = body.replace(/<noscript>[^]*?<\/noscript>/g, "").replace(/<[^>]*>/g, "").trim();
    assert.equal(shown, "", page);
    assert.match(source, /<title>Tandem<\/title>/, page);
    assert.doesNotMatch(body, /(aria-label|title|alt|placeholder)=/, page);
  }
});

test("a text in the code is found, and what is none is not", () => {
  const texts = [
    'h("p", {}, "no")', 'h("p", {}, isOn ? "on" : other)', 'button({ title: "save" })', 'setText(note, `${count} lines`)', 'const says = "Press Start";', 'app.toast("gone", "error")',
    'setAttr(one, "aria-label", "close")', 'fill(box, h("b", {}, name), "then")', 'throw new Error("gone")', 'confirm({ yes: "end it" })', 'const NAMES = { 8: "Coolant on" };', 'c.fillText("zero", x, y)',
  ];
  for (const code of texts) assert.equal(textsIn("a.js", code).length, 1, code);
  const others = [
    'import { h } from "./dom.js";', 'h("p", { class: "muted note" })', 'setText(note, t("path.fit"))', 'if (text === "not found") {}', 'element.closest("input, select")', 'h("b", {}, "MQTT")', 'switch (a) { case "Big one": }',
    'setAttr(one, "aria-hidden", "true")', 'const STYLE = `p { margin: 0; }\\n`;', 'names["Big one"]', 'throw new TypeError("give an address")',
  ];
  for (const code of others) assert.deepEqual(textsIn("a.js", code), [], code);
});

test("each text that is used is in the table, and each in the table is used", async () => {
  const offline = await readFile(`${WEB}offline.html`, "utf8");
  const used = new Set([...sources.flatMap(({ name, source }) => literalsIn(name, source)), ...[...offline.matchAll(/data-text="([^"]+)"/g)].map(([, key]) => key)]);
  assert.deepEqual(Object.keys(en).filter((key) => !used.has(key)), [], "nothing uses these");
  const asked = sources.flatMap(({ name, source }) => callsOfTexts(name, source).flatMap(({ keys, line }) => keys.map((key) => ({ key, at: `${name}:${line}` }))));
  assert.deepEqual(asked.filter(({ key }) => !(key in en)), []);
});

test("a text gets a value for each of its places, and no other", () => {
  for (const { name, source } of sources) {
    for (const { keys, values, line } of callsOfTexts(name, source)) {
      const wanted = [...new Set(keys.flatMap((key) => [...places(en[key]), ...(typeof en[key] === "string" ? [] : ["count"])]))].sort();
      if (values) assert.deepEqual(values, wanted, `${name}:${line} ${keys}`);
    }
  }
});

test("each language has every text, with the same places and the plurals that it has", () => {
  for (const [language, table] of Object.entries(TABLES)) {
    assert.deepEqual(Object.keys(table).sort(), Object.keys(en).sort(), language);
    const forms = new Intl.PluralRules(language).resolvedOptions().pluralCategories.filter((form) => ["one", "other"].includes(form)).sort();
    for (const [key, text] of Object.entries(table)) {
      assert.deepEqual(places(text), places(en[key]), `${language} ${key}`);
      assert.equal(typeof text, typeof en[key], `${language} ${key}`);
      if (typeof text !== "string") assert.ok("other" in text && Object.keys(text).every((form) => forms.includes(form)), `${language} ${key}: ${Object.keys(text)} of ${forms}`);
      for (const form of typeof text === "string" ? [text] : Object.values(text)) assert.equal(form.trim() === "", en[key].toString().trim() === "", `${language} ${key} is empty`);
    }
  }
});

test("what is a sentence in English is one in every language", () => {
  for (const [language, table] of Object.entries(TABLES)) {
    for (const [key, text] of Object.entries(table)) {
      const [form, other] = [text, en[key]].map((one) => (typeof one === "string" ? one : one.other));
      const ends = (one) => /[.。?？]$/.test(one.trim());
      // a text that ends with a value is a sentence if the value is a sentence
      if (ends(other) && !/\{\w+\}[.]?$/.test(other)) assert.ok(ends(form), `${language} ${key}: ${form}`);
    }
  }
});
