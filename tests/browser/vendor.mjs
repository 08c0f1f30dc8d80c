// Builds each third-party library of the HMI as one ES module, with the licences of all its parts: `npm run vendor`.

import { build } from "esbuild";
import { readFile, writeFile } from "node:fs/promises";
import { fileURLToPath } from "node:url";

const HERE = new URL(".", import.meta.url);
export const VENDORED = new URL("../../web/vendor/", HERE);

/** Returns the files of web/vendor by name, built from the pinned packages. */
export async function vendored() {
  const options = { bundle: true, format: "esm", minify: true, legalComments: "none", target: "es2022", metafile: true, write: false };
  const { outputFiles, metafile } = await build({ ...options, entryPoints: [fileURLToPath(new URL("codemirror.mjs", HERE))], absWorkingDir: fileURLToPath(HERE) });
  const packages = [...new Set(Object.keys(metafile.inputs).map((path) => /node_modules\/((?:@[^/]+\/)?[^/]+)/.exec(path)?.[1]).filter(Boolean))].sort();
  const licences = await licencesOf(packages);
  return {
    "codemirror.js": `/* CodeMirror, made by npm run vendor in tests/browser.\n\n${licences}*/\n${outputFiles[0].text.trimEnd()}\n`,
    "LICENSES.txt": licences,
  };
}

/** Returns the text of each licence, preceded by the packages that have it. @param {string[]} names of packages */
async function licencesOf(names) {
  /** @type {Map<string, string[]>} */
  const holders = new Map();
  for (const name of names) {
    const folder = new URL(`node_modules/${name}/`, HERE);
    const { version, license } = JSON.parse(await readFile(new URL("package.json", folder), "utf8"));
    if (license !== "MIT") throw new Error(`${name} has the licence ${license}`);
    const text = (await readFile(new URL("LICENSE", folder), "utf8")).trim();
    holders.set(text, [...(holders.get(text) ?? []), `${name} ${version}`]);
  }
  return [...holders].map(([text, packages]) => `${packages.join("\n")}\n\n${text}\n`).join("\n\n");
}

if (process.argv[1] === fileURLToPath(import.meta.url)) {
  for (const [name, text] of Object.entries(await vendored())) await writeFile(new URL(name, VENDORED), text);
}
