// The machine of this screen, for all modules of the screen.

import { Tandem } from "../tandem.js";

export const machine = new Tandem({ name: "hmi" });
