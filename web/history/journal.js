// The journal: read by pages from the newest line back, filtered by the machine, and shown as a table.

import { button, fill, h, setAttr, setText } from "../dom.js";
import { rounded } from "../format.js";

/**
 * A line; what else it has depends on its event.
 * @typedef {{event: string, ts: string | null, t_s: number | null, cs: number | null, boot_id: string} & Record<string, unknown>} Line
 */

/** Lines of one answer. */
export const PAGE_LINES = 1000;
/** Rows shown at once. */
const ROWS_MAX = 2000;
/** Delay before what is typed is asked for, ms. */
const TYPED_MS = 300;

/** What stands in columns of its own, or tells a person nothing. */
const HIDDEN = new Set(["event", "ts", "t_s", "cs", "boot_id", "hash", "n", "user", "client_id", "handler_id", "command_id", "program_hash"]);

/** @type {Record<string, string>} */
const SINCE = { "all that is kept": "", "the last hour": "1h", "the last 8 hours": "8h", "the last day": "24h", "the last week": "168h" };

const EVENTS = ["request", "command", "start", "end", "output", "claim", "reset", "question", "answer", "hold", "stop", "resume", "alarm", "warning", "program", "refused", "access", "lease", "boot"];

/** @param {import("../main.js").App} app */
export function journal(app) {
  const cs = picker("Coordinate system", ["all", "machine", ...[...app.model.systems.keys()].map(String)]);
  const event = picker("Event", ["all", ...EVENTS]);
  const since = picker("Since", Object.keys(SINCE));
  const m = field("M code", "number", { min: 0, max: 191 });
  const user = field("User, client or handler", "search");
  const run = field("Run, such as 1-7", "search");
  const body = h("tbody", {});
  const note = h("p", { class: "muted", role: "status" });
  const older = button({ onclick: () => void read(true) }, "Older lines");
  const again = button({ onclick: () => void read(false) }, "Read again");
  /** @type {Line[]} */
  let lines = [];
  /** Lines that were asked for, of all events. */
  let from = 0;
  let asked = 0;
  const show = () => {
    const found = lines.filter((line) => event.value === "all" || line.event === event.value);
    fill(body, ...found.slice(-ROWS_MAX).reverse().map(row));
    setText(note, found.length === 0 ? "No line is like that." : found.length > ROWS_MAX ? `The newest ${ROWS_MAX} of ${found.length} lines are shown.` : "");
  };
  /** @param {boolean} isOlder */
  const read = async (isOlder) => {
    const mine = ++asked;
    from = isOlder ? from + PAGE_LINES : 0;
    const query = { cs: { all: "", machine: "0" }[cs.value] ?? cs.value, since: SINCE[since.value] ?? "", m: m.value, user: user.value.trim(), run: run.value.trim() };
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
  const head = h("tr", {}, ...["Time", "CS", "Event", "Who", "What"].map((name) => h("th", { scope: "col" }, name)));
  const filters = h("div", { class: "history-tools" }, ...[cs, event, since, m, user, run].map(labelled), again);
  const table = h("table", { class: "history-table" }, h("thead", {}, head), body);
  return h("div", { class: "history-part" }, filters, h("div", { class: "scroll", tabindex: 0, role: "region", "aria-label": "Lines of the journal" }, table, older), note);
}

/** @param {string} label @param {string[]} choices */
export function picker(label, choices) {
  return h("select", { class: "input", "aria-label": label }, ...choices.map((name) => h("option", { value: name }, name)));
}

/** @param {string} label @param {string} type @param {import("../dom.js").Props} [more] */
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

/** What else a line says. @param {Line} line */
function what(line) {
  const told = Object.entries(line).filter(([name, value]) => !HIDDEN.has(name) && value !== null && !["", "{}", "[]", "false"].includes(typeof value === "object" ? JSON.stringify(value) : String(value)));
  return told.map(([name, value]) => `${name.replaceAll("_", " ")} ${typeof value === "object" ? JSON.stringify(value) : rounded(String(value))}`).join(" · ");
}

/** In the viewer's zone, such as `Nov 25 20:09:04.038`. @param {string | null} ts */
export function dayAndTime(ts) {
  const date = new Date(ts ?? "");
  if (Number.isNaN(date.getTime())) return "–";
  const two = (/** @type {number} */ n) => String(n).padStart(2, "0");
  const time = [date.getHours(), date.getMinutes(), date.getSeconds()].map(two).join(":");
  return `${date.getFullYear()}-${two(date.getMonth() + 1)}-${two(date.getDate())} ${time}.${String(date.getMilliseconds()).padStart(3, "0")}`;
}
