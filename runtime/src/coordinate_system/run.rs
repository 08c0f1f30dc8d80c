//! Programs and counters of a run; its state is in `run_state`.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use plc_api::types::state::RunKind;
use tandem_interp::not_there;
use tandem_model::alarm::{PROGRAM_NOT_FOUND, PROGRAM_REFUSED};
use tandem_model::settings::CoordinateSystemSettings;
use tandem_model::{Alarm, Axis, AxisVector, Origin};
use tandem_syntax::NcProgram;

use super::conditions::Conditions;
use super::line_search::LineArrival;
use super::pipeline::InForce;
use crate::clock::Clock;
use crate::command_memory::COMMAND_MEMORY;
use crate::program_store::StoredProgram;

/// Run of the loaded program, of manual data input, or of a motion by hand.
pub(super) struct ActiveRun {
    pub id: String,
    pub kind: ActiveRunKind,
    /// The main program; number 0 if there is none.
    pub main: Arc<StoredProgram>,
    pub programs: BTreeMap<u16, Arc<NcProgram>>,
    /// Conditions at its start; `None` if it is not the run of a program.
    pub conditions: Option<Arc<Conditions>>,
    /// Programs that it may not call, each with the reason.
    pub refused: BTreeMap<u16, String>,
    /// The number of its first segment.
    pub first_segment: u64,
    /// Rest position of the machine at its start.
    pub from: AxisVector,
    /// For a macro: the state restored at its end.
    pub restores: Option<Box<Restores>>,
    /// The first G31 that ended without a touch.
    pub missed_touch: Option<Origin>,
    pub steps: SingleBlockState,
    pub at_rest: AtRest,
    /// Set until a run that begins at a line has arrived there.
    pub arrival: Option<Box<LineArrival>>,
}

/// State in force when a macro began.
#[derive(Debug)]
pub(super) struct Restores {
    pub in_force: InForce,
    /// True if the next manual data input continues in this state.
    pub manual_goes_on: bool,
}

static NO_TEXTS: BTreeMap<u16, Arc<StoredProgram>> = BTreeMap::new();

impl ActiveRun {
    pub fn is_jog(&self) -> bool {
        matches!(self.kind, ActiveRunKind::Jog(_))
    }

    /// Returns the program of the run and those that it may call; empty for a run by hand.
    pub fn texts(&self) -> &BTreeMap<u16, Arc<StoredProgram>> {
        self.conditions
            .as_ref()
            .map_or(&NO_TEXTS, |conditions| &conditions.texts)
    }

    /// Returns the alarm of a call. Whether a computed program number may be called is known only at the call.
    pub fn refusal_of_call(&self, alarm: Alarm) -> Alarm {
        if alarm.entry != &PROGRAM_NOT_FOUND {
            return alarm;
        }
        let mut refused = self.refused.iter();
        match refused.find(|(number, _)| alarm.text == not_there(**number)) {
            Some((_, why)) => Alarm {
                entry: &PROGRAM_REFUSED,
                text: why.clone(),
                ..alarm
            },
            None => alarm,
        }
    }
}

/// Data kept of past runs.
#[derive(Debug, Default)]
pub(super) struct PastRuns {
    /// Runs that were started.
    pub count: u64,
    /// The one started last.
    pub last_id: Option<String>,
    /// True if the next manual data input continues in the modal state of the last one.
    pub manual_goes_on: bool,
    /// Number and text of the alarm that was raised last.
    pub alarm: String,
    pub jogs: Jogs,
}

/// Maximum number of early jog ends (ends that arrived before their begin) per user; the user's oldest is dropped.
/// Reason: such an end overtakes its begin by a moment only.
const ENDS_MAX: usize = 16;

/// Jogs that have ended, the oldest first, kept as long as commands are remembered. Each began with a command that had
/// room in that memory, which bounds their number.
#[derive(Debug, Default)]
pub(super) struct Jogs {
    ended: VecDeque<(String, f64)>,
    /// Ends of jogs that have not begun: user, name and time.
    ends: VecDeque<(String, String, f64)>,
}

