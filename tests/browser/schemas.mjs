// Checks messages of a browser against the documents that the machine serves. Stricter than the documents: a field that
// they do not name is wrong, too.

import { readFileSync } from "node:fs";

import Ajv from "ajv/dist/2020.js";
import addFormats from "ajv-formats";

const read = (name) => JSON.parse(readFileSync(new URL(`../../runtime/gateway/api/${name}.json`, import.meta.url), "utf8"));
const openapi = read("openapi");
const asyncapi = read("asyncapi");
close(openapi.components.schemas);

const ajv = new Ajv({ strictSchema: false, allowUnionTypes: true, allErrors: true });
addFormats(ajv);
// widths of numbers; their bounds are in the schema
for (const width of ["uint8", "uint16", "uint32", "uint64"]) ajv.addFormat(width, true);
ajv.addSchema(openapi, "document");

/** Allows only the named fields in objects. */
function close(schema) {
  if (schema === null || typeof schema !== "object") return;
  if (schema.type === "object" && schema.properties) schema.additionalProperties ??= false;
  for (const within of Object.values(schema)) close(within);
}

/** Returns the error in a value; null if the value matches its form. */
function wrong(schema, value, what) {
  const pointer = schema.$ref ?? `#/components/schemas/${schema}`;
  const validate = ajv.getSchema(`document${pointer}`);
  if (!validate) return `${what}: there is no form ${pointer}`;
  return validate(value) ? null : `${what}: ${ajv.errorsText(validate.errors)} in ${JSON.stringify(value)}`;
}

function parsed(text, what) {
  try {
    return [JSON.parse(text), null];
  } catch (error) {
    return [undefined, `${what}: ${error.message}`];
  }
}

/** Returns true if a path matches a template with names in braces. */
function fits(template, path) {
  const [wanted, levels] = [template.split("/"), path.split("/")];
  return wanted.length === levels.length && wanted.every((level, at) => level.startsWith("{") || level === levels[at]);
}

/** Returns the most specific of several matching templates. */
const nearest = (found, template) => found.sort((a, b) => template(a).split("{").length - template(b).split("{").length)[0];

/** A message on a path below the machine's root. */
export function wrongMessage(path, message) {
  const address = `tandem/v1/{machine}/${path}`;
  const found = Object.values(asyncapi.channels).filter((channel) => fits(channel.address, address));
  const channel = nearest(found, ({ address: template }) => template);
  if (!channel) return `no document names the topic ${path}`;
  return wrong(Object.values(channel.messages)[0].payload, message, path);
}

/** A frame that the machine sends. */
export function wrongFrame(text) {
  if (typeof text !== "string") return "a binary frame of the machine";
  const [frame, error] = parsed(text, "a frame of the machine");
  if (error) return error;
  if (frame?.topic === undefined) return wrong("WebSocketError", frame, "a frame of the machine");
  const { topic, ...message } = frame;
  return wrong("WebSocketMessage", frame, topic) ?? wrongMessage(topic, message);
}

/** A frame that the page sends. */
export function wrongAsked(text) {
  if (typeof text !== "string") return "a binary frame of the page";
  const [frame, error] = parsed(text, "a frame of the page");
  return error ?? wrong("WebSocketRequest", frame, "a frame of the page");
}

/** Checks an answer of the machine, and its request if the machine accepted it: a member that no document names is an error. */
export function wrongAnswer({ method, path, sent, status, type, body }) {
  const what = `${method} ${path} ${status}`;
  const below = path.replace(/^\/api\/v1/, "");
  const found = Object.keys(openapi.paths).filter((template) => fits(template, below) && openapi.paths[template][method.toLowerCase()]);
  const template = nearest(found, (name) => name);
  if (!template) return `no document names ${method} ${path}`;
  const operation = openapi.paths[template][method.toLowerCase()];
  const accepted = operation.requestBody?.content["application/json"];
  if (status < 300 && sent && accepted) {
    const [value, error] = parsed(sent, what);
    const problem = error ?? wrong(accepted.schema, value, `${what}, what was sent`);
    if (problem) return problem;
  }
  const response = operation.responses[status];
  if (!response) return `no document names status ${status} of ${method} ${path}`;
  const kinds = Object.entries(response.content ?? {});
  if (!kinds.length) return body ? `${what}: a body where none belongs: ${body}` : null;
  const kind = kinds.find(([name]) => name === type.split(";")[0]);
  if (!kind) return `${what}: no document names the type ${type}`;
  if (!kind[1].schema.$ref) return null;
  const [value, error] = parsed(body, what);
  return error ?? wrong(kind[1].schema, value, what);
}
