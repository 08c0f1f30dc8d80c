// Sound and notifications for questions and alarms: off until an operator switches them on, which this browser remembers.

import { t } from "../text/language.js";

/** @typedef {{key: string, kind: "question" | "alarm", title: string, text: string, cs: number | null}} Event */
/** @typedef {"sound" | "notification"} Way */

const KEYS = { sound: "tandem-sound", notification: "tandem-notifications" };
/** Tones of each kind, Hz, and the duration of each, s. */
const TONES = { question: [660, 880], alarm: [880, 587, 880, 587, 880, 587] };
const TONE_S = 0.16;
const VOLUME = 0.25;

/** Returns the events that need a person now. @param {import("../machine/model.js").Model} model @returns {Event[]} */
export function eventsOf({ systems, alarms, bootId }) {
  const questions = [...systems].flatMap(([cs, { pending }]) => (pending?.outputs ?? []).flatMap(({ m, seq, question }) => {
    if (!question || question.answer !== undefined) return [];
    return [{ key: `${bootId} question ${cs} ${seq} ${question.id}`, kind: /** @type {const} */ ("question"), title: t("alerts.m_asks", { m }), text: question.text, cs }];
  }));
  const active = alarms.filter(({ severity }) => severity === "alarm");
  return [...questions, ...active.map(({ id, number, text, cs }) => ({ key: `${bootId} alarm ${id}`, kind: /** @type {const} */ ("alarm"), title: t("alerts.alarm", { number }), text, cs }))];
}

export class Alerts {
  /** Keys of the previous events; null before the first state. @type {Set<string> | null} */
  #seen = null;
  /** @type {AudioContext | null} */
  #audio = null;
  #app;

  /** @param {import("../main.js").App} app */
  constructor(app) {
    this.#app = app;
    // browsers allow sound only after the user has touched the page
    for (const touched of /** @type {const} */ (["pointerdown", "keydown"])) document.addEventListener(touched, () => this.isOn("sound") && this.#wake(), { capture: true });
  }

  /** @param {Way} way */
  isOn(way) {
    try {
      return localStorage.getItem(KEYS[way]) === "on" && this.whyNot(way) === null;
    } catch {
      return false;
    }
  }

  /** Returns the reason why this kind of alert is not available; null if it is. @param {Way} way @returns {string | null} */
  whyNot(way) {
    if (way === "sound") return null;
    if (!isSecureContext) return t("alerts.browsers_allow_notifications_only_over");
    if (!("Notification" in globalThis)) return t("alerts.this_browser_has_no_notifications");
    return Notification.permission === "denied" ? t("alerts.this_browser_forbids_this_page") : null;
  }

  /** @param {Way} way @param {boolean} on */
  async choose(way, on) {
    if (on && way === "notification" && (await Notification.requestPermission()) !== "granted") return;
    try {
      localStorage.setItem(KEYS[way], on ? "on" : "off");
    } catch {
      return this.#app.toast(t("alerts.this_browser_keeps_no_settings"), "error");
    }
    if (on && way === "sound") this.#sound("question");
  }

  /** Announces new events. */
  render() {
    const { model } = this.#app;
    if (!model.birth || !model.online) return;
    const now = eventsOf(model);
    const seen = this.#seen;
    this.#seen = new Set(now.map(({ key }) => key));
    if (seen) for (const event of now) if (!seen.has(event.key)) this.#announce(event);
  }

  /** @param {Event} event */
  #announce(event) {
    if (this.isOn("sound")) this.#sound(event.kind);
    if (this.isOn("notification")) void this.#notify(event);
  }

  /** @param {Event} event */
  async #notify({ key, title, text, cs }) {
    const { birth } = this.#app.model;
    const machine = birth?.machine ?? t("alerts.machine");
    const head = cs === null ? t("alerts.head", { machine, title }) : t("alerts.head_cs", { machine, cs, title });
    const options = { body: text, tag: key, icon: "icon.svg" };
    try {
      const shown = new Notification(head, options);
      shown.onclick = () => {
        window.focus();
        if (cs !== null) this.#app.select(cs);
      };
    } catch {
      // on phones only the service worker may show notifications
      await navigator.serviceWorker?.getRegistration().then((worker) => worker?.showNotification(head, options)).catch(() => {});
    }
  }

  /** The audio of this page, which a touch enables. */
  #wake() {
    this.#audio ??= new AudioContext();
    if (this.#audio.state === "suspended") void this.#audio.resume().catch(() => {});
    return this.#audio;
  }

  /** @param {Event["kind"]} kind */
  #sound(kind) {
    const audio = this.#wake();
    for (const [at, hertz] of TONES[kind].entries()) {
      const tone = audio.createOscillator();
      const volume = audio.createGain();
      const begin = audio.currentTime + at * TONE_S;
      tone.frequency.value = hertz;
      volume.gain.setValueAtTime(VOLUME, begin);
      volume.gain.exponentialRampToValueAtTime(0.001, begin + TONE_S * 0.95);
      tone.connect(volume).connect(audio.destination);
      tone.start(begin);
      tone.stop(begin + TONE_S);
    }
  }
}
