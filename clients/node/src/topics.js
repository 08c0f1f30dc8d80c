// Topics that this package uses, below a machine's root, and the form of their messages, which are validated on
// arrival.

/**
 * Form of a member: the name of its type, or several with `|` between them, with `?` at the end if it may be missing or
 * null; a list of a form; or an object of members.
 * @typedef {string | ListOf | Members} Form
 * @typedef {{[member: string]: Form}} Members
 */

class ListOf {
  /** @param {Form} form */
  constructor(form) {
    this.form = form;
  }
}

const PARAM = "number?";
const PARAMS = { A: PARAM, B: PARAM, C: PARAM, D: PARAM, E: PARAM, F: PARAM, G: PARAM, H: PARAM };
const ALARM = { id: "number", number: "number", severity: "string", text: "string" };
const LOCK = { value: "boolean", text: "string", sources: new ListOf({ source: "string", value: "boolean", lost: "boolean" }) };
const TOLD = new ListOf({ kind: "string", from: "number", values: new ListOf("number|string") });
const OUTPUT = {
  id: "string",
  seq: "number",
  m: "number",
  state: "string",
  attempt: "number",
  lost: "boolean?",
  line: "number",
  program: "number",
  run_id: "string",
  params: PARAMS,
};

/** @type {Record<string, Form>} */
const FORMS = {
  presence: { boot_id: "string", online: "boolean", expires_ms: "number?" },
  heartbeat: { boot_id: "string", cycle: "number" },
  birth: { boot_id: "string", machine: "string", coordinate_systems: new ListOf({ number: "number" }) },
  "alarm/active": { alarms: new ListOf(ALARM) },
  "alarm/event": ALARM,
  "handler/+/presence": { online: "boolean" },
  "handler/+/result": { status: "string", instance: "string?", text: "string?" },
  "io/+/+": { boot_id: "string", value: "boolean|number", written: "boolean|number", lost: "boolean", owner: "string?" },
  variables: { variables: TOLD },
  tools: { tools: new ListOf({ id: "number", radius: "number", length: "number" }) },
  "cs/+/variables": { variables: TOLD },
  "cs/+/work_offsets": { work_offsets: "object" },
  "reply/+": { command_id: "string", status: "string", code: "string", text: "string" },
  "cs/+/state": { boot_id: "string", execution: "string" },
  "cs/+/run": { boot_id: "string" },
  "cs/+/captured": { motors: new ListOf("number"), positions: new ListOf("number") },
  "cs/+/position": { feedrate: "number" },
  "cs/+/tool/state": { id: "number" },
  "cs/+/override/state": { feed: "number", rapid: "number", spindle: "number" },
  "cs/+/input/interlock/state": LOCK,
  "cs/+/input/start_lock/state": LOCK,
  "cs/+/input/optional_skip/state": { requested: new ListOf("number"), effective: new ListOf("number") },
  "cs/+/m_code/pending": { boot_id: "string", outputs: new ListOf(OUTPUT) },
  "cs/+/m_code/+/result": { boot_id: "string", seq: "number", handler_id: "string", status: "string", of: "string?" },
  "cs/+/m_code/+/cancel": { boot_id: "string", seq: "number", reason: "string" },
  "cs/+/m_code/+/validate": { request_id: "string", params: PARAMS },
};

/** Topics to which each client subscribes, in addition to its `reply` and the topics of its handler. */
export const FILTERS = Object.keys(FORMS).filter((path) => !/^(handler|reply)\//.test(path));

/** Returns the pattern of a topic; undefined if this package does not use it. @param {string} path */
export function patternOf(path) {
  const levels = path.split("/");
  if (levels.length > 1) levels[1] = FORMS[path] === undefined ? "+" : /** @type {string} */ (levels[1]);
  if (levels.length === 3 && levels[0] === "io") levels[2] = "+";
  if (levels.length === 5 && levels[2] === "m_code") levels[3] = "+";
  const pattern = levels.join("/");
  return Object.hasOwn(FORMS, pattern) ? pattern : undefined;
}

/**
 * Returns the first mistake of a message as a sentence; null if the message is valid.
 * @param {string} pattern @param {unknown} message
 */
export function whatIsWrong(pattern, message) {
  return lookAt(FORMS[pattern] ?? "object", message, "the message");
}

/** @param {Form} form @param {unknown} value @param {string} where @returns {string | null} */
function lookAt(form, value, where) {
  if (typeof form === "string") {
    const isOptional = form.endsWith("?");
    if (isOptional && (value === undefined || value === null)) return null;
    const type = isOptional ? form.slice(0, -1) : form;
    return type.split("|").includes(typeof value) ? null : `${where} is not a ${type.replace("|", " or ")}`;
  }
  if (form instanceof ListOf) {
    if (!Array.isArray(value)) return `${where} is not a list`;
    return first(value.map((entry, at) => [form.form, entry, `${where}[${at}]`]));
  }
  if (typeof value !== "object" || value === null || Array.isArray(value)) return `${where} is not an object`;
  const given = /** @type {Record<string, unknown>} */ (value);
  return first(Object.entries(form).map(([member, of]) => [of, given[member], `${where}.${member}`]));
}

/** @param {[Form, unknown, string][]} all @returns {string | null} */
function first(all) {
  for (const [form, value, where] of all) {
    const wrong = lookAt(form, value, where);
    if (wrong !== null) return wrong;
  }
  return null;
}

/** Returns the number in a level of a path; -1 if there is none. @param {string} path @param {number} level */
export function numberAt(path, level) {
  const text = path.split("/")[level] ?? "";
  return /^\d{1,9}$/.test(text) ? Number(text) : -1;
}
