// The loop of a sequence program: it receives messages of the machine, and starts handlers.

import { Bell, sleep } from "./bell.js";
import { Alarm, CODE_OF_ERROR, CODE_OF_EXCEPTION, cut, NoAnswer, NotConnected, ProgramError, RequestRefused, sentence, TakenOver, TandemError } from "./errors.js";
import { Output } from "./output.js";
import { Params } from "./params.js";
import { numberAt } from "./topics.js";

/** The machine treats the handlers as lost after this time without a presence. A presence is published three times in it. */
const PRESENCE_EXPIRES_MS = 15_000;
const REFRESH_MS = PRESENCE_EXPIRES_MS / 3;
const RETRY_MS = 500;
/** Largest number of remembered outputs that were begun; a stale `pending` is older by far fewer outputs. */
const BEGUN_MAX = 4_096;
const CLEAN_UP_MS = 5_000;
const LEAVE_TIMEOUT_MS = 1_000;
/** Time limit for the machine's confirmation that a stopping program accepts no further output. */
const LEAVE_MAX_MS = 2_000;
export const RETURNS_WITHIN_MS = 60_000;
const RETURNS_WITHIN_MAX_MS = 3_600_000;
/** Tries of 1 s, because a broker reports a dead process after one and a half times its keep-alive of 5 s. */
const REFUSALS_MAX = 10;
const REFUSAL_RETRY_MS = 1_000;
const INSTANCE_TRIES = 4;
const CHECK_TEXT_MAX = 1_000;
/** @type {Redelivery[]} */
const STRICTEST_FIRST = ["ask", "verify", "redo"];

/** @typedef {import("./messages.d.ts").PendingOutput} PendingOutput */
/** @typedef {import("./messages.d.ts").PendingMessage} PendingMessage */
/** @typedef {import("./messages.d.ts").CancelReason} CancelReason */
/** @typedef {import("./messages.d.ts").HandshakeResultMessage} Result */
/** @typedef {import("./messages.d.ts").Redelivery} Redelivery */

/**
 * A handler of the table.
 * @typedef {object} HandlerEntry
 * @property {number} m
 * @property {number | undefined} cs undefined: all that have no separate handler for the M code
 * @property {(output: Output, plc: import("./plc.js").Plc) => unknown} call
 * @property {Redelivery | undefined} redelivery undefined: the machine's configuration applies
 * @property {import("./m_code_declaration.js").MCodeDeclaration} declared
 */

/**
 * @typedef {object} RunningHandler
 * @property {Output} output
 * @property {string} boot
 * @property {boolean} isAnswering true if the reset was sent, so the output is no longer cancelled
 * @property {boolean} isReclaiming
 * @property {Promise<void>} ended
 */

/** Returns the key of a handler or check in its table. @param {number | undefined} cs @param {number} m */
export function handlerKey(cs, m) {
  return `${cs ?? "all"}/${m}`;
}

/** Throws a `ProgramError` if the time is not a valid return time. @param {number} ms */
export function checkReturnsWithin(ms) {
  if (!(ms >= 0 && ms <= RETURNS_WITHIN_MAX_MS)) throw new ProgramError(`returnsWithinMs ${ms}: write 0 to ${RETURNS_WITHIN_MAX_MS}`);
}

/** Presence, claims, handlers and resets of one handler id. */
export class Runner {
  /** Rung once the machine has accepted these handlers. */
  announced = new Bell();
  /** Reported to the machine at the end; 0: the program does not return. */
  returnsWithinMs = 0;
  #isStopping = false;
  /** Rung once the machine knows that this program accepts no further output. */
  #isKnownToStop = new Bell();
  #alarms;
  #connection;
  #plc;
  #handlerId;
  /** @type {import("./output.js").Identity} */
  #identity;
  #handlers;
  #checks;
  #takeOver;
  /** @type {Map<string, RunningHandler>} */
  #running = new Map();
  /** Outputs that this instance has begun, the oldest first. @type {Set<string>} */
  #begun = new Set();
  #mustAnnounce = new Bell();
  #hasAnnounced = false;
  /** True while the machine has not answered the last registration. */
  #awaitsAcceptance = false;
  /** @type {number[]} */
  #announcedSystems = [];
  #refusals = 0;
  /** @type {TakenOver | null} */
  #ended = null;
  #left = new AbortController();

