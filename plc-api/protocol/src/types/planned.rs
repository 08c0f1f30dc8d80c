//! A program before it runs: its planned path and its rehearsal.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::CoordinateSystemNumber;

/// Default and smallest value of `tolerance`, the largest distance between the path and the lines of the
/// answer, mm.
pub const PATH_TOLERANCE_MM: f64 = 0.01;

/// Length of the header of a path, bytes. Its format does not depend on the rest of the path.
pub const PATH_HEADER_BYTES: usize = 128;

/// Requested part of the planned path of a program, and its accuracy.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PathQuery {
    /// The coordinate system that runs the program; `None` for the first coordinate system in which the
    /// program is loaded, otherwise the first of all.
    pub cs: Option<CoordinateSystemNumber>,
    /// Largest distance between a point of the path and the lines of the answer, mm; `None` for the accuracy
    /// with which the path is stored.
    pub tolerance: Option<f64>,
    /// Number of the first chunk of lines in the answer.
    pub from: u32,
    /// Number of chunks; `None` for all.
    pub count: Option<u32>,
}

/// A text of NC blocks for manual data input.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct ManualText {
    /// One or several lines.
    pub text: String,
}

/// Identity of a plan: all inputs from which the plan is computed. Two plans with the same identity are
/// equal.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct PlanIdentity {
    /// Hash of the main program.
    pub hash: String,
    /// SHA-256 of the lines `number hash` of every program that the main program may call, ascending; null if
    /// it calls no program.
    pub called: Option<String>,
    /// Revision of all other inputs: start position, line of the start, work offsets, tools, block skips,
    /// optional stop, dry run, and the values of the P and Q variables that the program reads.
    pub inputs: String,
}

/// A planned path as bytes; the book describes their format on the page about the planned path.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct PlannedPath {
    /// Identifies the plan, its progress, and its run: the `ETag`.
    pub tag: String,
    /// The run in progress to which the plan belongs; `None` if the plan is of a start that has not happened.
    pub run_id: Option<String>,
    /// Inputs of the plan.
    pub plan: PlanIdentity,
    /// Bytes of the path, with their header.
    pub bytes: Vec<u8>,
}

/// The run and the plan to which the bytes of a path belong, as JSON in the header.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct PathIdentity {
    /// The run in progress to which the plan belongs; null if the plan is of a start that has not happened.
    pub run_id: Option<String>,
    /// Inputs of the plan.
    #[serde(flatten)]
    pub plan: PlanIdentity,
}

impl PathIdentity {
    /// Reads the header of a path; returns `None` if the bytes have no valid header.
    pub fn of_bytes(bytes: &[u8]) -> Option<Self> {
        let u16_at = |at: usize| {
            let pair = bytes.get(at..at + 2)?;
            Some(usize::from(u16::from_le_bytes(pair.try_into().ok()?)))
        };
        let begin = (PATH_HEADER_BYTES + 2 * u16_at(124)? + u16_at(126)?).next_multiple_of(4);
        if bytes.get(..4)? != b"TPTH" || begin + 4 > u16_at(6)? {
            return None;
        }
        let length = u32::from_le_bytes(bytes.get(begin..begin + 4)?.try_into().ok()?);
        let text = bytes.get(begin + 4..(begin + 4).checked_add(usize::try_from(length).ok()?)?)?;
        serde_json::from_slice(text).ok()
    }
}

impl PlannedPath {
    /// Creates the path of these bytes, with the identity that their header contains.
    pub fn new(tag: String, bytes: Vec<u8>) -> Self {
        let PathIdentity { run_id, plan } = PathIdentity::of_bytes(&bytes).unwrap_or_default();
        Self {
            tag,
            run_id,
            plan,
            bytes,
        }
    }
}

