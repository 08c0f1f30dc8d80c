// The journal: read by pages from the newest line back, filtered by the machine, and shown as a table.

import { dayAndTime, rounded } from "../text/format.js";
import { t } from "../text/language.js";
import { button, fill, h, setAttr, setText } from "../ui/dom.js";

/**
 * A line; its other members depend on its event.
 * @typedef {{event: string, ts: string | null, t_s: number | null, cs: number | null, boot_id: string} & Record<string, unknown>} Line
 */

/** Lines of one answer. */
export const PAGE_LINES = 1000;
/** Rows shown at once. */
const ROWS_MAX = 2000;
/** Delay between typing and the request, ms. */
const TYPED_MS = 300;

/** Members with columns of their own, or without meaning for a person. */
const HIDDEN = new Set(["event", "ts", "t_s", "cs", "boot_id", "hash", "n", "user", "client_id", "handler_id", "command_id", "program_hash"]);

/** Value for the machine, and text. @type {[string, string][]} */
const SINCE = [["", t("journal.all_kept")], ["1h", t("journal.last_hour")], ["8h", t("journal.last_8_hours")], ["24h", t("journal.last_day")], ["168h", t("journal.last_week")]];

const EVENTS = ["request", "command", "start", "end", "output", "claim", "reset", "question", "answer", "hold", "stop", "resume", "alarm", "warning", "program", "refused", "access", "lease", "force", "io_write", "io_lost", "inconsistency", "boot"];

/** @param {import("../main.js").App} app */
export function journal(app) {
  const cs = picker(t("journal.coordinate_system"), [["", t("journal.all")], ["0", t("journal.machine")], ...[...app.model.systems.keys()].map(String).map(same)]);
  const event = picker(t("journal.event"), [["", t("journal.all")], ...EVENTS.map(same)]);
  const since = picker(t("journal.since"), SINCE);
  const m = field(t("journal.m_code"), "number", { min: 0, max: 191 });
  const user = field(t("journal.user"), "search");
  const run = field(t("journal.run"), "search");
  const body = h("tbody", {});
  const note = h("p", { class: "muted", role: "status" });
  const older = button({ onclick: () => void read(true) }, t("journal.older_lines"));
  const again = button({ onclick: () => void read(false) }, t("common.read_again"));
  /** @type {Line[]} */
  let lines = [];
  /** Number of requested lines, of all events. */
  let from = 0;
  let asked = 0;
  const show = () => {
    const found = lines.filter((line) => event.value === "" || line.event === event.value);
    fill(body, ...found.slice(-ROWS_MAX).reverse().map(row));
    setText(note, found.length === 0 ? t("journal.none") : found.length > ROWS_MAX ? t("journal.newest", { shown: ROWS_MAX, count: found.length }) : "");
  };
  /** @param {boolean} isOlder */
  const read = async (isOlder) => {
    const mine = ++asked;
    from = isOlder ? from + PAGE_LINES : 0;
    const query = { cs: cs.value, since: since.value, m: m.value, user: user.value.trim(), run: run.value.trim() };
    await app.attempt(async () => {
      const answer = await app.api.journal(from, PAGE_LINES, query);
      if (mine !== asked) return;
      lines = isOlder ? [...answer, ...lines] : answer;
      setAttr(older, "hidden", answer.length < PAGE_LINES);
      show();
    });
  };
  let typed = 0;
  const readSoon = () => {
    clearTimeout(typed);
    typed = setTimeout(() => void read(false), TYPED_MS);
  };
  for (const one of [cs, since, m, user, run]) one.addEventListener("input", readSoon);
  event.addEventListener("input", show);
  void read(false);
  const head = h("tr", {}, ...[t("journal.time"), t("common.cs_short"), t("journal.event"), t("journal.who"), t("journal.what")].map((name) => h("th", { scope: "col" }, name)));
  const filters = h("div", { class: "history-tools" }, ...[cs, event, since, m, user, run].map(labelled), again);
  const table = h("table", { class: "history-table journal-table" }, h("thead", {}, head), body);
  return h("div", { class: "history-part" }, filters, h("div", { class: "scroll", tabindex: 0, role: "region", "aria-label": t("journal.lines_of_the_journal") }, table, older), note);
}

/** @param {string} label @param {[string, string][]} choices values and their texts */
export function picker(label, choices) {
  return h("select", { class: "input", "aria-label": label }, ...choices.map(([value, name]) => h("option", { value }, name)));
}

/** Returns a choice whose text is its value. @param {string} name @returns {[string, string]} */
function same(name) {
  return [name, name];
}

/** @param {string} label @param {string} type @param {import("../ui/dom.js").Props} [more] */
function field(label, type, more = {}) {
  return h("input", { class: "input", type, "aria-label": label, ...more });
}

/** @param {HTMLInputElement | HTMLSelectElement} control */
export function labelled(control) {
  return h("span", { class: "history-filter" }, h("span", { class: "label", "aria-hidden": "true" }, control.getAttribute("aria-label")), control);
}

/** @param {Line} line */
function row(line) {
  const who = line.user ?? line.handler_id ?? line.client_id;
  const cells = [dayAndTime(line.ts), line.cs ? String(line.cs) : "", line.event, who ? String(who) : "", what(line)];
  return h("tr", { "data-event": line.event }, ...cells.map((cell) => h("td", {}, cell)));
}

/** Returns the other members of a line as text. @param {Line} line */
function what(line) {
  const told = Object.entries(line).filter(([name, value]) => !HIDDEN.has(name) && value !== null && !["", "{}", "[]", "false"].includes(typeof value === "object" ? JSON.stringify(value) : String(value)));
  return told.map(([name, value]) => `${name.replaceAll("_", " ")} ${typeof value === "object" ? JSON.stringify(value) : rounded(String(value))}`).join(" · ");
}

