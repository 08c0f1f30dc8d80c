//! The clock of tokio in simulated time. It is paused, and advances together with the simulation.
//!
//! When no task is ready, a paused executor advances its clock to its next timer. This module sets one timer, to the
//! next servo cycle. So tokio reaches either that cycle or an earlier timer of a task. In the second case the
//! simulation advances to the time of that timer before the task runs. If the machine is at rest and no task sleeps on
//! its clock, the module sets its timer repeatedly, until no timer of a task has been due for a long time.
//!
//! Tokio counts milliseconds, so its clock may be ahead of the machine's clock by less than 1 ms. Tokio's timers are in
//! slots of 64 ms, in slots of 64 of these, and so on. Tokio visits the slots one by one, so the module sets its timer
//! at most to the beginning of the next slot.

use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Waker};
use std::time::Duration;

use parking_lot::Mutex;
use tokio::runtime::Builder;
use tokio::time::{Instant, Sleep};

use tandem_runtime::simulation::{NextEvent, SimulationSlot, executor, run_in_slot};

/// Size of tokio's slots of timers: the first are 64 ms, the next 64 of these, and so on.
const SLOTS: u64 = 64;

/// Time in ns after the time limit of the simulation. Timers of tasks that are later than this are ignored.
const BEYOND_NS: u64 = 60_000_000_000;

/// Code that runs in a simulation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Code {
    /// Only the runtime's code, which sleeps on the clock of the machine.
    Own,
    /// Also the code of a user, which may sleep on the clock of tokio.
    Foreign,
}

/// Runs a future in simulated time. If `code` is foreign, tokio's clock runs in simulated time as well. Sockets do not
/// exist: opening one panics. `on_thread` is called when tokio starts another thread for blocking work, before the
/// simulation continues. The runtime puts its simulation into `slot`.
///
/// # Errors
/// Returns an error if the operating system provides no event queue.
pub(crate) fn run_in<T>(
    slot: SimulationSlot,
    code: Code,
    on_thread: impl Fn() + Send + Sync + 'static,
    main: impl Future<Output = T>,
) -> std::io::Result<T> {
    // tokio calls this when it requests a thread, so before the simulation continues
    let name = move || {
        on_thread();
        "other-thread".to_owned()
    };
    let clock = TokioClock::for_slot(&slot);
    let mut executor = match code {
        Code::Own => executor(&slot),
        Code::Foreign => clock.executor(),
    };
    let executor = executor.enable_time().thread_name_fn(name).build()?;
    let done = executor.block_on(run_in_slot(slot, main));
    clock.release();
    Ok(done)
}

/// The clock of tokio, coupled to the simulation in a slot.
struct TokioClock {
    slot: SimulationSlot,
    led: Mutex<Led>,
}

#[derive(Default)]
struct Led {
    /// Start of the simulation on tokio's clock.
    origin: Option<Instant>,
    /// Tokio timer that is set to the next cycle.
    guard: Option<Pin<Box<Sleep>>>,
    /// Next event of the simulation, and the due time of the timer in ns.
    next: Option<(NextEvent, u64)>,
    /// Time in ns since which nothing has happened.
    rests_since_ns: u64,
}

impl Led {
    /// Sets the timer to this event of the simulation, which is later than tokio's clock.
    fn set_timer(&mut self, next: NextEvent, at_ns: u64, origin: Instant) {
        let at = origin + Duration::from_nanos(at_ns);
        self.next = Some((next, at_ns));
        if let Some(guard) = &mut self.guard {
            guard.as_mut().reset(at);
        } else {
            let guard = self.guard.insert(Box::pin(tokio::time::sleep_until(at)));
            // the first poll registers the timer; `after_park` checks it later
            let _ = guard.as_mut().poll(&mut Context::from_waker(Waker::noop()));
        }
    }
}

