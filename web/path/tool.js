// Radius of the tool in the spindle, read from the tool table after a tool change.

import { machine } from "../machine/machine.js";

let known = { key: "", radius: 0 };

/** Returns the radius in mm; 0 if it is unknown. @param {import("../main.js").App} app @param {import("../machine/model.js").CoordinateSystem} system */
export function toolRadius({ model, invalidate }, { info, modal, state }) {
  const id = modal?.tool ?? 0;
  const key = [model.bootId, info.number, id, state?.run_id].join();
  if (key !== known.key) {
    const asked = { key, radius: known.radius };
    known = asked;
    void readRadius(id).then((radius) => {
      asked.radius = radius;
      invalidate();
    });
  }
  return known.radius;
}

/** @param {number} id */
async function readRadius(id) {
  if (!id) return 0;
  /** @type {import("../types.d.ts").ToolTable | null} */
  const table = await machine.get("/tools").catch(() => null);
  return table?.tools.find((tool) => tool.id === id)?.radius ?? 0;
}
