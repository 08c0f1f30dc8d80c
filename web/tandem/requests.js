// Requests to the machine over REST. A refused request throws a Refusal with the machine's text.

import { t } from "../text/language.js";

/** Time limit of a request: a slow machine may take seconds to stop on its path. */
export const TIMEOUT_MS = 15000;

/** Time after the newest heartbeat within which a request of a person takes effect, ms; later, the machine rejects it. */
export const NOT_AFTER_MS = 1000;
/** Time limit of the answer to such a request, after which the request can no longer take effect. */
export const PERSON_TIMEOUT_MS = 1500;

/**
 * Limits the age of a request: the machine rejects it as `expired` when it would take effect later.
 * @typedef {{boot_id: string, heartbeat: number, within_ms: number}} NotAfter
 */

/** Routes after which something can move. */
const MOVING = new RegExp(
  "^/(cs/\\d+/((start|resume|reset|mdi|jog|home|back_trace|runs)(\\?|$)|m_codes/\\d+/(reset|redeliver|answer)$|(inputs|overrides|spindle|tool)(/|$)|variables/)" +
    "|io/|motors/|variables/)",
);

/** Whether something can move after a request, so that it may carry an age limit. @param {string} method @param {string} path below `/api/v1` */
export function canMove(method, path) {
  return method !== "GET" && MOVING.test(path);
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
