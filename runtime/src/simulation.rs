//! Simulated time: servo cycles are executed as fast as the computer can, but only when no task is ready to run.
//!
//! All tasks run on one thread, so a run is reproducible byte for byte. Most events of a cycle concern only one
//! coordinate system, such as the start of the next block. Then that coordinate system handles the event at once, and
//! no task is woken.

use std::future::Future;
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use parking_lot::Mutex;
use tandem_servo::{HardwareFactory, Servo};
use tandem_store::clock::Clock;
use tokio::sync::Notify;

use crate::coordinate_system::Mailbox;
use crate::servo_thread::{cycle_after, pass};
use crate::shared::SharedState;

pub use crate::planned::{OnPlan, PlannedMotion};

/// Real time without progress of simulated time after which an error is logged.
const STANDSTILL_REPORT: Duration = Duration::from_secs(5);

/// Number of turns that coordinate systems take alone before all tasks get a turn, including tasks that wait for
/// external events.
const TURNS_MAX: usize = 256;

/// Function that is called after each servo cycle, for a trace.
pub type OnCycle = Box<dyn FnMut(&Servo) + Send>;

/// The servo of a simulation and the coordinate systems whose motion it executes.
pub struct Simulation {
    servo: Mutex<SimulatedServo>,
    clock: Clock,
    shared: Arc<SharedState>,
    mailboxes: Vec<Arc<Mailbox>>,
    stalled: Notify,
    period_ns: u64,
    missed_cycles_max: u64,
    limit_ns: u64,
    passes_even_motion: bool,
}

struct SimulatedServo {
    servo: Servo,
    /// Number of executed and omitted cycles.
    cycles: u64,
    /// Number of cycles to omit before the next cycle.
    missed: u64,
    /// Number of turns that coordinate systems have taken alone since the last turn of all tasks.
    turns: usize,
    on_cycle: Option<OnCycle>,
}

/// Next event of a simulation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NextEvent {
    /// Tasks are ready to run.
    Tasks,
    /// This servo cycle is next; nothing happens before it.
    Cycle(u64),
    /// Nothing can happen: nothing moves and no task sleeps, or the time limit is reached.
    Nothing,
}

impl std::fmt::Debug for Simulation {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Simulation").finish_non_exhaustive()
    }
}

impl Simulation {
    pub(crate) fn new(
        servo: Servo,
        clock: Clock,
        mailboxes: Vec<Arc<Mailbox>>,
        shared: &Arc<SharedState>,
        options: SimulationOptions,
    ) -> Self {
        let machine = &shared.machine;
        let limit_ns = u64::try_from(Duration::from_secs_f64(options.max_time_s.clamp(0.0, 1e9)).as_nanos())
            .unwrap_or(u64::MAX);
        let servo = Mutex::new(SimulatedServo {
            servo,
            cycles: 0,
            missed: 0,
            turns: 0,
            on_cycle: options.on_cycle,
        });
        Self {
            servo,
            clock,
            shared: Arc::clone(shared),
            mailboxes,
            stalled: Notify::new(),
            period_ns: machine.servo_period_us * 1000,
            missed_cycles_max: machine.missed_cycles_max(),
            limit_ns,
            passes_even_motion: options.passes_even_motion,
        }
    }

    /// Delays the start of the next servo cycle by `late`, as if the process were suspended. The servo cycles due in
    /// the meantime are omitted, and tasks that sleep until then wake afterwards.
    pub fn delay_servo(&self, late: Duration) {
        let late_ns = u64::try_from(late.as_nanos()).unwrap_or(u64::MAX);
        self.servo.lock().missed += late_ns / self.period_ns;
    }

    /// Waits until nothing further can happen: no motion and no sleeping task, or the time limit is reached.
    pub async fn stalled(&self) {
        self.stalled.notified().await;
    }

    /// Returns true when the time limit is reached.
    pub fn is_at_limit(&self) -> bool {
        self.cycles() * self.period_ns >= self.limit_ns
    }

    /// Returns the number of servo cycles so far, including omitted cycles.
    pub fn cycles(&self) -> u64 {
        self.servo.lock().cycles
    }

    /// Returns the time after the start at which a servo cycle begins, ns.
    pub fn cycle_start_ns(&self, cycle: u64) -> u64 {
        cycle * self.period_ns
    }

    /// Returns the simulated time at which the simulation ends, ns.
    pub fn limit_ns(&self) -> u64 {
        self.limit_ns
    }

