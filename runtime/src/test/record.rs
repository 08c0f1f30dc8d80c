//! The record of a run, for the assertions of a test.

use std::collections::BTreeMap;

use plc_api::types::CoordinateSystemNumber;
use plc_api::types::machine::{AlarmRecord, AlarmSeverity};
use plc_api::types::state::{CapturedPositions, Reason};
use plc_api::{Alarm, CancelReason, Execution, Params};

use super::TestError;
use super::trace::{Sample, Samples};

/// Results of a run: plain data, equal for equal tests. Times are seconds from the start of the programs.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Run {
    /// Why the run ended.
    pub stopped: RunEndReason,
    /// When the run ended.
    pub time_s: f64,
    /// Auxiliary function outputs in the order in which they were issued.
    pub outputs: Vec<OutputRecord>,
    /// Alarms and warnings in the order in which they were raised.
    pub alarms: Vec<AlarmRecord>,
    /// Captured positions of each G31, in order.
    pub captured: Vec<CapturedPositions>,
    /// State words of each coordinate system, from its start on.
    pub states: Vec<StateChange>,
    /// Coordinate systems that were started.
    pub(super) jobs: Vec<CoordinateSystemNumber>,
    pub(super) systems: BTreeMap<CoordinateSystemNumber, SystemEnd>,
    pub(super) order: Vec<(CoordinateSystemNumber, String)>,
    pub(super) samples: Samples,
    pub(super) p: NonZero,
    pub(super) q: BTreeMap<CoordinateSystemNumber, NonZero>,
}

/// Variables that are not zero, by number. They are stored as bits, because NaN must equal itself here.
pub(super) type NonZero = BTreeMap<u32, u64>;

/// Why a run ended.
#[derive(Debug, Clone, Default, PartialEq)]
pub enum RunEndReason {
    /// Every program has ended: at its end, by an alarm or by a command.
    #[default]
    ProgramsEnded,
    /// Nothing further could happen: a program was paused, or waited for an event that does not occur.
    NothingMoves,
    /// [`Bench::max_time_s`](super::Bench::max_time_s) was reached.
    TimeLimit,
}

/// One auxiliary function output.
#[derive(Debug, Clone, PartialEq)]
pub struct OutputRecord {
    /// Coordinate system that issued it.
    pub cs: CoordinateSystemNumber,
    /// Sequence number.
    pub seq: u64,
    /// M number.
    pub m: u16,
    /// VA to VH.
    pub params: Params,
    /// Program that contains it.
    pub program: u16,
    /// Line of that program, from 1.
    pub line: u32,
    /// When it was issued.
    pub output_s: f64,
    /// When it ended; `None` while it is pending.
    pub ended_s: Option<f64>,
    /// How it ended.
    pub ended: OutputEnd,
}

/// How an output ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum OutputEnd {
    /// It has not ended.
    Open,
    /// It was reset: the program continued.
    Reset,
    /// Its handler reported this alarm.
    Failed(Alarm),
    /// It was cancelled, such as by a stop.
    Cancelled(CancelReason),
}

impl OutputRecord {
    /// Returns the seconds from the output to its end.
    ///
    /// # Errors
    /// Returns an error if it has not ended.
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
    /// The state word.
    pub execution: Execution,
    /// The reason, if there is one.
    pub reason: Option<Reason>,
}

/// Final state of a coordinate system.
#[derive(Debug, Clone, PartialEq)]
pub struct SystemEnd {
    /// The state word.
    pub execution: Execution,
    /// The reason, if there is one.
    pub reason: Option<Reason>,
    /// The pending output: M number and the handler's last progress text.
    pub waiting_on: Option<(u16, Option<String>)>,
    /// Commanded machine positions by axis letter, mm or degrees.
    pub machine: BTreeMap<String, f64>,
    /// Commanded positions in work coordinates.
    pub work: BTreeMap<String, f64>,
    /// Tool in the spindle; 0: none.
    pub tool: u16,
}

impl Run {
    /// Returns this run if every program reached its end.
    ///
    /// # Errors
    /// Returns an error if a program did not: the text describes the actual end and the events before it.
    pub fn completed(self) -> Result<Run, TestError> {
        let unended = (self.jobs.iter())
            .filter_map(|cs| Some((*cs, self.systems.get(cs)?)))
            .find(|(_, end)| end.execution != Execution::ProgramCompleted);
        match unended {
            None => Ok(self),
            Some((cs, _)) => Err(self.story(cs)),
        }
    }

    /// Returns the alarm that stopped a program; the first if there are several.
    ///
    /// # Errors
    /// Returns an error if there is no alarm: the text describes how the run ended.
    pub fn alarm(&self) -> Result<&AlarmRecord, TestError> {
        let mut alarms = self
            .alarms
            .iter()
            .filter(|record| record.severity == AlarmSeverity::Alarm);
        alarms
            .next()
            .ok_or_else(|| TestError::new(format!("no alarm was raised; {}", self.summary())))
    }

    /// Returns the first output of an M number.
    ///
    /// # Errors
    /// Returns an error if there is none.
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

    /// Returns a P variable at the end of the run; 0 if the number does not exist.
    pub fn p(&self, number: u32) -> f64 {
        f64::from_bits(self.p.get(&number).copied().unwrap_or_default())
    }

    /// Returns a Q variable of a coordinate system at the end of the run; 0 if the number does not exist.
    pub fn q(&self, cs: CoordinateSystemNumber, number: u32) -> f64 {
        let of_cs = self.q.get(&cs);
        f64::from_bits(of_cs.and_then(|q| q.get(&number)).copied().unwrap_or_default())
    }

    /// Returns the positions of a coordinate system over time, ascending; empty without
    /// [`Bench::trace_every_s`](super::Bench::trace_every_s).
    pub fn trace(&self, cs: CoordinateSystemNumber) -> &[Sample] {
        self.samples.get(&cs).map_or(&[], Vec::as_slice)
    }

    /// Returns the last sample at or before a time, seconds from the start of the programs.
    ///
    /// # Errors
    /// Returns an error if there is no trace, no such coordinate system, or no sample before that time.
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

/// Advice if a program waits for an event that does not occur.
const HELP_TO_WAIT: &str =
    "a handler that waits must sleep by plc.sleep, or wait for an event of the machine";

fn word(alarm: &AlarmRecord) -> &'static str {
    match alarm.severity {
        AlarmSeverity::Warning => "warning",
        _ => "alarm",
    }
}
