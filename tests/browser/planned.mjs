// A planned path and a rehearsal in the form that a machine sends: see "Planned path and rehearsal" in the
// book.

const LEVELS = 4;

/** Inputs of a plan, unless a test sets them. */
export const PLAN = { hash: "5".repeat(64), called: null, inputs: "0".repeat(16) };

/**
 * The bytes of a path of one chunk: `[x, y, z, line, time, rapid]` of each vertex, in every level the same.
 */
export function plannedPath(number, cs, vertices, { run_id = null, ...plan } = PLAN) {
  const chunks = vertices.length ? 1 : 0;
  const identity = new TextEncoder().encode(JSON.stringify({ run_id, ...plan }));
  const header = 132 + 4 + Math.ceil(identity.length / 4) * 4;
  const bytes = new DataView(new ArrayBuffer(header + 48 * chunks + LEVELS * vertices.length * 20));
  const u16 = (at, value) => bytes.setUint16(at, value, true);
  const u32 = (at, value) => bytes.setUint32(at, value, true);
  const f32 = (at, value) => bytes.setFloat32(at, value, true);
  u32(0, 0x48545054);
  u16(4, 1);
  u16(6, header);
  u32(8, 1);
  u16(12, number);
  u16(14, cs);
  for (const [at, value] of [[16, vertices.length], [20, chunks], [24, LEVELS], [52, chunks]]) u32(at, value);
  [0.01, 0.04, 0.16, 0.64].forEach((tolerance, i) => f32(28 + 4 * i, tolerance));
  f32(56, vertices.at(-1)?.[4] ?? 0);
  const of = (most, i) => Math[most](...vertices.map((vertex) => vertex[i]));
  f32(84, Infinity);
  u16(124, 1);
  u16(128, number);
  u32(132, identity.length);
  new Uint8Array(bytes.buffer).set(identity, 136);
  if (!chunks) return Buffer.from(bytes.buffer);
  [of("min", 0), of("min", 1), of("min", 2), of("max", 0), of("max", 1), of("max", 2), vertices[0][4], vertices.at(-1)[4]].forEach((value, i) => f32(header + 4 * i, value));
  for (let level = 0; level < LEVELS; level += 1) {
    u32(header + 32 + 4 * level, vertices.length);
    vertices.forEach(([x, y, z, line, time, rapid], i) => {
      const at = header + 48 + (level * vertices.length + i) * 20;
      [x, y, z].forEach((value, k) => f32(at + 4 * k, value));
      u32(at + 12, (line | (rapid ? 0x80000000 : 0)) >>> 0);
      f32(at + 16, time);
    });
  }
  return Buffer.from(bytes.buffer);
}

/** A rehearsal of a program that does nothing. */
export function rehearsal(program, cs, change = {}) {
  return {
    program, cs, hash: PLAN.hash, run_id: null, plan: PLAN, revision: "r", outcome: "completed", text: "", at: null, cycle_time_s: 0, feed_s: 0, rapid_s: 0, fixed_s: 0, wait_s: 0,
    depends: null, m_codes: [], m_code_count: 0, axes: {}, corners: [], lines: [], run: null, ...change,
  };
}
