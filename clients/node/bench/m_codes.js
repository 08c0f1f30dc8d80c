// Measures the time from the output of an M code to the output of the next one, over the embedded broker.
// TANDEM_BIN=target/release/tandem node clients/node/bench/m_codes.js [M CODES]

import { SequenceProgram } from "../src/index.js";
import { Machine } from "../src/testing.js";

const count = Number(process.argv[2] ?? 1_000);
const machine = await Machine.start();
/** @type {number[]} */
const moments = [];
const program = new SequenceProgram("bench").on(20, () => moments.push(performance.now()));
const serving = await program.serve(machine.mqtt);
try {
  const { completed, alarms } = await machine.run(`${"M20\n".repeat(count + 1)}M30\n`);
  if (!completed) throw new Error(`the run has ended: ${alarms.join(", ")}`);
  const took = moments.slice(1).map((moment, at) => moment - (moments[at] ?? 0));
  took.sort((a, b) => a - b);
  const share = (/** @type {number} */ of) => took[Math.floor(took.length * of)]?.toFixed(2);
  console.log(`${took.length} M codes: median ${share(0.5)} ms, p99 ${share(0.99)} ms`);
} finally {
  await serving.close();
  await machine.close();
}
