// The page as an app of its own, where the browser allows it: over TLS or on the loopback.

/** Registers the service worker, which shows a page of its own while the machine does not answer, and serves nothing else. */
export function startWorker() {
  if (isSecureContext) void navigator.serviceWorker?.register("/sw.js").catch(() => {});
}
