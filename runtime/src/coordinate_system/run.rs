//! What a run has beside its state: what it runs, and what it counts.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use tandem_model::AxisVector;
use tandem_model::settings::CoordinateSystemSettings;
use tandem_syntax::NcProgram;

use crate::clock::Clock;
use crate::program_store::StoredProgram;

/// A run of the loaded program, of manual data input, or of a motion by hand.
pub(super) struct Run {
    pub id: String,
    pub kind: Kind,
    /// What it begins with; number 0: without one.
    pub main: Arc<StoredProgram>,
    pub programs: BTreeMap<u16, Arc<NcProgram>>,
    pub steps: Steps,
    pub at_rest: AtRest,
}

/// What is remembered of runs.
#[derive(Debug, Default)]
pub(super) struct PastRuns {
    /// Runs that were started.
    pub count: u64,
    /// The one started last.
    pub last_id: Option<String>,
    /// The next manual data input goes on in the modal state of the last one.
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
    pub fn remember(&mut self, run: &Run) {
        if let Kind::Jog(jog) = &run.kind {
            self.0.push_back(jog.refresh_id.clone());
            if self.0.len() > ENDED_JOGS_MAX {
                self.0.pop_front();
            }
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
    /// The servo is told to hold behind the running block, and has not said that it does.
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
    until_s: f64,
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
            self.until_s = self.since_s + period_s;
        }
    }

    /// When the run goes on, if that is still to come.
    pub fn until_s(&self, clock: &Clock) -> Option<f64> {
        let is_to_come = self.until_s > 0.0 && self.until_s > clock.now_s() + 1e-9;
        is_to_come.then_some(self.until_s)
    }
}
