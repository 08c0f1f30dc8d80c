// Output of openapi-typescript for the OpenAPI document: it compiles, and knows routes, bodies and answers.

import assert from "node:assert/strict";
import { mkdtemp, readFile, rm, writeFile } from "node:fs/promises";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { after, before, test } from "node:test";
import openapiTS, { astToString } from "openapi-typescript";
import ts from "typescript";

const DOCUMENT = new URL("../../runtime/gateway/api/openapi.json", import.meta.url);

let folder, declarations;
before(async () => {
  folder = await mkdtemp(join(tmpdir(), "tandem-generated-"));
  declarations = astToString(await openapiTS(DOCUMENT, { silent: true }));
  await writeFile(join(folder, "api.ts"), declarations);
});
after(() => rm(folder, { recursive: true, force: true }));

test("every route of the document is in the generated types", async () => {
  const { paths } = JSON.parse(await readFile(DOCUMENT, "utf8"));
  const operations = Object.values(paths).flatMap((methods) => Object.values(methods).map(({ operationId }) => operationId));
  const missing = operations.filter((id) => !declarations.includes(`operations["${id}"]`));
  assert.deepEqual(missing, []);
});

test("the generated types compile, and find what is not so", async () => {
  const page = join(folder, "page.ts");
  await writeFile(page, `import type { components, operations, paths } from "./api.ts";
type Json<Operation extends keyof operations, Status extends number> =
  operations[Operation] extends { responses: Record<Status, { content: { "application/json": infer Body } }> } ? Body : never;
export const word = (state: Json<"get_cs_cs_state", 200>) => state.execution === "READY";
export const pocket = (params: components["schemas"]["Params"]) => params.A;
export const load: NonNullable<paths["/cs/{cs}/load"]["post"]["requestBody"]>["content"]["application/json"] = { program: 1 };
export const address: operations["put_variables_p"]["parameters"]["query"] = { from: 100 };
// @ts-expect-error: a write of variables names the first one
export const everywhere: operations["put_variables_p"]["parameters"]["query"] = {};
// @ts-expect-error: a state has no such member
export const nothing = (state: Json<"get_cs_cs_state", 200>) => state.nothing;
// @ts-expect-error: there is no such route
export type None = paths["/cs/{cs}/begin"];
`);
  const options = { strict: true, noEmit: true, types: [], allowImportingTsExtensions: true, module: ts.ModuleKind.ES2022, moduleResolution: ts.ModuleResolutionKind.Bundler, target: ts.ScriptTarget.ES2022 };
  const found = ts.getPreEmitDiagnostics(ts.createProgram([page], options));
  assert.deepEqual(found.map(({ messageText }) => ts.flattenDiagnosticMessageText(messageText, " ")), []);
});
