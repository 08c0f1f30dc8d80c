// The HMI as a person sees it: its parts by role and name, and waiting for what they show.

import assert from "node:assert/strict";

/** Longest wait for something to appear, ms: the motions of the test programs take up to a few seconds. */
const WAIT_MS = 15000;

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
    await this.page.getByRole("button", { name: `Load ${name}` }).click();
  }

  /** Waits for the state word of the coordinate system on the screen. */
  async sees(execution) {
    await this.page.locator(`.status[data-execution="${execution}"]`).waitFor().catch(async () => {
      assert.fail(`waited for ${execution}, the screen says: ${await this.said()}; notices: ${await this.notices()}`);
    });
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
