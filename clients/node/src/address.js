// Addresses of machines on a broker.

import { AddressError } from "./errors.js";

const NODES_MAX = 16;

/**
 * @typedef {object} Address
 * @property {{host: string, port: number}[]} nodes of the broker, at least one
 * @property {boolean} tls
 * @property {string} root of the machine's topics, without a slash at the end
 * @property {string} shown the given address, without user and password
 * @property {string} [user]
 * @property {string} [password]
 */

/**
 * Reads `mqtt://[user[:password]@]host[:port][,host[:port]..]/[prefix/]machine`, or `mqtts://` with TLS. An
 * `AddressError` describes the mistake and the correct form; its text never contains the password.
 * @param {string} text @returns {Address}
 */
export function parseAddress(text) {
  const [scheme, rest] = text.includes("://") ? split(text, "://") : ["mqtt", text];
  const [authority, path] = split(rest, "/");
  const at = authority.lastIndexOf("@");
  const hosts = authority.slice(at + 1);
  // text before an @ may be a password, wherever the @ is
  const shown = `${scheme}://${rest.slice(rest.lastIndexOf("@") + 1)}`;
  /** @param {string} reason */
  const wrong = (reason) => new AddressError(`${shown} is not an address of a machine: ${reason}`);

  if (scheme !== "mqtt" && scheme !== "mqtts") throw wrong("write mqtt://host:port/machine, or mqtts:// with TLS");
  const tls = scheme === "mqtts";
  const nodes = hosts.split(",").map((node) => parseNode(node, tls ? 8883 : 1883, wrong));
  if (nodes.length > NODES_MAX) throw wrong(`it names more than ${NODES_MAX} hosts`);
  const machine = path.slice(path.lastIndexOf("/") + 1);
  if (machine === "") throw wrong("it names no machine; write mqtt://host:port/machine");
  if (/[+#]|^\/|\/\//.test(path)) throw wrong("topic levels are not empty and have no + or #");
  const root = `${path.slice(0, path.length - machine.length)}tandem/v1/${machine}`;
  if (at < 0) return { nodes, tls, root, shown };
  const [user, password] = split(authority.slice(0, at), ":");
  try {
    return { nodes, tls, root, shown, user: decodeURIComponent(user), password: decodeURIComponent(password) };
  } catch {
    throw wrong("user or password are not percent-encoded");
  }
}

/** @param {string} text @param {number} port @param {(reason: string) => AddressError} wrong */
function parseNode(text, port, wrong) {
  const [, bracketed, plain, given] = /^(?:\[([^\]]*)\]|([^:[\]]*))(?::(.*))?$/.exec(text) ?? [];
  const host = bracketed ?? plain;
  if (host === undefined) throw wrong(`${JSON.stringify(text)} is not host:port; write an IPv6 address in [ ]`);
  if (host === "") throw wrong("it names no host; write mqtt://host:port/machine");
  if (given === undefined) return { host, port };
  if (!/^\d{1,5}$/.test(given) || Number(given) < 1 || Number(given) > 65_535) throw wrong("its port is not a number; / @ and : of a password are written %2F, %40 and %3A");
  return { host, port: Number(given) };
}

/** Splits a text at the first separator. @param {string} text @param {string} separator @returns {[string, string]} */
function split(text, separator) {
  const at = text.indexOf(separator);
  return at < 0 ? [text, ""] : [text.slice(0, at), text.slice(at + separator.length)];
}
