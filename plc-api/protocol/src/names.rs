//! Names of handlers and connections.

use std::hash::{BuildHasher, Hasher, RandomState};
use std::sync::atomic::{AtomicU64, Ordering};

use crate::types::ids::check_client_id;

/// Returns a name that is unique across processes and calls.
pub fn unique_name(kind: &str) -> String {
    static COUNT: AtomicU64 = AtomicU64::new(0);
    let mut hasher = RandomState::new().build_hasher();
    hasher.write_u32(std::process::id());
    hasher.write_u64(COUNT.fetch_add(1, Ordering::Relaxed));
    format!("{kind}-{:012x}", hasher.finish() & 0xffff_ffff_ffff)
}

/// Returns the mistake in the name of a handler as a text, or `None` if the name is valid.
pub fn mistake_in_id(id: &str) -> Option<String> {
    let checked = check_client_id(&format!("handler_id {id:?}"), id);
    checked.err().map(|refusal| refusal.text)
}
