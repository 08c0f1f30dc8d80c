// Starts the real runtime as its user does: the binary, a configuration file, a separate folder.

import assert from "node:assert/strict";
import { execFile, spawn } from "node:child_process";
import { once } from "node:events";
import { appendFile, mkdtemp, readFile, rm, writeFile } from "node:fs/promises";
import { createServer } from "node:net";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { after, afterEach, before, beforeEach } from "node:test";
import { setTimeout as sleep } from "node:timers/promises";
import { promisify } from "node:util";

import { launch, openPage } from "./browser.mjs";
import { Screen } from "./screen.mjs";

const BINARY = process.env.TANDEM_BIN ?? new URL("../../target/debug/tandem", import.meta.url).pathname;
const START_MS = 20000;

/** A bracket: contour, tool change in the middle, four holes. M08 and M100 have no handler here, so they stay pending. */
const BRACKET = `// Bracket with four holes
N10 G17 G90 G54
N20 S3000
N25 M08                    // coolant on, while the machine keeps moving
N30 G00 X-8 Y-8 Z5
N40 G01 Z-3 F3000
N50 X88 F6000
N60 Y40
N70 X70 Y58
N80 X10
N90 X-8 Y40
N100 Y-8
N110 G00 Z50
N120 M100 VA5 VB0.25   // drill 6.8
N130 G00 X10 Y10
N140 G01 Z-5 F3000
N150 G00 Z5
N160 X70
N170 G01 Z-5
N180 G00 Z5
N190 Y40
N200 G01 Z-5
N210 G00 Z5
N220 X10
N230 G01 Z-5
N240 G00 Z50
N250 M30
`;

/** A program that is slow enough for hold, switches and stop by hand. */
const LONG_WAY = `// Long way
G90 G54
G01 X100 F600
G01 X0
M30
`;

const LOADER = `// Loader: to the magazine and back
G90
G01 X100 F3000
G01 X0
M30
`;

function config(http, mqtt) {
  const motor = (number) => `
[[motor]]
number = ${number}
kind = "linear"
max_velocity = 500.0
max_acceleration = 5000.0
soft_limits = [-500.0, 500.0]
`;
  return `[machine]
name = "mill-1"
data_dir = "data"
${[1, 2, 3, 4, 5].map(motor).join("")}
[[motor]]
number = 6
kind = "spindle"
max_velocity = 12000.0
max_acceleration = 24000.0

[[coordinate_system]]
number = 1
axes = { X = 1, Y = 2, Z = 3 }
spindle = 6
max_feedrate = 30000.0
default_feedrate = 1000.0
programs = { 1 = "bracket.nc", 2 = "long_way.nc" }
[coordinate_system.work_offset]
G54 = { X = 120.0, Y = 60.0, Z = -100.0 }

[[coordinate_system]]
number = 2
axes = { X = 4, Z = 5 }
max_feedrate = 30000.0
default_feedrate = 1000.0
programs = { 3 = "loader.nc" }

[m_code.100]
unhandled = "wait"
wait_state = "TOOL_LOAD"

[m_code.8]
timing = "with_motion"
unhandled = "wait"

[mqtt]
listen = "127.0.0.1:${mqtt}"

[http]
listen = "127.0.0.1:${http}"
`;
}

/** Ports below the range that the operating system assigns to clients, so that no client occupies one before the runtime. */
export async function freePort() {
  const port = 10000 + Math.floor(Math.random() * 20000);
  const server = createServer();
  server.listen(port, "127.0.0.1");
  try {
    await once(server, "listening");
  } catch {
    return freePort();
  }
  server.close();
  await once(server, "close");
  return port;
}

export class Runtime {
  log = "";
  #child = null;

  /** Creates a folder with configuration and programs, and selects free ports. */
  static async create() {
    const runtime = new Runtime();
    runtime.folder = await mkdtemp(join(tmpdir(), "tandem-hmi-"));
    const http = await freePort();
    runtime.url = `http://127.0.0.1:${http}`;
    const files = { "tandem.toml": config(http, await freePort()), "bracket.nc": BRACKET, "long_way.nc": LONG_WAY, "loader.nc": LOADER };
    for (const [name, text] of Object.entries(files)) await writeFile(join(runtime.folder, name), text);
    return runtime;
  }

