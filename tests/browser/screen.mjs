// The HMI as a person sees it: finds its parts by role and name, and waits for their content.

import assert from "node:assert/strict";
import { setTimeout as sleep } from "node:timers/promises";
import { inspect, isDeepStrictEqual } from "node:util";

/** Longest wait for an element, ms: the motions of the test programs last a few seconds. */
const WAIT_MS = 15000;

/**
 * Waits until `read` returns `expected`: a value, a pattern, or a predicate. The screen follows the machine's messages
 * with a delay, so a single check is not sufficient.
 */
export async function until(read, expected, what = "") {
  const is = (value) => {
    if (typeof expected === "function") return expected(value);
    return expected instanceof RegExp ? expected.test(String(value)) : isDeepStrictEqual(value, expected);
  };
  let value = await read();
  for (const end = Date.now() + WAIT_MS; !is(value); value = await read()) {
    if (Date.now() > end) assert.fail(`${what} is ${inspect(value)}; waited for ${inspect(expected)}`);
    await sleep(50);
  }
}

/** Waits until a button or field can be used. */
export function enabled(locator) {
  return locator.and(locator.page().locator(":enabled")).waitFor();
}

/** Waits until a button or field cannot be used. */
export function disabled(locator) {
  return locator.and(locator.page().locator(":disabled")).waitFor();
}

export class Screen {
  constructor(page) {
    this.page = page;
    page.setDefaultTimeout(WAIT_MS);
  }

  command(label) {
    return this.page.getByRole("group", { name: "Commands" }).getByRole("button", { name: label });
  }

  tab(cs) {
    return this.page.getByRole("tab", { name: new RegExp(`^CS ${cs}`) });
  }

  async load(name) {
    await this.page.getByRole("tab", { name: "Programs" }).click();
    await this.page.getByRole("button", { name: `Load ${name}` }).click();
  }

  /** Opens the panel By hand, and waits for its buttons, which appear in a later frame. */
  async openByHand() {
    await this.page.getByRole("tab", { name: "By hand" }).click();
    await this.page.locator("#by-hand").waitFor();
  }

  /** Confirms an M code by hand, and answers the confirmation question. */
  async confirmByHand(m) {
    await this.page.getByRole("button", { name: `Confirm M${m} by hand` }).click();
    await this.page.getByRole("dialog").getByRole("button", { name: `M${m} is done` }).click();
  }

  /** Waits for the state word of the coordinate system on the screen. */
  async sees(execution) {
    await this.page.locator(`.status[data-execution="${execution}"]`).waitFor().catch(async () => {
      assert.fail(`waited for ${execution}, the screen says: ${await this.said()}; notices: ${await this.notices()}`);
    });
  }

  /** Waits until state word and sentence match. */
  async says(pattern) {
    await until(() => this.said(), pattern, "the state on the screen");
  }

  /** State word and sentence. */
  async said() {
    return (await this.page.locator(".state-word, .sentence").allTextContents()).join(" | ");
  }

  async notices() {
    return (await this.page.locator(".toast p").allTextContents()).join(" | ");
  }

  async workPosition(axis) {
    return Number(await this.page.locator(`tr[data-axis="${axis}"] td.work`).textContent());
  }
}