    /// Returns the next event. If sleeping tasks are due, wakes them. An executor that advances other clocks together
    /// with the simulation uses this function and [`follow`](Simulation::follow).
    pub fn next_event(&self) -> NextEvent {
        self.next(&mut self.servo.lock())
    }

    /// Executes this cycle if it is the end of a [delay](Simulation::delay_servo), during which no task wakes. Returns
    /// true if it was executed.
    pub fn run_delayed_cycle(&self, cycle: u64) -> bool {
        let mut servo = self.servo.lock();
        let is_delayed = servo.missed > 0;
        if is_delayed {
            self.advance(&mut servo, cycle);
        }
        is_delayed
    }

    /// Advances the simulation to `now_ns`, at most to the next event.
    pub fn follow(&self, next: NextEvent, now_ns: u64) {
        let last = match next {
            NextEvent::Tasks => return,
            NextEvent::Cycle(cycle) => cycle,
            NextEvent::Nothing => u64::MAX,
        };
        let due = if now_ns < self.limit_ns {
            now_ns / self.period_ns
        } else {
            self.stalled.notify_one();
            self.limit_ns.div_ceil(self.period_ns)
        };
        let mut servo = self.servo.lock();
        if due >= last {
            self.advance(&mut servo, last);
        } else {
            if due > servo.cycles {
                self.advance(&mut servo, due);
            }
            self.clock.set_ns(now_ns);
        }
    }

    /// Lets time pass while nothing moves and no task sleeps on the clock of the machine.
    pub fn rest_until(&self, now_ns: u64) {
        self.clock.set_ns(now_ns);
    }

    /// Reports that nothing further can happen; `since_ns` is the time since which nothing has happened.
    pub fn stall_at(&self, since_ns: u64) {
        if !self.is_at_limit() {
            self.clock.set_ns(since_ns);
        }
        self.stalled.notify_one();
    }

    /// Executes cycles until a task is ready to run or nothing can happen.
    fn step(&self) {
        let mut servo = self.servo.lock();
        loop {
            match self.next(&mut servo) {
                NextEvent::Tasks => return,
                NextEvent::Nothing => {
                    self.stalled.notify_one();
                    return;
                }
                NextEvent::Cycle(cycle) => {
                    if self.advance(&mut servo, cycle) {
                        return;
                    }
                }
            }
        }
    }

    /// Returns the next event. If sleeping tasks are due, wakes them.
    fn next(&self, servo: &mut SimulatedServo) -> NextEvent {
        if self.clock.wake_due() {
            servo.turns = 0;
            return NextEvent::Tasks;
        }
        let moving = servo.servo.channels().iter().any(|channel| !channel.is_idle());
        let now_ns = servo.cycles * self.period_ns;
        if (!moving && self.clock.next_due_ns().is_none()) || now_ns >= self.limit_ns {
            return NextEvent::Nothing;
        }
        let before = if servo.missed == 0 {
            self.cycles_to_pass(servo, now_ns)
        } else {
            servo.missed
        };
        NextEvent::Cycle(servo.cycles + before + 1)
    }

    /// Executes the cycles up to `cycle`, which must not be later than that of [`next`](Simulation::next). Returns true
    /// if tasks must run before time advances.
    fn advance(&self, servo: &mut SimulatedServo, cycle: u64) -> bool {
        let missed = std::mem::take(&mut servo.missed);
        let before = cycle - servo.cycles - 1;
        servo.cycles = cycle;
        let events = self.cycle(&mut servo.servo, before, missed);
        self.clock.set_ns(cycle * self.period_ns);
        if let Some(on_cycle) = &mut servo.on_cycle {
            on_cycle(&servo.servo);
        }
        if !events {
            return false;
        }
        servo.turns += 1;
        if missed == 0 && self.turn_alone(&servo.servo) && servo.turns < TURNS_MAX {
            return false;
        }
        servo.turns = 0;
        // wakes a task, so that the executor calls this again even if no task received an event
        for mailbox in &self.mailboxes {
            mailbox.wake_task();
        }
        true
    }

    /// Executes a cycle after `before` cycles that passed at once or were omitted. Returns the result of
    /// [`Servo::cycle`], and true when the servo has just failed.
    fn cycle(&self, servo: &mut Servo, before: u64, missed: u64) -> bool {
        let statistics = &self.shared.servo;
        let had_failed = statistics.failure().is_some();
        if missed == 0 && !had_failed {
            pass(servo, before, statistics);
        }
        let events = cycle_after(servo, missed, self.missed_cycles_max, statistics);
        if let (false, Some(why)) = (had_failed, statistics.failure()) {
            self.shared.on_servo_failed(why);
            return true;
        }
        events
    }

