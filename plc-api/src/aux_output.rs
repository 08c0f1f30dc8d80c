//! An output from the point of view of its handler.

use std::future::Future;
use std::panic::AssertUnwindSafe;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use futures_util::FutureExt;
use plc_protocol::error::Result;
use plc_protocol::lock::lock;
use plc_protocol::port::BoxFuture;
use plc_protocol::supervisor::panic_text;
use plc_protocol::types::CoordinateSystemNumber;
use plc_protocol::types::output::{
    CancelReason, CheckpointReport, OutputNotice, Params, PendingOutput, ProgressReport,
};
use plc_protocol::types::refusal::{Refusal, RefusalCode};
use plc_protocol::types::request::Request;
use plc_protocol::types::request::typed::{Checkpoint, Progress};
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;
use tokio::sync::{Mutex, MutexGuard, watch};

use crate::claim::OutputId;
use crate::handler_session::HandlerSession;
use crate::identity::Identity;
use crate::plc::Plc;
use crate::states::States;

tokio::task_local! {
    /// The output whose handler runs in the current task.
    static AT_WORK: AuxOutput;
}

/// An auxiliary function output: an M code with its parameters, on which a handler works. A clone is another
/// handle to the same output.
#[derive(Debug, Clone)]
pub struct AuxOutput {
    inner: Arc<HandledOutput>,
    /// States of the sequence program, or of the merged program that serves the output.
    states: States,
}

#[derive(Debug)]
struct HandledOutput {
    plc: Plc,
    by: Identity,
    id: OutputId,
    notice: OutputNotice,
    /// Checkpoint that the machine had stored at the time of the claim.
    checkpoint: Option<Value>,
    verify: AtomicBool,
    cancellation: Cancellation,
    /// True once the handler has ended and the reset is being sent: a cancellation then has no effect.
    is_answering: AtomicBool,
    /// Lock that a question holds while it is pending: an output asks one question at a time.
    question: Mutex<()>,
    /// Clean-ups for a cancellation; they run in reverse order.
    clean_ups: std::sync::Mutex<CleanUps>,
    reports: std::sync::Mutex<LastReports>,
}

/// The last reports of the handler, which are sent again after a lost connection.
#[derive(Debug, Default)]
struct LastReports {
    progress: Option<ProgressReport>,
    checkpoint: Option<CheckpointReport>,
}

