//! The request queues of a coordinate system, and the coordinate system itself.
//!
//! If no other thread works on the coordinate system, a caller executes its own request at once in its own thread. So
//! the answer needs no second thread, and a handler in the same process needs no wake-up. Otherwise the caller queues
//! the request for the task. The task does everything else: commands, which may take long because a load checks whole
//! programs; events of the servo; deadlines; and further preparation.

use std::collections::VecDeque;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use parking_lot::{Mutex, MutexGuard};
use plc_protocol::supervisor::{Consequence, FaultReport, panic_text};
use plc_protocol::types::CoordinateSystemNumber;
use plc_protocol::types::command::Verb;
use plc_protocol::types::not_after::NotAfter;
use plc_protocol::types::request::{Answer, CoordinateSystemRequest, Refusal, RefusalCode};
use tandem_model::alarm::{FAULT_LASTS, RUNTIME_FAULT};
use tokio::sync::{Notify, Semaphore, TryAcquireError, oneshot};

use super::run::preparation::TurnLimits;
use super::{CoordinateSystem, View};
use crate::shared::SharedState;

/// Maximum number of requests that wait for one coordinate system; further senders wait until the queue has a free
/// slot.
/// Hold, stop and abort have a queue of the same size.
const REQUESTS_MAX: usize = 256;

/// Time in s after which a control is sent again if the servo's ring was full.
const RETRY_S: f64 = 0.001;

/// Queued request and the channel for its answer.
pub(crate) struct Envelope {
    /// Sequence number, larger than that of every envelope queued before.
    pub order: u64,
    pub request: CoordinateSystemRequest,
    /// Age limit of the request; a command has its limit in its meta data instead.
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

    fn is_reset(&self) -> bool {
        let CoordinateSystemRequest::Command { command, .. } = &self.request else {
            return false;
        };
        command.verb() == Verb::Reset
    }

    /// Returns true for a value from outside that moves nothing and that must not be lost while the coordinate system
    /// stays stopped.
    pub fn sets_value(&self) -> bool {
        matches!(
            self.request,
            CoordinateSystemRequest::Input(_)
                | CoordinateSystemRequest::Handler(..)
                | CoordinateSystemRequest::HandlerLeft(..)
                | CoordinateSystemRequest::Heartbeat(..)
                | CoordinateSystemRequest::SkipInput(..)
                | CoordinateSystemRequest::Tool(_)
        )
    }
}

/// A coordinate system and its request queues.
pub(crate) struct Mailbox {
    pub number: CoordinateSystemNumber,
    pub view: Arc<View>,
    shared: Arc<SharedState>,
    /// Index 0: the queue of hold, stop and abort, which pass all others. Index 1: the queue of all other requests.
    queues: [Queue; 2],
    count: AtomicU64,
    work: Mutex<MailboxState>,
    /// Name of the coordinate system in reports of faults.
    task: String,
    /// Wakes the task.
    wake: Arc<Notify>,
}

struct MailboxState {
    /// `None` after the runtime has closed it.
    system: Option<CoordinateSystem>,
    condition: FaultCondition,
    /// Time at which the task next wakes without a request, in s since the start.
    task_wakes_at_s: Option<f64>,
}

/// Condition of the coordinate system after internal faults.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum FaultCondition {
    Sound,
    /// A fault has occurred, and no reset has cleared its alarm yet.
    Recovered,
    /// A second fault has occurred before the reset: the coordinate system executes no turns until a reset recovers it.
    GivenUp,
    /// The recovery by a reset has failed. A further reset tries it again.
    ResetFailed,
}

impl FaultCondition {
    /// Returns true if the coordinate system executes no turns.
    fn is_given_up(self) -> bool {
        matches!(self, FaultCondition::GivenUp | FaultCondition::ResetFailed)
    }
}

impl std::fmt::Debug for Mailbox {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Mailbox")
            .field("number", &self.number)
            .finish_non_exhaustive()
    }
}

impl Mailbox {
    /// Creates the mailbox and publishes the state of the coordinate system. [`Mailbox::run`] is its task.
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

    /// Sends a request to the coordinate system and returns its answer. An urgent request passes the waiting requests,
    /// and is repeated once if an internal fault occurs during its execution.
    ///
    /// # Errors
    /// Returns the refusal of the request, or an error if the runtime is stopping or an internal fault occurred.
    pub async fn ask(&self, request: CoordinateSystemRequest, urgent: bool) -> Result<Answer, Refusal> {
        self.put_and_wait(request, None, urgent).await
    }

    /// Sends a request with an age limit. The coordinate system checks the limit when it begins to execute the request.
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