    /// Makes each coordinate system with servo events take a turn. Returns false if tasks must run before time
    /// advances.
    fn turn_alone(&self, servo: &Servo) -> bool {
        let mailboxes = self.mailboxes.iter().zip(servo.channels());
        let told = mailboxes.filter(|(_, channel)| channel.has_reported());
        // `count` visits every coordinate system, even after one that must leave work to its task
        told.filter(|(mailbox, _)| !mailbox.turn_alone()).count() == 0
    }

    /// Returns the number of cycles without events before the next sleeping task is due; these cycles pass at once.
    /// None pass if `on_cycle` needs each cycle; with `passes_even_motion` only those pass in which no speed changes.
    fn cycles_to_pass(&self, servo: &mut SimulatedServo, now_ns: u64) -> u64 {
        let is_watched = servo.on_cycle.is_some();
        if is_watched && !self.passes_even_motion {
            return 0;
        }
        let due_ns = self.clock.next_due_ns().unwrap_or(u64::MAX).min(self.limit_ns);
        let left_ns = due_ns.saturating_sub(now_ns);
        let cycles_max = left_ns.div_ceil(self.period_ns).saturating_sub(1);
        if is_watched {
            servo.servo.even_cycles_to_pass(cycles_max)
        } else {
            servo.servo.cycles_to_pass(cycles_max)
        }
    }
}

/// Options of a simulation.
pub struct SimulationOptions {
    /// Simulated time in s at which the simulation ends.
    pub max_time_s: f64,
    /// Function that is called after each servo cycle.
    pub on_cycle: Option<OnCycle>,
    /// True if `on_cycle` does not need cycles in which each motor keeps its speed. The time of the next cycle shows
    /// the gap.
    pub passes_even_motion: bool,
    /// Function that is called with each plan.
    pub on_plan: Option<OnPlan>,
    /// Function that creates the hardware; with `None` the hardware is simulated.
    pub hardware: Option<HardwareFactory>,
}

impl Default for SimulationOptions {
    fn default() -> Self {
        Self {
            max_time_s: 86_400.0,
            on_cycle: None,
            passes_even_motion: false,
            on_plan: None,
            hardware: None,
        }
    }
}

/// Place where a runtime in simulated time puts its simulation, so that the executor finds the simulation.
pub type SimulationSlot = Arc<OnceLock<Arc<Simulation>>>;

tokio::task_local! {
    static SLOT: SimulationSlot;
}

/// Returns the slot of the simulation in which this task runs.
pub(crate) fn slot() -> Option<SimulationSlot> {
    SLOT.try_with(Arc::clone).ok()
}

/// Runs a future in simulated time. The future may call [`Runtime::start_simulated`](crate::Runtime::start_simulated).
///
/// # Errors
/// Returns an error if the operating system provides no event queue.
pub fn run<T>(main: impl Future<Output = T>) -> std::io::Result<T> {
    let slot = SimulationSlot::default();
    let mut executor = executor(&slot);
    let report = report_standstill(Arc::clone(&slot));
    let watched = async {
        tokio::select! {
            biased;
            done = main => done,
            never = report => match never {},
        }
    };
    Ok(executor.enable_all().build()?.block_on(SLOT.scope(slot, watched)))
}

/// Runs a future whose runtime puts its simulation into `slot`, on an executor that advances this simulation, such as
/// one of [`executor`].
pub async fn run_in_slot<T>(slot: SimulationSlot, main: impl Future<Output = T>) -> T {
    SLOT.scope(slot, main).await
}

/// Returns an executor that executes the servo cycles of the simulation in `slot` when no task is ready to run.
pub fn executor(slot: &SimulationSlot) -> tokio::runtime::Builder {
    let stepper = Arc::clone(slot);
    let mut executor = tokio::runtime::Builder::new_current_thread();
    executor.on_thread_park(move || {
        if let Some(simulation) = stepper.get() {
            simulation.step();
        }
    });
    executor
}

/// Logs an error when simulated time has stopped because every task waits for an event other than time.
async fn report_standstill(slot: SimulationSlot) -> std::convert::Infallible {
    let mut last = None;
    loop {
        tokio::time::sleep(STANDSTILL_REPORT).await;
        let cycles = slot.get().map(|simulation| simulation.cycles());
        if cycles.is_some() && cycles == last {
            tracing::error!(
                "simulated time does not advance: nothing moves, no task sleeps on its clock, and all \
                 tasks wait for other events"
            );
        }
        last = cycles;
    }
}

#[cfg(test)]
pub(crate) mod tests;
