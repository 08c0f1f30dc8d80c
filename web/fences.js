// Numbers of the control leases that this screen holds. A lease is for a coordinate system, and its number, the fence,
// goes with every command, so that one of a lease that has ended is refused instead of coming too late.

/** By coordinate system. @type {Map<number, number>} */
const fences = new Map();

/** The fence of this screen's own lease; undefined: it holds none. @param {number} cs */
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

/** What a command carries. @param {number} cs @returns {Record<string, string>} */
export function underLease(cs) {
  const fence = fences.get(cs);
  return fence === undefined ? {} : { "Lease-Fence": String(fence) };
}
