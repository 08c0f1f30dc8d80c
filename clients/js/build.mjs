// Copies the modules that the package consists of from web/, and writes their declarations.

import { rm } from "node:fs/promises";
import { createRequire } from "node:module";
import { fileURLToPath } from "node:url";

import { copyModules, declareModules } from "./closure.mjs";

const DIST = fileURLToPath(new URL("dist", import.meta.url));
const ENTRIES = ["tandem.js", "tandem/elements.js"];
const ts = createRequire(new URL("../../tests/browser/package.json", import.meta.url))("typescript");

await rm(DIST, { recursive: true, force: true });
await copyModules(ENTRIES, DIST);
declareModules(ts, ENTRIES, DIST);
