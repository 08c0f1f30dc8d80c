//! The request queues of a coordinate system, and the coordinate system itself.
//!
//! If no other thread is working on the coordinate system, a caller executes its own request at once, in its own
//! thread: the answer needs no second thread, and an in-process handler no wake-up. Otherwise it queues the request for
//! the task. The task does everything else: commands, which may take long because a load checks whole programs; events
//! of the servo; deadlines; and further preparation.

use std::collections::VecDeque;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use parking_lot::{Mutex, MutexGuard};
use plc_api::supervisor::{Consequence, FaultReport, panic_text};
use plc_api::types::CoordinateSystemNumber;
use plc_api::types::command::Verb;
use plc_api::types::not_after::NotAfter;
use plc_api::types::request::{Answer, CoordinateSystemRequest, Refusal, RefusalCode};
use tandem_model::alarm::RUNTIME_FAULT;
use tokio::sync::{Notify, Semaphore, TryAcquireError, oneshot};

use super::preparation::TurnLimits;
use super::{CoordinateSystem, View};
use crate::shared::SharedState;

/// Maximum number of requests that wait for one coordinate system; a sender waits for room. Hold, stop and abort have a
/// queue of the same size.
const REQUESTS_MAX: usize = 256;

/// Time after which a control that found no room in the servo is handed over again, s.
const RETRY_S: f64 = 0.001;

/// Queued request, and the destination of its answer.
pub(super) struct Envelope {
    /// Larger than that of every envelope queued before.
    pub order: u64,
    pub request: CoordinateSystemRequest,
    /// Its age limit; a command has its limit in its meta data.
    pub not_after: Option<NotAfter>,
    pub reply: oneshot::Sender<Result<Answer, Refusal>>,
}

impl Envelope {
    fn is_abort(&self) -> bool {
        let CoordinateSystemRequest::Command { command, .. } = &self.request else {
            return false;
        };
        command.verb() == Verb::Abort
    }

    fn is_command(&self) -> bool {
        matches!(self.request, CoordinateSystemRequest::Command { .. })
    }
}

/// A coordinate system and its request queues.
pub(crate) struct Mailbox {
    pub number: CoordinateSystemNumber,
    pub view: Arc<View>,
    shared: Arc<SharedState>,
    /// The queue of hold, stop and abort, which pass all others, and the queue of all other requests.
    queues: [Queue; 2],
    count: AtomicU64,
    work: Mutex<MailboxState>,
    /// Name of its work in reports of faults.
    task: String,
    /// Wakes the task.
    wake: Arc<Notify>,
}

struct MailboxState {
    /// `None` after its end.
    system: Option<CoordinateSystem>,
    condition: FaultCondition,
    /// Time at which the task next wakes without a request, seconds since the start.
    task_wakes_at_s: Option<f64>,
}

/// Condition of the coordinate system after internal faults.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum FaultCondition {
    Sound,
    /// A fault has occurred, and a reset is still pending.
    Recovered,
    /// Another fault has occurred: it stays stopped until the runtime is restarted.
    GivenUp,
}

impl std::fmt::Debug for Mailbox {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Mailbox")
            .field("number", &self.number)
            .finish_non_exhaustive()
    }
}

impl Mailbox {
    /// Publishes the state of the coordinate system; [`Mailbox::run`] is its task.
    pub fn new(shared: Arc<SharedState>, mut system: CoordinateSystem) -> Self {
        system.publish_all();
        let wake = Arc::default();
        shared.wakes(Arc::clone(&wake));
        let task = format!("coordinate system {}", system.context.number);
        Self {
            number: system.context.number,
            view: Arc::clone(&system.context.view),
            shared,
            queues: [Queue::new(), Queue::new()],
            count: AtomicU64::new(0),
            task,
            work: Mutex::new(MailboxState {
                system: Some(system),
                condition: FaultCondition::Sound,
                task_wakes_at_s: None,
            }),
            wake,
        }
    }

    /// Sends a request to the coordinate system and returns its answer. An urgent request passes the waiting ones, and
    /// is repeated if an internal fault occurs during its execution.
    ///
    /// # Errors
    /// Returns the refusal of the request, or an error if the runtime is stopping or an internal fault occurred.
    pub async fn ask(&self, request: CoordinateSystemRequest, urgent: bool) -> Result<Answer, Refusal> {
        self.put_and_wait(request, None, urgent).await
    }

    /// Sends a request with an age limit, which is checked when its turn comes.
    ///
    /// # Errors
    /// Returns an error in the cases of [`Mailbox::ask`].
    pub async fn ask_not_after(
        &self,
        request: CoordinateSystemRequest,
        not_after: Option<NotAfter>,
    ) -> Result<Answer, Refusal> {
        self.put_and_wait(request, not_after, false).await
    }

