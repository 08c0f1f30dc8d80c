//! The record of a run, for the assertions of a test.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use plc_api::{Alarm, CancelReason, Execution, Params};
use plc_protocol::types::CoordinateSystemNumber;
use plc_protocol::types::machine::{AlarmRecord, AlarmSeverity};
use plc_protocol::types::state::{CapturedPositions, Reason};

use tandem_store::journal::{Journal, Line};

use super::TestError;
use super::trace::{Sample, Samples};

/// Results of a run, as plain data that is equal for equal tests. Times are seconds from the start of the
/// programs.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Run {
    /// Reason why the run ended.
    pub stopped: RunEndReason,
    /// Time when the run ended.
    pub time_s: f64,
    /// Auxiliary function outputs in the order in which they were issued.
    pub outputs: Vec<OutputRecord>,
    /// Alarms and warnings in the order in which they were raised.
    pub alarms: Vec<AlarmRecord>,
    /// Captured positions of each G31, in the order of the captures.
    pub captured: Vec<CapturedPositions>,
    /// State changes of each coordinate system, from the start of the run.
    pub states: Vec<StateChange>,
    /// Coordinate systems that the test has started.
    pub(super) jobs: Vec<CoordinateSystemNumber>,
    pub(super) systems: BTreeMap<CoordinateSystemNumber, SystemEnd>,
    pub(super) order: Vec<(CoordinateSystemNumber, String)>,
    pub(super) samples: Samples,
    pub(super) p: NonZero,
    pub(super) q: BTreeMap<CoordinateSystemNumber, NonZero>,
}

/// Variables that are not zero, by number. The values are stored as bits, because NaN must be equal to itself
/// here.
pub(super) type NonZero = BTreeMap<u32, u64>;

/// Reason why a run ended.
#[derive(Debug, Clone, Default, PartialEq)]
pub enum RunEndReason {
    /// Every program has ended: at its end, by an alarm or by a command.
    #[default]
    ProgramsEnded,
    /// No further event could occur: a program was paused, or waited for an event that does not occur.
    NothingMoves,
    /// The run reached the time of [`Bench::max_time_s`](super::Bench::max_time_s).
    TimeLimit,
}

/// One auxiliary function output.
#[derive(Debug, Clone, PartialEq)]
pub struct OutputRecord {
    /// Coordinate system that issued the output.
    pub cs: CoordinateSystemNumber,
    /// Sequence number of the output.
    pub seq: u64,
    /// M number.
    pub m: u16,
    /// Parameters VA to VH.
    pub params: Params,
    /// Number of the program that contains the M code.
    pub program: u16,
    /// Line of the M code in that program, from 1.
    pub line: u32,
    /// Time when the output was issued.
    pub output_s: f64,
    /// Time when the output ended; `None` while it is pending.
    pub ended_s: Option<f64>,
    /// Result of the output.
    pub ended: OutputEnd,
}

/// Result of an output.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum OutputEnd {
    /// The output has not ended.
    Open,
    /// A handler reset the output, and the program continued.
    Reset,
    /// The handler reported this alarm.
    Failed(Alarm),
    /// The output was cancelled, for example by a stop.
    Cancelled(CancelReason),
}

impl OutputRecord {
    /// Returns the time from the issue of the output to its end, s.
    ///
    /// # Errors
    /// Returns an error if the output has not ended.
    pub fn took_s(&self) -> Result<f64, TestError> {
        let ended_s = self.ended_s.ok_or_else(|| {
            TestError::new(format!(
                "M{:02} in line {} of program {} has not ended",
                self.m, self.line, self.program
            ))
        })?;
        Ok(ended_s - self.output_s)
    }
}

/// A state change of a coordinate system.
#[derive(Debug, Clone, PartialEq)]
pub struct StateChange {
    /// Time of the change.
    pub at_s: f64,
    /// The coordinate system.
    pub cs: CoordinateSystemNumber,
    /// State after the change.
    pub execution: Execution,
    /// Reason for the state; `None` if it has none.
    pub reason: Option<Reason>,
}

/// Final state of a coordinate system.
#[derive(Debug, Clone, PartialEq)]
pub struct SystemEnd {
    /// State at the end of the run.
    pub execution: Execution,
    /// Reason for the state; `None` if it has none.
    pub reason: Option<Reason>,
    /// The pending output: its M number and the last progress text of its handler.
    pub waiting_on: Option<(u16, Option<String>)>,
    /// Commanded machine positions by axis letter, mm or degrees.
    pub machine: BTreeMap<String, f64>,
    /// Commanded positions in work coordinates, by axis letter, mm or degrees.
    pub work: BTreeMap<String, f64>,
    /// Number of the tool in the spindle; 0 if the spindle is empty.
    pub tool: u16,
}

impl Run {
    /// Returns this run if every program reached its end.
    ///
    /// # Errors
    /// Returns an error if a program did not reach its end. The text describes how the run ended and the
    /// events before.
    pub fn completed(self) -> Result<Run, TestError> {
        let unended = (self.jobs.iter())
            .filter_map(|cs| Some((*cs, self.systems.get(cs)?)))
            .find(|(_, end)| end.execution != Execution::ProgramCompleted);
        match unended {
            None => Ok(self),
            Some((cs, _)) => Err(self.story(cs)),
        }
    }

    /// Returns the first alarm that stopped a program.
    ///
    /// # Errors
    /// Returns an error if no program was stopped by an alarm. The text describes how the run ended.
    pub fn alarm(&self) -> Result<&AlarmRecord, TestError> {
        let mut alarms = self
            .alarms
            .iter()
            .filter(|record| record.severity == AlarmSeverity::Alarm);
        alarms
            .next()
            .ok_or_else(|| TestError::new(format!("no alarm was raised; {}", self.summary())))
    }