impl Jogs {
    /// Remembers an ended jog, so that a late refresh does not start it again.
    pub fn remember(&mut self, ended: &ActiveRunKind, now_s: f64) {
        if let ActiveRunKind::Jog(jog) = ended {
            self.forget(now_s);
            self.ended.push_back((jog.refresh_id.clone(), now_s));
        }
    }

    /// Marks the jog with this name as ended, although it has not begun.
    pub fn mark_ended(&mut self, user: &str, refresh_id: &str, now_s: f64) {
        self.forget(now_s);
        if self.has_ended(refresh_id, now_s) {
            return;
        }
        let own = self.ends.iter().filter(|(by, ..)| by == user).count();
        if own >= ENDS_MAX
            && let Some(oldest) = self.ends.iter().position(|(by, ..)| by == user)
        {
            self.ends.remove(oldest);
        }
        self.ends
            .push_back((user.to_owned(), refresh_id.to_owned(), now_s));
    }

    pub fn has_ended(&self, refresh_id: &str, now_s: f64) -> bool {
        let mut ended = self.ended.iter();
        let mut ends = self.ends.iter();
        ended.any(|(name, at_s)| name == refresh_id && is_remembered(*at_s, now_s))
            || ends.any(|(_, name, at_s)| name == refresh_id && is_remembered(*at_s, now_s))
    }

    fn forget(&mut self, now_s: f64) {
        while self
            .ended
            .pop_front_if(|(_, at_s)| !is_remembered(*at_s, now_s))
            .is_some()
        {}
        while self
            .ends
            .pop_front_if(|(.., at_s)| !is_remembered(*at_s, now_s))
            .is_some()
        {}
    }
}

fn is_remembered(at_s: f64, now_s: f64) -> bool {
    now_s - at_s <= COMMAND_MEMORY.as_secs_f64()
}

/// Kind of a run.
#[derive(Debug)]
pub(super) enum ActiveRunKind {
    /// The loaded program.
    Program,
    /// Manual data input.
    Manual,
    Home,
    Jog(Jog),
}

impl ActiveRunKind {
    /// Returns the kind as published in the state.
    pub fn run_kind(&self) -> RunKind {
        match self {
            ActiveRunKind::Program => RunKind::Program,
            ActiveRunKind::Manual => RunKind::Mdi,
            ActiveRunKind::Home => RunKind::Home,
            ActiveRunKind::Jog(_) => RunKind::Jog,
        }
    }
}

/// Active jog.
#[derive(Debug)]
pub(super) struct Jog {
    pub refresh_id: String,
    pub axis: Axis,
    /// The commanded distance, mm or degrees; `None` for a jog to the soft limit.
    pub distance: Option<f64>,
    /// Time at which it stops unless it is refreshed; `None` for a step, which needs no refresh.
    pub until_s: Option<f64>,
    /// End position: at the distance, or before it at the soft limit.
    pub to: AxisVector,
    /// Settings with the jog's velocity as rapid velocity.
    pub settings: Arc<CoordinateSystemSettings>,
}

/// Single block of one run.
#[derive(Debug, Default)]
pub(super) struct SingleBlockState {
    /// True if items of a block have been taken, and the block has not ended.
    pub in_block: bool,
    /// Segments up to this one were planned before single block was switched on.
    pub planned_ahead: u64,
    /// True if the servo has been commanded to hold after the running block, and does not hold yet.
    pub armed: bool,
}

/// Maximum number of items interpreted within one servo period that produce no motion. Reason: computing takes no
/// simulated time, so a loop without motion would stop that time.
const ITEMS_AT_REST_MAX: u32 = 100;

/// Items interpreted since the servo last received motion.
#[derive(Debug, Default)]
pub(super) struct AtRest {
    last_segment: u64,
    items: u32,
    /// When the first of them was interpreted, seconds since the start.
    since_s: f64,
    /// Time until which the run waits, seconds since the start.
    until_s: Option<f64>,
}

