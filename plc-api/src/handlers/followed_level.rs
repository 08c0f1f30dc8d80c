//! Sources of interlocks and start locks, each of which follows a level of a sequence program.

use plc_protocol::error::Result;
use plc_protocol::types::CoordinateSystemNumber;
use plc_protocol::types::lock::LockSet;
use tokio::sync::watch;

use crate::levels::LockKind;
use crate::plc::Plc;

/// A level, and the source of a lock that follows it.
#[derive(Debug, Clone)]
pub(super) struct FollowedLevel {
    pub(super) cs: CoordinateSystemNumber,
    pub(super) kind: LockKind,
    pub(super) source: String,
    pub(super) level: watch::Receiver<bool>,
    pub(super) text: String,
}

impl FollowedLevel {
    /// Writes the source after each change of the level; does not return except with an error. If the sender
    /// of the level is dropped, the level is unknown, and the source is set on.
    ///
    /// # Errors
    /// Fails if the machine refuses the source.
    pub(super) async fn run(mut self, plc: Plc) -> Result<()> {
        loop {
            let value = *self.level.borrow_and_update();
            let text = if value { self.text.clone() } else { String::new() };
            self.set(&plc, value, text).await?;
            if self.level.changed().await.is_err() {
                let text = format!("{}, or unknown (the program no longer reports it)", self.text);
                self.set(&plc, true, text).await?;
                return std::future::pending().await;
            }
        }
    }

    async fn set(&self, plc: &Plc, value: bool, text: String) -> Result<()> {
        let set = LockSet::new(value, text).of_source(&self.source);
        plc.set_lock(self.cs, self.kind, set).await
    }
}
