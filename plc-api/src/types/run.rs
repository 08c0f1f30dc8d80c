//! A run: what was ordered, its progress, how it ended, and where its time went.

use serde::{Deserialize, Serialize};

use super::explained::explained;
use super::planned::{PlanIdentity, PlannedPlace};
use super::{CoordinateSystemNumber, Timestamp};

/// Most parts of one run.
pub const PARTS_MAX: u32 = 1_000_000;

/// Runs that are kept, over all starts of the runtime; the oldest are forgotten.
pub const RUNS_KEPT: usize = 10_000;

/// Runs of one answer at the most.
pub const RUNS_AT_ONCE_MAX: u32 = 1000;

/// Longest wait for the end of a run in one request, s.
pub const RUN_WAIT_MAX_S: u32 = 60;

/// Body of `POST /cs/{n}/runs`, and arguments of `command/run`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct RunOrder {
    /// The program, which is loaded for it; null: the one that is loaded.
    #[serde(default)]
    #[cfg_attr(feature = "schema", schemars(range(min = 1, max = 9999)))]
    pub program: Option<u16>,
    /// How many times it is run, one part each.
    #[serde(default = "one")]
    #[cfg_attr(feature = "schema", schemars(default = "one", range(min = 1, max = PARTS_MAX)))]
    pub parts: u32,
}

fn one() -> u32 {
    1
}

impl RunOrder {
    /// One part of a program.
    pub fn program(number: u16) -> Self {
        Self {
            program: Some(number),
            parts: 1,
        }
    }
}

/// A run of the loaded program: of `cs/{n}/run`, `GET /runs/{id}` and `GET /runs`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Run {
    /// Names the run, over all starts of the runtime: the `run_id` of `state`, of outputs and of the journal.
    pub id: String,
    /// Its coordinate system.
    pub cs: CoordinateSystemNumber,
    /// Main program number.
    pub program: u16,
    /// The program's hash.
    #[serde(default)]
    pub hash: Option<String>,
    /// The line that it began at, unless at the head.
    #[serde(default)]
    pub from_line: Option<u32>,
    /// Parts that were ordered.
    pub parts: u32,
    /// Parts that were completed.
    pub parts_done: u32,
    /// When it began.
    pub began: Timestamp,
    /// How it ended; null: it has not.
    #[serde(default)]
    pub end: Option<RunEnded>,
    /// How long it has taken, from its begin to the end of its last part, s.
    pub took_s: f64,
    /// How long the last completed part took, s.
    #[serde(default)]
    pub last_part_s: Option<f64>,
    /// M codes for which the program waited, the longest first, at most 20.
    pub waits: Vec<RunWait>,
    /// Alarms of its coordinate system while it ran, at most 10.
    pub alarms: Vec<RunAlarm>,
    /// Why the next part does not begin yet, such as the text of the start lock.
    #[serde(default)]
    pub waits_for: Option<String>,
}

/// Payload of `cs/{n}/run`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct RunState {
    /// The run that goes on, or the last one that ended; null: there was none.
    pub run: Option<Run>,
}

/// Payload of `cs/{n}/time_left`: of the run of a program that is under way.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct TimeLeft {
    /// The run; null: no program runs.
    #[serde(default)]
    pub run_id: Option<String>,
    /// The plan of that run, by which the time was computed; null: it is not planned yet.
    #[serde(default)]
    pub plan: Option<PlanIdentity>,
    /// Time to the end with the overrides of now, s, without holds and without waits that lie ahead and are not known; null: no
    /// program runs, it is not planned yet, or the time cannot be known, since an override of 0 stops what is left, or the
    /// program waits without a known end.
    pub left_s: Option<f64>,
    /// Share of the planned time that is done, 0 to 1; null: no program runs, or it is not planned yet.
    pub progress: Option<f64>,
}

/// How a run has ended.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct RunEnded {
    /// When.
    pub at: Timestamp,
    /// How.
    pub how: RunEndedHow,
    /// What there is to say of it, such as why the next part was refused; else empty.
    pub text: String,
    /// The block whose motion ran when it was cut short; null where it was completed, or nothing had run.
    #[serde(default)]
    pub place: Option<PlannedPlace>,
}

explained! {
    "end of a run"
    /// How a run has ended.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
    #[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
    #[non_exhaustive]
    pub enum RunEndedHow {
        /// All its parts are completed.
        Completed = "completed",
            "Nothing to do.";
        /// The stop command.
        Stopped = "stopped",
            "Reset, then start or order a run anew.";
        /// The abort command.
        Aborted = "aborted",
            "Reset, then start or order a run anew.";
        /// The reset command.
        Reset = "reset",
            "Start or order a run anew.";
        /// An alarm.
        Alarm = "alarm",
            "The run's `alarms` say which; mend the cause, reset, then start or order a run anew.";
        /// Before its next part: the lease under which it was ordered has ended or is another's.
        LeaseLost = "lease_lost",
            "Take the control lease, and order the parts that are missing.";
        /// Before its next part: another command took its place, such as a load, a start or MDI.
        Replaced = "replaced",
            "Order the parts that are missing.";
        /// Before its next part: its start was refused; the text says why.
        Refused = "refused",
            "Mend what the text names, and order the parts that are missing.";
        /// The runtime ended while it ran.
        Restarted = "restarted",
            "Look at the machine; `last_run` says where it was. Order the parts that are missing.";
    }
}

/// The waits of a run for one M code.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct RunWait {
    /// M number.
    pub m: u16,
    /// How often.
    pub count: u64,
    /// For how long in all, s.
    pub total_s: f64,
    /// The longest, s.
    pub longest_s: f64,
}

/// An alarm of a run.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct RunAlarm {
    /// Its number.
    pub number: u16,
    /// What happened.
    pub text: String,
    /// Line of the program, where it has one.
    #[serde(default)]
    pub line: Option<u32>,
}

/// Which runs are asked for: of `GET /runs`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct RunQuery {
    /// Of this coordinate system.
    pub cs: Option<CoordinateSystemNumber>,
    /// How many of the newest are left out.
    pub from: u32,
    /// How many, 1 to 1000.
    pub count: u32,
}

/// Runs that have ended, the newest first, and what was produced: of `GET /runs`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "schema", schemars(rename = "RunList"))]
pub struct Runs {
    /// Runs.
    pub runs: Vec<Run>,
    /// Counters of each program, of the coordinate systems asked for, ascending. They count on over all starts of the runtime.
    pub production: Vec<Production>,
}

/// What one program has produced in one coordinate system.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Production {
    /// The coordinate system.
    pub cs: CoordinateSystemNumber,
    /// Main program number.
    pub program: u16,
    /// Parts completed.
    pub parts: u64,
    /// Runs that ended before all their parts were completed.
    pub cut_short: u64,
    /// Time of the completed parts in all, s.
    pub parts_s: f64,
    /// When the last part was completed.
    #[serde(default)]
    pub last: Option<Timestamp>,
}