    async fn put_and_wait(
        &self,
        request: CoordinateSystemRequest,
        not_after: Option<NotAfter>,
        urgent: bool,
    ) -> Result<Answer, Refusal> {
        let again = urgent.then(|| request.clone());
        let mut answer = self.ask_once(request, not_after, urgent).await;
        if let (None, Some(request)) = (&answer, again) {
            answer = self.ask_once(request, None, urgent).await;
        }
        answer.unwrap_or_else(|| Err(self.unanswered()))
    }

    /// Returns `None` if an internal fault occurred, or if the runtime is stopping.
    async fn ask_once(
        &self,
        request: CoordinateSystemRequest,
        not_after: Option<NotAfter>,
        urgent: bool,
    ) -> Option<Result<Answer, Refusal>> {
        if self.shared.closing.is_cancelled() {
            return None;
        }
        let (reply, answer) = oneshot::channel();
        let queue = &self.queues[usize::from(!urgent)];
        let order = self.count.fetch_add(1, Ordering::Relaxed);
        let envelope = Envelope {
            order,
            request,
            not_after,
            reply,
        };
        queue.put(envelope).await;
        self.work_if_free(TurnLimits::OF_CALLER);
        answer.await.ok()
    }

    fn unanswered(&self) -> Refusal {
        let text = if self.shared.closing.is_cancelled() {
            "the runtime is stopping".to_owned()
        } else {
            format!(
                "an internal fault occurred in coordinate system {} before it answered; alarm {} describes \
                 the remedy",
                self.number, RUNTIME_FAULT.number
            )
        };
        Refusal::new(RefusalCode::Unavailable, text)
    }

    /// Publishes the spindle's state if it has changed: its speed follows the command with a delay. While another
    /// thread is at work, this is left to the next call.
    pub fn publish_spindle(&self) {
        if let Some(work) = self.work.try_lock()
            && work.condition != FaultCondition::GivenUp
            && let Some(system) = &work.system
        {
            system.publish_spindle();
        }
    }

    /// Wakes the task for a turn.
    pub fn wake_task(&self) {
        self.wake.notify_one();
    }

    /// Executes a turn of simulated time while every task waits. Returns true if no other task has to run before time
    /// advances.
    pub fn turn_alone(&self) -> bool {
        let sent = self.shared.sent();
        self.work_if_free(TurnLimits::OF_TASK) && self.shared.sent() == sent
    }

    /// Works if no other thread is at work. If work remains, wakes the task and returns false: another thread may
    /// already have looked for requests for the last time.
    fn work_if_free(&self, share: TurnLimits) -> bool {
        let work = self.work.try_lock();
        let is_done = work.is_some_and(|work| self.work_for_task(work, share));
        if !is_done {
            self.wake.notify_one();
        }
        is_done
    }

    /// Works in place of the task. Returns false if work is left to the task.
    fn work_for_task(&self, mut work: MutexGuard<'_, MailboxState>, share: TurnLimits) -> bool {
        if self.queues.iter().any(Queue::begins_with_command) {
            return false;
        }
        let left = self.work(&mut work, share);
        let is_sooner = |at_s: f64| work.task_wakes_at_s.is_none_or(|task_s| at_s < task_s);
        !left.busy && !left.due_s.is_some_and(is_sooner)
    }

    /// Runs the task of the coordinate system until the runtime closes.
    pub async fn run(&self) {
        // also when the task is dropped: no other task serves the coordinate system
        let _ended = MailboxCloser(self);
        let clock = &self.shared.clock;
        loop {
            let left = self.work_as_task();
            tokio::select! {
                biased;
                () = self.shared.closing.cancelled() => break,
                () = self.wake.notified() => {}
                () = tokio::task::yield_now(), if left.busy => {}
                () = clock.sleep_until_s(left.due_s.unwrap_or(0.0)), if left.due_s.is_some() => {}
            }
        }
        let system = self.work.lock().system.take();
        if let Some(system) = system {
            // the runtime closes even if this fails
            let _ = catch_unwind(AssertUnwindSafe(|| system.shut_down()));
        }
    }

    fn work_as_task(&self) -> RemainingWork {
        let mut work = self.work.lock();
        let left = self.work(&mut work, TurnLimits::OF_TASK);
        work.task_wakes_at_s = left.due_s;
        left
    }

