// Pictures of a part of the screen at four sizes and in both themes, kept in `out/`.

import { mkdir } from "node:fs/promises";

import { openPage } from "./browser.mjs";

const OUT = new URL("out/", import.meta.url).pathname;
export const SIZES = [[390, 844], [820, 1180], [1280, 800], [1920, 1080]];
export const SCHEMES = ["light", "dark"];

/** Opens the page in each size and theme, lets `show` bring the part into view, and takes its picture; gives what the consoles said. */
export async function takePictures(browser, url, name, show) {
  await mkdir(OUT, { recursive: true });
  const said = [];
  for (const [width, height] of SIZES) {
    for (const colorScheme of SCHEMES) {
      const { page, errors, close } = await openPage(browser, { colorScheme, viewport: { width, height } });
      await page.goto(url);
      await page.getByText("Connected", { exact: true }).waitFor();
      await show(page);
      await page.screenshot({ path: `${OUT}${name}-${width}-${colorScheme}.png` });
      said.push(...errors);
      await close();
    }
  }
  return said;
}
