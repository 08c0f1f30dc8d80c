//! Returns memory to the operating system after clients have disconnected. Otherwise the allocator of the C
//! library keeps this memory. Measured: nearly all of 300 MiB, after 80 clients of the broker for which large
//! messages had waited.

use std::time::Duration;

use tokio_util::task::AbortOnDropHandle;

/// Time between two calls. Reason: a call takes a fraction of a millisecond, and no other task waits for it.
const INTERVAL: Duration = Duration::from_secs(10);

/// Size from which a block has pages of its own, which the allocator returns when the block is released, bytes. Without
/// this setting, the size grows to that of the largest block released so far, and `malloc_trim` does not return the free
/// end of a thread's heap: measured, 57 of 58 MiB.
#[cfg(target_env = "gnu")]
const OWN_PAGES_MIN: libc::c_int = 128 * 1024;

/// Free memory that the allocator keeps at the end of a heap when a block there is released, bytes.
#[cfg(target_env = "gnu")]
const KEPT_AT_THE_END: libc::c_int = 1 << 20;

/// Returns free memory to the operating system every [`INTERVAL`], until the handle is dropped.
pub(super) fn give_back() -> AbortOnDropHandle<()> {
    limit_kept_memory();
    AbortOnDropHandle::new(tokio::spawn(async {
        let mut due = tokio::time::interval(INTERVAL);
        loop {
            due.tick().await;
            // A panic in this task could only be a fault of the C library, so it is ignored.
            let _ = tokio::task::spawn_blocking(trim).await;
        }
    }))
}

#[cfg(target_env = "gnu")]
#[allow(
    unsafe_code,
    reason = "a function of the C library that changes numbers of the allocator"
)]
fn limit_kept_memory() {
    // SAFETY: `mallopt` takes two numbers and locks the allocator itself; if it refuses, nothing changes
    unsafe {
        libc::mallopt(libc::M_MMAP_THRESHOLD, OWN_PAGES_MIN);
        libc::mallopt(libc::M_TRIM_THRESHOLD, KEPT_AT_THE_END);
    }
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

/// Does nothing, because other C libraries have no such setting.
#[cfg(not(target_env = "gnu"))]
fn limit_kept_memory() {}

/// Does nothing, because other C libraries have no function that returns memory.
#[cfg(not(target_env = "gnu"))]
fn trim() {}
