// The question about stored files that do not fit together: shown until a person decides, and asked once more.

import assert from "node:assert/strict";
import { after, afterEach, before, test } from "node:test";

import { launch, openPage } from "./browser.mjs";
import { BIRTH, ORIGIN, ScriptedMachine } from "./scripted_machine.mjs";
import { disabled, Screen, until } from "./screen.mjs";

const OLDER = { part: "store", fault: "older", text: "data/state.redb: the file is an older copy, of generation 5; other files name generation 9" };
const QUESTION = { since: "2026-11-28T10:00:00.000000Z", newest_journal_entry: "2026-11-28T09:58:00.000000Z", findings: [OLDER] };

let browser;
let page;
let errors;
let close;
let machine;

before(async () => {
  browser = await launch();
});
after(() => browser?.close());

async function open(role = "operate", options = {}) {
  ({ page, errors, close } = await openPage(browser, options));
  machine = new ScriptedMachine();
  machine.answers.set("GET /login", { status: 200, body: { user: "anna", role, is_login: true } });
  machine.answers.set("POST /stored_data/answer", { status: 204 });
  machine.programs.set(1, "M30\n");
  machine.start();
  machine.say("birth", BIRTH);
  machine.say("stored_data", { question: QUESTION });
  await machine.attach(page);
  await page.goto(`${ORIGIN}/`);
  await new Screen(page).sees("READY");
}

afterEach(async () => {
  await close();
  assert.deepEqual(errors, [], "the browser's console shows no errors");
  assert.deepEqual(machine.wrong, [], "the scripted machine speaks as a real one does");
});

const note = () => page.locator("[data-stored-data]");
const press = (name) => page.getByRole("button", { name, exact: true });

test("the question names the parts and the newest journal entry, and a decision is confirmed before it is sent", async () => {
  await open();
  await until(() => note().innerText(), /variables, tools and offsets: an older copy[^]*newest entry of the journal is from/);
  for (const [name, decision] of [["Refuse them", "refuse"], ["Accept them", "accept"]]) {
    await note().getByRole("button", { name, exact: true }).click();
    const dialog = page.getByRole("dialog");
    await until(() => dialog.innerText(), /generation 5; other files name generation 9/);
    await press("Decide later").click();
    assert.equal(machine.requests.filter(({ path }) => path.endsWith("/stored_data/answer")).length, decision === "refuse" ? 0 : 1);
    await note().getByRole("button", { name, exact: true }).click();
    await dialog.getByRole("button", { name, exact: true }).click();
    await until(() => machine.requests.filter(({ path, body }) => path.endsWith("/stored_data/answer") && body?.decision === decision).length, 1);
  }
  machine.say("stored_data", { question: null });
  await until(() => note().isVisible(), false);
});

test("a user that may only look cannot decide", async () => {
  await open("view");
  await disabled(note().getByRole("button", { name: "Accept them", exact: true }));
});
