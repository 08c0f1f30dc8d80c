// Requests of the HMI to its machine: commands, inputs, programs. Refused requests throw a Refusal with the machine's
// text.

import { Refusal, TIMEOUT_MS } from "../tandem.js";
import { randomName } from "../tandem/requests.js";
import { t } from "../text/language.js";
import { forgetFence, keepFence, ownFence, underLease } from "./fences.js";
import { machine } from "./machine.js";

export { Refusal };

/** Lowest rate at which a long program is sent and checked, bytes per millisecond. */
const STORED_BYTES_PER_MS = 100;
/** Time limit for reading a long program as a stream, ms. */
const READ_MS = 120_000;
/** Time limit of a refresh of a jog, ms; the machine stops the axis after a shorter time. */
const JOG_TIMEOUT_MS = 1000;

/** Name of this holder of a control lease, shown at other screens. */
const HOLDER = `HMI ${randomName().slice(0, 4)}`;

/**
 * The diagnostics of a program that the machine refused; any other error is thrown again.
 * @param {unknown} error
 */
export function diagnosticsOf(error) {
  const diagnostics = error instanceof Refusal ? error.problem.diagnostics : undefined;
  if (!diagnostics?.length) throw error;
  return diagnostics;
}

/**
 * @param {string} method @param {string} path below `/api/v1` @param {object | string} [body]
 * @param {Record<string, string>} [headers] @param {number} [timeoutMs] @param {boolean} [keepalive]
 */
function request(method, path, body, headers, timeoutMs, keepalive) {
  return machine.request(method, path, { body, headers, keepalive, ...(timeoutMs !== undefined && { timeoutMs }) });
}

/** @param {number} cs @param {"p" | "q"} kind */
function variablesOf(cs, kind) {
  return kind === "p" ? "/variables/p" : `/cs/${cs}/variables/q`;
}

/**
 * A line at which a run begins.
 * @typedef {{from_line: number, program?: number, occurrence?: number, approach?: "plane_first" | "infeed_first" | "direct"}} LineStart
 */

