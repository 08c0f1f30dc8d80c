// Errors between a program and a machine.

/** First alarm number of sequence programs: the number of an alarm is this base plus the code. */
const USER_ALARM_BASE = 10_000;
export const CODE_MAX = 9_999;
/** Maximum number of characters of an alarm's text; a longer text is cut. */
export const TEXT_MAX = 1_000;

/** Code of the alarm that a `TandemError` in a handler becomes. */
export const CODE_OF_ERROR = 9_999;
/** Code of the alarm that any other exception in a handler becomes. */
export const CODE_OF_EXCEPTION = 9_998;
/** Code of the alarm of a parameter that is missing or out of its range. */
export const CODE_OF_PARAMETER = 9_997;

/**
 * An alarm of a sequence program: thrown in a handler, it stops the NC program. The machine shows number 10000 + code
 * and the unchanged text. Throws a `RangeError` if the code is not 0 to 9999, or the text is empty.
 */
export class Alarm extends Error {
  /** @param {number} code 0 to 9999 @param {string} text for the operator; cut after 1000 characters */
  constructor(code, text) {
    if (!Number.isInteger(code) || code < 0 || code > CODE_MAX) throw new RangeError(`alarm code ${code}: write 0 to ${CODE_MAX}`);
    if (text === "") throw new RangeError("an alarm needs a text: describe the fault for the operator");
    super(cut(text, TEXT_MAX));
    this.name = "Alarm";
    this.code = code;
  }

  /** The text as shown. */
  get text() {
    return this.message;
  }

  /** Number that the machine shows: 10000 + code. */
  get number() {
    return USER_ALARM_BASE + this.code;
  }
}

/** Base of all errors between a program and a machine. */
export class TandemError extends Error {
  /** @param {string} text */
  constructor(text) {
    super(text);
    this.name = new.target.name;
  }
}

/** The address is not a valid address of a machine. */
export class AddressError extends TandemError {}

/** A sequence program has a mistake, such as two handlers for one M code. */
export class ProgramError extends TandemError {}

/** Another process with this handler id serves the machine: this process has ended, or was refused. */
export class TakenOver extends TandemError {}

/** The machine was not found in time, or the broker refuses this client for good. */
export class ConnectError extends TandemError {}

/** There is no connection; nothing was sent and nothing has changed. */
export class NotConnected extends TandemError {}

/** The machine has refused a request; nothing has changed. */
export class RequestRefused extends TandemError {
  /** @param {string} code @param {string} text */
  constructor(code, text) {
    super(text);
    /** Machine-readable reason, such as `not_allowed`, `start_locked` or `invalid`. */
    this.code = code;
  }
}

/** A command was accepted, but its effect was prevented. */
export class CommandFailed extends TandemError {
  /** @param {string} verb @param {string} code @param {string} text @param {Record<string, number>} [moved] */
  constructor(verb, code, text, moved = {}) {
    super(`${verb} failed: ${text}`);
    this.verb = verb;
    /** Machine-readable reason. */
    this.code = code;
    /** Distance covered by `jog`, `mdi` or `home`, by axis letter, mm or degrees. */
    this.moved = moved;
  }
}

/**
 * The machine did not answer within the time limit, so the effect of the request is unknown. A command can be repeated
 * safely with `{ commandId: error.commandId }`: within 10 minutes and one boot the machine repeats its answer and does
 * not execute it twice.
 */
export class NoAnswer extends TandemError {
  /** @param {string} what @param {number} timeoutMs @param {string | undefined} commandId */
  constructor(what, timeoutMs, commandId) {
    super(`${what}: no answer within ${timeoutMs / 1000} s; its effect is unknown`);
    /** Id of the command; undefined if the request was not a command. */
    this.commandId = commandId;
  }
}

/** The output no longer belongs to this handler: it was cancelled, reset by hand, or belongs to another boot. */
export class OutputEnded extends TandemError {
  /** @param {string} text @param {import("./messages.d.ts").CancelReason | null} reason */
  constructor(text, reason) {
    super(text);
    /** Reason of the cancellation; null if it was lost with a connection. */
    this.reason = reason;
  }
}

/** Returns the first characters of a text, without splitting one. @param {string} text @param {number} most */
export function cut(text, most) {
  return text.length <= most ? text : [...text].slice(0, most).join("");
}

/** Returns the message of an error. @param {unknown} error */
export function sentence(error) {
  return error instanceof Error ? `${error.name}: ${error.message}` : String(error);
}
