//! One output, as its handler uses it.

use std::future::Future;
use std::panic::AssertUnwindSafe;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use futures_util::FutureExt;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;
use tokio::sync::{Mutex, MutexGuard, watch};

use crate::claim::OutputId;
use crate::error::Result;
use crate::extract::States;
use crate::identity::Identity;
use crate::lock::lock;
use crate::plc::Plc;
use crate::port::BoxFuture;
use crate::presence::Presence;
use crate::text::panic_text;
use crate::types::CoordinateSystemNumber;
use crate::types::output::{
    CancelReason, CheckpointReport, OutputNotice, Params, PendingOutput, ProgressReport,
};
use crate::types::refusal::{Refusal, RefusalCode};
use crate::types::request::typed::{Checkpoint, Progress};

tokio::task_local! {
    /// The output whose handler runs in this task.
    static AT_WORK: AuxOutput;
}

/// An auxiliary function output, that is an M code with its parameters, which a handler works on. Clones are handles to
/// the same output.
#[derive(Debug, Clone)]
pub struct AuxOutput {
    inner: Arc<Inner>,
    /// Of the program, or of the part that it was made of.
    states: States,
}

#[derive(Debug)]
struct Inner {
    plc: Plc,
    by: Identity,
    id: OutputId,
    notice: OutputNotice,
    /// What had been noted when it was taken up.
    checkpoint: Option<Value>,
    verify: bool,
    cancellation: Cancellation,
    /// True once the handler has ended and the reset is being sent: nothing is left to cancel.
    is_answering: AtomicBool,
    /// An output asks one question at a time; others wait for this lock.
    question: Mutex<()>,
    /// What is done when it is cancelled, last first.
    clean_ups: std::sync::Mutex<CleanUps>,
}

