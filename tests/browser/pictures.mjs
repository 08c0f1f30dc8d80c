// Pictures of the screen for people, written to `out/` if TANDEM_PICTURES=1 is in the environment.

import { mkdir } from "node:fs/promises";

import { test } from "node:test";

import { openPage } from "./browser.mjs";

const ALL = process.env.TANDEM_PICTURES === "1";
const OUT = new URL("out/", import.meta.url).pathname;
export const SIZES = [[390, 844], [820, 1180], [1280, 800], [1920, 1080]];
export const SCHEMES = ["light", "dark"];

/** All sizes if pictures are requested, otherwise only the first. */
export const inPictures = (all) => (ALL ? all : all.slice(0, 1));

/** A test that repeats others for its pictures; it runs only if pictures are requested. */
export function pictures(of, take) {
  if (ALL) test(`pictures of ${of}`, take);
}

/** Time that a worker needs to draw the path in other colours, ms. */
const DRAWN_MS = 300;

/** Takes a picture of the current page, if pictures are requested. */
export async function picture(page, name, options = {}) {
  if (!ALL) return;
  await mkdir(OUT, { recursive: true });
  await page.waitForTimeout(DRAWN_MS);
  await page.screenshot({ path: `${OUT}${name}.png`, ...options });
}

/**
 * Opens the page, lets each of `shows` (by the picture's name) bring its part into view, one after the other, and gives what the
 * console said. It is done in each size, and a picture is taken in both themes.
 */
export async function takePictures(browser, url, shows) {
  const said = [];
  for (const [width, height] of SIZES) {
    const { page, errors, close } = await openPage(browser, { viewport: { width, height } });
    await page.goto(url);
    await page.getByText("Connected", { exact: true }).waitFor();
    for (const [name, show] of Object.entries(shows)) {
      await show(page);
      for (const colorScheme of SCHEMES) {
        await page.emulateMedia({ colorScheme });
        await picture(page, `${name}-${width}-${colorScheme}`);
      }
    }
    said.push(...errors);
    await close();
  }
  return said;
}
