// A page about the interface: every route and topic of the machine's documents, with their schemas.

import { language, t } from "./text/language.js";
import { fill, h } from "./ui/dom.js";

/** @param {string} path @returns {Promise<any>} */
async function load(path) {
  const response = await fetch(path);
  if (!response.ok) throw new Error(t("api_page.status", { path, status: response.status }));
  return response.json();
}

/**
 * Returns a schema with its references resolved; a recursive reference stays a name.
 * @param {any} document
 * @param {any} schema
 * @param {string[]} within
 * @returns {any}
 */
function written(document, schema, within = []) {
  if (Array.isArray(schema)) return schema.map((part) => written(document, part, within));
  if (schema === null || typeof schema !== "object") return schema;
  const name = typeof schema.$ref === "string" ? schema.$ref.split("/").pop() : undefined;
  if (name !== undefined) {
    return within.includes(name) ? name : written(document, document.components.schemas[name], [...within, name]);
  }
  return Object.fromEntries(Object.entries(schema).map(([key, part]) => [key, written(document, part, within)]));
}

/** @param {string} title @param {any} document @param {any} schema */
function form(title, document, schema) {
  return h("div", {}, h("h4", {}, title), h("pre", {}, JSON.stringify(written(document, schema), null, 2)));
}

/** Returns the schema of a body or answer, for any media type. @param {any} part */
function schemaOf(part) {
  /** @type {any[]} */
  const media = Object.values(part?.content ?? {});
  return media[0]?.schema;
}

/** @param {any} api @param {string} path @param {string} method @param {any} operation */
function route(api, path, method, operation) {
  const body = schemaOf(operation.requestBody);
  const all = Object.entries(operation.responses);
  const answers = all.filter(([status]) => Number(status) < 400);
  const refusals = all.filter(([status]) => Number(status) >= 400);
  return h(
    "details",
    {},
    h(
      "summary",
      {},
      h("code", { class: "method" }, method.toUpperCase()),
      h("code", {}, path),
      h("span", { class: "right" }, operation["x-right"] ?? t("api_page.open")),
    ),
    h("p", {}, operation.summary),
    body ? form(t("api_page.body"), api, body) : null,
    ...answers.map(([status, answer]) => form(t("api_page.answer", { status }), api, schemaOf(answer) ?? {})),
    h("h4", {}, t("api_page.refusals")),
    h("ul", {}, ...refusals.map(([status, refusal]) => h("li", {}, `${status} ${refusal.description}`))),
  );
}

/** @param {any} api @param {any} operation */
function topic(api, operation) {
  const channel = api.channels[operation.channel.$ref.split("/").pop()];
  const names = operation.messages?.map((/** @type {any} */ part) => part.$ref.split("/").pop()) ?? Object.keys(channel.messages);
  const mqtt = operation.bindings?.mqtt;
  const kind = mqtt ? `QoS ${mqtt.qos}${mqtt.retain ? ", retained" : ""}` : "WebSocket";
  return h(
    "details",
    {},
    h(
      "summary",
      {},
      h("code", { class: "method" }, operation.action === "send" ? t("api_page.out") : t("api_page.in")),
      h("code", {}, channel.address),
      h("span", { class: "right" }, kind),
    ),
    ...names.map((/** @type {string} */ name) => form(name, api, channel.messages[name].payload)),
  );
}

async function show() {
  const [rest, mqtt] = await Promise.all([load("/api/v1/openapi.json"), load("/api/v1/asyncapi.json")]);
  const routes = Object.entries(rest.paths).flatMap(([path, operations]) =>
    Object.entries(/** @type {object} */ (operations)).map(([method, operation]) =>
      route(rest, `/api/v1${path}`, method, operation),
    ),
  );
  const topics = Object.values(mqtt.operations).map((operation) => topic(mqtt, operation));
  fill(
    document.body,
    h("h1", {}, t("api_page.interface")),
    h("p", {}, rest.info.description),
    h("p", {}, h("a", { href: "/api/v1/openapi.json" }, "OpenAPI"), " · ", h("a", { href: "/api/v1/asyncapi.json" }, "AsyncAPI")),
    h("h2", {}, "REST"),
    ...routes,
    h("h2", {}, t("api_page.mqtt_and_websocket")),
    h("p", {}, mqtt.info.description),
    ...topics,
  );
}

document.documentElement.lang = language;
show().catch((error) => fill(document.body, h("p", {}, t("api_page.failed", { message: error.message }))));
