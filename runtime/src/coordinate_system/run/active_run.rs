//! Programs and counters of a run. The state of the run is in `run_state`.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use plc_protocol::types::state::RunKind;
use tandem_interp::not_there;
use tandem_model::alarm::{PROGRAM_NOT_FOUND, PROGRAM_REFUSED};
use tandem_model::settings::CoordinateSystemSettings;
use tandem_model::{Alarm, Axis, AxisVector, Origin};
use tandem_store::clock::Clock;
use tandem_store::program_store::StoredProgram;
use tandem_syntax::NcProgram;

use super::conditions::Conditions;
use super::line_search::LineArrival;
use super::pipeline::InForce;
use crate::command_memory::COMMAND_MEMORY;

/// Run of the loaded program, of manual data input (MDI), of homing, or of a jog.
pub(crate) struct ActiveRun {
    pub id: String,
    pub kind: ActiveRunKind,
    /// The main program; its number is 0 if the run is not that of a stored program.
    pub main: Arc<StoredProgram>,
    pub programs: BTreeMap<u16, Arc<NcProgram>>,
    /// Conditions at the start of the run; `None` if the run is not that of a stored program.
    pub conditions: Option<Arc<Conditions>>,
    /// Programs that the run may not call, each with the reason.
    pub refused: BTreeMap<u16, String>,
    /// Number of the first segment of the run.
    pub first_segment: u64,
    /// Rest position of the machine at the start of the run.
    pub from: AxisVector,
    /// For a macro, the state that is restored at its end; otherwise `None`.
    pub restores: Option<Box<Restores>>,
    /// Line of the first G31 that ended without a touch.
    pub missed_touch: Option<Origin>,
    pub steps: SingleBlockState,
    pub at_rest: AtRest,
    /// Remaining approach of a run that begins at a line; `None` after the run has reached that line.
    pub arrival: Option<Box<LineArrival>>,
}

/// State in force when a macro began.
#[derive(Debug)]
pub(crate) struct Restores {
    pub in_force: InForce,
    /// True if the next manual data input would have continued in this state.
    pub manual_goes_on: bool,
}

static NO_TEXTS: BTreeMap<u16, Arc<StoredProgram>> = BTreeMap::new();

impl ActiveRun {
    pub fn is_jog(&self) -> bool {
        matches!(self.kind, ActiveRunKind::Jog(_))
    }

    /// Returns the main program and the programs that it may call; empty for a run by hand.
    pub fn texts(&self) -> &BTreeMap<u16, Arc<StoredProgram>> {
        self.conditions
            .as_ref()
            .map_or(&NO_TEXTS, |conditions| &conditions.texts)
    }

    /// Returns the alarm of a failed call. If the called program exists but may not be called, replaces the text by
    /// that reason.
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

/// Data kept from past runs.
#[derive(Debug, Default)]
pub(crate) struct PastRuns {
    /// Number of runs that were started since the start of the runtime.
    pub count: u64,
    /// Name of the run that was started last.
    pub last_id: Option<String>,
    /// True if the next manual data input continues in the modal state of the last input.
    pub manual_goes_on: bool,
    /// Number and text of the alarm that was raised last.
    pub alarm: String,
    pub jogs: Jogs,
}

/// Maximum number of early jog ends per user; further ends drop the oldest. An early end arrives before the begin of
/// its jog. Reason for the small number: such an end overtakes the begin only by a moment.
const ENDS_MAX: usize = 16;

/// Jogs that have ended, the oldest first. They are kept as long as the command memory keeps commands, which also
/// limits their number: the command that began a jog has an entry in that memory.
#[derive(Debug, Default)]
pub(crate) struct Jogs {
    ended: VecDeque<(String, f64)>,
    /// Ends of jogs that have not begun: user, name of the jog, and time of the end in s.
    ends: VecDeque<(String, String, f64)>,
}

impl Jogs {
    /// Keeps the name of an ended jog, so that a late refresh does not start the jog again.
    pub fn remember(&mut self, ended: &ActiveRunKind, now_s: f64) {
        if let ActiveRunKind::Jog(jog) = ended {
            self.forget(now_s);
            self.ended.push_back((jog.refresh_id.clone(), now_s));
        }
    }

    /// Marks the jog with this name as ended before its begin has arrived.
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
pub(crate) enum ActiveRunKind {
    /// Run of the loaded program.
    Program,
    /// Manual data input.
    Manual,
    Home,
    Jog(Jog),
}

impl ActiveRunKind {
    /// Returns the kind of the run in its published form.
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
pub(crate) struct Jog {
    pub refresh_id: String,
    pub axis: Axis,
    /// Commanded distance in mm or degrees; `None` for a jog without distance.
    pub distance: Option<f64>,
    /// Time in s at which the jog stops if no refresh arrives; `None` for a jog by a distance, which needs no refresh.
    pub until_s: Option<f64>,
    /// End position: at the commanded distance, or at the soft limit if that is nearer.
    pub to: AxisVector,
    /// Settings of the coordinate system, with the velocity of the jog as rapid velocity.
    pub settings: Arc<CoordinateSystemSettings>,
}

/// State of single block in one run.
#[derive(Debug, Default)]
pub(crate) struct SingleBlockState {
    /// True from the first interpreted item of a block until the block has ended.
    pub in_block: bool,
    /// The last segment that was planned before single block was switched on.
    pub planned_ahead: u64,
    /// True if the servo will hold after the running block, and does not hold yet.
    pub armed: bool,
}

/// Maximum number of items without motion that are interpreted within one servo period. Reason: computing takes no
/// simulated time, so a loop without motion would stop the simulated time.
const ITEMS_AT_REST_MAX: u32 = 100;

/// Number of items interpreted since the last planned motion.
#[derive(Debug, Default)]
pub(crate) struct AtRest {
    last_segment: u64,
    items: u32,
    /// Time in s since the start at which the first of these items was interpreted.
    since_s: f64,
    /// Time in s since the start until which the run waits; `None` if it does not wait.
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

    /// Ends the wait of the run if its end has passed.
    pub fn on_time(&mut self, now_s: f64) {
        self.until_s = self.until_s.filter(|until_s| *until_s > now_s + 1e-9);
    }

    /// Returns the time at which the wait of the run ends. The value stays set until [`AtRest::on_time`] ends the wait,
    /// so the run also continues if the turn comes later than that time.
    pub fn until_s(&self) -> Option<f64> {
        self.until_s
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn jog(refresh_id: &str) -> ActiveRunKind {
        let machine = tandem_config::Config::demo().resolve().unwrap();
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
        // a turn that began before this time must still find the wait, so that it wakes at its end
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
