// Pictures of a part of the screen at four sizes and in both themes, kept in `out/`.

import { mkdir } from "node:fs/promises";

import { openPage } from "./browser.mjs";

const OUT = new URL("out/", import.meta.url).pathname;
export const SIZES = [[390, 844], [820, 1180], [1280, 800], [1920, 1080]];
export const SCHEMES = ["light", "dark"];

/**
 * Opens the page in each size, lets each of `shows` (by the picture's name) bring its part into view, one after the other, and
 * takes its picture in both themes; gives what the consoles said.
 */
export async function takePictures(browser, url, shows) {
  await mkdir(OUT, { recursive: true });
  const said = [];
  for (const [width, height] of SIZES) {
    const { page, errors, close } = await openPage(browser, { viewport: { width, height } });
    await page.goto(url);
    await page.getByText("Connected", { exact: true }).waitFor();
    for (const [name, show] of Object.entries(shows)) {
      await show(page);
      for (const colorScheme of SCHEMES) {
        await page.emulateMedia({ colorScheme });
        await page.screenshot({ path: `${OUT}${name}-${width}-${colorScheme}.png` });
      }
    }
    said.push(...errors);
    await close();
  }
  return said;
}