/// What is done when an output is cancelled, each within its time.
#[derive(Default)]
struct CleanUps(Vec<(Duration, BoxFuture<'static, ()>)>);

impl std::fmt::Debug for CleanUps {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("CleanUps").field(&self.0.len()).finish()
    }
}

impl AuxOutput {
    pub(super) fn new(
        (presence, states): (&Presence, &States),
        id: OutputId,
        pending: &PendingOutput,
        verify: bool,
    ) -> (Self, Cancel) {
        let (cancel, state) = watch::channel(CancelState::default());
        let inner = Inner {
            plc: presence.plc.clone(),
            by: presence.by.clone(),
            id,
            notice: pending.output.clone(),
            checkpoint: pending.checkpoint.clone(),
            verify,
            cancellation: Cancellation { state },
            is_answering: AtomicBool::new(false),
            question: Mutex::default(),
            clean_ups: std::sync::Mutex::default(),
        };
        let inner = Arc::new(inner);
        let states = states.clone();
        (Self { inner, states }, Cancel(cancel))
    }

    /// The same output for the handler of a part with states of its own.
    pub(super) fn with_states(self, states: States) -> Self {
        Self { states, ..self }
    }

    /// The output of the handler that calls this from its own task.
    pub(crate) fn at_work() -> Option<Self> {
        AT_WORK.try_with(Clone::clone).ok()
    }

    pub(super) fn at_work_on<T>(&self, work: impl Future<Output = T>) -> impl Future<Output = T> {
        AT_WORK.scope(self.clone(), work)
    }

    pub(super) fn is_answering(&self) -> bool {
        self.inner.is_answering.load(Ordering::Relaxed)
    }

    pub(super) fn set_answering(&self) {
        self.inner.is_answering.store(true, Ordering::Relaxed);
    }

    /// Waits until this output has no other question.
    pub(crate) async fn turn_to_ask(&self) -> MutexGuard<'_, ()> {
        self.inner.question.lock().await
    }

    pub(crate) fn key(&self) -> &OutputId {
        &self.inner.id
    }

    pub(crate) fn by(&self) -> &Identity {
        &self.inner.by
    }

    pub(crate) fn states(&self) -> &States {
        &self.states
    }

    pub(crate) fn plc(&self) -> &Plc {
        &self.inner.plc
    }

    /// Identifies this output permanently, across all starts of the runtime: note under it what must be done once, such as a part
    /// that is counted, and look there before it is done again. A redelivered output has the same name.
    ///
    /// ```
    /// use std::collections::BTreeSet;
    /// use std::sync::{Arc, Mutex};
    ///
    /// use plc_api::{Alarm, AuxOutput, SequenceProgram};
    ///
    /// // in a machine a table of a database, whose key is the name
    /// type Parts = Arc<Mutex<BTreeSet<String>>>;
    ///
    /// async fn count(output: AuxOutput, parts: Parts) -> Result<(), Alarm> {
    ///     let mut parts = parts.lock().map_err(|_| Alarm::user(1, "the counter is broken"))?;
    ///     // counts once, however often it is delivered
    ///     parts.insert(output.id().to_owned());
    ///     Ok(())
    /// }
    ///
    /// let parts = Parts::default();
    /// let program = SequenceProgram::new().on(60, move |output| count(output, parts.clone()));
    /// # assert_eq!(program.check(), Ok(()));
    /// ```
    pub fn id(&self) -> &str {
        &self.inner.notice.id
    }

    /// M number, 0 to 191.
    pub fn m(&self) -> u16 {
        self.inner.notice.m
    }

    /// Sequence number: identifies this output within boot and coordinate system, as [`AuxOutput::id`] does permanently.
    pub fn seq(&self) -> u64 {
        self.inner.id.seq
    }

    /// VA to VH.
    pub fn params(&self) -> &Params {
        &self.inner.notice.params
    }

    /// Coordinate system that put it out.
    pub fn coordinate_system(&self) -> CoordinateSystemNumber {
        self.inner.id.cs
    }

    /// Number of its program.
    pub fn program(&self) -> u16 {
        self.inner.notice.program
    }

    /// Line of the source file, from 1.
    pub fn line(&self) -> u32 {
        self.inner.notice.line
    }

    /// The program run that put it out; never the same again, over all starts of the runtime.
    pub fn run_id(&self) -> &str {
        &self.inner.notice.run_id
    }

    /// True if the work may have been started before, and `verify` was chosen: check the machine first. False on the
    /// first delivery, and if `redo` was chosen.
    pub fn redelivered(&self) -> bool {
        self.inner.verify
    }

    /// Reports progress, which panels show while the program waits. `text` has at most 200 characters, `percent` is 0
    /// to 100 or `None`. No effect if the output is no longer this handler's.
    ///
    /// # Errors
    /// The machine cannot be reached.
    pub async fn progress(&self, text: impl Into<String>, percent: impl Into<Option<f64>>) -> Result<()> {
        let report = ProgressReport {
            boot_id: self.inner.id.boot_id.clone(),
            seq: self.seq(),
            handler_id: self.by().id(),
            instance: Some(self.by().instance()),
            text: text.into(),
            percent: percent.into(),
        };
        let request = Progress(self.coordinate_system(), Some(self.m()), report);
        self.inner.plc.request(request).await.map(|_| ())
    }

    /// Stores how far the work has come, replacing the previous checkpoint: any value of at most 4096 bytes as JSON. When this handler is
    /// lost and another one takes over the output, it receives the checkpoint ([`AuxOutput::last_checkpoint`]), so that five minutes of
    /// washing can continue at minute four. The machine keeps it as long as the output is open. No effect if the output is no longer
    /// this handler's. Whether the work may be taken over at all is decided by
    /// [`SequenceProgram::redelivery`](super::SequenceProgram::redelivery).
    ///
    /// ```
    /// # use std::time::Duration;
    /// # use plc_api::{Alarm, AuxOutput, Plc, Redelivery, SequenceProgram};
    /// async fn wash(output: AuxOutput, plc: Plc) -> Result<(), Alarm> {
    ///     let done: u32 = output.last_checkpoint()?.unwrap_or(0);
    ///     for minute in done..5 {
    ///         output.checkpoint(&minute).await?;
    ///         plc.sleep(Duration::from_secs(60)).await;
    ///     }
    ///     Ok(())
    /// }
    ///
    /// let program = SequenceProgram::new().on(90, wash).redelivery(90, Redelivery::Redo);
    /// # assert_eq!(program.check(), Ok(()));
    /// ```
    ///
    /// # Errors
    /// It is too long, or cannot be written as JSON; the machine cannot be reached.
    pub async fn checkpoint(&self, value: &impl Serialize) -> Result<()> {
        let checkpoint = serde_json::to_value(value).map_err(|error| {
            let text = format!("a checkpoint cannot be written as JSON: {error}");
            Refusal::new(RefusalCode::Invalid, text)
        })?;
        let report = CheckpointReport {
            boot_id: self.inner.id.boot_id.clone(),
            seq: self.seq(),
            handler_id: self.by().id(),
            instance: Some(self.by().instance()),
            checkpoint,
        };
        report.check()?;
        let request = Checkpoint(self.coordinate_system(), Some(self.m()), report);
        self.inner.plc.request(request).await.map(|_| ())
    }

    /// The last [`AuxOutput::checkpoint`] of the handler that worked on this output before; `None` if there is none.
    ///
    /// # Errors
    /// It has another form, as another version of the handler stored it.
    pub fn last_checkpoint<T: DeserializeOwned>(&self) -> Result<Option<T>> {
        let Some(noted) = &self.inner.checkpoint else {
            return Ok(None);
        };
        T::deserialize(noted).map(Some).map_err(|error| {
            let text = format!("the checkpoint of M{} is not of this form: {error}", self.m());
            Refusal::new(RefusalCode::Invalid, text).into()
        })
    }

    /// Registers a clean-up for the case that this output is cancelled and its handler dropped, such as moving an arm back; it does not
    /// run when the handler returns. It may take this long on the machine's clock, and is dropped then, with an error in the log.
    /// Several clean-ups run in reverse order. The machine does not wait for them: use an interlock or a start lock for what must not
    /// begin meanwhile.
    ///
    /// It does not run when the whole program is dropped or its process ends: hardware must be safe without it.
    ///
    /// ```
    /// # use std::sync::{Arc, atomic::{AtomicBool, Ordering}};
    /// # use std::time::Duration;
    /// # use plc_api::{Alarm, AuxOutput, CancelReason, Params, Plc, SequenceProgram, fake::FakePort};
    /// # static RETRACTED: AtomicBool = AtomicBool::new(false);
    /// # async fn retract() { RETRACTED.store(true, Ordering::Relaxed); }
    /// async fn load(output: AuxOutput, plc: Plc) -> Result<(), Alarm> {
    ///     let arm = plc.clone();
    ///     output.on_cancel(Duration::from_secs(10), async move {
    ///         arm.sleep(Duration::from_millis(500)).await; // until the axes stand
    ///         retract().await;
    ///     });
    ///     // ... move the arm ...
    ///     plc.sleep(Duration::from_secs(30)).await;
    ///     Ok(())
    /// }
    /// # #[tokio::main(flavor = "current_thread")] async fn main() {
    /// # let fake = FakePort::new([1]);
    /// # let plc = fake.plc();
    /// # tokio::spawn(async move { SequenceProgram::new().on(8, load).run(&plc).await });
    /// # fake.put_out(1, 8, Params::default());
    /// # fake.advance(Duration::from_secs(1)).await;
    /// # fake.cancel(1, CancelReason::Stop);
    /// # fake.advance(Duration::from_secs(1)).await;
    /// # assert!(RETRACTED.load(Ordering::Relaxed));
    /// # }
    /// ```
    pub fn on_cancel(&self, limit: Duration, clean_up: impl Future<Output = ()> + Send + 'static) {
        lock(&self.inner.clean_ups).0.push((limit, Box::pin(clean_up)));
    }

    /// The handler has ended. A clean-up may hold the output, which holds the clean-up.
    pub(super) fn forget_clean_ups(&self) {
        let forgotten = std::mem::take(&mut *lock(&self.inner.clean_ups));
        drop(forgotten);
    }

    /// Does what is to be done after a cancel.
    pub(super) async fn clean_up(&self) {
        loop {
            let last = lock(&self.inner.clean_ups).0.pop();
            let Some((limit, work)) = last else { return };
            let work = AssertUnwindSafe(self.inner.plc.timeout(limit, work)).catch_unwind();
            let (m, seq) = (self.m(), self.seq());
            match work.await {
                Ok(Ok(())) => {}
                Ok(Err(error)) => tracing::error!(m, seq, %error, "the clean-up of a handler was cut short"),
                Err(panicked) => {
                    let text = panic_text(&*panicked);
                    tracing::error!(m, seq, "the clean-up of a handler panicked: {text}");
                }
            }
        }
    }

    /// Tells whether, when and why this output is cancelled, for destructors and for work in other tasks. The handler's
    /// own future is dropped then.
    pub fn cancellation(&self) -> Cancellation {
        self.inner.cancellation.clone()
    }
}