    /// Executes the next request and a turn. A panic of one coordinate system must stop neither the others nor the
    /// caller: it becomes an alarm.
    fn work(&self, work: &mut MailboxState, share: TurnLimits) -> RemainingWork {
        let Some(system) = &mut work.system else {
            return RemainingWork::default();
        };
        if work.condition == FaultCondition::GivenUp {
            return self.work_given_up(system, share);
        }
        let mut aborts = false;
        let worked = catch_unwind(AssertUnwindSafe(|| {
            self.shared.supervisor.fault_point(&self.task);
            if let Some(envelope) = self.queues.iter().find_map(|queue| queue.take_request(share)) {
                aborts = envelope.is_abort();
                system.handle(envelope);
            }
            RemainingWork {
                busy: system.turn(share),
                due_s: system.next_deadline_s(),
            }
        }));
        match worked {
            Ok(left) => {
                if work.condition == FaultCondition::Recovered && system.has_recovered() {
                    work.condition = FaultCondition::Sound;
                }
                RemainingWork {
                    busy: left.busy || !self.queues.iter().all(Queue::is_empty),
                    ..left
                }
            }
            Err(panicked) => {
                let why = panic_text(panicked.as_ref());
                work.condition = contain(system, work.condition, aborts, why);
                self.report(work.condition, why);
                RemainingWork {
                    busy: true,
                    due_s: None,
                }
            }
        }
    }

    fn report(&self, condition: FaultCondition, why: &str) {
        self.shared.supervisor.report(&FaultReport {
            task: self.task.clone(),
            consequence: match condition {
                FaultCondition::GivenUp => Consequence::CoordinateSystemNeedsRestart,
                FaultCondition::Sound | FaultCondition::Recovered => Consequence::StopsCoordinateSystem,
            },
            text: why.to_owned(),
        });
    }

    /// Answers requests to a coordinate system that stays stopped.
    fn work_given_up(&self, system: &mut CoordinateSystem, share: TurnLimits) -> RemainingWork {
        let worked = catch_unwind(AssertUnwindSafe(|| {
            if let Some(envelope) = self.queues.iter().find_map(|queue| queue.take_request(share)) {
                system.answer_given_up(envelope);
            }
            system.follow_servo_given_up()
        }));
        let is_backlogged = worked.unwrap_or(true);
        RemainingWork {
            busy: !self.queues.iter().all(Queue::is_empty),
            due_s: is_backlogged.then(|| self.shared.clock.now_s() + RETRY_S),
        }
    }

    fn close(&self) {
        self.queues.iter().for_each(Queue::close);
    }
}

/// Recovers after a panic: motion brakes, then the coordinate system is rebuilt, or given up if that fails too.
fn contain(system: &mut CoordinateSystem, before: FaultCondition, aborts: bool, why: &str) -> FaultCondition {
    system.brake_at_once(aborts);
    if before == FaultCondition::Sound && catch_unwind(AssertUnwindSafe(|| system.recover(why))).is_ok() {
        return FaultCondition::Recovered;
    }
    system.give_up(why);
    FaultCondition::GivenUp
}

/// Discards the coordinate system and its pending requests.
struct MailboxCloser<'a>(&'a Mailbox);

impl Drop for MailboxCloser<'_> {
    fn drop(&mut self) {
        self.0.work.lock().system = None;
        self.0.close();
    }
}

/// Work that is left.
#[derive(Debug, Clone, Copy, Default)]
struct RemainingWork {
    /// True if there is more to do at once.
    busy: bool,
    /// Time of the next work, seconds since the start.
    due_s: Option<f64>,
}

/// Requests in the order of their arrival.
struct Queue {
    envelopes: Mutex<VecDeque<Envelope>>,
    room: Semaphore,
}

impl Queue {
    fn new() -> Self {
        Self {
            envelopes: Mutex::default(),
            room: Semaphore::new(REQUESTS_MAX),
        }
    }

    /// Waits for room. An envelope that arrives after the end is discarded, as the waiting ones are.
    async fn put(&self, envelope: Envelope) {
        // tried first: a task that has used up its budget would wait, and its next request would overtake this one
        let room = match self.room.try_acquire() {
            Err(TryAcquireError::NoPermits) => self.room.acquire().await.ok(),
            room => room.ok(),
        };
        if let Some(room) = room {
            self.envelopes.lock().push_back(envelope);
            room.forget();
        }
        if self.room.is_closed() {
            self.envelopes.lock().clear();
        }
    }

    /// Takes the first request, unless it is a command that is left to the task.
    fn take_request(&self, share: TurnLimits) -> Option<Envelope> {
        if self.is_empty() {
            return None;
        }
        let may_take = |first: &mut Envelope| share.commands || !first.is_command();
        let envelope = self.envelopes.lock().pop_front_if(may_take)?;
        self.room.add_permits(1);
        Some(envelope)
    }

    fn begins_with_command(&self) -> bool {
        !self.is_empty() && self.envelopes.lock().front().is_some_and(Envelope::is_command)
    }

    /// Returns true if no envelope is queued. Each envelope takes its room before it is queued, so this needs no lock.
    fn is_empty(&self) -> bool {
        self.room.available_permits() == REQUESTS_MAX
    }

    fn close(&self) {
        self.room.close();
        self.envelopes.lock().clear();
    }
}

#[cfg(test)]
mod tests;
