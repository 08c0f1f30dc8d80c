// One output, as its handler uses it.

import { AsyncLocalStorage } from "node:async_hooks";
import { randomBytes } from "node:crypto";

import { Bell, sleep } from "./bell.js";
import { cut, Ended, NotConnected } from "./errors.js";
import { Params } from "./params.js";

const RETRY_MS = 500;
const ASK_TIMEOUT_MS = 2_000;

const QUESTION_MAX = 200;
const CHOICES_MAX = 8;
const CHOICE_MAX = 40;
const PROGRESS_MAX = 200;
const CHECKPOINT_MAX = 4096;

/** How long a handler may still send after its output was cancelled, to clean up. */
export const limits = { cleanUpMs: 5_000 };
/** The output whose handler is at work in what runs now. @type {AsyncLocalStorage<Output>} */
const atWork = new AsyncLocalStorage();

/** Throws an `Ended` where the handler that would send now was cancelled, and has had its time to clean up. */
export function checkMaySend() {
  atWork.getStore()?.checkMaySend();
}

/** @typedef {{handler_id: string, instance?: string}} Identity */

/**
 * An auxiliary function output: an M code with its parameters, on which a handler works. When it is cancelled, `signal` is aborted:
 * give it to whatever the handler waits for. A handler that is cancelled has 5 s to clean up; what it sends later by any `Plc` is
 * refused with an `Ended`, and does not reach the machine.
 */
export class Output {
  /** Aborted when the output is no longer this handler's; its `reason` is an `Ended`, whose `reason` says why. @type {AbortSignal} */
  signal;
  /** VA to VH. @type {Params} */
  params;
  /** True when the work may have been begun before and it was decided to look first: check the machine. */
  redelivered;
  #connection;
  #identity;
  #notice;
  #abort = new AbortController();
  #isOver = false;
  /** @type {object | null} */
  #progress = null;
  /** @type {object | null} */
  #checkpoint = null;
  /** @type {Promise<unknown>} */
  #turn = Promise.resolve();

  /**
   * @param {import("./connection.js").Connection} connection @param {Identity} identity
   * @param {{bootId: string, cs: number}} place @param {import("./messages.d.ts").PendingOutput} notice @param {boolean} redelivered
   */
  constructor(connection, identity, { bootId, cs }, notice, redelivered) {
    this.#connection = connection;
    this.#identity = identity;
    this.#notice = notice;
    /** The boot of the runtime that has put it out. */
    this.bootId = bootId;
    /** Coordinate system that has put it out. */
    this.cs = cs;
    this.params = new Params(notice.params);
    this.redelivered = redelivered;
    this.signal = this.#abort.signal;
  }

  /** M number, 0 to 191. */
  get m() {
    return this.#notice.m;
  }

  /** Names this output for ever, also over restarts: what is done once for each output is kept by it. */
  get id() {
    return this.#notice.id;
  }

  /** Identifies it within boot and coordinate system. */
  get seq() {
    return this.#notice.seq;
  }

  /** Number of its program. */
  get program() {
    return this.#notice.program;
  }

  /** Line of the source file, from 1. */
  get line() {
    return this.#notice.line;
  }

  /** The program run that has put it out. */
  get runId() {
    return this.#notice.run_id;
  }

  /** True once it is cancelled. */
  get cancelled() {
    return this.signal.aborted;
  }

  /** Why it was cancelled; null if it is not, or if the reason was lost with a connection. */
  get cancelReason() {
    return this.signal.reason instanceof Ended ? this.signal.reason.reason : null;
  }

  toString() {
    return `M${this.m} seq ${this.seq} of coordinate system ${this.cs}`;
  }

  /**
   * Tells what the handler does now; panels show it while the program waits. It is told again after a loss of the connection, and has
   * no effect once the output is no longer this handler's.
   * @param {string} text of more than 200 characters the first @param {number} [percent] 0 to 100
   */
  progress(text, percent) {
    const share = percent === undefined || Number.isNaN(percent) ? {} : { percent: Math.min(Math.max(percent, 0), 100) };
    this.#progress = { ...this.named(), text: cut(text, PROGRESS_MAX), ...share };
    this.#tell("progress", this.#progress);
  }

  /** What the last `checkpoint` of whoever worked on it before has noted; undefined where nothing was. */
  get lastCheckpoint() {
    return this.#notice.checkpoint;
  }

  /**
   * Notes how far the work has come, in place of what was noted before. When this handler is lost and another takes the output up, that
   * one has it as `lastCheckpoint`. The machine keeps it as long as the output is open. It is told again after a loss of the
   * connection, and has no effect once the output is no longer this handler's. Throws a `RangeError` where it is too long.
   * @param {unknown} value anything that has at most 4096 bytes as JSON; null takes it away
   */
  checkpoint(value) {
    const size = Buffer.byteLength(JSON.stringify(value) ?? "");
    if (size === 0) throw new TypeError("a checkpoint is a value that can be written as JSON");
    if (size > CHECKPOINT_MAX) throw new RangeError(`a checkpoint has at most ${CHECKPOINT_MAX} bytes as JSON, and this one has ${size}`);
    this.#checkpoint = { ...this.named(), checkpoint: value };
    this.#tell("checkpoint", this.#checkpoint);
  }

