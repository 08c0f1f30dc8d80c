// The texts of the screen: one table for each language. Numbers, dates and lists have the format of the browser's locale.

import de from "../language/de.js";
import en from "../language/en.js";
import ja from "../language/ja.js";

/** @typedef {keyof typeof en} Key @typedef {string | {one?: string, other: string}} Text */
/** @typedef {Record<Key, Text>} Table every language has each text */

/** @type {Record<string, Table>} */
const TABLES = { en, de, ja };
/** Languages by their code, each with its own name. */
export const LANGUAGES = { en: "English", de: "Deutsch", ja: "日本語" };
const KEY = "tandem-language";

/** Locale for numbers and dates. */
export const locale = globalThis.navigator?.language || "en";
/** The code of the language of this page. */
export const language = known(chosenLanguage()) ?? known(globalThis.document?.documentElement.dataset.language) ?? preferred();

const table = TABLES[language] ?? en;
const plurals = new Intl.PluralRules(language);
/** @type {Map<number, Intl.NumberFormat>} */
const formats = new Map();

/**
 * Returns a text in the language of this page. Placeholders are replaced by values, numbers in the format of the
 * locale; in a text with a plural, `count` selects the form.
 * @param {Key} key @param {Record<string, string | number | null | undefined>} [values]
 */
export function t(key, values = {}) {
  const found = table[key];
  const form = typeof found === "string" ? found : (found[plurals.select(Number(values.count)) === "one" ? "one" : "other"] ?? found.other);
  return form.replace(/\{(\w+)\}/g, (_, name) => {
    const value = values[name] ?? "";
    return typeof value === "number" ? decimal(value, 0, 3) : value;
  });
}

/** Returns several parts as a list. @param {(string | number | false | null | undefined)[]} parts those that are nothing are left out */
export function listed(parts) {
  return parts.filter(Boolean).join(t("language.comma"));
}

/** Returns several sentences as one text. @param {...(string | false | null | undefined)} parts those that are nothing are left out */
export function sentences(...parts) {
  return parts.filter(Boolean).join(t("language.between_sentences"));
}

/** Formats a number with the decimal sign of the locale, without separators between thousands. @param {number} value @param {number} least decimals @param {number} most decimals */
export function decimal(value, least, most) {
  const key = least * 100 + most;
  let format = formats.get(key);
  if (!format) {
    format = new Intl.NumberFormat(locale, { minimumFractionDigits: least, maximumFractionDigits: most, useGrouping: false, numberingSystem: "latn", signDisplay: "negative" });
    formats.set(key, format);
  }
  return format.format(value).replace("\u2212", "-");
}

/** The language chosen by the operator; null: the browser's preference. */
export function chosenLanguage() {
  try {
    return globalThis.localStorage?.getItem(KEY) ?? null;
  } catch {
    return null;
  }
}

/** Stores a choice, and loads the page again in that language; false if this browser stores nothing. @param {string} code empty: the browser's preference */
export function chooseLanguage(code) {
  try {
    if (code === "") localStorage.removeItem(KEY);
    else localStorage.setItem(KEY, code);
  } catch {
    return false;
  }
  location.reload();
  return true;
}

/** @param {string | null | undefined} code */
function known(code) {
  return code && code in TABLES ? code : null;
}

/** Returns the first language of the browser that has a table. */
function preferred() {
  const wanted = globalThis.navigator?.languages ?? [];
  return wanted.map((one) => known(one.split("-")[0]?.toLowerCase())).find((one) => one !== null) ?? "en";
}

/** Texts of the text field of the editor. @returns {Record<string, string>} */
export function phrases() {
  return {
    Find: t("find.find"), Replace: t("find.replace_by"), next: t("find.next"), previous: t("find.previous"), all: t("find.all"), "match case": t("find.match_case"), regexp: t("find.regexp"), "by word": t("find.by_word"),
    replace: t("find.replace"), "replace all": t("find.replace_all"), close: t("common.close"), "current match": t("find.current_match"), "on line": t("find.on_line"), "replaced match on line $": t("find.replaced"),
    "replaced $ matches": t("find.replaced_all"), "Go to line": t("find.go_to_line"), go: t("find.go"), "$ unchanged lines": t("find.unchanged_lines"), Diagnostics: t("editor.findings"), "No diagnostics": t("findings.none"),
  };
}
