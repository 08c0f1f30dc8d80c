//! Memory that clients needed goes back to the system when they have gone. The allocator of the C library keeps it otherwise:
//! nearly all of 300 MiB after 80 clients of the broker for which large messages had waited.

use std::time::Duration;

use tokio_util::task::AbortOnDropHandle;

/// How often. Reason: it takes a fraction of a millisecond, and nobody waits for it.
const INTERVAL: Duration = Duration::from_secs(10);

/// Gives back what is free from time to time, until it is dropped.
pub(super) fn give_back() -> AbortOnDropHandle<()> {
    AbortOnDropHandle::new(tokio::spawn(async {
        let mut due = tokio::time::interval(INTERVAL);
        loop {
            due.tick().await;
            // a task that has panicked would be a fault of the C library
            let _ = tokio::task::spawn_blocking(trim).await;
        }
    }))
}

#[cfg(target_env = "gnu")]
#[allow(
    unsafe_code,
    reason = "a function of the C library that takes a number and touches free memory only"
)]
fn trim() {
    // SAFETY: `malloc_trim` has no preconditions; it may be called from any thread at any time
    unsafe {
        libc::malloc_trim(0);
    }
}

/// Other C libraries have nothing of the kind.
#[cfg(not(target_env = "gnu"))]
fn trim() {}