  /** Requires tokens from the next start on; returns a token. */
  async withToken(role) {
    const arguments_ = ["token", "screen", "--role", role, "--file", join(this.folder, "tokens.toml")];
    const { stdout } = await promisify(execFile)(BINARY, arguments_);
    await appendFile(join(this.folder, "tandem.toml"), 'token_file = "tokens.toml"\n');
    return stdout.match(/^token: (\w+)$/m)[1];
  }

  /** Adds lines to the configuration for the next start: keys of an existing table, or new tables. */
  async add(lines, table = null) {
    const file = join(this.folder, "tandem.toml");
    const text = await readFile(file, "utf8");
    await writeFile(file, table ? text.replace(`\n[${table}]\n`, (head) => `${head}${lines}\n`) : `${text}${lines}`);
  }

  /** Returns the text of the configuration. */
  configuration() {
    return readFile(join(this.folder, "tandem.toml"), "utf8");
  }

  /** Replaces a line of the configuration for the next start. */
  async change(line, other) {
    const file = join(this.folder, "tandem.toml");
    const text = await this.configuration();
    if (!text.includes(line)) throw new Error(`the configuration has no ${line}`);
    await writeFile(file, text.replace(line, other));
  }

  /** Adds a person that may log in from the next start on. */
  async withPerson(name, role, pin) {
    const arguments_ = ["token", name, "--role", role, "--file", join(this.folder, "tokens.toml"), "--pin"];
    const ran = promisify(execFile)(BINARY, arguments_);
    ran.child.stdin.end(`${pin}\n`);
    await ran;
  }

  /** Starts the runtime, and waits until REST answers. */
  async start() {
    const child = spawn(BINARY, ["serve", "--config", join(this.folder, "tandem.toml")], { stdio: ["ignore", "pipe", "pipe"] });
    this.#child = child;
    let failed = null;
    child.on("error", (error) => (failed = error));
    for (const stream of [child.stdout, child.stderr]) stream.on("data", (data) => (this.log += data));
    for (const end = Date.now() + START_MS; Date.now() < end; await sleep(50)) {
      if (failed) throw failed;
      if (child.exitCode !== null) throw new Error(`the runtime ended with ${child.exitCode}:\n${this.log}`);
      const answer = await fetch(`${this.url}/api/v1/health`).catch(() => null);
      if (answer) return;
    }
    throw new Error(`the runtime does not answer at ${this.url}:\n${this.log}`);
  }

  /** Suspends the process until it is resumed, as when a computer is suspended. */
  pause() {
    this.#child.kill("SIGSTOP");
  }

  resume() {
    this.#child?.kill("SIGCONT");
  }

  /** Ends the process at once, as a power cut does. */
  async kill() {
    await this.#end("SIGKILL");
  }

  /** Ends the process in order; returns the exit code. */
  async stop() {
    return this.#end("SIGTERM");
  }

  async remove() {
    await this.kill();
    await rm(this.folder, { recursive: true, force: true });
  }

  async #end(signal) {
    const child = this.#child;
    this.#child = null;
    if (!child) return null;
    if (child.exitCode === null && child.signalCode === null && child.kill(signal)) await once(child, "exit");
    return child.exitCode;
  }
}

/** Before the tests of a file configures and starts a runtime, and a browser, and hands them to `take`; they end after the tests. */
export function withRuntime(take, configure = async () => {}) {
  let made;
  before(async () => {
    const runtime = await Runtime.create();
    made = { runtime };
    await configure(runtime);
    await runtime.start();
    made.browser = await launch();
    await take(made);
  });
  after(async () => {
    await made?.browser?.close();
    await made?.runtime.remove();
  });
}

/**
 * Before each test opens a connected page of `machine()`, a runtime and a browser, and hands it to `take`; after it the page has
 * reported no error.
 */
export function withPage(machine, take) {
  let opened;
  beforeEach(async () => {
    const { runtime, browser } = machine();
    opened = await openPage(browser);
    take({ ...opened, screen: new Screen(opened.page) });
    await opened.page.goto(runtime.url);
    await opened.page.getByText("Connected", { exact: true }).waitFor();
  });
  afterEach(async () => {
    await opened.close();
    assert.deepEqual(opened.errors, [], "the browser's console shows no errors, and all is of its form");
  });
}
