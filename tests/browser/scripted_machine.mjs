// A machine played by the test: the HMI's files, REST and the WebSocket answered inside the browser. It shows the
// HMI states that are rare on a real machine: a lost handler, refusals, a program of a million lines, another
// boot.

import { readFile } from "node:fs/promises";
import { extname, join } from "node:path";

import { build } from "esbuild";

import { PLAN, plannedPath, rehearsal } from "./planned.mjs";
import { wrongAsked, wrongFrame } from "./schemas.mjs";

const WEB = new URL("../../web/", import.meta.url).pathname;
const TYPES = { ".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml" };
export const ORIGIN = "http://hmi.test";
/** Modules that a page loads as one file each, bundled with all imports, which saves a hundred answers for each
 * page. */
const ENTRIES = { main: "main.js", machines: "machines.js", renderer_worker: "path/renderer_worker.js" };
let bundles = null;

/** Texts of the bundled modules by path; modules imported later remain separate files. */
function bundled() {
  const entryPoints = Object.entries(ENTRIES).map(([out, file]) => ({ in: join(WEB, file), out }));
  bundles ??= build({ entryPoints, bundle: true, splitting: true, format: "esm", write: false, outdir: "/", logLevel: "error" })
    .then(({ outputFiles }) => new Map(outputFiles.map(({ path, text }) => [path, text])));
  return bundles;
}

const axes = (numbers) => ({ kind: "linear", soft_limits: [-500, 500], max_velocity: 500, ...numbers });

export const BIRTH = {
  machine: "mill-1",
  servo_period_us: 1000,
  identification: {},
  coordinate_systems: [
    { number: 1, axes: { X: 1, Y: 2, Z: 3 }, spindle: 6, dialect: "nj", units: "mm" },
    { number: 2, axes: { X: 4, Z: 5 }, spindle: null, dialect: "nj", units: "mm" },
  ],
  motors: [1, 2, 3, 4, 5].map((number) => axes({ number })).concat({ number: 6, kind: "spindle", soft_limits: null, max_velocity: 12000 }),
  m_codes: {},
  serves: [],
  io: { in: {}, out: {} },
  limits: { open_outputs_max: 64, program_bytes_max: 67108864 },
};

export const STATE = {
  execution: "READY", transition: null, reason: null, wait_state: null, waiting_on: null, program: 1, run_id: null, run_kind: null,
  hash: PLAN.hash, o_number: null, single_block: false, dry_run: false, optional_stop: false, optional_skip: [], alarm_count: 0, last_command_id: null,
};

/** Returns true if a subscription, which may end with `#`, includes a topic. */
const fits = (pattern, topic) => pattern === topic || (pattern.endsWith("#") && topic.startsWith(pattern.slice(0, -1)));

export class ScriptedMachine {
  bootId = "boot-1";
  rev = 0;
  /** Last payload of each topic. */
  topics = new Map();
  /** Every request below `/api/v1` except reads: `{method, path, body}`. */
  requests = [];
  /** Answers by `METHOD path`: `{status, body}`. */
  answers = new Map();
  /** Vertices of planned paths by program: `[x, y, z, line, time, rapid]`; data of rehearsals. */
  paths = new Map();
  rehearsals = new Map();
  /** Program of the plan, if it differs from the run or the loaded text. */
  plans = new Map();
  /** Program text by number. */
  programs = new Map();
  programList = [];
  /** Frames of either side that no real machine sends or understands. */
  wrong = [];
  reachable = true;
  /** True if further connections are accepted. */
  takesSockets = true;
  #sockets = new Set();
  #commands = new Set();

