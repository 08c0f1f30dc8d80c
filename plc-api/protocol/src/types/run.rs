//! A run: its order, its progress, its end, and the distribution of its time.

use serde::{Deserialize, Serialize};

use super::explained::explained;
use super::planned::{PlanIdentity, PlannedLocation};
use super::{CoordinateSystemNumber, Timestamp};

/// Largest number of parts of one run.
pub const PARTS_MAX: u32 = 1_000_000;

/// Largest number of stored runs of all boots together; the runtime removes the oldest runs.
pub const RUNS_KEPT: usize = 10_000;

/// Largest number of runs of one answer.
pub const RUNS_AT_ONCE_MAX: u32 = 1000;

/// Longest wait for the end of a run in one request, s.
pub const RUN_WAIT_MAX_S: u32 = 60;

/// Body of `POST /cs/{n}/runs`, and arguments of `command/run`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct RunOrder {
    /// The program to load and run; null for the loaded program.
    #[serde(default)]
    #[cfg_attr(feature = "schema", schemars(range(min = 1, max = 9999)))]
    pub program: Option<u16>,
    /// Number of parts: the program is run once for each part.
    #[serde(default = "one")]
    #[cfg_attr(feature = "schema", schemars(default = "one", range(min = 1, max = PARTS_MAX)))]
    pub parts: u32,
}

fn one() -> u32 {
    1
}

impl RunOrder {
    /// Creates an order for one part: the program with this number is run once.
    pub fn program(number: u16) -> Self {
        Self {
            program: Some(number),
            parts: 1,
        }
    }
}

/// A run of the loaded program, as in `cs/{n}/run`, `GET /runs/{id}` and `GET /runs`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Run {
    /// Id of the run, unique over all starts of the runtime: the `run_id` of `state`, of outputs and of the
    /// journal.
    pub id: String,
    /// Coordinate system of the run.
    pub cs: CoordinateSystemNumber,
    /// Main program number.
    pub program: u16,
    /// Hash of the program.
    #[serde(default)]
    pub hash: Option<String>,
    /// The line at which the run started; null if it started at the beginning.
    #[serde(default)]
    pub from_line: Option<u32>,
    /// Number of ordered parts.
    pub parts: u32,
    /// Number of completed parts.
    pub parts_done: u32,
    /// Time at which the run started.
    pub began: Timestamp,
    /// End of the run; null if the run has not ended.
    #[serde(default)]
    pub end: Option<RunEnded>,
    /// Duration from the start of the run to the end of its last part, s.
    pub took_s: f64,
    /// Duration of the last completed part, s.
    #[serde(default)]
    pub last_part_s: Option<f64>,
    /// M codes for which the program waited, longest wait first, at most 20.
    pub waits: Vec<RunWait>,
    /// Alarms of the coordinate system during the run, at most 10.
    pub alarms: Vec<RunAlarm>,
    /// Reason why the next part has not started yet, such as the text of the start lock.
    #[serde(default)]
    pub waits_for: Option<String>,
}

/// Payload of `cs/{n}/run`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct RunState {
    /// The run in progress, otherwise the last run that ended; null if no run has started.
    pub run: Option<Run>,
}

/// Payload of `cs/{n}/time_left`: remaining time of the program run in progress.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct TimeLeft {
    /// Id of the run; null if no program runs.
    #[serde(default)]
    pub run_id: Option<String>,
    /// The plan of the run from which the time was computed; null if the run is not planned yet.
    #[serde(default)]
    pub plan: Option<PlanIdentity>,
    /// Time to the end, s, with the current overrides, without holds and without future waits of unknown
    /// duration. Null if no program runs, the run is not planned yet, or the time is unknown because an
    /// override of 0 stops the motion or the program waits without a known end.
    pub left_s: Option<f64>,
    /// Completed share of the planned time, 0 to 1; null if no program runs, or the run is not planned yet.
    pub progress: Option<f64>,
}

/// End of a run.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct RunEnded {
    /// Time of the end.
    pub at: Timestamp,
    /// Kind of the end.
    pub how: RunEndedHow,
    /// Explanation, such as the reason why the next part was refused; otherwise empty.
    pub text: String,
    /// The block whose motion ran at an early end; null if the run was completed, or no block had run.
    #[serde(default)]
    pub place: Option<PlannedLocation>,
}

explained! {
    "end of a run"
    /// Kind of the end of a run.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
    #[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
    #[non_exhaustive]
    pub enum RunEndedHow {
        /// All parts of the run are completed.
        Completed = "completed",
            "Nothing to do.";
        /// The stop command.
        Stopped = "stopped",
            "Reset, then start again, or order a new run.";
        /// The abort command.
        Aborted = "aborted",
            "Reset, then start again, or order a new run.";
        /// The reset command.
        Reset = "reset",
            "Start again, or order a new run.";
        /// An alarm.
        Alarm = "alarm",
            "`alarms` of the run lists the alarms; remove the cause, reset, then start again or order a new run.";
        /// Before the next part: the lease under which the run was ordered has ended or belongs to another
        /// holder.
        LeaseLost = "lease_lost",
            "Take the control lease, and order the missing parts.";
        /// Before the next part: another command replaced the run, such as a load, a start or MDI.
        Replaced = "replaced",
            "Order the missing parts.";
        /// Before the next part: the start of the part was refused; the text gives the reason.
        Refused = "refused",
            "Remove the cause that the text names, and order the missing parts.";
        /// The runtime ended during the run.
        Restarted = "restarted",
            "Check the machine; `last_run` contains the state at the end. Order the missing parts.";
    }
}

/// The waits of a run for one M code.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct RunWait {
    /// M number.
    pub m: u16,
    /// Number of waits.
    pub count: u64,
    /// Total duration, s.
    pub total_s: f64,
    /// Longest wait, s.
    pub longest_s: f64,
}

/// An alarm of a run.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct RunAlarm {
    /// Number of the alarm.
    pub number: u16,
    /// Text of the alarm.
    pub text: String,
    /// Line of the program, if the alarm has one.
    #[serde(default)]
    pub line: Option<u32>,
}

/// Filter for runs: query of `GET /runs`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct RunQuery {
    /// The coordinate system; `None` for all.
    pub cs: Option<CoordinateSystemNumber>,
    /// Number of newest runs to skip.
    pub from: u32,
    /// Number of runs, 1 to 1000.
    pub count: u32,
}

/// Response of `GET /runs`: runs that have ended, newest first, and production counters.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "schema", schemars(rename = "RunList"))]
pub struct Runs {
    /// Runs that have ended, newest first.
    pub runs: Vec<Run>,
    /// Counters of each program in the requested coordinate systems, ascending. They continue over all starts
    /// of the runtime.
    pub production: Vec<Production>,
}

/// Production of one program in one coordinate system.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Production {
    /// The coordinate system.
    pub cs: CoordinateSystemNumber,
    /// Main program number.
    pub program: u16,
    /// Number of completed parts.
    pub parts: u64,
    /// Number of runs that ended before all their parts were completed.
    pub cut_short: u64,
    /// Total time of the completed parts, s.
    pub parts_s: f64,
    /// Time when the last part was completed.
    #[serde(default)]
    pub last: Option<Timestamp>,
}
