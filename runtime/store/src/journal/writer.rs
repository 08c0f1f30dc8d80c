//! Passes lines to the thread that writes them to disk. Lines that must survive a kill are first written to
//! another storage.

use std::collections::BTreeMap;
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{SyncSender, TrySendError};
use std::time::{Instant, SystemTime};

use plc_protocol::types::CoordinateSystemNumber;

use super::Line;

/// Message to the thread that writes to disk.
#[derive(Debug)]
pub enum JournalMessage {
    /// A line to write.
    Line {
        /// Number of the line, which increases across all starts of the runtime.
        n: u64,
        /// The line itself.
        line: Line,
        /// Time of day of the line.
        time: SystemTime,
        /// Time at which the line entered the queue.
        handed_over: Instant,
    },
    /// Request to the thread to write the waiting lines and to end.
    Close,
}

/// Storage in which lines immediately survive a kill.
pub trait WriteAhead: std::fmt::Debug + Send + Sync {
    /// Writes a line with this number.
    ///
    /// # Errors
    /// Returns an error if the operating system refuses, or if the line is too long.
    fn write(&self, n: u64, line: &Line, time: SystemTime) -> io::Result<()>;

    /// Records the outputs that a line closes, without I/O: the line of the next output lists the pending
    /// ones.
    fn close(&self, line: &Line);

    /// Writes the rest positions of a coordinate system's axes by motor number; `None` while the axes move.
    /// `after` is the number of the newest line.
    ///
    /// # Errors
    /// Returns an error if the operating system refuses.
    fn rest(
        &self,
        cs: CoordinateSystemNumber,
        after: u64,
        positions: Option<&BTreeMap<u16, f64>>,
    ) -> io::Result<()>;
}

/// Handle of the thread that writes to disk. Clones write to the same journal.
#[derive(Debug, Clone)]
pub struct JournalWriter {
    /// Queue of the thread that writes the journal.
    pub lines: SyncSender<JournalMessage>,
    /// Number of lines dropped because the queue was full.
    pub lost: Arc<AtomicU64>,
    /// Number of the last line.
    pub last: Arc<AtomicU64>,
    /// Storage for lines that must survive a kill; `None` if the disk has failed.
    pub ahead: Option<Arc<dyn WriteAhead>>,
}

impl JournalWriter {
    /// Reserves the number of the next line.
    pub fn reserve(&self) -> u64 {
        self.last.fetch_add(1, Ordering::Relaxed) + 1
    }

    /// Passes a line with this number to the thread, without waiting. If clients receive the effect of the
    /// line before it is on disk, the line is safe from a kill when this function returns.
    pub fn write_as(&self, n: u64, line: Line, time: SystemTime) {
        if let Some(ahead) = &self.ahead {
            if line.event.closes_outputs() {
                ahead.close(&line);
            }
            if line.event.may_be_published_early()
                && let Err(error) = ahead.write(n, &line, time)
            {
                tracing::debug!("line {n} of the journal is not written ahead: {error}");
            }
        }
        let message = JournalMessage::Line {
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
