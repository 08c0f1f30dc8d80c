// A broker that several machines share: Debian's Mosquitto, with a port and a folder of its own.

import { spawn } from "node:child_process";
import { once } from "node:events";
import { existsSync } from "node:fs";
import { mkdtemp, rm, writeFile } from "node:fs/promises";
import { connect } from "node:net";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { setTimeout as sleep } from "node:timers/promises";

import { freePort } from "./runtime.mjs";

const BINARY = ["/usr/sbin/mosquitto", "/usr/local/sbin/mosquitto"].find((path) => existsSync(path)) ?? "mosquitto";
const START_MS = 10_000;

export class Mosquitto {
  #child = null;

  static async create() {
    const broker = new Mosquitto();
    broker.folder = await mkdtemp(join(tmpdir(), "tandem-broker-"));
    broker.port = await freePort();
    broker.url = `mqtt://127.0.0.1:${broker.port}`;
    await writeFile(join(broker.folder, "mosquitto.conf"), `listener ${broker.port} 127.0.0.1\nallow_anonymous true\nset_tcp_nodelay true\n`);
    return broker;
  }

  /** Starts it, and waits until it takes connections. */
  async start() {
    this.#child = spawn(BINARY, ["-c", join(this.folder, "mosquitto.conf")], { stdio: "ignore" });
    for (const end = Date.now() + START_MS; Date.now() < end; await sleep(50)) if (await answers(this.port)) return;
    throw new Error(`the broker does not answer at ${this.url}`);
  }

  async kill() {
    const child = this.#child;
    this.#child = null;
    if (child && child.exitCode === null && child.kill("SIGKILL")) await once(child, "exit");
  }

  async remove() {
    await this.kill();
    await rm(this.folder, { recursive: true, force: true });
  }
}

function answers(port) {
  return new Promise((resolve) => {
    const socket = connect(port, "127.0.0.1", () => {
      socket.destroy();
      resolve(true);
    });
    socket.on("error", () => resolve(false));
  });
}