/// Advances tokio's clock. Afterwards the executor checks its timers.
fn advance(by: Duration) {
    // the first poll advances the clock; the rest of the future, which is dropped, would wait for the executor
    let _ = std::pin::pin!(tokio::time::advance(by)).poll(&mut Context::from_waker(Waker::noop()));
}

/// Returns the beginning of the next slot in ns. Slots are larger after a longer rest.
fn next_slot_ns(now_ns: u64, rests_since_ns: u64) -> u64 {
    let mut slot_ns = SLOTS * 1_000_000;
    while slot_ns * SLOTS <= now_ns - rests_since_ns {
        slot_ns *= SLOTS;
    }
    (now_ns / slot_ns + 1) * slot_ns
}

fn elapsed_ns(origin: Instant) -> u64 {
    u64::try_from((Instant::now() - origin).as_nanos()).unwrap_or(u64::MAX)
}

impl TokioClock {
    fn for_slot(slot: &SimulationSlot) -> Arc<Self> {
        Arc::new(Self {
            slot: Arc::clone(slot),
            led: Mutex::default(),
        })
    }

    /// Returns an executor that advances both clocks when no task is ready to run.
    fn executor(self: &Arc<Self>) -> Builder {
        let (before, after) = (Arc::clone(self), Arc::clone(self));
        let mut executor = Builder::new_current_thread();
        executor
            .start_paused(true)
            .on_thread_park(move || before.before_park())
            .on_thread_unpark(move || after.after_park());
        executor
    }

    /// Executes the servo cycles that are due on tokio's clock, then sets the timer to the next event. Called when no
    /// task is ready to run.
    fn before_park(&self) {
        let Some(simulation) = self.slot.get() else { return };
        let mut led = self.led.lock();
        let origin = *led.origin.get_or_insert_with(Instant::now);
        loop {
            let next = simulation.next_event();
            if let NextEvent::Cycle(cycle) = next
                && simulation.run_delayed_cycle(cycle)
            {
                let left_ns = simulation
                    .cycle_start_ns(cycle)
                    .saturating_sub(elapsed_ns(origin));
                advance(Duration::from_nanos(left_ns));
                return;
            }
            let at_ns = match next {
                NextEvent::Tasks => return,
                NextEvent::Cycle(cycle) => simulation.cycle_start_ns(cycle),
                NextEvent::Nothing => {
                    let now_ns = elapsed_ns(origin);
                    if now_ns >= simulation.limit_ns().saturating_add(BEYOND_NS) {
                        simulation.stall_at(led.rests_since_ns);
                        return;
                    }
                    if simulation.is_at_limit() {
                        simulation.stall_at(now_ns);
                    }
                    next_slot_ns(now_ns, led.rests_since_ns)
                }
            };
            // A timer to a millisecond that has passed would never be due.
            if at_ns > elapsed_ns(origin) {
                led.set_timer(next, at_ns, origin);
                return;
            }
            led.rests_since_ns = at_ns;
            simulation.follow(next, at_ns);
        }
    }

    /// Advances the simulation after tokio has reached a timer or a task was woken.
    fn after_park(&self) {
        let Some(simulation) = self.slot.get() else { return };
        let mut led = self.led.lock();
        let (Some((next, at_ns)), Some(origin)) = (led.next.take(), led.origin) else {
            return;
        };
        let is_ours = led.guard.as_ref().is_some_and(|guard| guard.is_elapsed());
        // the most frequent case, in which the clock need not be read
        let is_cycle = is_ours && matches!(next, NextEvent::Cycle(_));
        let now_ns = if is_cycle { at_ns } else { elapsed_ns(origin) };
        match next {
            NextEvent::Nothing if is_ours => simulation.rest_until(now_ns),
            _ => {
                led.rests_since_ns = now_ns;
                simulation.follow(next, now_ns);
            }
        }
    }

    /// Drops the timer, because it keeps the executor alive.
    fn release(&self) {
        self.led.lock().guard = None;
    }
}