export const api = {
  /**
   * Commands a coordinate system under the screen's own control lease, and waits until it is done.
   * @param {number} cs @param {import("../types.d.ts").Verb} verb @param {object} [args] @param {import("../tandem.js").Expected} [expect]
   * @param {() => void} [onAccepted]
   */
  command(cs, verb, args = {}, expect = {}, onAccepted = () => {}) {
    return machine.command(cs, verb, args, { expect, fence: ownFence(cs), onAccepted });
  },

  /** Accepts or refuses stored files that do not fit together. The answer waits for the disk. @param {"accept" | "refuse"} decision */
  async answerStoredData(decision) {
    await machine.request("POST", "/stored_data/answer", { body: { decision }, timeoutMs: TIMEOUT_MS, unanswered: t("requests.the_machine_did_not_answer") });
  },

  /** Orders a run of one part or more. @param {number} cs @param {number} program @param {number} parts */
  async order(cs, program, parts) {
    await request("POST", `/cs/${cs}/runs`, { program, parts }, underLease(cs));
  },

  /** The path of a text as manual data input would move now, as bytes. @param {number} cs @param {string} text */
  async manualPath(cs, text) {
    return (await request("POST", `/cs/${cs}/mdi/path`, { text })).arrayBuffer();
  },

  /**
   * Returns the effect of a line of NC text, without running it.
   * @param {number} cs @param {string} text @returns {Promise<import("../types.d.ts").Rehearsal>}
   */
  async manualRehearsal(cs, text) {
    return (await request("POST", `/cs/${cs}/mdi/rehearsal`, { text })).json();
  },

  /**
   * Returns the modal state at a line, and the steps of a start from there.
   * @param {number} cs @param {LineStart} from @returns {Promise<import("../types.d.ts").LineState>}
   */
  async lineState(cs, from) {
    return (await request("POST", `/cs/${cs}/line_state`, from)).json();
  },

  /**
   * Begins or refreshes a jog; the reply contains whether it is allowed.
   * @param {number} cs @param {object} args @param {string} [id] of the command, for {@link api.reply}
   */
  async jog(cs, args, id) {
    await request("POST", `/cs/${cs}/jog`, args, { ...underLease(cs), ...(id !== undefined && { "Idempotency-Key": id }) }, JOG_TIMEOUT_MS);
  },

  /**
   * Ends a jog at once, also when the page closes. If the request is lost, the machine stops automatically.
   * @param {number} cs @param {string} axis @param {string} refresh_id
   */
  async endJog(cs, axis, refresh_id) {
    const asked = { body: { axis, refresh_id, end: true }, headers: underLease(cs), timeoutMs: JOG_TIMEOUT_MS, keepalive: true, notAfter: null };
    await machine.request("POST", `/cs/${cs}/jog`, asked).catch(() => {});
  },

  /** Takes the control lease, or renews the lease of this screen. @param {number} cs */
  async takeLease(cs) {
    const fence = ownFence(cs);
    const response = await request("POST", `/cs/${cs}/lease`, { holder: HOLDER, ...(fence !== undefined && { fence }) });
    keepFence(cs, (await response.json()).lease.fence);
  },

  /** @param {number} cs */
  async releaseLease(cs) {
    const headers = underLease(cs);
    forgetFence(cs);
    await request("DELETE", `/cs/${cs}/lease`, undefined, headers);
  },

  /** Ends the lease of any holder. @param {number} cs */
  async breakLease(cs) {
    await request("POST", `/cs/${cs}/lease/break`, {});
  },

  /** @param {number} cs @param {"interlock" | "start_lock"} input @param {{value: boolean, text: string, source?: string, force?: boolean}} lock */
  async setLock(cs, input, lock) {
    await request("PUT", `/cs/${cs}/inputs/${input}`, lock);
  },

  /** Forces an input or output of the plant; null: the written value applies again. @param {import("../inputs/plant.js").Point} point @param {boolean | number | null} value */
  async forceIo({ side, name }, value) {
    await request("PUT", `/io/${side}/${encodeURIComponent(name)}/force`, { value, by: "hmi" });
  },

  /** The last run before the runtime was started, interrupted or not. @param {number} cs */
  async lastRun(cs) {
    /** @type {{last_run: import("../types.d.ts").LastRun | null}} */
    const answer = await (await request("GET", `/cs/${cs}/last_run`)).json();
    return answer.last_run ?? null;
  },

  /** @param {number} cs @param {string} input such as `optional_skip/3` @param {boolean} value */
  async setInput(cs, input, value) {
    await request("PUT", `/cs/${cs}/inputs/${input}`, { value });
  },

  /** @param {number} cs @param {{feed?: number, rapid?: number, spindle?: number}} change percent */
  async setOverrides(cs, change) {
    await request("PUT", `/cs/${cs}/overrides`, change);
  },

  /**
   * Resets an output by hand, also if a handler owns it.
   * @param {number} cs @param {string} boot_id @param {number} seq
   */
  async resetOutput(cs, boot_id, seq) {
    const body = { boot_id, handler_id: "hmi", result: "ok", force: true };
    await request("POST", `/cs/${cs}/m_codes/${seq}/reset`, body);
  },

  /** @param {number} cs @param {string} boot_id @param {number} seq @param {"redo" | "verify"} how */
  async redeliver(cs, boot_id, seq, how) {
    await request("POST", `/cs/${cs}/m_codes/${seq}/redeliver`, { boot_id, how });
  },

  /** @param {number} cs @param {string} boot_id @param {number} seq @param {string} question_id @param {string} choice */
  async answer(cs, boot_id, seq, question_id, choice) {
    await request("POST", `/cs/${cs}/m_codes/${seq}/answer`, { boot_id, question_id, choice, client_id: "hmi" });
  },

  /** @param {number} id */
  async acknowledge(id) {
    await request("POST", `/alarms/${id}/acknowledge`, {});
  },

  /** Returns the user of this screen. @returns {Promise<import("../types.d.ts").CurrentUser>} */
  async user() {
    return (await request("GET", "/login")).json();
  },

  async logOut() {
    await request("DELETE", "/login");
  },

  /**
   * Returns the result of a command, if the machine still remembers it.
   * @param {string} id @returns {Promise<import("../types.d.ts").CommandReply>}
   */
  async reply(id) {
    return (await request("GET", `/commands/${encodeURIComponent(id)}`)).json();
  },

  /** @param {number} cs @returns {Promise<Record<string, Record<string, number>>>} */
  async workOffsets(cs) {
    return (await (await request("GET", `/cs/${cs}/work_offsets`)).json()).work_offsets;
  },

  /** @param {number} cs @param {Record<string, Record<string, number>>} work_offsets those that change */
  async setWorkOffsets(cs, work_offsets) {
    await request("PUT", `/cs/${cs}/work_offsets`, { work_offsets });
  },

  /** @returns {Promise<import("../types.d.ts").ToolData[]>} */
  async tools() {
    return (await (await request("GET", "/tools")).json()).tools;
  },

  /** @param {{tools?: import("../types.d.ts").ToolData[], remove?: number[]}} change */
  async changeTools(change) {
    await request("PUT", "/tools", { tools: [], ...change });
  },

  /** @param {number} cs @param {"p" | "q"} kind @param {number} from @param {number} count @returns {Promise<import("../types.d.ts").Number[]>} */
  async variables(cs, kind, from, count) {
    return (await (await request("GET", `${variablesOf(cs, kind)}?from=${from}&count=${count}`)).json()).values;
  },

  /** @param {number} cs @param {"p" | "q"} kind @param {number} from @param {import("../types.d.ts").Number[]} values */
  async setVariables(cs, kind, from, values) {
    await request("PUT", `${variablesOf(cs, kind)}?from=${from}`, { values });
  },

  /** @param {number} number @param {string} hash of the program that is meant */
  async removeProgram(number, hash) {
    await request("DELETE", `/programs/${number}`, undefined, { "If-Match": `"${hash}"` });
  },

  /** Returns the machine builder's additions to this screen. @returns {Promise<import("../types.d.ts").Hmi>} */
  async hmi() {
    return (await request("GET", "/hmi")).json();
  },

  /** Returns the meaning of a name. @param {string} what @returns {Promise<import("../types.d.ts").Explanation>} */
  async explain(what) {
    return (await request("GET", `/explain/${encodeURIComponent(what)}`)).json();
  },

  /**
   * Returns lines of the journal in the order of time: the newest lines, without the last `from`.
   * @param {number} from @param {number} count @param {Record<string, string>} wanted filter of the machine; empty: all lines
   * @returns {Promise<import("../history/journal.js").Line[]>}
   */
  async journal(from, count, wanted) {
    const asked = Object.entries(wanted).filter(([, value]) => value !== "");
    const query = new URLSearchParams([["from", String(from)], ["count", String(count)], ...asked]);
    return (await (await request("GET", `/journal?${query}`)).json()).lines;
  },

  /** @returns {Promise<import("../types.d.ts").AlarmRecord[]>} */
  async alarmHistory() {
    return (await (await request("GET", "/alarms/history")).json()).alarms;
  },

  /** @returns {Promise<import("../types.d.ts").ProgramInfo[]>} */
  async programs() {
    return (await (await request("GET", "/programs")).json()).programs;
  },

  /** @param {number} number @returns {Promise<import("../types.d.ts").ProgramDiagnostic[]>} */
  async check(number) {
    return (await (await request("POST", `/programs/${number}/check`)).json()).diagnostics;
  },

  /** A program and its hash. @param {number} number @returns {Promise<{text: string, hash: string}>} */
  async program(number) {
    const response = await request("GET", `/programs/${number}`);
    return { text: await response.text(), hash: (response.headers.get("ETag") ?? "").replaceAll('"', "") };
  },

  /** Returns the bytes of a program as a stream. @param {number} number @returns {Promise<ReadableStream<Uint8Array>>} */
  async programBytes(number) {
    const { body } = await request("GET", `/programs/${number}`, undefined, {}, READ_MS);
    return body ?? new Blob().stream();
  },

  /** Checks a text as this program without storing it. @param {number} number @param {Blob} text @param {string} dialect @returns {Promise<import("../types.d.ts").ProgramDiagnostic[]>} */
  async checkText(number, text, dialect) {
    const query = dialect === "" ? "" : `?dialect=${dialect}`;
    const answer = await request("POST", `/programs/${number}/check_text${query}`, text, {}, TIMEOUT_MS + text.size / STORED_BYTES_PER_MS);
    return (await answer.json()).diagnostics;
  },

  /** Moves a program to a folder; empty: to no folder. @param {number} number @param {string} folder */
  async moveToFolder(number, folder) {
    await request("PUT", `/programs/${number}/folder`, { folder });
  },

  /**
   * Stores a program, also one with errors.
   * @param {number} number
   * @param {Blob} text
   * @param {string | null} hash of the program that may be replaced; empty: any program; null: no program
   * @param {string} dialect of the text; empty: that of the lowest coordinate system
   * @returns {Promise<import("../types.d.ts").ProgramCheck>}
   */
  async storeProgram(number, text, hash, dialect) {
    /** @type {Record<string, string>} */
    const headers = hash === null ? { "If-None-Match": "*" } : hash === "" ? {} : { "If-Match": `"${hash}"` };
    const query = dialect === "" ? "" : `?dialect=${dialect}`;
    return (await request("PUT", `/programs/${number}${query}`, text, headers, TIMEOUT_MS + text.size / STORED_BYTES_PER_MS)).json();
  },
};
