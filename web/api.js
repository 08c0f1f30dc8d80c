// REST: commands, inputs, programs. Whatever is refused comes back as a Refusal with the machine's own words.

/** Time limit of a request; a stop on the path of a slow machine may take seconds. */
const TIMEOUT_MS = 15000;

export class Refusal extends Error {
  /**
   * @param {string} text
   * @param {import("./types.d.ts").Problem} problem
   */
  constructor(text, problem = {}) {
    super(text);
    this.name = "Refusal";
    this.problem = problem;
  }
}

/**
 * @param {string} method
 * @param {string} path below `/api/v1`
 * @param {object} [body]
 * @param {Record<string, string>} [headers]
 * @returns {Promise<Response>}
 */
async function request(method, path, body, headers = {}) {
  /** @type {Response} */
  let response;
  try {
    response = await fetch(`/api/v1${path}`, {
      method,
      cache: "no-store",
      headers: body === undefined ? headers : { "Content-Type": "application/json", ...headers },
      body: body === undefined ? undefined : JSON.stringify(body),
      signal: AbortSignal.timeout(TIMEOUT_MS),
    });
  } catch {
    throw new Refusal("The machine did not answer. Nothing is known about what it did with the request.");
  }
  if (response.ok) return response;
  /** @type {import("./types.d.ts").Problem} */
  const problem = await response.json().catch(() => ({}));
  throw new Refusal(asSentence(problem.detail || problem.title || `refused with status ${response.status}`), problem);
}

/** With a capital and a full stop. @param {string} text */
function asSentence(text) {
  return text.charAt(0).toUpperCase() + text.slice(1).replace(/[^.!?]$/, "$&.");
}

/** A random name of a command, so that one sent twice is carried out once. */
function commandId() {
  const bytes = crypto.getRandomValues(new Uint8Array(12));
  return `hmi-${[...bytes].map((byte) => byte.toString(16).padStart(2, "0")).join("")}`;
}

export const api = {
  /**
   * Commands a coordinate system, and waits until the effect is reached.
   * @param {number} cs
   * @param {import("./types.d.ts").Verb} verb
   * @param {object} [args]
   */
  async command(cs, verb, args = {}) {
    const response = await request("POST", `/cs/${cs}/${verb}?wait=1`, args, { "Idempotency-Key": commandId() });
    const reply = await response.json().catch(() => ({}));
    if (reply.status === "rejected" || reply.status === "failed") throw new Refusal(reply.text || `${verb} failed.`, reply);
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
   * Resets an output by hand, whoever owns it.
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

  /** @param {number} id */
  async acknowledge(id) {
    await request("POST", `/alarms/${id}/acknowledge`, {});
  },

  /** @returns {Promise<import("./types.d.ts").ProgramInfo[]>} */
  async programs() {
    return (await (await request("GET", "/programs")).json()).programs;
  },

  /** @param {number} number @returns {Promise<import("./types.d.ts").Diagnostic[]>} */
  async check(number) {
    return (await (await request("POST", `/programs/${number}/check`)).json()).diagnostics;
  },

  /** @param {number} number */
  async programText(number) {
    return (await request("GET", `/programs/${number}`)).text();
  },
};