  /**
   * @param {string} handlerId @param {Map<string, HandlerEntry>} handlers @param {Map<string, (params: Params) => unknown>} checks
   * @param {import("./alarms.js").UserAlarm[]} alarms @param {import("./plc.js").Plc} plc
   * @param {import("./connection.js").Connection} connection @param {boolean} takeOver
   */
  constructor(handlerId, handlers, checks, alarms, plc, connection, takeOver) {
    this.#handlerId = handlerId;
    this.#identity = { handler_id: handlerId, instance: connection.instance };
    this.#handlers = handlers;
    this.#checks = checks;
    this.#alarms = alarms;
    this.#plc = plc;
    this.#connection = connection;
    this.#takeOver = takeOver;
    connection.will = JSON.stringify(this.#offline());
    connection.onMessage = (path, pattern, message) => this.#onMessage(path, pattern, message);
    connection.onConnected = () => {
      plc.levels.onOffline();
      this.#mustAnnounce.ring();
    };
  }

  /** Registers the handlers whenever necessary, until `leave`; throws `TakenOver`. */
  async run() {
    const { signal } = this.#left;
    this.#mustAnnounce.ring();
    for (;;) {
      const must = await this.#mustAnnounce.rung({ timeoutMs: REFRESH_MS, signal });
      if (this.#ended !== null) throw this.#ended;
      if (signal.aborted) return;
      if (!must) {
        if (this.#awaitsAcceptance) this.#connection.log.warn("the machine has not accepted the handlers yet");
        if (this.#hasAnnounced) this.#connection.post(this.#presencePath, this.#online(), true);
        continue;
      }
      this.#mustAnnounce.mute();
      try {
        await this.#announce();
      } catch (error) {
        if (!(error instanceof NotConnected || error instanceof NoAnswer)) throw error;
        if (signal.aborted || this.#connection.stopped.aborted) return;
        this.#connection.log.warn(`the machine has not accepted the handlers yet: ${error.message}`);
        await sleep(RETRY_MS, signal);
        this.#mustAnnounce.ring();
      }
    }
  }

  /** Accepts no further output, and waits until the running handlers have ended or the time is over. @param {number | undefined} withinMs */
  async finish(withinMs) {
    this.#isStopping = true;
    this.#mustAnnounce.ring();
    const late = new AbortController();
    const timer = withinMs === undefined ? undefined : setTimeout(() => late.abort(), withinMs);
    // outputs that the machine claimed for this program before it knew of the stop are still executed
    await this.#isKnownToStop.rung({ timeoutMs: LEAVE_MAX_MS, signal: late.signal });
    while (this.#running.size > 0 && !late.signal.aborted && !this.#left.signal.aborted) {
      await Promise.race([Promise.all([...this.#running.values()].map(({ ended }) => ended)), new Bell().rung({ signal: late.signal })]);
    }
    clearTimeout(timer);
    if (this.#running.size > 0) this.#connection.log.warn(`${this.#running.size} handlers had not ended within ${withinMs} ms`);
  }

  /** Ends all handlers, and notifies the machine that they are offline. */
  async leave() {
    this.#left.abort();
    this.#cancel(() => true, "shutdown");
    await Promise.race([Promise.all([...this.#running.values()].map(({ ended }) => ended)), sleep(CLEAN_UP_MS, this.#connection.stopped)]);
    if (!this.#connection.isConnected) return;
    const gone = { ...this.#offline(), ...(this.returnsWithinMs > 0 ? { returns_within_ms: this.returnsWithinMs } : {}) };
    await this.#connection.request(this.#presencePath, gone, { retain: true, timeoutMs: LEAVE_TIMEOUT_MS }).catch((error) => {
      this.#connection.log.warn(`the machine was not notified that the handlers are offline: ${error.message}`);
    });
  }

  // --- presence

  get #presencePath() {
    return `handler/${this.#handlerId}/presence`;
  }

  #offline() {
    return { online: false, handles: [], validates: false, instance: this.#connection.instance };
  }

  /** @returns {number[]} */
  #systems() {
    return this.#plc.birth?.coordinate_systems.map(({ number }) => number) ?? [];
  }

  /** @returns {import("./messages.d.ts").HandlerPresence} */
  #online() {
    const entries = [...this.#handlers.values()];
    const served = entries.flatMap(({ cs, m }) => (cs === undefined ? this.#announcedSystems : [cs]).map((of) => `${of}/${m}`));
    return {
      online: true,
      handles: [...new Set(served)].map((of) => ({ cs: numberAt(of, 0), m: numberAt(of, 1) })),
      validates: this.#checks.size > 0,
      m_codes: entries.map(({ cs, m, declared, redelivery }) => ({ ...declared.toJson(m, cs), ...(redelivery ? { redelivery } : {}) })),
      alarms: this.#alarms.map((alarm) => alarm.toJSON()),
      instance: this.#connection.instance,
      take_over: this.#takeOver,
      exclusive: !this.#isStopping,
      expires_ms: PRESENCE_EXPIRES_MS,
      connection: this.#connection.connections,
    };
  }

  async #announce() {
    const connection = this.#connection;
    // releases claims of an earlier program of the same name that ended unnoticed
    if (!this.#hasAnnounced) await connection.request(this.#presencePath, this.#offline(), { retain: true });
    this.#announcedSystems = this.#systems();
    this.#awaitsAcceptance = true;
    await connection.request(this.#presencePath, this.#online(), { retain: true });
    this.#hasAnnounced = true;
  }

  #onAccepted() {
    this.#refusals = 0;
    this.#takeOver = false;
    if (this.#isStopping) this.#isKnownToStop.ring();
    if (!this.#awaitsAcceptance) return;
    this.#awaitsAcceptance = false;
    this.announced.ring();
    this.#plc.levels.onAnnounced(this.#handlerId);
    this.#updateAllHandlers();
  }

  // --- messages of the machine

  /** @param {string} path @param {string} pattern @param {any} message */
  #onMessage(path, pattern, message) {
    const cs = numberAt(path, 1);
    if (pattern === "cs/+/m_code/pending") this.#updateHandlers(cs, message);
    else if (pattern === "cs/+/m_code/+/cancel") this.#cancel((id) => id === idOf(message.boot_id, cs, message.seq), message.reason);
    else if (pattern === "cs/+/m_code/+/validate") void this.#validate(cs, numberAt(path, 3), message);
    else if (pattern === "presence" && message.online) {
      this.#cancel((_id, { boot }) => boot !== message.boot_id, "shutdown");
      this.#updateAllHandlers();
    } else if (pattern === "birth") {
      if (this.#hasAnnounced && this.#systems().join() !== this.#announcedSystems.join()) this.#mustAnnounce.ring();
    } else if (pattern === "handler/+/result" && message.instance === this.#connection.instance) this.#onResult(message);
    // the last will of an earlier connection, which arrived after the registration
    else if (pattern === "handler/+/presence" && !message.online && this.#hasAnnounced) this.#mustAnnounce.ring();
  }

  /** Processes the machine's answer to the presence. @param {import("./messages.d.ts").HandlerResultMessage} result */
  #onResult({ status, text }) {
    if (status === "accepted") this.#onAccepted();
    else if (status === "confirm") {
      // another process requests the name, and the machine asks whether this process is still online
      this.#mustAnnounce.ring();
    } else if (status === "refused" && this.#refusals < REFUSALS_MAX) {
      // the previous process may be about to end
      this.#refusals += 1;
      void sleep(REFUSAL_RETRY_MS, this.#left.signal).then(() => this.#mustAnnounce.ring());
    } else {
      this.#cancel(() => true, "shutdown");
      this.#ended ??= new TakenOver(text || `another process serves as ${this.#handlerId}`);
      this.#mustAnnounce.ring();
    }
  }

  /** @param {number} cs @param {number} m */
  #find(cs, m) {
    return this.#handlers.get(handlerKey(cs, m)) ?? this.#handlers.get(handlerKey(undefined, m));
  }

  /** @param {number} cs @param {number} m @param {import("./messages.d.ts").ValidateMessage} asked */
  async #validate(cs, m, asked) {
    if (this.#checks.size === 0 || this.#find(cs, m) === undefined) return;
    const ofAll = this.#handlers.has(handlerKey(cs, m)) ? undefined : this.#checks.get(handlerKey(undefined, m));
    const check = this.#checks.get(handlerKey(cs, m)) ?? ofAll;
    let verdict = { ok: true, text: "" };
    try {
      await check?.(new Params(asked.params));
    } catch (error) {
      if (!(error instanceof Alarm)) this.#connection.log.error(`the check of M${m} has failed:`, error);
      const text = error instanceof Alarm ? error.text : `the check of M${m} has failed: ${sentence(error)}`;
      verdict = { ok: false, text: cut(text, CHECK_TEXT_MAX) };
    }
    const answer = { request_id: asked.request_id, handler_id: this.#handlerId, ...(verdict.ok ? { ok: true } : verdict) };
    this.#connection.post(`cs/${cs}/m_code/${m}/validate_result`, answer);
  }

  #updateAllHandlers() {
    for (const cs of this.#systems()) {
      const pending = this.#connection.hub.last(`cs/${cs}/m_code/pending`);
      if (pending !== undefined) this.#updateHandlers(cs, pending);
    }
  }

  /**
   * Ends handlers whose output is over or belongs to another handler, and starts handlers of pending ones.
   * @param {number} cs @param {PendingMessage} pending
   */
  #updateHandlers(cs, { boot_id: boot, outputs }) {
    if (boot !== this.#connection.bootId || !this.announced.isRung || this.#left.signal.aborted || this.#ended !== null) return;
    const ours = outputs.filter((output) => output.handler_id === null || output.handler_id === this.#handlerId);
    const open = new Set(ours.map(({ seq }) => seq));
    this.#cancel((_id, { output, boot: its }) => its === boot && output.cs === cs && !open.has(output.seq), null);
    for (const output of ours) {
      const id = idOf(boot, cs, output.seq);
      if (output.state === "OUTPUT" && output.handler_id === null) this.#startHandler(id, boot, cs, output, false);
      else if (this.#isClaimedForUs(output) && this.#isNew(id)) this.#startHandler(id, boot, cs, output, true);
    }
  }

  /**
   * Returns whether the machine already claimed an output for this instance when it issued it.
   * @param {PendingOutput} output
   */
  #isClaimedForUs(output) {
    const isOurs = output.handler_id === this.#handlerId && output.instance === this.#connection.instance;
    return output.state === "CLAIMED" && output.attempt === 1 && isOurs;
  }

  /** Returns whether an output was never begun here: a stale `pending` may arrive after its end. @param {string} id */
  #isNew(id) {
    return !this.#running.has(id) && !this.#begun.has(id);
  }

  /** @param {string} id */
  #rememberOutput(id) {
    this.#begun.add(id);
    const [oldest] = this.#begun;
    if (this.#begun.size > BEGUN_MAX && oldest !== undefined) this.#begun.delete(oldest);
  }

  /**
   * Returns whether an output was claimed for this instance but lost in transit, so that it was never started (H20).
   * @param {string} id @param {PendingOutput} pending
   */
  #isNeverStarted(id, pending) {
    return pending.lost_instance === this.#connection.instance && this.#isNew(id);
  }

  // --- outputs

  /** @param {string} id @param {string} boot @param {number} cs @param {PendingOutput} pending @param {boolean} isClaimed */
  #startHandler(id, boot, cs, pending, isClaimed) {
    const working = this.#running.get(id);
    if (working !== undefined) {
      // the handler still works; only its connection was lost
      if (pending.lost && !working.isAnswering && !working.output.cancelled) this.#reclaim(working);
      return;
    }
    const entry = this.#find(cs, pending.m);
    if (entry === undefined || (this.#isStopping && !isClaimed)) return;
    const how = this.#isNeverStarted(id, pending) ? "redo" : howOf(pending, entry.redelivery);
    if (how === "ask") return;
    this.#rememberOutput(id);
    const output = new Output(this.#connection, this.#identity, { bootId: boot, cs }, pending, how === "verify");
    /** @type {RunningHandler} */
    const running = { output, boot, isAnswering: false, isReclaiming: false, ended: Promise.resolve() };
    this.#running.set(id, running);
    running.ended = this.#work(running, entry, isClaimed, pending.lost)
      .catch((error) => this.#connection.log.error(`the handler of ${output} could not be ended:`, error))
      .then(() => this.#onEnd(id, cs, output));
  }

  /** @param {string} id @param {number} cs @param {Output} output */
  #onEnd(id, cs, output) {
    this.#running.delete(id);
    const pending = this.#connection.hub.last(`cs/${cs}/m_code/pending`);
    if (output.cancelled && pending !== undefined) this.#updateHandlers(cs, pending);
  }

  /** @param {(id: string, running: RunningHandler) => boolean} isMeant @param {CancelReason | null} reason */
  #cancel(isMeant, reason) {
    for (const [id, running] of this.#running) {
      if (isMeant(id, running) && !running.isAnswering && !running.output.cancelled) running.output.cancel(reason);
    }
  }

  /** @param {RunningHandler} running @param {HandlerEntry} entry @param {boolean} isClaimed @param {boolean} isLost */
  async #work(running, entry, isClaimed, isLost) {
    const { output } = running;
    const { log } = this.#connection;
    if (!isClaimed) {
      if (isLost) await this.#register();
      const claimed = await this.#untilAnswered(output, "claim", {});
      if (claimed === null || claimed.status !== "accepted" || output.cancelled) {
        log.debug(`${output} is not claimed by this handler`, claimed);
        return;
      }
      if (claimed.how !== undefined) output.redelivered = claimed.how === "verify";
    }
    const alarm = await this.#call(output, entry);
    if (output.cancelled) return;
    running.isAnswering = true;
    const reset = alarm === null ? { result: "ok" } : { result: "fault", code: alarm.code, text: alarm.text };
    const answer = await this.#untilAnswered(output, "reset", reset);
    // `duplicate` means that this reset was sent twice, because its answer was late
    if (answer === null || (answer.status !== "accepted" && answer.status !== "duplicate")) {
      log.warn(`the machine did not accept the reset of ${output}: ${answer?.status ?? "refused"}`);
    }
  }

  /** @param {Output} output @param {HandlerEntry} entry @returns {Promise<Alarm | null>} */
  async #call(output, entry) {
    try {
      entry.declared.check(output.m, output.params);
      await output.work(() => entry.call(output, this.#plc));
      return null;
    } catch (error) {
      if (error instanceof Alarm || output.cancelled) return error instanceof Alarm ? error : null;
      if (error instanceof TandemError) {
        this.#connection.log.warn(`the handler of M${output.m}: ${error.message}`);
        return new Alarm(CODE_OF_ERROR, error.message || error.name);
      }
      this.#connection.log.error(`the handler of M${output.m} has failed:`, error);
      return new Alarm(CODE_OF_EXCEPTION, `the handler of M${output.m} has failed: ${sentence(error)}`);
    }
  }

  /**
   * Claims or resets until the machine answers; null if it refuses permanently, or this program ends.
   * @param {Output} output @param {"claim" | "reset"} kind @param {object} more @returns {Promise<Result | null>}
   */
  async #untilAnswered(output, kind, more) {
    const { stopped, log } = this.#connection;
    const resultOf = { path: output.path("result"), seq: output.seq, handlerId: this.#handlerId, kind };
    for (let tries = 1; !stopped.aborted && (kind === "reset" || !output.cancelled); ) {
      try {
        return await this.#connection.request(output.path(kind), { ...output.named(), ...more }, { resultOf });
      } catch (error) {
        if (error instanceof RequestRefused) {
          const isOld = error.message.includes("unknown field `instance`") && tries < INSTANCE_TRIES;
          if (!isOld) {
            log.warn(`${kind} of ${output} is refused: ${error.message}`);
            return null;
          }
          // a machine without support for instances; an answer to an earlier try may still arrive
          delete this.#identity.instance;
          tries += 1;
        } else if (error instanceof NotConnected || error instanceof NoAnswer) {
          if (!stopped.aborted) log.warn(`${kind} of ${output}: ${error.message}`);
          await sleep(RETRY_MS, stopped);
          if (kind === "claim") await this.#register();
        } else throw error;
      }
    }
    return null;
  }

  /** Registers the handlers again, before a claim: the machine drops the registration when the connection is lost. */
  async #register() {
    await this.#connection.request(this.#presencePath, this.#online(), { retain: true }).catch((error) => {
      if (!(error instanceof NotConnected || error instanceof NoAnswer)) throw error;
    });
  }

  /** Repeats the claim of an output on which a handler still works. @param {RunningHandler} running */
  #reclaim(running) {
    if (running.isReclaiming) return;
    running.isReclaiming = true;
    const { output } = running;
    const claim = async () => {
      await this.#register();
      const claimed = await this.#untilAnswered(output, "claim", {});
      running.isReclaiming = false;
      if (claimed?.status === "accepted") output.postReportsAgain();
      else if (!running.isAnswering && !output.cancelled) output.cancel(null);
    };
    claim().catch((error) => this.#connection.log.error(`the claim of ${output} has failed:`, error));
  }
}

/**
 * Returns how an output is begun, as the machine decides at the claim: for a lost one the strictest setting applies.
 * @param {PendingOutput} pending @param {Redelivery | undefined} own
 */
function howOf({ lost, how, redelivery }, own) {
  if (!lost) return "redo";
  const said = [own, redelivery];
  return how ?? STRICTEST_FIRST.find((one) => said.includes(one)) ?? "ask";
}

/** @param {string} boot @param {number} cs @param {number} seq */
function idOf(boot, cs, seq) {
  return `${boot}/${cs}/${seq}`;
}