/// Tells whether an output has been cancelled. Clones watch the same output.
#[derive(Debug, Clone)]
pub struct Cancellation {
    state: watch::Receiver<CancelState>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
struct CancelState {
    cancelled: bool,
    reason: Option<CancelReason>,
}

impl Cancellation {
    /// True once the output is cancelled.
    pub fn is_cancelled(&self) -> bool {
        self.state.borrow().cancelled
    }

    /// Why it was cancelled; `None` if it is not, or if the reason was lost with a connection.
    pub fn reason(&self) -> Option<CancelReason> {
        self.state.borrow().reason
    }

    /// Waits until the output is cancelled or has ended in another way.
    pub(crate) async fn ended(&self) {
        let mut state = self.state.clone();
        let _closed = state.wait_for(|state| state.cancelled).await.is_err();
    }

    /// Waits until the output is cancelled; forever if it ends in another way.
    pub async fn cancelled(&self) -> Option<CancelReason> {
        let mut state = self.state.clone();
        if let Ok(state) = state.wait_for(|state| state.cancelled).await {
            return state.reason;
        }
        std::future::pending().await
    }
}

pub(super) struct Cancel(watch::Sender<CancelState>);

impl Cancel {
    pub(super) fn cancel(&self, reason: Option<CancelReason>) {
        let cancelled = true;
        self.0.send_replace(CancelState { cancelled, reason });
    }
}
