//! Trace of a world: a checksum of all event lines. If `TANDEM_TRACE` is set, the lines are printed, too.

use std::fmt::{Arguments, Write as _};
use std::sync::Arc;

use parking_lot::Mutex;
use tokio::time::Instant;

#[derive(Debug, Clone)]
pub(super) struct Trace {
    start: Instant,
    kept: Arc<Mutex<TraceState>>,
}

#[derive(Debug, Default)]
struct TraceState {
    hasher: crc32fast::Hasher,
    line: String,
    is_shown: bool,
}

impl Trace {
    pub fn new() -> Self {
        let kept = TraceState {
            is_shown: std::env::var_os("TANDEM_TRACE").is_some(),
            ..TraceState::default()
        };
        Self {
            start: Instant::now(),
            kept: Arc::new(Mutex::new(kept)),
        }
    }

    /// Returns the seconds since the beginning of the world.
    pub fn now_s(&self) -> f64 {
        self.start.elapsed().as_secs_f64()
    }

    pub fn line(&self, line: Arguments<'_>) {
        let mut kept = self.kept.lock();
        let TraceState {
            hasher,
            line: text,
            is_shown,
        } = &mut *kept;
        text.clear();
        let _ = write!(text, "{:10.6} {line}", self.start.elapsed().as_secs_f64());
        hasher.update(text.as_bytes());
        if *is_shown {
            #[expect(clippy::print_stderr, reason = "the user has requested the output")]
            {
                eprintln!("{text}");
            }
        }
    }

    /// Returns the checksum of all lines up to now.
    pub fn checksum(&self) -> u32 {
        self.kept.lock().hasher.clone().finalize()
    }
}
