//! Guards that keep an interlock or a start lock on while a handler works.

use plc_protocol::error::Result;
use plc_protocol::types::lock::LockSet;

use crate::coordinate_system::CoordinateSystem;
use crate::levels::{LevelTarget, LockKind};

/// A guard that keeps a source of an interlock or start lock on until the guard is released or dropped, for
/// example because its handler is cancelled. Created by [`CoordinateSystem::start_lock_while_here`] and
/// [`CoordinateSystem::interlock_while_here`].
#[derive(Debug)]
#[must_use = "the lock is off as soon as the guard is dropped"]
pub struct LockGuard {
    coordinate_system: CoordinateSystem,
    kind: LockKind,
    source: String,
    is_released: bool,
}

impl CoordinateSystem {
    /// Refuses program starts until the guard is released or dropped, by the source `source` of the start
    /// lock; `text` is the reason. If several guards hold one source, the source is on until the last of
    /// these guards is released or dropped. The source belongs to the sequence program: if the program is
    /// lost, the source takes the value of its `on_loss`. Ownership is as for
    /// [`set_interlock`](Self::set_interlock).
    ///
    /// ```
    /// # use std::time::Duration;
    /// # use plc_api::{Alarm, AuxOutput, Params, Plc, SequenceProgram, fake::FakePort};
    /// async fn change_pallet(output: AuxOutput, plc: Plc) -> Result<(), Alarm> {
    ///     let mill = plc.coordinate_system(output.coordinate_system());
    ///     let _lock = mill.start_lock_while_here("pallet", "the pallet moves").await?;
    ///     // ... move the pallet; the lock is off afterwards, also if the handler is cancelled here ...
    ///     plc.sleep(Duration::from_secs(5)).await;
    ///     Ok(())
    /// }
    /// # #[tokio::main(flavor = "current_thread")] async fn main() -> plc_api::Result<()> {
    /// # let fake = FakePort::new([1]);
    /// # let plc = fake.plc();
    /// # tokio::spawn(async move { SequenceProgram::new().on(60, change_pallet).run(&plc).await });
    /// # fake.issue_output(1, 60, Params::default());
    /// # fake.advance(Duration::from_secs(1)).await;
    /// # assert_eq!(fake.plc().coordinate_system(1).start_lock().await?.text, "the pallet moves");
    /// # fake.advance(Duration::from_secs(5)).await;
    /// # assert!(!fake.plc().coordinate_system(1).start_lock().await?.value);
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// Fails if the machine refuses the source, or if the machine cannot be reached.
    pub async fn start_lock_while_here(&self, source: &str, text: impl Into<String>) -> Result<LockGuard> {
        self.guard_lock(LockKind::StartLock, source, text.into()).await
    }

    /// Holds motion on its path until the guard is released or dropped, by the source `source` of the
    /// interlock. Ownership, and the effect of several guards, are as for
    /// [`start_lock_while_here`](Self::start_lock_while_here).
    ///
    /// # Errors
    /// Fails if the machine refuses the source, or if the machine cannot be reached.
    pub async fn interlock_while_here(&self, source: &str, text: impl Into<String>) -> Result<LockGuard> {
        self.guard_lock(LockKind::Interlock, source, text.into()).await
    }

    async fn guard_lock(&self, kind: LockKind, source: &str, text: String) -> Result<LockGuard> {
        // create the guard first, because a cancelled request may still reach the machine
        let guard = LockGuard {
            coordinate_system: self.clone(),
            kind,
            source: source.to_owned(),
            is_released: false,
        };
        self.plc().levels().begin_hold(guard.level_target());
        let set = LockSet::new(true, text).of_source(source);
        self.plc().set_lock(self.number(), kind, set).await?;
        Ok(guard)
    }
}

impl LockGuard {
    fn level_target(&self) -> LevelTarget {
        LevelTarget::Lock(self.coordinate_system.number(), self.kind, self.source.clone())
    }

    /// Releases the guard. If no other guard holds the source, waits until the machine has cleared the
    /// source.
    ///
    /// # Errors
    /// Fails if the machine cannot be reached.
    pub async fn release(mut self) -> Result<()> {
        self.is_released = true;
        let plc = self.coordinate_system.plc().clone();
        if !plc.levels().end_hold(&self.level_target()) {
            return Ok(());
        }
        let off = LockSet::new(false, "").of_source(&self.source);
        plc.set_lock(self.coordinate_system.number(), self.kind, off)
            .await
    }
}

impl Drop for LockGuard {
    fn drop(&mut self) {
        let plc = self.coordinate_system.plc();
        if self.is_released || !plc.levels().end_hold(&self.level_target()) {
            return;
        }
        let (plc, cs, kind) = (plc.clone(), self.coordinate_system.number(), self.kind);
        let off = LockSet::new(false, "").of_source(&self.source);
        let here = plc.clone();
        here.do_without_waiting(async move {
            if let Err(error) = plc.set_lock(cs, kind, off).await {
                tracing::warn!(%error, cs, "a source of a lock was not cleared");
            }
        });
    }
}
