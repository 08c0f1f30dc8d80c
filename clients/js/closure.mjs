// // Finds the modules of web/ that belong to a package.

import { cp, mkdir, readFile } from "node:fs/promises";
import { dirname, join, relative } from "node:path";
import { fileURLToPath } from "node:url";

export const WEB = fileURLToPath(new URL("../../web", import.meta.url));

/** Pattern of the imports of a module, and of the modules that it starts as workers. */
const NEEDED = /^(?:import|export) .*from "(\..*)";$|new URL\("(\..*?)", import\.meta\.url\)/gm;

/** Returns these modules and all modules that they need, below WEB. @param {string[]} entries */
async function closure(entries) {
  const found = new Set();
  const open = [...entries];
  for (let file = open.pop(); file !== undefined; file = open.pop()) {
    if (found.has(file)) continue;
    found.add(file);
    const text = await readFile(join(WEB, file), "utf8");
    for (const [, imported, started] of text.matchAll(NEEDED)) open.push(relative(WEB, join(WEB, dirname(file), imported ?? started)));
  }
  return [...found].sort();
}

/**
 * Copies these modules, their dependencies, and the types of messages.
 * @param {string[]} entries @param {string} folder
 */
export async function copyModules(entries, folder) {
  for (const file of [...(await closure(entries)), "types.d.ts"]) {
    await mkdir(join(folder, dirname(file)), { recursive: true });
    await cp(join(WEB, file), join(folder, file));
  }
}

/**
 * Writes the declarations of these modules of WEB.
 * @param {typeof import("typescript")} ts @param {string[]} entries @param {string} folder
 */
export function declareModules(ts, entries, folder) {
  const program = ts.createProgram(entries.map((file) => join(WEB, file)), {
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
    outDir: folder,
  });
  const { diagnostics } = program.emit();
  if (diagnostics.length > 0) throw new Error(ts.formatDiagnostics(diagnostics, ts.createCompilerHost({})));
}