  /** Answers all requests of the page to ORIGIN. */
  async attach(page) {
    await page.routeWebSocket(/\/api\/v1\/ws$/, (socket) => {
      if (!this.reachable || !this.takesSockets) return void socket.close();
      this.#sockets.add(socket);
      socket.subscribed = new Set();
      socket.onClose(() => this.#sockets.delete(socket));
      socket.onMessage((text) => {
        this.#check(wrongAsked(text));
        for (const pattern of JSON.parse(text).subscribe) {
          if (socket.subscribed.has(pattern)) continue;
          socket.subscribed.add(pattern);
          for (const topic of this.topics.keys()) if (fits(pattern, topic)) this.#send(socket, topic);
        }
      });
    });
    await page.route(`${ORIGIN}/**`, (route) => this.#serve(route));
  }

  /** Publishes a payload on a topic; outputs have names according to their numbers. */
  say(topic, payload) {
    const outputs = payload.outputs?.map((output) => ({ id: `${this.bootId}-${topic.split("/")[1]}-${output.seq}`, ...output }));
    this.topics.set(topic, outputs ? { ...payload, outputs } : payload);
    const wants = (socket) => [...socket.subscribed].some((pattern) => fits(pattern, topic));
    for (const socket of this.#sockets) if (wants(socket)) this.#send(socket, topic);
  }

  /** Publishes the state of a coordinate system with these fields changed. */
  state(cs, change) {
    this.say(`cs/${cs}/state`, { ...STATE, ...this.topics.get(`cs/${cs}/state`), ...change });
  }

  /** Ends all connections and accepts none, or accepts them again. */
  setReachable(reachable) {
    this.reachable = reachable;
    if (!reachable) for (const socket of this.#sockets) socket.close();
    if (!reachable) this.#sockets.clear();
  }

  /** Sends a machine's first messages: two coordinate systems at rest, positions zero. */
  start() {
    this.say("presence", { online: true, started_at: now(), version: "0.1.0" });
    this.say("heartbeat", { cycle: 1 });
    this.say("birth", BIRTH);
    this.say("alarm/active", { alarms: [] });
    for (const { number, axes: named } of BIRTH.coordinate_systems) {
      const zero = Object.fromEntries(Object.keys(named).map((axis) => [axis, 0]));
      this.say(`cs/${number}/state`, STATE);
      this.say(`cs/${number}/program`, { number: null, nest_level: 0, stack: [], line: 0, block: "", interpreted_line: 0 });
      this.say(`cs/${number}/position`, { machine: zero, work: zero, distance_to_go: zero, actual: zero, homed: Object.fromEntries(Object.keys(named).map((axis) => [axis, true])), following_error: zero, feedrate: 0, spindle_rpm: 0 });
      this.say(`cs/${number}/modal`, { g: { "01": "G00" }, f: 0, s: 0, ta: 100, td: 100, ts_ms: 50, tool: 0, work_offset: "G54", mdi: [] });
      this.say(`cs/${number}/m_code/pending`, { outputs: [] });
      this.say(`cs/${number}/override/state`, { feed: 100, rapid: 100, spindle: 100 });
      this.say(`cs/${number}/input/optional_skip/state`, { requested: [], effective: [], effective_from_line: 0 });
      for (const input of ["optional_stop"]) this.say(`cs/${number}/input/${input}/state`, { value: false });
    }
  }

  #send(socket, topic) {
    this.rev += 1;
    const frame = JSON.stringify({ topic, v: 1, boot_id: this.bootId, ts: now(), rev: this.rev, ...this.topics.get(topic) });
    this.#check(wrongFrame(frame));
    socket.send(frame);
  }

  /** Records a request that changes something, without its age limit; a repeated command is recorded once. */
  #note(request, path) {
    const key = request.headers()["idempotency-key"];
    if (key !== undefined && this.#commands.has(key)) return;
    this.#commands.add(key);
    const { not_after: _limit, ...body } = request.postDataJSON() ?? {};
    this.requests.push({ method: request.method(), path, body: request.postData() === null ? null : body });
  }

  #check(problem) {
    if (problem) this.wrong.push(problem);
  }

  async #serve(route) {
    const request = route.request();
    const { pathname } = new URL(request.url());
    if (!this.reachable) return route.abort();
    if (!pathname.startsWith("/api/v1/")) {
      const file = pathname === "/" ? "index.html" : pathname.slice(1);
      const headers = { "Content-Security-Policy": "default-src 'self'" };
      const body = (await bundled()).get(pathname) ?? await readFile(join(WEB, file));
      return route.fulfill({ body, contentType: TYPES[extname(file)] ?? "text/plain", headers });
    }
    const path = pathname.slice("/api/v1".length);
    if (request.method() !== "GET") this.#note(request, path);
    const answer = this.answers.get(`${request.method()} ${path}`);
    if (answer) return route.fulfill(answer.status < 400 ? { status: answer.status, json: answer.body } : problem(answer));
    const planned = /^\/programs\/(\d+)\/(path|rehearsal)$/.exec(path);
    if (planned) return this.#plan(route, Number(planned[1]), planned[2]);
    if (path === "/programs") {
      const unsaid = { dialect: "nj", hash: "5".repeat(64), folder: "", o_number: null, signature: null };
      return route.fulfill({ json: { programs: this.programList.map((program) => ({ ...unsaid, ...program })) } });
    }
    const text = this.programs.get(Number(/^\/programs\/(\d+)$/.exec(path)?.[1]));
    if (text !== undefined) return route.fulfill({ body: text, contentType: "text/plain; charset=utf-8" });
    return route.fulfill(this.#answer(request.method(), path, request.postDataJSON()));
  }

  /** Answers with the planned path of a program, which is constant unless a test changes it, and its rehearsal. */
  #plan(route, number, what) {
    const cs = Number(new URL(route.request().url()).searchParams.get("cs") ?? 1);
    const { run_kind: kind, run_id: id, hash } = this.topics.get(`cs/${cs}/state`);
    const of = { run_id: kind === "program" ? id : null, hash: hash ?? PLAN.hash };
    if (what === "rehearsal") return route.fulfill({ json: rehearsal(number, cs, { ...of, plan: { ...PLAN, hash: of.hash }, ...this.rehearsals.get(number) }) });
    const body = plannedPath(number, cs, this.paths.get(number) ?? [], { ...PLAN, ...of, ...this.plans.get(number) });
    return route.fulfill({ body, contentType: "application/octet-stream", headers: { ETag: `"${number}-${cs}-all"` } });
  }

  /** Returns the answers of a machine that accepts everything. */
  #answer(method, path, body) {
    const handshake = /^\/cs\/\d+\/m_codes\/(\d+)\/(reset|answer)$/.exec(path);
    if (handshake) return { json: { seq: Number(handshake[1]), handler_id: body.handler_id ?? "hmi", status: "accepted" } };
    if (path.endsWith("/redeliver")) return { status: 204 };
    if (path === "/hmi") return { json: { jog_step_max: 10, buttons: [], cards: [] } };
    if (path === "/machines") return { json: { addresses: [], broker: "none", machines: [] } };
    if (path === "/health") return { json: { status: "ok" } };
    if (path === "/machine") return { json: { v: 1, boot_id: this.bootId, ts: now(), ...BIRTH } };
    if (path === "/journal") return { json: { lines: [] } };
    if (path === "/tools") return { json: { tools: [] } };
    if (path.endsWith("/work_offsets") && method === "GET") return { json: { work_offsets: { G54: { X: 1, Y: 2, Z: 3 } } } };
    if (path === "/login") return { json: { user: null, role: "admin", is_login: false } };
    if (path.endsWith("/trace")) return { json: rest(Number(path.split("/")[2])) };
    if (path.endsWith("/last_run")) return { json: { last_run: null } };
    return method === "GET" ? problem({ status: 404, body: { detail: `there is no ${path}` } }) : { status: 202, json: { command_id: "scripted" } };
  }
}

/** Returns the recent trace of axes at rest: two samples. */
function rest(cs) {
  const zero = [0, 0];
  const letters = Object.keys(BIRTH.coordinate_systems.find(({ number }) => number === cs).axes);
  const still = { position: zero, velocity: zero, acceleration: zero, following_error: zero };
  return { cs, interval_s: 0.01, first: 0, next: 2, now: now(), now_s: 1, time_s: [0.98, 0.99], feedrate: zero, spindle_rpm: zero, axes: Object.fromEntries(letters.map((letter) => [letter, still])) };
}

/** Returns a refusal as problem details. */
function problem({ status, body }) {
  const details = { type: "about:blank", title: "Refused", status, code: "refused", ...body };
  return { status, body: JSON.stringify(details), contentType: "application/problem+json" };
}

export function now(agoMs = 0) {
  return new Date(Date.now() - agoMs).toISOString();
}
