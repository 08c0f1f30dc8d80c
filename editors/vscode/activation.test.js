// Tests the extension as an editor starts it: with a substitute for the module `vscode`, the real client of the
// package, and the real `tandem lsp` of TANDEM_BIN.
"use strict";

const assert = require("node:assert");
const Module = require("node:module");
const { after, test } = require("node:test");

/** An event that records its listeners. */
function event() {
  const listeners = new Set();
  const subscribe = (/** @type {(value: unknown) => void} */ listener) => {
    listeners.add(listener);
    return { dispose: () => listeners.delete(listener) };
  };
  subscribe.fire = (/** @type {unknown} */ value) => listeners.forEach((listener) => listener(value));
  return subscribe;
}

/** Whatever the client asks of a namespace and these tests say nothing of: a class, an event, or a registration. */
function namespace(/** @type {Record<string, unknown>} */ known) {
  const made = new Map();
  const make = (/** @type {string} */ name) => {
    if (/^[A-Z]/.test(name)) return class { dispose() {} };
    if (/^on[A-Z]/.test(name)) return event();
    return () => ({ dispose() {} });
  };
  return new Proxy(known, {
    get(of, name) {
      if (typeof name === "symbol" || name in of) return Reflect.get(of, name);
      if (!made.has(name)) made.set(name, make(name));
      return made.get(name);
    },
  });
}

class Place {
  constructor(...parts) {
    this.parts = parts;
  }
}

/** @type {Record<string, string>} */
const settings = {};
/** @type {((found: { code: string, line: number }[]) => void)[]} */
const waiting = [];
const told = [];
const commands = new Map();

const text = "G90 G54\nG05\nM30\n";
const uri = { scheme: "file", fsPath: "/a.nc", path: "/a.nc", toString: () => "file:///a.nc" };
const document = { uri, languageId: "nc", version: 1, getText: () => text, isClosed: false, isUntitled: false };

const workspace = namespace({
  textDocuments: [document],
  workspaceFolders: undefined,
  notebookDocuments: [],
  getConfiguration: () => ({ get: (name, other) => settings[name] ?? other }),
});

const vscode = namespace({
  version: "1.91.0",
  env: { appName: "test", language: "en" },
  workspace,
  window: namespace({
    visibleTextEditors: [],
    tabGroups: { all: [], onDidChangeTabs: event() },
    createOutputChannel: () => ({ append() {}, appendLine() {}, show() {}, dispose() {} }),
    showErrorMessage: async (message) => void told.push(message),
  }),
  commands: namespace({
    registerCommand(name, command) {
      commands.set(name, command);
      return { dispose: () => commands.delete(name) };
    },
  }),
  languages: namespace({
    match: (selector, of) => (selector.some(({ language }) => language === of.languageId) ? 10 : 0),
    createDiagnosticCollection: () => ({
      set(_, found) {
        const shown = found.map(({ code, range }) => ({ code, line: range.parts[0] }));
        waiting.splice(0).forEach((resolve) => resolve(shown));
      },
      delete() {},
      clear() {},
      dispose() {},
    }),
  }),
  Diagnostic: class {
    constructor(/** @type {unknown} */ range) {
      this.range = range;
    }
  },
  Disposable: class {
    dispose() {}
    static from() {
      return new this();
    }
  },
  Range: Place,
  Position: Place,
  Uri: { parse: () => uri },
  EventEmitter: class {
    event = event();
    fire = this.event.fire;
    dispose() {}
  },
  CancellationTokenSource: class {
    token = { isCancellationRequested: false, onCancellationRequested: event() };
    cancel() {}
    dispose() {}
  },
});

const load = Module["_load"];
Module["_load"] = (name, ...rest) => (name === "vscode" ? vscode : load(name, ...rest));
const extension = require("./extension.js");
const context = { subscriptions: [] };

/** The next findings that the editor is to show. */
const findings = () => new Promise((resolve) => waiting.push(resolve));

settings.command = process.env.TANDEM_BIN ?? "tandem";
after(() => extension.deactivate());

test("an open program is checked by the command of the settings, in their dialect, and again after a restart", async () => {
  const first = findings();
  await extension.activate(context);
  assert.deepEqual(told, []);
  assert.deepEqual(await first, [{ code: "E0101", line: 1 }]);
  // dialect dgshape also requires its mark
  settings.dialect = "dgshape";
  const second = findings();
  workspace.onDidChangeConfiguration.fire({ affectsConfiguration: (name) => name === "tandem" });
  assert.ok((await second).some(({ code }) => code === "E0024"));
  const third = findings();
  await commands.get("tandem.restart")();
  assert.ok((await third).length > 0);
  assert.deepEqual(told, []);
});

test("a command that is not there is told with what to do", async () => {
  settings.command = "/no/such/tandem";
  await commands.get("tandem.restart")();
  // the client has shown a message of its own before
  assert.match(told.at(-1), /^\/no\/such\/tandem lsp does not start: .*Install tandem, or set tandem\.command to its path\.$/);
});
