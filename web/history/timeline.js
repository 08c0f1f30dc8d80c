// Activity of each coordinate system over time, read from the journal: motion, waits for M codes, holds, stops, losses.

import { reasonWord, stateWord } from "../machine/sentence.js";
import { listed, t } from "../text/language.js";

/** @typedef {import("./journal.js").Line} Line */
/** @typedef {"moving" | "waiting" | "asked" | "held" | "stopped"} Kind */

/**
 * A section of a run with one activity.
 * @typedef {object} Span
 * @property {Kind} kind
 * @property {number} from ms since 1970
 * @property {number} to
 * @property {string} says such as `M100`, or the reason of a hold
 * @property {number | null} m the awaited M code
 * @property {number | null} line of the program
 * @property {string} who the handler that has claimed it
 * @property {number | null} met the awaited coordinate system, which reached the same M code later
 */

/**
 * @typedef {object} Run
 * @property {number} cs
 * @property {number} program 0: by hand
 * @property {string} runId
 * @property {number} from
 * @property {number} to
 * @property {string} ended empty while it runs
 * @property {Span[]} spans
 */

/** Waits for one M code that end within this time are one meeting, ms. */
const MEETING_MS = 200;

/**
 * The runs of the journal's lines, in the order of their starts.
 * @param {Line[]} lines in the order of time
 * @param {number} now end time of runs that have not ended, ms since 1970
 * @returns {Run[]}
 */
export function timelineOf(lines, now) {
  /** @type {Run[]} */
  const runs = [];
  /** @type {Map<number, RunningRun>} */
  const running = new Map();
  const clock = new Clock();
  for (const line of lines) {
    const { at, isNewBoot, before } = clock.read(line);
    if (isNewBoot) {
      for (const one of running.values()) one.end(before, t("timeline.cut_short"));
      running.clear();
    }
    const cs = line.cs ?? 0;
    if (line.event === "start") {
      const one = new RunningRun(cs, line, at);
      runs.push(one.run);
      running.set(cs, one);
    } else if (line.event === "end") {
      const outcome = outcomeWord(String(line.outcome ?? ""));
      running.get(cs)?.end(at, line.reason ? `${outcome} (${reasonWord(line.reason)})` : outcome);
      running.delete(cs);
    } else {
      running.get(cs)?.applyLine(line, at);
    }
  }
  for (const one of running.values()) one.pause(Math.max(now, one.since));
  findMeetings(runs);
  return runs;
}

/** Times by the machine's monotonic clock, from the first line of each start of the runtime on. */
class Clock {
  #boot = "";
  #zero = 0;
  #last = 0;

  /** @param {Line} line */
  read({ boot_id, t_s, ts }) {
    const before = this.#last;
    const isNewBoot = boot_id !== this.#boot;
    if (isNewBoot) {
      this.#boot = boot_id;
      this.#zero = Date.parse(ts ?? "") - (t_s ?? 0) * 1000;
    }
    this.#last = t_s === null || t_s === undefined ? Date.parse(ts ?? "") : this.#zero + t_s * 1000;
    return { at: this.#last, isNewBoot: isNewBoot && before > 0, before };
  }
}

/** A run that has not ended. */
class RunningRun {
  /** @type {Run} */
  run;
  since;
  /** Open outputs that the motion waits for. @type {Map<number, {m: number, line: number | null, who: string, isAsked: boolean}>} */
  #outputs = new Map();
  #held = "";
  #stopped = "";

  /** @param {number} cs @param {Line} line @param {number} at */
  constructor(cs, line, at) {
    this.run = { cs, program: Number(line.program ?? 0), runId: String(line.run_id ?? ""), from: at, to: at, ended: "", spans: [] };
    this.since = at;
  }

  /** @param {Line} line @param {number} at */
  applyLine(line, at) {
    if (!this.#changes(line)) return;
    this.pause(at);
    const seq = Number(line.seq);
    const output = this.#outputs.get(seq);
    if (line.event === "output") this.#outputs.set(seq, { m: Number(line.m), line: Number(line.line), who: "", isAsked: false });
    else if (line.event === "reset") this.#outputs.delete(seq);
    else if (line.event === "claim" && output) output.who = String(line.handler_id ?? "");
    else if (line.event === "question" && output) output.isAsked = true;
    else if (line.event === "answer" && output) output.isAsked = false;
    else if (line.event === "command") this.#held = "HOLD";
    else if (line.event === "hold") this.#held = String(line.reason ?? "HOLD");
    else if (line.event === "stop") this.#stopped = line.m === undefined || line.m === null ? reasonWord(line.reason ?? "SINGLE_BLOCK") : `M0${line.m}`;
    else if (line.event === "resume") this.#held = this.#stopped = "";
  }

  /** Returns whether a line changes the activity of the run. @param {Line} line */
  #changes({ event, verb, timing, seq }) {
    if (event === "command") return verb === "hold" && this.#held === "" && this.#stopped === "";
    if (event === "output") return timing === "after_motion" && !this.#outputs.has(Number(seq));
    if (event === "reset" || event === "claim" || event === "question" || event === "answer") return this.#outputs.has(Number(seq));
    return event === "hold" || event === "stop" || event === "resume";
  }

