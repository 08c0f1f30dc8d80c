// The page as an app of its own, where the browser allows it: over TLS or on the loopback.

import { language } from "./language.js";
import { writeTexts } from "./offline.js";

/** Where the service worker finds what it shows: as in sw.js. */
const OFFLINE = "offline-2";
const PAGE = "/offline.html";

/** The browser reads name and shortcuts of the app in the language of this screen, when it is installed. */
function nameApp() {
  const manifest = document.querySelector('link[rel="manifest"]');
  if (manifest && language !== "en") manifest.setAttribute("href", `manifest.${language}.webmanifest`);
}

/** Registers the service worker, which shows a page of its own while the machine does not answer, and serves nothing else. */
export function startWorker() {
  nameApp();
  if (!isSecureContext) return;
  void navigator.serviceWorker?.register("/sw.js").then(keepOfflinePage).catch(() => {});
}

/** Gives the worker its page in the language of this screen: without the machine no script can write it. */
async function keepOfflinePage() {
  const page = new DOMParser().parseFromString(await (await fetch(PAGE)).text(), "text/html");
  writeTexts(page);
  page.querySelector("script")?.remove();
  const text = `<!doctype html>${new XMLSerializer().serializeToString(page.documentElement)}`;
  const cache = await caches.open(OFFLINE);
  await cache.put(PAGE, new Response(text, { headers: { "Content-Type": "text/html; charset=utf-8" } }));
}
