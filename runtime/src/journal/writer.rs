//! The way of lines to the thread that writes them to disk, and of those that must not be lost with the process.

use std::collections::BTreeMap;
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{SyncSender, TrySendError};
use std::time::{Instant, SystemTime};

use plc_api::types::CoordinateSystemNumber;

use super::Line;

/// What the thread that writes to disk is sent.
#[derive(Debug)]
pub(crate) enum Message {
    /// A line.
    Line {
        /// Its number, which rises over all starts of the runtime.
        n: u64,
        line: Line,
        /// Its time of day.
        time: SystemTime,
        handed_over: Instant,
    },
    /// Writes what waits, and ends.
    Close,
}

/// Where lines are safe from a kill at once.
pub(crate) trait WriteAhead: std::fmt::Debug + Send + Sync {
    /// Writes a line of this number.
    ///
    /// # Errors
    /// The operating system refuses, or the line has no room.
    fn write(&self, n: u64, line: &Line, time: SystemTime) -> io::Result<()>;

    /// Hears of outputs that are closed, without I/O: the next output's line says which are open.
    fn close(&self, line: &Line);

    /// Writes where the axes of a coordinate system rest, by motor number; `None`: they move. `after` is the number of the
    /// newest line.
    ///
    /// # Errors
    /// The operating system refuses.
    fn rest(
        &self,
        cs: CoordinateSystemNumber,
        after: u64,
        positions: Option<&BTreeMap<u16, f64>>,
    ) -> io::Result<()>;
}

/// The way to the thread that writes to disk. Cloning gives another handle to the same journal.
#[derive(Debug, Clone)]
pub(crate) struct JournalWriter {
    pub lines: SyncSender<Message>,
    /// Lines that found no room.
    pub lost: Arc<AtomicU64>,
    /// Number of the last line.
    pub last: Arc<AtomicU64>,
    /// Where lines go that must not be lost with the process; `None`: the disk refuses.
    pub ahead: Option<Arc<dyn WriteAhead>>,
}

impl JournalWriter {
    /// The number of the next line.
    pub fn reserve(&self) -> u64 {
        self.last.fetch_add(1, Ordering::Relaxed) + 1
    }

    /// As [`JournalWriter::write_as`], with the next number.
    #[cfg(test)]
    pub fn write(&self, line: Line, time: SystemTime) {
        self.write_as(self.reserve(), line, time);
    }

    /// Hands a line of this number over, without waiting. One that clients learn of earlier is safe from a kill when this
    /// returns.
    pub fn write_as(&self, n: u64, line: Line, time: SystemTime) {
        if let Some(ahead) = &self.ahead {
            if line.event.closes_outputs() {
                ahead.close(&line);
            }
            if line.event.is_heard_of()
                && let Err(error) = ahead.write(n, &line, time)
            {
                tracing::debug!("line {n} of the journal is not written ahead: {error}");
            }
        }
        let message = Message::Line {
            n,
            line,
            time,
            handed_over: Instant::now(),
        };
        if let Err(TrySendError::Full(_)) = self.lines.try_send(message) {
            self.lost.fetch_add(1, Ordering::Relaxed);
        }
    }
}