  /** Ends the present section. @param {number} at */
  pause(at) {
    const [output] = this.#outputs.values();
    const last = this.run.spans.at(-1);
    this.run.to = at;
    if (at > this.since) {
      const span = this.#span(output, at);
      const isSame = last?.kind === span.kind && last.says === span.says && last.line === span.line && last.to === span.from && (last.who === span.who || last.who === "");
      if (last && isSame) Object.assign(last, { to: at, who: span.who });
      else this.run.spans.push(span);
    }
    this.since = at;
  }

  /** @param {{m: number, line: number | null, who: string, isAsked: boolean} | undefined} output @param {number} at @returns {Span} */
  #span(output, at) {
    const base = { from: this.since, to: at, m: null, line: null, who: "", met: null };
    if (this.#held) return { ...base, kind: "held", says: reasonWord(this.#held) };
    if (this.#stopped) return { ...base, kind: "stopped", says: this.#stopped };
    if (output) return { ...base, kind: output.isAsked ? "asked" : "waiting", says: `M${output.m}`, m: output.m, line: output.line, who: output.who };
    return { ...base, kind: "moving", says: t("timeline.moves") };
  }

  /** @param {number} at @param {string} outcome */
  end(at, outcome) {
    this.pause(at);
    this.run.ended = outcome;
  }
}


/** Returns the end of a run as a text. @param {string} outcome */
function outcomeWord(outcome) {
  if (outcome === "PROGRAM_COMPLETED") return t("timeline.completed");
  return outcome === "STOPPED" ? t("timeline.stopped") : stateWord(outcome);
}

/** Records the awaited coordinate system of each M code at which two of them met. @param {Run[]} runs */
function findMeetings(runs) {
  const waits = runs.flatMap((run) => run.spans.filter(({ m }) => m !== null).map((span) => ({ run, span })));
  for (const { run, span } of waits) {
    const later = waits.find((other) => other.run.cs !== run.cs && other.span.m === span.m && other.span.from > span.from && other.span.from <= span.to && Math.abs(other.span.to - span.to) < MEETING_MS);
    if (later) span.met = later.run.cs;
  }
}

/**
 * Returns the name of a span for a person.
 * @param {Span} span
 */
export function describe({ kind, says, who, met, line }) {
  if (kind === "moving") return t("timeline.moves");
  if (kind === "held") return t("timeline.held", { reason: says });
  if (kind === "stopped") return t("timeline.stands", { reason: says });
  const whom = met !== null ? t("timeline.met", { cs: met }) : who || t("timeline.unclaimed");
  const what = kind === "asked" ? t("timeline.asked", { m: says }) : t("timeline.waits", { m: says });
  return listed([what, whom, line && t("common.line", { line })]);
}

/**
 * Returns the causes of lost time of these runs, the largest first; motion is not a cause.
 * @param {Run[]} runs
 */
export function losses(runs) {
  /** @type {Map<string, {cs: number, kind: Kind, says: string, whom: string, count: number, total: number, longest: number}>} */
  const causes = new Map();
  /** @type {Map<number, {moving: number, total: number}>} */
  const shares = new Map();
  for (const run of runs) {
    const share = shares.get(run.cs) ?? { moving: 0, total: 0 };
    shares.set(run.cs, share);
    for (const { kind, says, who, met, from, to } of run.spans) {
      share.total += to - from;
      if (kind === "moving") {
        share.moving += to - from;
        continue;
      }
      const whom = met !== null ? t("common.coordinate_system", { cs: met }) : kind === "asked" ? t("timeline.operator") : kind === "waiting" ? who || t("timeline.unclaimed") : "";
      const key = [run.cs, kind, says, whom].join();
      const cause = causes.get(key) ?? { cs: run.cs, kind, says, whom, count: 0, total: 0, longest: 0 };
      causes.set(key, { ...cause, count: cause.count + 1, total: cause.total + to - from, longest: Math.max(cause.longest, to - from) });
    }
  }
  return { shares, causes: [...causes.values()].sort((a, b) => b.total - a.total) };
}
