// Copies the modules that the package consists of from web/, and writes their declarations.

import { cp, mkdir, readFile, rm } from "node:fs/promises";
import { createRequire } from "node:module";
import { dirname, join, relative } from "node:path";
import { fileURLToPath } from "node:url";

const HERE = dirname(fileURLToPath(import.meta.url));
const WEB = join(HERE, "../../web");
const DIST = join(HERE, "dist");
const ENTRIES = ["tandem.js", "tandem/elements.js"];
const ts = createRequire(join(HERE, "../../tests/browser/package.json"))("typescript");

/** All modules that these import, and they themselves, below WEB. @param {string[]} entries */
async function closure(entries) {
  const found = new Set();
  const open = [...entries];
  for (let file = open.pop(); file !== undefined; file = open.pop()) {
    if (found.has(file)) continue;
    found.add(file);
    const text = await readFile(join(WEB, file), "utf8");
    for (const [, from] of text.matchAll(/^(?:import|export) .*from "(\..*)";$/gm)) open.push(relative(WEB, join(WEB, dirname(file), from)));
  }
  return [...found].sort();
}

await rm(DIST, { recursive: true, force: true });
const files = await closure(ENTRIES);
for (const file of [...files, "types.d.ts"]) {
  await mkdir(join(DIST, dirname(file)), { recursive: true });
  await cp(join(WEB, file), join(DIST, file));
}
const program = ts.createProgram(ENTRIES.map((file) => join(WEB, file)), {
  allowJs: true,
  declaration: true,
  emitDeclarationOnly: true,
  allowImportingTsExtensions: true,
  skipLibCheck: true,
  target: ts.ScriptTarget.ES2022,
  module: ts.ModuleKind.ES2022,
  moduleResolution: ts.ModuleResolutionKind.Bundler,
  lib: ["lib.es2023.d.ts", "lib.dom.d.ts", "lib.dom.iterable.d.ts"],
  types: [],
  rootDir: WEB,
  outDir: DIST,
});
const { diagnostics } = program.emit();
if (diagnostics.length > 0) throw new Error(ts.formatDiagnostics(diagnostics, ts.createCompilerHost({})));
