// The control leases that this screen holds, one per coordinate system. The number of a lease, its fence, is sent with every
// command, so that a late command under a lease that has ended is refused.

/** By coordinate system. @type {Map<number, number>} */
const fences = new Map();

/** Returns the fence of this screen's own lease; undefined if it holds no lease. @param {number} cs */
export function ownFence(cs) {
  return fences.get(cs);
}

/** @param {number} cs @param {number} fence */
export function keepFence(cs, fence) {
  fences.set(cs, fence);
}

/** @param {number} cs */
export function forgetFence(cs) {
  fences.delete(cs);
}

/** Returns the lease number to send with a command. @param {number} cs @returns {Record<string, string>} */
export function underLease(cs) {
  const fence = fences.get(cs);
  return fence === undefined ? {} : { "Lease-Fence": String(fence) };
}