    /// Sends the request once. Returns `None` if an internal fault occurred, or if the runtime is stopping.
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
                "an internal fault occurred in coordinate system {} before it answered; alarm {} or {} describes \
                 the remedy",
                self.number, RUNTIME_FAULT.number, FAULT_LASTS.number
            )
        };
        Refusal::new(RefusalCode::Unavailable, text)
    }

    /// Publishes the spindle's state if it has changed: the spindle's speed follows its command with a delay. While
    /// another thread works on the coordinate system, does nothing; a later call publishes the state.
    pub fn publish_spindle(&self) {
        if let Some(work) = self.work.try_lock()
            && !work.condition.is_given_up()
            && let Some(system) = &work.system
        {
            system.publish_spindle();
        }
    }

    /// Wakes the task for a turn.
    pub fn wake_task(&self) {
        self.wake.notify_one();
    }

    /// Executes a turn in simulated time while every task waits. Returns true if the turn has left nothing to other
    /// tasks, so that time can advance.
    pub fn turn_alone(&self) -> bool {
        let sent = self.shared.sent();
        self.work_if_free(TurnLimits::OF_TASK) && self.shared.sent() == sent
    }

    /// Executes a request and a turn if no other thread works on the coordinate system. If work remains, wakes the task
    /// and returns false. Reason: another thread may have checked the queues before this request arrived.
    fn work_if_free(&self, share: TurnLimits) -> bool {
        let work = self.work.try_lock();
        let is_done = work.is_some_and(|work| self.work_for_task(work, share));
        if !is_done {
            self.wake.notify_one();
        }
        is_done
    }

    /// Executes a request and a turn in the caller's thread. Returns false if the task has to do the rest.
    fn work_for_task(&self, mut work: MutexGuard<'_, MailboxState>, share: TurnLimits) -> bool {
        if self
            .queues
            .iter()
            .any(|queue| queue.begins_with(Envelope::is_command))
        {
            return false;
        }
        let left = self.work(&mut work, share);
        let is_sooner = |at_s: f64| work.task_wakes_at_s.is_none_or(|task_s| at_s < task_s);
        !left.busy && !left.due_s.is_some_and(is_sooner)
    }

    /// Runs the task of the coordinate system until the runtime closes.
    pub async fn run(&self) {
        // closes the mailbox also if the task is dropped, because no other task serves the coordinate system
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
            // the runtime closes even if this step panics
            let _ = catch_unwind(AssertUnwindSafe(|| system.shut_down()));
        }
    }

    fn work_as_task(&self) -> RemainingWork {
        let mut work = self.work.lock();
        let left = self.work(&mut work, TurnLimits::OF_TASK);
        work.task_wakes_at_s = left.due_s;
        left
    }

    /// Executes the next request and a turn. A panic becomes an alarm, because it must stop neither other coordinate
    /// systems nor the caller.
    fn work(&self, work: &mut MailboxState, share: TurnLimits) -> RemainingWork {
        let Some(system) = &mut work.system else {
            return RemainingWork::default();
        };
        let is_given_up = work.condition.is_given_up();
        if is_given_up && !self.reset_is_next(share) {
            return self.work_given_up(system, share);
        }
        let mut aborts = false;
        let worked = catch_unwind(AssertUnwindSafe(|| {
            self.shared.supervisor.fault_point(&self.task);
            if is_given_up {
                system.recover_for_reset();
            }
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
                if is_given_up {
                    self.shared.supervisor.note_reset(&self.task);
                }
                if work.condition != FaultCondition::Sound {
                    work.condition = if system.has_recovered() {
                        FaultCondition::Sound
                    } else {
                        FaultCondition::Recovered
                    };
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
                FaultCondition::ResetFailed => Consequence::CoordinateSystemNeedsRestart,
                _ => Consequence::StopsCoordinateSystem,
            },
            text: why.to_owned(),
        });
    }

    /// Returns true if the next request to take is a reset.
    fn reset_is_next(&self, share: TurnLimits) -> bool {
        let [urgent, other] = &self.queues;
        share.commands && urgent.is_empty() && other.begins_with(Envelope::is_reset)
    }

    /// Answers requests to a coordinate system that stays stopped after two faults.
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

/// Recovers after a panic: brakes the motion, then rebuilds the coordinate system. If that fails or an earlier fault
/// was not reset, leaves it stopped until a reset.
fn contain(system: &mut CoordinateSystem, before: FaultCondition, aborts: bool, why: &str) -> FaultCondition {
    system.brake_at_once(aborts);
    if before == FaultCondition::Sound && catch_unwind(AssertUnwindSafe(|| system.recover(why))).is_ok() {
        return FaultCondition::Recovered;
    }
    system.give_up(why);
    if before.is_given_up() {
        FaultCondition::ResetFailed
    } else {
        FaultCondition::GivenUp
    }
}

/// Discards the coordinate system and its pending requests when dropped. If the task has failed, the coordinate system
/// still exists: its motion stops on its path, and its outputs are cancelled.
struct MailboxCloser<'a>(&'a Mailbox);

impl Drop for MailboxCloser<'_> {
    fn drop(&mut self) {
        let system = self.0.work.lock().system.take();
        if let Some(mut system) = system {
            // a step that panics must not prevent the next one
            let _ = catch_unwind(AssertUnwindSafe(|| system.brake_at_once(false)));
            let _ = catch_unwind(AssertUnwindSafe(|| system.shut_down()));
        }
        self.0.close();
    }
}

/// Work that a turn has left.
#[derive(Debug, Clone, Copy, Default)]
struct RemainingWork {
    /// True if there is more to do now.
    busy: bool,
    /// Time of the next work, in s since the start.
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

    /// Queues an envelope; if the queue is full, waits for a free slot. After the end of the mailbox, discards all
    /// envelopes.
    async fn put(&self, envelope: Envelope) {
        // not only `acquire`: in a task without remaining budget it would wait, and the task's next request would
        // overtake
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

    /// Takes the first request. Returns `None` if it is a command and `share` leaves commands to the task.
    fn take_request(&self, share: TurnLimits) -> Option<Envelope> {
        if self.is_empty() {
            return None;
        }
        let may_take = |first: &mut Envelope| share.commands || !first.is_command();
        let envelope = self.envelopes.lock().pop_front_if(may_take)?;
        self.room.add_permits(1);
        Some(envelope)
    }

    /// Returns true if the first request fulfils the condition.
    fn begins_with(&self, is_it: fn(&Envelope) -> bool) -> bool {
        !self.is_empty() && self.envelopes.lock().front().is_some_and(is_it)
    }

    /// Returns true if no envelope is queued. Needs no lock, because each envelope takes its slot before it is queued.
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