  /**
   * Asks the operator, and waits for one of the choices. The question is shown with the output and ends with it; several are asked one
   * after the other. Throws `Ended` once the output is no longer this handler's, and a `RangeError` for what cannot be asked.
   * @template {string} Choice
   * @param {string} text 1 to 200 characters @param {readonly Choice[]} choices 1 to 8 different texts of 1 to 40 characters
   * @returns {Promise<Choice>}
   */
  async ask(text, choices) {
    checkQuestion(text, choices);
    const turn = this.#turn.then(() => this.#askOnce(text, choices));
    this.#turn = turn.catch(() => {});
    return /** @type {Promise<Choice>} */ (turn);
  }

  /** @param {string} text @param {readonly string[]} choices */
  async #askOnce(text, choices) {
    const question = { ...this.named(), question_id: `question-${randomBytes(6).toString("hex")}` };
    const isHidden = new Bell();
    const over = new AbortController();
    isHidden.ring();
    try {
      void this.#keepShown({ ...question, text, choices }, isHidden, over.signal);
      return await this.#answerTo(question.question_id, isHidden);
    } catch (error) {
      this.#connection.post(this.path("ask"), { ...question, choices: [] });
      throw error;
    } finally {
      over.abort();
    }
  }

  /**
   * While it is not shown it is asked again: the claim may have been lost with the connection.
   * @param {object} question @param {Bell} isHidden @param {AbortSignal} over
   */
  async #keepShown(question, isHidden, over) {
    const { stopped } = this.#connection;
    while (!over.aborted && !stopped.aborted) {
      await isHidden.rung({ signal: over });
      if (over.aborted) return;
      // without an answer it is asked once more
      await this.#connection.request(this.path("ask"), question, { timeoutMs: ASK_TIMEOUT_MS }).catch(() => {});
      await sleep(RETRY_MS, over);
    }
  }

  /** @param {string} id @param {Bell} isHidden */
  async #answerTo(id, isHidden) {
    const look = (/** @type {import("./messages.d.ts").PendingMessage} */ pending) => {
      if (pending.boot_id !== this.bootId) return undefined;
      const output = pending.outputs.find(({ seq }) => seq === this.seq);
      if (output === undefined) throw new Ended(`M${this.m} has ended before it was answered`, null);
      if (output.question?.id === id) isHidden.mute();
      else isHidden.ring();
      return output.question?.id === id ? output.question.answer : undefined;
    };
    const answer = await this.#connection.hub.find(`cs/${this.cs}/m_code/pending`, look, this.signal);
    if (answer === undefined) throw new NotConnected("the connection was closed here");
    return answer;
  }

  /** Where something is said of it. @internal @param {string} what */
  path(what) {
    return `cs/${this.cs}/m_code/${this.m}/${what}`;
  }

  /** What names it in a message. @internal */
  named() {
    return { boot_id: this.bootId, seq: this.seq, ...this.#identity };
  }

  /** Tells the last progress and checkpoint again. @internal */
  tellAgain() {
    this.#tell("progress", this.#progress);
    this.#tell("checkpoint", this.#checkpoint);
  }

  /** @param {string} what @param {object | null} report */
  #tell(what, report) {
    if (report !== null && !this.cancelled) this.#connection.post(this.path(what), report);
  }

  /** Does the work of its handler; what that sends is known by it. @internal @template Value @param {() => Value} work */
  work(work) {
    return atWork.run(this, work);
  }

  /** @internal @param {import("./messages.d.ts").CancelReason | null} reason */
  cancel(reason) {
    this.#abort.abort(new Ended(`M${this.m} was cancelled; ${this.#whyCancelled(reason)}`, reason));
    setTimeout(() => (this.#isOver = true), limits.cleanUpMs).unref();
  }

  /** @internal */
  checkMaySend() {
    if (!this.#isOver) return;
    const reason = this.cancelReason;
    const ago = `M${this.m} was cancelled ${limits.cleanUpMs / 1000} s ago and more; ${this.#whyCancelled(reason)}`;
    throw new Ended(`${ago}; nothing was sent: its handler must end when output.signal is aborted`, reason);
  }

  /** @param {import("./messages.d.ts").CancelReason | null} reason */
  #whyCancelled(reason) {
    return reason === null ? "it is no longer this handler's" : `reason: ${reason}`;
  }
}

/** @param {string} text @param {readonly string[]} choices */
function checkQuestion(text, choices) {
  if (text.length < 1 || text.length > QUESTION_MAX) throw new RangeError(`a question has 1 to ${QUESTION_MAX} characters`);
  if (choices.length < 1 || choices.length > CHOICES_MAX) throw new RangeError(`a question has 1 to ${CHOICES_MAX} choices`);
  if (choices.some((choice) => choice.length < 1 || choice.length > CHOICE_MAX)) throw new RangeError(`a choice has 1 to ${CHOICE_MAX} characters`);
  if (new Set(choices).size !== choices.length) throw new RangeError("a choice stands twice");
}
