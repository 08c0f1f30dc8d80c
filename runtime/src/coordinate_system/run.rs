//! A run's programs and counters; its state is in `run_state`.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use plc_api::types::state::RunKind;
use tandem_interp::not_there;
use tandem_model::alarm::{PROGRAM_NOT_FOUND, PROGRAM_REFUSED};
use tandem_model::settings::CoordinateSystemSettings;
use tandem_model::{Alarm, AxisVector};
use tandem_syntax::NcProgram;

use super::line_search::LineArrival;
use crate::clock::Clock;
use crate::program_store::StoredProgram;

/// A run of the loaded program, of manual data input, or of a motion by hand.
pub(super) struct Run {
    pub id: String,
    pub kind: Kind,
    /// What it begins with; number 0: without one.
    pub main: Arc<StoredProgram>,
    pub programs: BTreeMap<u16, Arc<NcProgram>>,
    /// Programs that it may not call, and why.
    pub refused: BTreeMap<u16, String>,
    /// The number of its first segment.
    pub first_segment: u64,
    pub steps: Steps,
    pub at_rest: AtRest,
    /// It begins at a line, and has not come there yet.
    pub arrival: Option<Box<LineArrival>>,
}

impl Run {
    /// The alarm of a call: of one that the program computes, nobody could say before that it may not be made.
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

/// What is remembered of runs.
#[derive(Debug, Default)]
pub(super) struct PastRuns {
    /// Runs that were started.
    pub count: u64,
    /// The one started last.
    pub last_id: Option<String>,
    /// The next manual data input continues in the modal state of the last one.
    pub manual_goes_on: bool,
    pub jogs: Jogs,
}

/// Jogs that have ended and whose late refreshes are refused.
const ENDED_JOGS_MAX: usize = 16;

/// Jogs that have ended, the oldest first.
#[derive(Debug, Default)]
pub(super) struct Jogs(VecDeque<String>);

impl Jogs {
    /// A jog that has ended is not begun again by a refresh that comes late.
    pub fn remember(&mut self, ended: &Kind) {
        if let Kind::Jog(jog) = ended {
            self.end(&jog.refresh_id);
        }
    }

    /// From now on the jog of this name has ended, whether it has begun or not.
    pub fn end(&mut self, refresh_id: &str) {
        if self.has_ended(refresh_id) {
            return;
        }
        self.0.push_back(refresh_id.to_owned());
        if self.0.len() > ENDED_JOGS_MAX {
            self.0.pop_front();
        }
    }

    pub fn has_ended(&self, refresh_id: &str) -> bool {
        self.0.iter().any(|ended| ended == refresh_id)
    }
}

/// What a run runs.
#[derive(Debug)]
pub(super) enum Kind {
    /// The loaded program.
    Program,
    /// Manual data input.
    Manual,
    Home,
    Jog(Jog),
}

impl Kind {
    /// As the state says it.
    pub fn run_kind(&self) -> RunKind {
        match self {
            Kind::Program => RunKind::Program,
            Kind::Manual => RunKind::Mdi,
            Kind::Home => RunKind::Home,
            Kind::Jog(_) => RunKind::Jog,
        }
    }
}

/// A jog that runs.
#[derive(Debug)]
pub(super) struct Jog {
    pub refresh_id: String,
    /// When it stops, unless it is refreshed.
    pub until_s: f64,
    pub to: AxisVector,
    /// With the jog's velocity as rapid velocity.
    pub settings: Arc<CoordinateSystemSettings>,
}

/// Single block of one run.
#[derive(Debug, Default)]
pub(super) struct Steps {
    /// Items of a block have been taken, and the block has not ended.
    pub in_block: bool,
    /// Segments up to this one were planned before single block was switched on.
    pub planned_ahead: u64,
    /// The servo has been told to hold behind the running block, and does not hold yet.
    pub armed: bool,
}

/// Items interpreted within one servo period that give the servo no motion. Reason: computing takes no simulated time, and a
/// loop that moves nothing would let none go by.
const ITEMS_AT_REST_MAX: u32 = 100;

/// What has been interpreted since the servo was last given motion.
#[derive(Debug, Default)]
pub(super) struct AtRest {
    last_segment: u64,
    items: u32,
    /// When the first of them was interpreted, seconds since the start.
    since_s: f64,
    /// The run waits until then, seconds since the start.
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

    /// The run waits no longer once its time has come.
    pub fn on_time(&mut self, now_s: f64) {
        self.until_s = self.until_s.filter(|until_s| *until_s > now_s + 1e-9);
    }

    /// When the run continues, until [`AtRest::on_time`] finds that it has come: who waits by it also wakes by it, however
    /// late the clock is by then.
    pub fn until_s(&self) -> Option<f64> {
        self.until_s
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn jog(refresh_id: &str) -> Kind {
        let machine = crate::Config::demo().resolve().unwrap();
        Kind::Jog(Jog {
            refresh_id: refresh_id.to_owned(),
            until_s: 0.2,
            to: AxisVector::ZERO,
            settings: Arc::new(machine.coordinate_systems[0].settings.clone()),
        })
    }

    #[test]
    fn a_jog_that_has_ended_is_known_until_as_many_others_have_ended_as_are_kept() {
        let numbered = |count: usize| (1..=count).map(|n| n.to_string()).collect::<Vec<_>>();
        for (ended, asked, is_known) in [
            (0, "1", false),
            (1, "1", true),
            (1, "2", false),
            (2, "1", true),
            (ENDED_JOGS_MAX, "1", true),
            (ENDED_JOGS_MAX + 1, "1", false),
            (ENDED_JOGS_MAX + 1, "2", true),
            (ENDED_JOGS_MAX + 1, "17", true),
        ] {
            let mut jogs = Jogs::default();
            for refresh_id in numbered(ended) {
                jogs.remember(&jog(&refresh_id));
            }
            assert_eq!(jogs.has_ended(asked), is_known, "{asked} of {ended}");
        }
    }

    #[test]
    fn a_run_that_waits_at_rest_has_a_time_to_wake_until_a_turn_has_seen_it_pass() {
        let (clock, mut at_rest) = (Clock::simulated(), AtRest::default());
        for _ in 0..ITEMS_AT_REST_MAX {
            assert_eq!(at_rest.until_s(), None);
            at_rest.count(0, &clock, 0.001);
        }
        assert_eq!(at_rest.until_s(), Some(0.001));
        clock.set_ns(2_000_000);
        // a turn that began before goes on: what waits in it must still be woken
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
            (Kind::Program, false),
            (Kind::Manual, false),
            (Kind::Home, false),
            (jog(""), true),
        ] {
            let mut jogs = Jogs::default();
            jogs.remember(&ended);
            assert_eq!(jogs.has_ended(""), is_known, "{ended:?}");
        }
    }
}