/// Clean-ups for a cancellation, each with a time limit.
#[derive(Default)]
struct CleanUps(Vec<(Duration, BoxFuture<'static, ()>)>);

impl std::fmt::Debug for CleanUps {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("CleanUps").field(&self.0.len()).finish()
    }
}

impl AuxOutput {
    pub(crate) fn new(
        (presence, states): (&HandlerSession, &States),
        id: OutputId,
        pending: &PendingOutput,
        verify: bool,
    ) -> (Self, CancelSender) {
        let (cancel, state) = watch::channel(CancelState::default());
        let inner = HandledOutput {
            plc: presence.plc.clone(),
            by: presence.by.clone(),
            id,
            notice: pending.output.clone(),
            checkpoint: pending.checkpoint.clone(),
            verify: AtomicBool::new(verify),
            cancellation: Cancellation { state },
            is_answering: AtomicBool::new(false),
            question: Mutex::default(),
            clean_ups: std::sync::Mutex::default(),
            reports: std::sync::Mutex::default(),
        };
        let inner = Arc::new(inner);
        let states = states.clone();
        (Self { inner, states }, CancelSender(cancel))
    }

    /// Returns the same output with other states, for the handler of a merged program with its own states.
    pub(crate) fn with_states(self, states: States) -> Self {
        Self { states, ..self }
    }

    /// Returns the output of the calling handler; `None` if the caller is not the task of a handler.
    pub(crate) fn at_work() -> Option<Self> {
        AT_WORK.try_with(Clone::clone).ok()
    }

    pub(crate) fn at_work_on<T>(&self, work: impl Future<Output = T>) -> impl Future<Output = T> {
        AT_WORK.scope(self.clone(), work)
    }

    pub(crate) fn is_answering(&self) -> bool {
        self.inner.is_answering.load(Ordering::Relaxed)
    }

    pub(crate) fn set_answering(&self) {
        self.inner.is_answering.store(true, Ordering::Relaxed);
    }

    /// Sets whether the handler must check the machine first, before the handler starts.
    pub(crate) fn set_redelivered(&self, verify: bool) {
        self.inner.verify.store(verify, Ordering::Relaxed);
    }

    /// Returns the last reports of the handler, to send them again.
    pub(crate) fn last_reports(&self) -> Vec<Request> {
        let (cs, m) = (self.coordinate_system(), Some(self.m()));
        let reports = lock(&self.inner.reports);
        let progress = reports.progress.clone();
        let checkpoint = reports.checkpoint.clone();
        let progress = progress.map(|report| Request::Progress(cs, m, report));
        let checkpoint = checkpoint.map(|report| Request::Checkpoint(cs, m, report));
        progress.into_iter().chain(checkpoint).collect()
    }

    /// Waits until no other question of this output is pending, and returns the lock for a new question.
    pub(crate) async fn lock_question(&self) -> MutexGuard<'_, ()> {
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

    /// Returns the permanent identifier of this output, unique across all starts of the runtime. If work must
    /// be done only once, such as counting a part, record the work under this identifier, and check the
    /// record before the work is repeated. A redelivered output has the same identifier.
    ///
    /// ```
    /// use std::collections::BTreeSet;
    /// use std::sync::{Arc, Mutex};
    ///
    /// use plc_api::{Alarm, AuxOutput, SequenceProgram};
    ///
    /// // on a real machine, use a table of a database with the identifier as its key
    /// type Parts = Arc<Mutex<BTreeSet<String>>>;
    ///
    /// async fn count(output: AuxOutput, parts: Parts) -> Result<(), Alarm> {
    ///     let mut parts = parts.lock().map_err(|_| Alarm::user(1, "the counter is broken"))?;
    ///     // a redelivered output is counted only once
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

    /// Returns the M number, 0 to 191.
    pub fn m(&self) -> u16 {
        self.inner.notice.m
    }

    /// Returns the sequence number, which identifies this output within one boot and one coordinate system.
    /// [`AuxOutput::id`] is the permanent identifier.
    pub fn seq(&self) -> u64 {
        self.inner.id.seq
    }

    /// Returns the parameters VA to VH.
    pub fn params(&self) -> &Params {
        &self.inner.notice.params
    }

    /// Returns the coordinate system that issued this output.
    pub fn coordinate_system(&self) -> CoordinateSystemNumber {
        self.inner.id.cs
    }

    /// Returns the number of the NC program that issued this output.
    pub fn program(&self) -> u16 {
        self.inner.notice.program
    }

    /// Returns the line of this output in the source file of the NC program, from 1.
    pub fn line(&self) -> u32 {
        self.inner.notice.line
    }

    /// Returns the identifier of the program run that issued this output; unique across all starts of the
    /// runtime.
    pub fn run_id(&self) -> &str {
        &self.inner.notice.run_id
    }

    /// Returns true if an earlier handler may have started the work, and the redelivery is `verify`: the
    /// handler must check the machine first. Returns false on the first delivery, and if the redelivery is
    /// `redo`.
    pub fn redelivered(&self) -> bool {
        self.inner.verify.load(Ordering::Relaxed)
    }

    /// Reports progress, which panels show while the program waits. `text` has at most 200 characters,
    /// `percent` is 0 to 100 or `None`. The report is sent again after a loss of the connection. It has no
    /// effect if this handler no longer owns the output.
    ///
    /// # Errors
    /// Fails if the machine cannot be reached.
    pub async fn progress(&self, text: impl Into<String>, percent: impl Into<Option<f64>>) -> Result<()> {
        let report = ProgressReport {
            boot_id: self.inner.id.boot_id.clone(),
            seq: self.seq(),
            handler_id: self.by().id(),
            instance: Some(self.by().instance()),
            text: text.into(),
            percent: percent.into(),
        };
        lock(&self.inner.reports).progress = Some(report.clone());
        let request = Progress(self.coordinate_system(), Some(self.m()), report);
        self.inner.plc.request(request).await.map(|_| ())
    }

    /// Stores a checkpoint: any value, of at most 4096 bytes as JSON, that records how far the work has
    /// progressed. It replaces the previous checkpoint. If this handler is lost and another handler claims
    /// the output, that handler reads the checkpoint with [`AuxOutput::last_checkpoint`]. Five minutes of
    /// washing can then continue at minute four. The machine keeps the checkpoint as long as the output is
    /// open. The call has no effect if this handler no longer owns the output.
    /// [`SequenceProgram::redelivery`](crate::SequenceProgram::redelivery) decides whether another handler
    /// may continue the work.
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
    /// Fails if the value is too long or cannot be written as JSON, or the machine cannot be reached.
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
        lock(&self.inner.reports).checkpoint = Some(report.clone());
        let request = Checkpoint(self.coordinate_system(), Some(self.m()), report);
        self.inner.plc.request(request).await.map(|_| ())
    }

    /// Returns the checkpoint that the previous handler of this output stored last, or `None` if no
    /// checkpoint is stored. [`AuxOutput::checkpoint`] stores checkpoints.
    ///
    /// # Errors
    /// Fails if the checkpoint is not a `T`, for example because another version of the handler stored it.
    pub fn last_checkpoint<T: DeserializeOwned>(&self) -> Result<Option<T>> {
        let Some(noted) = &self.inner.checkpoint else {
            return Ok(None);
        };
        T::deserialize(noted).map(Some).map_err(|error| {
            let text = format!("the checkpoint of M{} has another type: {error}", self.m());
            Refusal::new(RefusalCode::Invalid, text).into()
        })
    }

    /// Registers a clean-up, such as moving an arm back. The clean-up runs if this output is cancelled and
    /// its handler is dropped; it does not run if the handler returns. If the clean-up takes longer than
    /// `limit` on the machine's clock, it is dropped, and the log contains an error. Several clean-ups run in
    /// reverse order. The machine does not wait for clean-ups: if no motion or program may start during a
    /// clean-up, set an interlock or a start lock.
    ///
    /// A clean-up does not run if the whole sequence program is dropped or its process ends: the hardware
    /// must be safe without the clean-up.
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
    ///         arm.sleep(Duration::from_millis(500)).await; // until the axes are at rest
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
    /// # fake.issue_output(1, 8, Params::default());
    /// # fake.advance(Duration::from_secs(1)).await;
    /// # fake.cancel(1, CancelReason::Stop);
    /// # fake.advance(Duration::from_secs(1)).await;
    /// # assert!(RETRACTED.load(Ordering::Relaxed));
    /// # }
    /// ```
    pub fn on_cancel(&self, limit: Duration, clean_up: impl Future<Output = ()> + Send + 'static) {
        lock(&self.inner.clean_ups).0.push((limit, Box::pin(clean_up)));
    }

    /// Drops all clean-ups after the end of the handler, because a clean-up may hold a handle to the output,
    /// and the output holds the clean-up.
    pub(crate) fn forget_clean_ups(&self) {
        let forgotten = std::mem::take(&mut *lock(&self.inner.clean_ups));
        drop(forgotten);
    }

    /// Runs all clean-ups after a cancellation, the last one first.
    pub(crate) async fn clean_up(&self) {
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

    /// Returns a watch on the cancellation of this output, for destructors and for work in other tasks. The
    /// future of the handler itself is dropped at a cancellation.
    pub fn cancellation(&self) -> Cancellation {
        self.inner.cancellation.clone()
    }
}

/// A watch on the cancellation of an output. All clones watch the same output.
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
    /// Returns true once the output is cancelled.
    pub fn is_cancelled(&self) -> bool {
        self.state.borrow().cancelled
    }

    /// Returns the reason of the cancellation; `None` if the output is not cancelled, or the reason was lost
    /// with a connection.
    pub fn reason(&self) -> Option<CancelReason> {
        self.state.borrow().reason
    }

    /// Waits until the output is cancelled or has ended in another way.
    pub(crate) async fn ended(&self) {
        let mut state = self.state.clone();
        let _closed = state.wait_for(|state| state.cancelled).await.is_err();
    }

    /// Waits until the output is cancelled, and returns the reason as [`reason`](Self::reason) does. If the
    /// output ends in another way, this future never completes.
    pub async fn cancelled(&self) -> Option<CancelReason> {
        let mut state = self.state.clone();
        if let Ok(state) = state.wait_for(|state| state.cancelled).await {
            return state.reason;
        }
        std::future::pending().await
    }
}

pub(crate) struct CancelSender(watch::Sender<CancelState>);

impl CancelSender {
    pub(crate) fn cancel(&self, reason: Option<CancelReason>) {
        let cancelled = true;
        self.0.send_replace(CancelState { cancelled, reason });
    }
}
