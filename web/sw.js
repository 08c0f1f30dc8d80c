// The service worker. It never serves a screen that it has kept: pages come from the machine, or report that it does not answer.

// The screen keeps the first in its language (app/install.js), the others are kept here.
const OFFLINE = "offline-3";
const KEPT = ["/offline.html", "/styles/offline.css", "/icon.svg"];
const worker = /** @type {any} */ (globalThis);

worker.addEventListener("install", (/** @type {any} */ event) => {
  event.waitUntil(caches.open(OFFLINE).then((cache) => cache.addAll(KEPT.slice(1))).then(() => worker.skipWaiting()));
});

worker.addEventListener("activate", (/** @type {any} */ event) => {
  const forget = async () => {
    for (const name of await caches.keys()) if (name !== OFFLINE) await caches.delete(name);
    await worker.clients.claim();
  };
  event.waitUntil(forget());
});

worker.addEventListener("fetch", (/** @type {any} */ event) => {
  const { mode, url } = event.request;
  const { origin, pathname } = new URL(url);
  const kept = mode === "navigate" ? KEPT[0] : KEPT.find((path) => origin === worker.location.origin && path === pathname);
  // the browser handles all other requests
  if (!kept) return;
  event.respondWith(fetch(event.request).catch(async () => (await caches.match(kept)) ?? Response.error()));
});
