// The extension starts the language server `tandem lsp`, which provides all other
// functions.
"use strict";

const vscode = require("vscode");
const { LanguageClient } = require("vscode-languageclient/node");

/** @type {LanguageClient | undefined} */
let client;

/** Returns the command to start, by the settings. */
function server() {
  const settings = vscode.workspace.getConfiguration("tandem");
  const args = ["lsp"];
  for (const name of ["config", "dialect"]) {
    const value = settings.get(name);
    if (typeof value === "string" && value !== "") args.push(`--${name}`, value);
  }
  return { command: settings.get("command", "tandem"), args };
}

async function start() {
  const command = server();
  // one time above each program; a click on it does nothing
  client = new LanguageClient("tandem", "Tandem", command, { documentSelector: [{ language: "nc" }] });
  try {
    await client.start();
  } catch (error) {
    const text = `${command.command} lsp does not start: ${error}. Install tandem, or set tandem.command to its path.`;
    void vscode.window.showErrorMessage(text);
  }
}

async function stop() {
  const running = client;
  client = undefined;
  try {
    if (running?.isRunning()) await running.stop();
  } catch (error) {
    // the server has already ended; the next one starts anyway
    console.error(`tandem lsp did not end in order: ${error}`);
  }
}

/** The restart in progress: one after the other, since a client that only starts cannot be stopped. */
let last = Promise.resolve();

function restart() {
  last = last.then(stop).then(start);
  return last;
}

/** @param {import("vscode").ExtensionContext} context */
async function activate(context) {
  context.subscriptions.push(
    vscode.commands.registerCommand("tandem.restart", restart),
    vscode.workspace.onDidChangeConfiguration((change) => {
      if (change.affectsConfiguration("tandem")) void restart();
    }),
  );
  await restart();
}

function deactivate() {
  last = last.then(stop);
  return last;
}

module.exports = { activate, deactivate };