/// Predicted run of a program. If a run of the program is in progress, it is planned with the conditions at
/// the start of that run, otherwise with the current conditions. Times apply to overrides of 100 percent.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Rehearsal {
    /// Program number.
    pub program: u16,
    /// The coordinate system that runs the program.
    pub cs: CoordinateSystemNumber,
    /// Hash of the program.
    pub hash: String,
    /// The run in progress to which the plan belongs; null if no run of the program is in progress.
    #[serde(default)]
    pub run_id: Option<String>,
    /// Inputs of the plan.
    #[serde(default)]
    pub plan: PlanIdentity,
    /// Identifies the plan and its progress, as the `ETag` of the path.
    pub revision: String,
    /// State of the planning.
    pub outcome: RehearsalOutcome,
    /// The alarm that ends the run, or the reason why planning ended early; empty if `outcome` is `planning`
    /// or `completed`.
    pub text: String,
    /// Program and line of the alarm or the early end; null without such an event.
    pub at: Option<PlannedLocation>,
    /// Time from start to end, including waits, s.
    pub cycle_time_s: f64,
    /// Part of the cycle time at feedrate, s.
    pub feed_s: f64,
    /// Part of the cycle time in G00, s.
    pub rapid_s: f64,
    /// Part of the cycle time for dwells, threads and the time that motors need to come into position, s.
    pub fixed_s: f64,
    /// Part of the cycle time for waits for M codes, as far as their durations are known from runs since the
    /// start of the runtime, s.
    pub wait_s: f64,
    /// First block whose path depends on events while the program runs; null if the path depends on no such
    /// event.
    pub depends: Option<RunTimeDependence>,
    /// M codes in the order in which the program issues them, at most 1000.
    pub m_codes: Vec<RehearsedMCode>,
    /// Number of all M codes that the program issues.
    pub m_code_count: u64,
    /// Lowest and highest machine position of each axis, by letter.
    pub axes: BTreeMap<String, RehearsedAxis>,
    /// The corners from which the path is farthest, at most 100, the largest distance first. Corners that the path
    /// misses by less than 0.001 mm are left out.
    #[serde(default)]
    pub corners: Vec<RehearsedCorner>,
    /// Start times of blocks, ascending: of at most 2048 blocks, evenly selected if the program has more. The
    /// path contains the time of every line.
    pub lines: Vec<RehearsedLine>,
    /// Progress of this program's run; null if no run is in progress or planning continues.
    pub run: Option<RehearsedRun>,
}

/// State of the planning.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum RehearsalOutcome {
    /// Planning continues; the answer contains the results so far.
    #[default]
    Planning,
    /// The program reaches its end.
    Completed,
    /// An alarm ends the run before its end.
    Alarm,
    /// The program is longer than the part that is planned ahead.
    TooLong,
}

/// A block of a program.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct PlannedLocation {
    /// Program number, main or subprogram.
    pub program: u16,
    /// Line, from 1.
    pub line: u32,
}

/// First block whose path depends on events while the program runs.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct RunTimeDependence {
    /// Program number.
    pub program: u16,
    /// Line of the first block that depends on an event.
    pub line: u32,
    /// Time when that block begins, s.
    pub at_s: f64,
    /// The cause of the dependence.
    pub why: String,
}

/// An M code of a planned run.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct RehearsedMCode {
    /// M number.
    pub m: u16,
    /// Program number.
    pub program: u16,
    /// Line of the M code.
    pub line: u32,
    /// Time at which the M code is issued, s from the start of the run.
    pub at_s: f64,
    /// Whether the program waits for the reset of the M code.
    pub waits: bool,
    /// Duration of the wait in earlier runs, s; null if it is unknown.
    pub wait_s: Option<f64>,
}

/// An axis of a planned run.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct RehearsedAxis {
    /// CNC motor number.
    pub motor: u16,
    /// Lowest machine position, mm or degrees.
    pub lowest: f64,
    /// Highest machine position, mm or degrees.
    pub highest: f64,
    /// Lowest and highest allowed machine position, mm or degrees; null if the axis has no soft limits.
    pub soft_limits: Option<[f64; 2]>,
    /// Highest speed, mm/s or degrees/s, and the block that causes it.
    pub velocity: RehearsedPeak,
    /// Highest acceleration, mm/s² or degrees/s², and the block that causes it.
    pub acceleration: RehearsedPeak,
}

/// A highest value, its limit, and the block that causes it.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct RehearsedPeak {
    /// The highest value.
    pub value: f64,
    /// The motor's limit.
    pub limit: f64,
    /// Program number.
    pub program: u16,
    /// Line of the block with the highest value, from 1.
    pub line: u32,
}

/// A programmed corner that the path misses, because the next block begins without a stop.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct RehearsedCorner {
    /// Distance of the path from the corner, mm.
    pub distance_mm: f64,
    /// Program number.
    pub program: u16,
    /// Line of the block that ends at the corner, from 1.
    pub line: u32,
}

/// Start time of a block.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct RehearsedLine {
    /// Program number.
    pub program: u16,
    /// Line of the block, from 1.
    pub line: u32,
    /// Start time of the block, s from the start of the run.
    pub at_s: f64,
}

/// Progress of a run.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct RehearsedRun {
    /// Time in the plan of the block that runs now, s from the start of the run.
    pub at_s: f64,
    /// Time to the end, s, with the current overrides, without holds and without future waits of unknown
    /// duration. Null if the time is unknown because an override of 0 stops the motion, or because the
    /// program waits without a known end.
    pub left_s: Option<f64>,
    /// Completed share of the planned time, 0 to 1.
    pub progress: f64,
}
