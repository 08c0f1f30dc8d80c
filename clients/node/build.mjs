// Writes the package to dist/: its modules with their declarations, the forms of messages, and the HMI's tandem.js for REST.

import { cp, readdir, rm } from "node:fs/promises";
import { join } from "node:path";
import { fileURLToPath } from "node:url";
import ts from "typescript";

import { copyModules, declareModules, WEB } from "../js/closure.mjs";

const HERE = fileURLToPath(new URL(".", import.meta.url));
const SRC = join(HERE, "src");
const DIST = join(HERE, "dist");
const HTTP = join(DIST, "http");

await rm(DIST, { recursive: true, force: true });
for (const file of await readdir(SRC)) if (file.endsWith(".js")) await cp(join(SRC, file), join(DIST, file));
await copyModules(["tandem.js"], HTTP);
declareModules(ts, ["tandem.js"], HTTP);
await cp(join(WEB, "types.d.ts"), join(DIST, "messages.d.ts"));

const { config } = ts.readConfigFile(join(HERE, "tsconfig.json"), ts.sys.readFile);
const { options } = ts.parseJsonConfigFileContent(config, ts.sys, HERE);
const emit = { ...options, noEmit: false, declaration: true, emitDeclarationOnly: true, rootDir: SRC, outDir: DIST };
const program = ts.createProgram(["index.js", "testing.js"].map((file) => join(SRC, file)), emit);
const { diagnostics } = program.emit(undefined, undefined, undefined, true, { afterDeclarations: [withoutInternals] });
if (diagnostics.length > 0) throw new Error(ts.formatDiagnostics(diagnostics, ts.createCompilerHost({})));

/** Removes the members that only the modules of the package use. @type {import("typescript").TransformerFactory<any>} */
function withoutInternals(context) {
  const isInternal = (/** @type {import("typescript").Node} */ node) => ts.getJSDocTags(ts.getOriginalNode(node)).some(({ tagName }) => tagName.text === "internal");
  const visit = (/** @type {import("typescript").Node} */ node) =>
    ts.isClassElement(node) && isInternal(node) ? undefined : ts.visitEachChild(node, visit, context);
  return (file) => ts.visitEachChild(file, visit, context);
}