impl AtRest {
    pub fn count(&mut self, last_segment: u64, clock: &Clock, period_s: f64) {
        if last_segment != self.last_segment {
            *self = Self {
                last_segment,
                ..Self::default()
            };
        }
        if self.items == 0 {
            self.since_s = clock.now_s();
        }
        self.items += 1;
        if self.items == ITEMS_AT_REST_MAX {
            self.items = 0;
            let until_s = self.since_s + period_s;
            self.until_s = (until_s > clock.now_s() + 1e-9).then_some(until_s);
        }
    }

    /// Ends the wait of the run if its time has come.
    pub fn on_time(&mut self, now_s: f64) {
        self.until_s = self.until_s.filter(|until_s| *until_s > now_s + 1e-9);
    }

    /// Returns the time at which the run continues, until [`AtRest::on_time`] ends the wait. A waiter woken by this
    /// time thus also continues, however late the clock is.
    pub fn until_s(&self) -> Option<f64> {
        self.until_s
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn jog(refresh_id: &str) -> ActiveRunKind {
        let machine = crate::Config::demo().resolve().unwrap();
        ActiveRunKind::Jog(Jog {
            refresh_id: refresh_id.to_owned(),
            axis: Axis::X,
            distance: None,
            until_s: Some(0.2),
            to: AxisVector::ZERO,
            settings: Arc::new(machine.coordinate_systems[0].settings.clone()),
        })
    }

    #[test]
    fn a_jog_that_has_ended_is_known_for_ten_minutes_however_many_others_end() {
        let mut jogs = Jogs::default();
        for n in 0..1000 {
            jogs.remember(&jog(&n.to_string()), 0.0);
        }
        assert!(!jogs.has_ended("1000", 0.0));
        for (now_s, is_known) in [(0.0, true), (600.0, true), (600.1, false)] {
            assert_eq!(jogs.has_ended("0", now_s), is_known, "{now_s}");
        }
        jogs.remember(&jog("later"), 601.0);
        assert_eq!(jogs.ended.len(), 1, "the others are forgotten");
    }

    #[test]
    fn ends_of_jogs_that_have_not_begun_are_bounded_for_each_user() {
        let mut jogs = Jogs::default();
        jogs.mark_ended("anna", "a", 0.0);
        for n in 0..=ENDS_MAX {
            jogs.mark_ended("bert", &n.to_string(), 0.0);
        }
        assert!(
            jogs.has_ended("a", 0.0),
            "another user's ends evict nothing of hers"
        );
        assert!(!jogs.has_ended("0", 0.0) && jogs.has_ended("1", 0.0));
    }

    #[test]
    fn run_waiting_at_rest_keeps_its_wake_time_until_a_turn_sees_it_pass() {
        let (clock, mut at_rest) = (Clock::simulated(), AtRest::default());
        for _ in 0..ITEMS_AT_REST_MAX {
            assert_eq!(at_rest.until_s(), None);
            at_rest.count(0, &clock, 0.001);
        }
        assert_eq!(at_rest.until_s(), Some(0.001));
        clock.set_ns(2_000_000);
        // a turn that began before this time still sees it: its wait must be woken
        assert_eq!(at_rest.until_s(), Some(0.001));
        at_rest.on_time(clock.now_s());
        assert_eq!(at_rest.until_s(), None);
    }

    #[test]
    fn items_that_take_longer_than_a_servo_period_wait_for_nothing() {
        let (clock, mut at_rest) = (Clock::simulated(), AtRest::default());
        at_rest.count(0, &clock, 0.001);
        clock.set_ns(1_000_000);
        for _ in 1..ITEMS_AT_REST_MAX {
            at_rest.count(0, &clock, 0.001);
        }
        assert_eq!(at_rest.until_s(), None);
    }

    #[test]
    fn only_the_end_of_a_jog_is_remembered() {
        for (ended, is_known) in [
            (ActiveRunKind::Program, false),
            (ActiveRunKind::Manual, false),
            (ActiveRunKind::Home, false),
            (jog(""), true),
        ] {
            let mut jogs = Jogs::default();
            jogs.remember(&ended, 0.0);
            assert_eq!(jogs.has_ended("", 0.0), is_known, "{ended:?}");
        }
    }
}
