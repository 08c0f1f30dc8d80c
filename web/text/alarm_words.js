// Text of an alarm in the language of the screen, if the machine builder has provided that language.

import { language } from "./language.js";

/**
 * @param {import("../types.d.ts").AlarmRecord} alarm
 * @returns {{text: string, remedy: string | null, detail: string | null}} `detail`: the original text, if it differs
 * is shown
 */
export function alarmWords({ text, remedy, languages }) {
  const said = Object.entries(languages ?? {});
  const own = said.find(([tag]) => tag === language) ?? said.find(([tag]) => tag.startsWith(`${language}-`));
  if (!own) return { text, remedy: remedy ?? null, detail: null };
  return { text: own[1].text, remedy: own[1].remedy ?? remedy ?? null, detail: text };
}
