// One output, as its handler uses it.

import { AsyncLocalStorage } from "node:async_hooks";
import { randomBytes } from "node:crypto";

import { Bell, sleep } from "./bell.js";
import { cut, NotConnected, OutputEnded } from "./errors.js";
import { Params } from "./params.js";

const RETRY_MS = 500;
const ASK_TIMEOUT_MS = 2_000;

const QUESTION_MAX = 200;
const CHOICES_MAX = 8;
const CHOICE_MAX = 40;
const PROGRESS_MAX = 200;
const CHECKPOINT_MAX = 4096;

/** Time after a cancellation in which a handler may still send messages, to clean up. */
export const limits = { cleanUpMs: 5_000 };
/** The output whose handler runs in the current asynchronous context. @type {AsyncLocalStorage<Output>} */
const atWork = new AsyncLocalStorage();

/** Throws an `OutputEnded` if the running handler was cancelled and its clean-up time is over. */
export function checkMaySend() {
  atWork.getStore()?.checkMaySend();
}

/** @typedef {{handler_id: string, instance?: string}} Identity */

/**
 * An auxiliary function output: an M code with its parameters, on which a handler works. If the output is cancelled,
 * `signal` is aborted: pass it to every wait of the handler. A cancelled handler has 5 s to clean up; after that, any
 * message that it sends through any `Plc` is refused with an `OutputEnded`, and does not reach the machine.
 */
