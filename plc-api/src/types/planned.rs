//! A program before it runs: its planned path and its rehearsal.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::CoordinateSystemNumber;

/// Largest distance between the path and what is answered where none is named, mm; a finer one is not answered.
pub const PATH_TOLERANCE_MM: f64 = 0.01;

/// Bytes at the beginning of a path whose meaning does not depend on its contents.
pub const PATH_HEADER_BYTES: usize = 128;

/// Which part of the planned path of a program is asked for, and how exactly.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PathQuery {
    /// The coordinate system that runs it; `None`: the first one in which it is loaded, or the first one of all.
    pub cs: Option<CoordinateSystemNumber>,
    /// How far a point of the path may be from the lines, mm; `None`: as exactly as it is kept.
    pub tolerance: Option<f64>,
    /// First chunk whose lines are answered.
    pub from: u32,
    /// How many chunks; `None`: all.
    pub count: Option<u32>,
}

/// A text of NC blocks, as manual data input would run it.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct ManualText {
    /// One or several lines.
    pub text: String,
}

/// What a plan was made with. Two plans with the same identity are the same.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct PlanIdentity {
    /// Hash of the main program.
    pub hash: String,
    /// SHA-256 of the lines `number hash` of every program that it may call, ascending; null: it calls none.
    pub called: Option<String>,
    /// Revision of all other inputs: start position, line of the start, work offsets, tools, block skips, optional stop, dry
    /// run, and the values of the P and Q variables that the program reads.
    pub inputs: String,
}

/// A planned path as bytes, which the page on the planned path describes.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct PlannedPath {
    /// What it was made with, how far it has come, and the run that it is of: the `ETag`.
    pub tag: String,
    /// The run under way that it is the plan of; `None`: a start would run so.
    pub run_id: Option<String>,
    /// What it was made with.
    pub plan: PlanIdentity,
    /// The bytes.
    pub bytes: Vec<u8>,
}

/// The run and the plan that the bytes of a path are of, as their header has them in JSON.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct PathIdentity {
    /// The run under way that it is the plan of; null: a start would run so.
    pub run_id: Option<String>,
    /// What it was made with.
    #[serde(flatten)]
    pub plan: PlanIdentity,
}

impl PathIdentity {
    /// Reads the header of a path; `None`: it has none, or is no path.
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
    /// The path of these bytes, with the identity that their header has.
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

/// What a run of a program does: planned with the conditions with which the run under way began, else with those of now. Times
/// are those at 100 percent overrides.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Rehearsal {
    /// Program number.
    pub program: u16,
    /// The coordinate system that runs it.
    pub cs: CoordinateSystemNumber,
    /// Which program that is, by its hash.
    pub hash: String,
    /// The run under way that it is the plan of; null: no run of the program is under way.
    #[serde(default)]
    pub run_id: Option<String>,
    /// What it was made with.
    #[serde(default)]
    pub plan: PlanIdentity,
    /// What it was made with, and how far it has come: as the `ETag` of the path.
    pub revision: String,
    /// How far planning is.
    pub outcome: RehearsalOutcome,
    /// The alarm that ends the run, or why no more is planned; empty with `planning` and `completed`.
    pub text: String,
    /// Where that is: program and line; null without.
    pub at: Option<PlannedPlace>,
    /// From start to end, waits included, s.
    pub cycle_time_s: f64,
    /// Of that, at feedrate, s.
    pub feed_s: f64,
    /// Of that, G00, s.
    pub rapid_s: f64,
    /// Of that, dwells, threads and what motors need to come into position, s.
    pub fixed_s: f64,
    /// Of that, waiting for M codes, as far as runs since the start of the runtime have shown how long they take, s.
    pub wait_s: f64,
    /// From where on the path depends on what happens while the program runs; null: it does not.
    pub depends: Option<RunTimeDependence>,
    /// The M codes in their order, at most 1000.
    pub m_codes: Vec<RehearsedMCode>,
    /// How many M codes there are.
    pub m_code_count: u64,
    /// Lowest and highest machine position of each axis, by letter.
    pub axes: BTreeMap<String, RehearsedAxis>,
    /// When blocks begin, ascending; of many blocks some, evenly spread. The path tells the time of every line.
    pub lines: Vec<RehearsedLine>,
    /// How far the run of this program is that is under way; null: there is none, or planning goes on.
    pub run: Option<RehearsedRun>,
}

/// How far planning is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum RehearsalOutcome {
    /// It goes on; what is known so far is here.
    #[default]
    Planning,
    /// The program comes to its end.
    Completed,
    /// An alarm ends the run before its end.
    Alarm,
    /// It is longer than what is planned ahead.
    TooLong,
}

/// A block of a program.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct PlannedPlace {
    /// Program number, main or subprogram.
    pub program: u16,
    /// From 1.
    pub line: u32,
}

/// From where on a path depends on what happens while the program runs.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct RunTimeDependence {
    /// Program number.
    pub program: u16,
    /// Line of the first block that does.
    pub line: u32,
    /// When it begins, s.
    pub at_s: f64,
    /// On what.
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
    /// Its line.
    pub line: u32,
    /// When it is put out, s.
    pub at_s: f64,
    /// True: the program waits for its reset.
    pub waits: bool,
    /// How long the program waits for it, as earlier runs have shown, s; null: nobody knows yet.
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
    /// Highest machine position.
    pub highest: f64,
    /// Soft limits; null: none.
    pub soft_limits: Option<[f64; 2]>,
    /// Highest speed, per second, and where.
    pub velocity: RehearsedPeak,
    /// Highest acceleration, per second squared, and where.
    pub acceleration: RehearsedPeak,
}

/// The most of something, its limit, and the block that causes it.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct RehearsedPeak {
    /// The most.
    pub value: f64,
    /// The motor's limit.
    pub limit: f64,
    /// Program number.
    pub program: u16,
    /// Line.
    pub line: u32,
}

/// When a block begins.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct RehearsedLine {
    /// Program number.
    pub program: u16,
    /// Line.
    pub line: u32,
    /// When, s.
    pub at_s: f64,
}

/// How far a run is.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct RehearsedRun {
    /// The planned time of what runs now, s.
    pub at_s: f64,
    /// Time to the end with the overrides of now, s, without holds and without waits that lie ahead and are not known; null:
    /// it cannot be known, since an override of 0 stops what is left, or the program waits without a known end.
    pub left_s: Option<f64>,
    /// Share of the planned time that is done, 0 to 1.
    pub progress: f64,
}
