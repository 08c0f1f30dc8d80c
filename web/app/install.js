// The page as an app of its own, where the browser allows it: over TLS or on the loopback.

import { language } from "../text/language.js";
import { writeTexts } from "./offline.js";

/** Names of the cache of the service worker: as in sw.js. */
const OFFLINE = "offline-3";
const PAGE = "/offline.html";

/** The browser reads name and shortcuts of the app in the language of this screen, when it is installed. */
function nameApp() {
  const manifest = document.querySelector('link[rel="manifest"]');
  if (manifest && language !== "en") manifest.setAttribute("href", `manifest.${language}.webmanifest`);
}

/** Registers the service worker, which serves only the page for a machine that does not answer. */
export function startWorker() {
  nameApp();
  if (!isSecureContext) return;
  void navigator.serviceWorker?.register("/sw.js").then(keepOfflinePage).catch(() => {});
}

/** Stores the page of the worker in the language of this screen, because no script runs without the machine. */
async function keepOfflinePage() {
  const page = new DOMParser().parseFromString(await (await fetch(PAGE)).text(), "text/html");
  writeTexts(page);
  page.querySelector("script")?.remove();
  const text = `<!doctype html>${new XMLSerializer().serializeToString(page.documentElement)}`;
  const cache = await caches.open(OFFLINE);
  await cache.put(PAGE, new Response(text, { headers: { "Content-Type": "text/html; charset=utf-8" } }));
}