export class Output {
  /**
   * Aborted when the output no longer belongs to this handler; its `reason` is an `OutputEnded`, whose `reason` is the
   * cause.
   * @type {AbortSignal}
   */
  signal;
  /** VA to VH. @type {Params} */
  params;
  /** True if the work may already have begun and the redelivery is `verify`: check the machine first. */
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
    /** The boot of the runtime that issued the output. */
    this.bootId = bootId;
    /** Coordinate system that issued the output. */
    this.cs = cs;
    this.params = new Params(notice.params);
    this.redelivered = redelivered;
    this.signal = this.#abort.signal;
  }

  /** M number, 0 to 191. */
  get m() {
    return this.#notice.m;
  }

  /** Identifies this output permanently, also across restarts: use it as the key of work that must be done only
   * once. */
  get id() {
    return this.#notice.id;
  }

  /** Sequence number: identifies this output within boot and coordinate system. */
  get seq() {
    return this.#notice.seq;
  }

  /** Number of the NC program that issued the output. */
  get program() {
    return this.#notice.program;
  }

  /** Line of the source file, from 1. */
  get line() {
    return this.#notice.line;
  }

  /** Id of the program run that issued the output. */
  get runId() {
    return this.#notice.run_id;
  }

  /** True once the output is cancelled. */
  get cancelled() {
    return this.signal.aborted;
  }

  /** Reason of the cancellation; null without a cancellation, or if the reason was lost with a connection. */
  get cancelReason() {
    return this.signal.reason instanceof OutputEnded ? this.signal.reason.reason : null;
  }

  toString() {
    return `M${this.m} seq ${this.seq} of coordinate system ${this.cs}`;
  }

  /**
   * Reports the current step of the handler; panels show it while the program waits. The report is sent again after a
   * loss of the connection, and has no effect if this handler no longer owns the output.
   * @param {string} text cut after 200 characters @param {number} [percent] 0 to 100
   */
  progress(text, percent) {
    const share = percent === undefined || Number.isNaN(percent) ? {} : { percent: Math.min(Math.max(percent, 0), 100) };
    this.#progress = { ...this.named(), text: cut(text, PROGRESS_MAX), ...share };
    this.#postReport("progress", this.#progress);
  }

  /** The last `checkpoint` of a previous handler of this output; undefined if no checkpoint was stored. */
  get lastCheckpoint() {
    return this.#notice.checkpoint;
  }

  /**
   * Stores a checkpoint that records the progress of the work; it replaces the previous checkpoint. If this handler is
   * lost, the next handler finds the checkpoint in `lastCheckpoint`. The machine keeps it until the output ends. It is
   * sent again after a loss of the connection, and has no effect if this handler no longer owns the output. Throws a
   * `RangeError` if it is too long.
   * @param {unknown} value at most 4096 bytes as JSON; null removes the checkpoint
   */
  checkpoint(value) {
    const size = Buffer.byteLength(JSON.stringify(value) ?? "");
    if (size === 0) throw new TypeError("a checkpoint is a value that can be written as JSON");
    if (size > CHECKPOINT_MAX) throw new RangeError(`a checkpoint has at most ${CHECKPOINT_MAX} bytes as JSON, but this checkpoint has ${size}`);
    this.#checkpoint = { ...this.named(), checkpoint: value };
    this.#postReport("checkpoint", this.#checkpoint);
  }

  /**
   * Asks the operator, and waits for one of the choices. The question is shown with the output and ends with it;
   * several questions are asked one after the other. Throws `OutputEnded` once the output no longer belongs to this
   * handler, and a `RangeError` for an invalid question.
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
   * Repeats the question until it is shown: the claim may have been lost with the connection.
   * @param {object} question @param {Bell} isHidden @param {AbortSignal} over
   */
  async #keepShown(question, isHidden, over) {
    const { stopped } = this.#connection;
    while (!over.aborted && !stopped.aborted) {
      await isHidden.rung({ signal: over });
      if (over.aborted) return;
      // without an answer the question is asked again
      await this.#connection.request(this.path("ask"), question, { timeoutMs: ASK_TIMEOUT_MS }).catch(() => {});
      await sleep(RETRY_MS, over);
    }
  }

  /** @param {string} id @param {Bell} isHidden */
  async #answerTo(id, isHidden) {
    const look = (/** @type {import("./messages.d.ts").PendingMessage} */ pending) => {
      if (pending.boot_id !== this.bootId) return undefined;
      const output = pending.outputs.find(({ seq }) => seq === this.seq);
      if (output === undefined) throw new OutputEnded(`M${this.m} ended before the question was answered`, null);
      if (output.question?.id === id) isHidden.mute();
      else isHidden.ring();
      return output.question?.id === id ? output.question.answer : undefined;
    };
    const answer = await this.#connection.hub.find(`cs/${this.cs}/m_code/pending`, look, this.signal);
    if (answer === undefined) throw new NotConnected("the connection was closed here");
    return answer;
  }

  /** Returns the topic for a report of this output. @internal @param {string} what */
  path(what) {
    return `cs/${this.cs}/m_code/${this.m}/${what}`;
  }

  /** Returns the members that identify this output in a message. @internal */
  named() {
    return { boot_id: this.bootId, seq: this.seq, ...this.#identity };
  }

  /** Sends the last progress and checkpoint again. @internal */
  postReportsAgain() {
    this.#postReport("progress", this.#progress);
    this.#postReport("checkpoint", this.#checkpoint);
  }

  /** @param {string} what @param {object | null} report */
  #postReport(what, report) {
    if (report !== null && !this.cancelled) this.#connection.post(this.path(what), report);
  }

  /**
   * Runs the work of its handler, so that messages sent by it can be attributed to this output.
   * @internal @template Value @param {() => Value} work
   */
  work(work) {
    return atWork.run(this, work);
  }

  /** @internal @param {import("./messages.d.ts").CancelReason | null} reason */
  cancel(reason) {
    this.#abort.abort(new OutputEnded(`M${this.m} was cancelled; ${this.#whyCancelled(reason)}`, reason));
    setTimeout(() => (this.#isOver = true), limits.cleanUpMs).unref();
  }

  /** @internal */
  checkMaySend() {
    if (!this.#isOver) return;
    const reason = this.cancelReason;
    const ago = `M${this.m} was cancelled ${limits.cleanUpMs / 1000} s ago and more; ${this.#whyCancelled(reason)}`;
    throw new OutputEnded(`${ago}; nothing was sent: its handler must end when output.signal is aborted`, reason);
  }

  /** @param {import("./messages.d.ts").CancelReason | null} reason */
  #whyCancelled(reason) {
    return reason === null ? "it no longer belongs to this handler" : `reason: ${reason}`;
  }
}

/** @param {string} text @param {readonly string[]} choices */
function checkQuestion(text, choices) {
  if (text.length < 1 || text.length > QUESTION_MAX) throw new RangeError(`a question has 1 to ${QUESTION_MAX} characters`);
  if (choices.length < 1 || choices.length > CHOICES_MAX) throw new RangeError(`a question has 1 to ${CHOICES_MAX} choices`);
  if (choices.some((choice) => choice.length < 1 || choice.length > CHOICE_MAX)) throw new RangeError(`a choice has 1 to ${CHOICE_MAX} characters`);
  if (new Set(choices).size !== choices.length) throw new RangeError("a choice occurs twice");
}
