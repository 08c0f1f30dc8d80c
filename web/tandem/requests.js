// Requests to the machine over REST. A refused request throws a Refusal with the machine's text.

import { t } from "../text/language.js";

/** Time limit of a request: a slow machine may take seconds to stop on its path. */
export const TIMEOUT_MS = 15000;

/** Time after the newest heartbeat within which a request of a person takes effect, ms; later, the machine rejects it. */
export const NOT_AFTER_MS = 1000;
/** Age limit of a load, ms. Reason: handlers may validate the parameters of the program for 2 s before the load takes effect. */
const LOAD_NOT_AFTER_MS = 5000;
/** Time for the answer after the age limit of a request, ms; by then the request can no longer take effect. */
const ANSWER_MS = 500;
/** Time limit of the answer to a request with the age limit `NOT_AFTER_MS`. */
export const PERSON_TIMEOUT_MS = NOT_AFTER_MS + ANSWER_MS;

/** Routes that accept an age limit: after their requests something can move, or other values apply. */
const LIMITED = new RegExp(
  "^/(cs/\\d+/((load|start|resume|reset|mdi|jog|home|back_trace|runs)(\\?|$)|m_codes/\\d+/(reset|redeliver|answer)$" +
    "|(inputs|overrides|spindle|tool)(/|$)|variables/|work_offsets$)" +
    "|alarms/\\d+/acknowledge$|stored_data/answer$|tools$|io/|motors/|variables/)",
);

/** Whether a request accepts an age limit. @param {string} method @param {string} path below `/api/v1` */
export function isLimited(method, path) {
  return method !== "GET" && LIMITED.test(path);
}

/** Age limit that a person's request has by default, ms. @param {string} path below `/api/v1` */
export function ageLimitMs(path) {
  return /^\/cs\/\d+\/load(\?|$)/.test(path) ? LOAD_NOT_AFTER_MS : NOT_AFTER_MS;
}

/** Time limit of the answer to a request with an age limit, ms. @param {import("./age_limits.js").NotAfter} notAfter */
export function answerLimitMs({ within_ms }) {
  return within_ms + ANSWER_MS;
}

/** A refusal of the machine, or a missing answer. */
export class Refusal extends Error {
  /**
   * @param {string} text a sentence for people
   * @param {Partial<import("../types.d.ts").Problem>} problem the machine's problem document; empty: no answer
   */
  constructor(text, problem = {}) {
    super(text);
    this.name = "Refusal";
    this.problem = problem;
  }
}

/**
 * @typedef {object} Asked
 * @property {object | string | Blob} [body] text unchanged, all other values as JSON
 * @property {Record<string, string>} [headers]
 * @property {number} [timeoutMs]
 * @property {boolean} [keepalive] also when the page closes
 * @property {string} [unanswered] text of the refusal if no answer arrives
 */

/**
 * Sends a request, and returns a successful answer, or 304 if the request names the known version.
 * @param {string} url @param {string | null} token @param {string} method @param {Asked} [asked]
 * @returns {Promise<Response>}
 */
export async function request(url, token, method, { body, headers = {}, timeoutMs = TIMEOUT_MS, keepalive = false, unanswered } = {}) {
  const isText = typeof body === "string" || body instanceof Blob;
  /** @type {Record<string, string>} */
  const own = {};
  if (body !== undefined) own["Content-Type"] = isText ? "text/plain" : "application/json";
  if (token !== null) own.Authorization = `Bearer ${token}`;
  /** @type {Response} */
  let response;
  try {
    response = await fetch(url, {
      method,
      keepalive,
      cache: "no-store",
      headers: { ...own, ...headers },
      body: body === undefined || isText ? /** @type {string | Blob | undefined} */ (body) : JSON.stringify(body),
      signal: AbortSignal.timeout(timeoutMs),
    });
  } catch {
    throw new Refusal(unanswered ?? t("requests.the_machine_did_not_answer"));
  }
  if (response.ok || response.status === 304) return response;
  /** @type {import("../types.d.ts").Problem} */
  const problem = await response.json().catch(() => ({}));
  throw new Refusal(asSentence(problem.detail || problem.title || t("requests.refused_with_status", { status: response.status })), problem);
}

/** With a capital letter and a full stop. @param {string} text */
export function asSentence(text) {
  return text.charAt(0).toUpperCase() + text.slice(1).replace(/[^.!?]$/, "$&.");
}

/** 24 random characters. */
export function randomName() {
  const bytes = crypto.getRandomValues(new Uint8Array(12));
  return [...bytes].map((byte) => byte.toString(16).padStart(2, "0")).join("");
}