    /// Returns the first output with this M number.
    ///
    /// # Errors
    /// Returns an error if the run has no such output.
    pub fn output(&self, m: u16) -> Result<&OutputRecord, TestError> {
        let mut outputs = self.outputs.iter().filter(|output| output.m == m);
        outputs
            .next()
            .ok_or_else(|| TestError::new(format!("M{m:02} was not issued; {}", self.summary())))
    }

    /// Returns the final state of a coordinate system.
    ///
    /// # Errors
    /// Returns an error if the coordinate system does not exist.
    pub fn system(&self, cs: CoordinateSystemNumber) -> Result<&SystemEnd, TestError> {
        self.systems
            .get(&cs)
            .ok_or_else(|| TestError::new(format!("the machine has no coordinate system {cs}")))
    }

    /// Returns the events of a coordinate system in order: `block 3` (line of a motion), `output M100 VA3`, `reset
    /// M100`, `fail M100`, `stop M00`, `resume`, `capture`, `alarm 10001`, `warning`, `end`.
    pub fn order(&self, cs: CoordinateSystemNumber) -> Vec<&str> {
        let of_cs = self.order.iter().filter(|(system, _)| *system == cs);
        of_cs.map(|(_, what)| what.as_str()).collect()
    }

    /// Returns the value of a P variable at the end of the run; 0 if the number does not exist.
    pub fn p(&self, number: u32) -> f64 {
        f64::from_bits(self.p.get(&number).copied().unwrap_or_default())
    }

    /// Returns the value of a Q variable of a coordinate system at the end of the run; 0 if the number does
    /// not exist.
    pub fn q(&self, cs: CoordinateSystemNumber, number: u32) -> f64 {
        let of_cs = self.q.get(&cs);
        f64::from_bits(of_cs.and_then(|q| q.get(&number)).copied().unwrap_or_default())
    }

    /// Returns the positions of a coordinate system in ascending order of time; empty if
    /// [`Bench::trace_every_s`](super::Bench::trace_every_s) was not set.
    pub fn trace(&self, cs: CoordinateSystemNumber) -> &[Sample] {
        self.samples.get(&cs).map_or(&[], Vec::as_slice)
    }

    /// Returns the last sample at or before the time `at_s`, which counts from the start of the programs.
    ///
    /// # Errors
    /// Returns an error if the run has no trace, or if the coordinate system does not exist or has no sample
    /// before that time.
    pub fn at_s(&self, cs: CoordinateSystemNumber, at_s: f64) -> Result<&Sample, TestError> {
        let trace = self.trace(cs);
        let after = trace.partition_point(|sample| sample.at_s <= at_s);
        let sample = after.checked_sub(1).and_then(|place| trace.get(place));
        sample.ok_or_else(|| {
            TestError::new(format!(
                "no sample of coordinate system {cs} at {at_s} s: record them with Bench::trace_every_s"
            ))
        })
    }

    fn summary(&self) -> String {
        let ends = self.systems.iter().map(|(cs, end)| {
            let reason = end
                .reason
                .map_or_else(String::new, |reason| format!(" ({reason:?})"));
            let waits = match &end.waiting_on {
                None => String::new(),
                Some((m, None)) => format!(", waits for M{m:02}"),
                Some((m, Some(text))) => format!(", waits for M{m:02}: {text}"),
            };
            format!("coordinate system {cs} is {:?}{reason}{waits}", end.execution)
        });
        let ends = ends.collect::<Vec<_>>().join("; ");
        let mut systems = self.systems.values();
        if self.stopped == RunEndReason::NothingMoves && systems.any(|end| end.execution == Execution::Wait) {
            return format!("{ends}; {HELP_TO_WAIT}");
        }
        ends
    }

    fn story(&self, cs: CoordinateSystemNumber) -> TestError {
        let why = match self.stopped {
            RunEndReason::ProgramsEnded => String::new(),
            RunEndReason::TimeLimit => format!(" within {} s", self.time_s),
            RunEndReason::NothingMoves => ": no further event is possible".to_owned(),
        };
        let summary = self.summary();
        let mut lines = vec![format!(
            "the program of coordinate system {cs} did not reach its end{why}; {summary}"
        )];
        for alarm in self.alarms.iter().filter(|alarm| alarm.cs == Some(cs)) {
            let line = alarm
                .line
                .map_or_else(String::new, |line| format!(" in line {line}"));
            lines.push(format!("{} {}{line}: {}", word(alarm), alarm.number, alarm.text));
        }
        lines.push(format!("it did: {}", self.order(cs).join(", ")));
        TestError::new(lines.join("\n  "))
    }
}

/// Advice for a program that waits for an event that does not occur.
const HELP_TO_WAIT: &str =
    "a handler that waits must sleep by plc.sleep, or wait for an event of the machine";

fn word(alarm: &AlarmRecord) -> &'static str {
    match alarm.severity {
        AlarmSeverity::Warning => "warning",
        _ => "alarm",
    }
}

/// Creates a journal that keeps its lines in memory, in their order.
pub fn kept_journal() -> (Journal, Arc<Mutex<Vec<Line>>>) {
    let lines = Arc::<Mutex<Vec<_>>>::default();
    let kept = Arc::clone(&lines);
    let sink = move |line: &Line| {
        kept.lock()
            .unwrap_or_else(PoisonError::into_inner)
            .push(line.clone());
        false
    };
    (Journal::to_sink(Arc::new(Mutex::new(sink))), lines)
}
