// The machine of this screen, for all of its modules.

import { Tandem } from "./tandem.js";

export const machine = new Tandem({ name: "hmi" });
