//! Runs: the active ones, the ended ones with their results, and production counters. Pure; all data come from events
//! of the journal.

use std::collections::{BTreeMap, VecDeque};
use std::time::SystemTime;

use plc_api::handshake::Now;
use plc_api::types::output::Timing;
use plc_api::types::planned::PlannedLocation;
use plc_api::types::run::{
    Production, RUNS_AT_ONCE_MAX, RUNS_KEPT, Run, RunAlarm, RunEnded, RunEndedHow, RunQuery, RunState,
    RunWait, Runs,
};
use plc_api::types::state::Reason;
use plc_api::types::{CoordinateSystemNumber, Timestamp};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::disk::number;
use crate::journal::{Event, Line, RaisedAlarm, RunEnd};
use crate::order_key::OrderKey;

/// Maximum number of alarms and M codes reported for a run.
const ALARMS_MAX: usize = 10;
const WAITS_MAX: usize = 20;

/// Ended run, and its number over all starts of the runtime.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct EndedRun {
    pub n: u64,
    #[serde(flatten)]
    pub run: Run,
    /// The order that has started it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub order: Option<OrderKey>,
}

/// Stored active run, with the order that has started it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct ActiveRunRecord {
    #[serde(flatten)]
    pub run: Run,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub order: Option<OrderKey>,
    /// Start of its current part, or of the last one that ended.
    pub part_began: Timestamp,
}

/// Data of runs stored over starts of the runtime.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct KeptRuns {
    pub ended: Vec<EndedRun>,
    /// Runs that were active when the runtime ended.
    pub open: Vec<ActiveRunRecord>,
    pub production: Vec<Production>,
    /// Number of the newest line of the journal that is included, by coordinate system.
    pub lines: LinesIncluded,
}

/// Number of a line of the journal, by coordinate system.
pub(crate) type LinesIncluded = BTreeMap<CoordinateSystemNumber, u64>;

/// All runs.
#[derive(Debug, Default)]
pub(crate) struct RunBook {
    open: BTreeMap<CoordinateSystemNumber, OpenRun>,
    /// Ended runs, the oldest first.
    ended: VecDeque<EndedRun>,
    production: BTreeMap<(CoordinateSystemNumber, u16), Production>,
    lines: LinesIncluded,
}

/// Active run.
#[derive(Debug)]
struct OpenRun {
    run: Run,
    order: Option<OrderKey>,
    began_s: f64,
    part_began_s: f64,
    part_began: Timestamp,
    /// M number of each pending output that the program waits for, and the start of the wait, by its sequence number.
    waiting: BTreeMap<u64, (u16, f64)>,
    waits: BTreeMap<u16, RunWait>,
}

impl RunBook {
    /// Continues with the stored data and the additions from the newest lines of the journal: the store lags behind
    /// published data, the journal does not. A run that had not ended is ended by the end of the runtime, in the block
    /// given by `place_of`; these runs are returned.
    pub fn restore(
        &mut self,
        kept: KeptRuns,
        journal: &[Value],
        place_of: impl Fn(&Run) -> Option<PlannedLocation>,
        time: SystemTime,
    ) -> Vec<Run> {
        let mut ended = kept.ended;
        ended.sort_by_key(|ended| ended.n);
        self.ended.extend(ended);
        self.production = kept
            .production
            .into_iter()
            .map(|of| ((of.cs, of.program), of))
            .collect();
        self.lines = kept.lines;
        for open in kept.open {
            let is_known = self.ended.iter().rev().any(|ended| ended.run.id == open.run.id);
            if !is_known {
                self.open.insert(open.run.cs, OpenRun::restore(open));
            }
        }
        for line in journal {
            self.replay(line);
        }
        let newest = journal.iter().map(number).max().unwrap_or(0);
        self.lines
            .values_mut()
            .for_each(|included| *included = newest.min(*included));
        let cut_short = std::mem::take(&mut self.open).into_values();
        let close = |open: OpenRun| {
            let end = ended_now(RunEndedHow::Restarted, String::new(), place_of(&open.run), time);
            let run = open.run.clone();
            self.close(open.run, open.order, end);
            run
        };
        cut_short.map(close).collect()
    }

    /// Processes a line of an earlier start. Its time of day replaces the monotonic clock.
    fn replay(&mut self, written: &Value) {
        let (n, line) = (number(written), Line::from_json(written));
        let ts = Timestamp::deserialize(&written["ts"]).ok();
        let time = ts.and_then(|ts| ts.to_system_time());
        let (Some(Line { cs, event, .. }), Some(time)) = (line, time) else {
            return;
        };
        if self.lines.get(&cs).is_some_and(|included| n <= *included) {
            return;
        }
        if matches!(event, Event::Boot { .. }) {
            self.end_run(cs, ended_now(RunEndedHow::Restarted, String::new(), None, time));
        } else if Self::learns_from(&event) {
            let monotonic_s = unix_s(time);
            self.on(cs, &event, Now { monotonic_s, time });
        }
        self.note_line(cs, n);
    }

    /// Notes that the line with this number is included.
    pub fn note_line(&mut self, cs: CoordinateSystemNumber, n: u64) {
        let included = self.lines.entry(cs).or_default();
        *included = n.max(*included);
    }

    /// Returns the number of the newest included line, by coordinate system.
    pub fn lines(&self) -> &LinesIncluded {
        &self.lines
    }

    /// Returns true for an event that changes runs or counters.
    pub fn learns_from(event: &Event) -> bool {
        matches!(
            event,
            Event::Start { .. }
                | Event::Output(_)
                | Event::Reset { .. }
                | Event::Alarm(_)
                | Event::PartsWait { .. }
                | Event::PartsEnded { .. }
                | Event::End(_)
        )
    }

    /// Processes an event. Returns true if the state must be published.
    pub fn on(&mut self, cs: CoordinateSystemNumber, event: &Event, now: Now) -> bool {
        if let Event::Start { program: 1.., .. } = event {
            self.begin_run(cs, event, now);
            return true;
        }
        let Some(open) = self.open.get_mut(&cs) else {
            return false;
        };
        match event {
            Event::Output(notice) => {
                if notice.timing == Timing::AfterMotion {
                    open.waiting.insert(notice.seq, (notice.m, now.monotonic_s));
                }
                false
            }
            Event::Reset { seq, .. } => {
                open.end_wait(*seq, now.monotonic_s);
                false
            }
            Event::Alarm(alarm) => {
                open.take_alarm(alarm);
                true
            }
            Event::PartsWait { text } => {
                open.run.waits_for = Some(text.clone());
                true
            }
            Event::PartsEnded { how, text } => {
                self.end_run(cs, ended_now(*how, text.clone(), None, now.time));
                true
            }
            Event::End(end) => {
                self.on_end(cs, *end, now);
                true
            }
            _ => false,
        }
    }

    fn begin_run(&mut self, cs: CoordinateSystemNumber, event: &Event, now: Now) {
        let Event::Start {
            program,
            run_id,
            program_hash,
            from_line,
            parts,
            order,
        } = event
        else {
            return;
        };
        if let Some(open) = self.open.get_mut(&cs).filter(|open| open.run.id == *run_id) {
            open.part_began_s = now.monotonic_s;
            open.part_began = Timestamp::from_system_time(now.time);
            open.run.waits_for = None;
            return;
        }
        let run = Run {
            id: run_id.clone(),
            cs,
            program: *program,
            hash: program_hash.clone(),
            from_line: *from_line,
            parts: parts.unwrap_or(1),
            parts_done: 0,
            began: Timestamp::from_system_time(now.time),
            end: None,
            took_s: 0.0,
            last_part_s: None,
            waits: Vec::new(),
            alarms: Vec::new(),
            waits_for: None,
        };
        let open = OpenRun {
            run,
            order: order.clone(),
            began_s: now.monotonic_s,
            part_began_s: now.monotonic_s,
            part_began: Timestamp::from_system_time(now.time),
            waiting: BTreeMap::new(),
            waits: BTreeMap::new(),
        };
        self.open.insert(cs, open);
    }

    fn on_end(&mut self, cs: CoordinateSystemNumber, end: RunEnd, now: Now) {
        let Some(open) = self.open.get_mut(&cs) else {
            return;
        };
        open.end_part(now.monotonic_s);
        let (how, place) = match end {
            RunEnd::Completed { .. } => {
                let took_s = now.monotonic_s - open.part_began_s;
                open.run.parts_done += 1;
                open.run.last_part_s = Some(took_s);
                let (program, is_last) = (open.run.program, open.run.parts_done >= open.run.parts);
                let produced = self.produced(cs, program);
                produced.parts += 1;
                produced.parts_s += took_s;
                produced.last = Some(Timestamp::from_system_time(now.time));
                if !is_last {
                    return;
                }
                (RunEndedHow::Completed, None)
            }
            RunEnd::CutShort {
                reason,
                program,
                line,
                ..
            } => {
                let how = match reason {
                    Some(Reason::Stop) => RunEndedHow::Stopped,
                    Some(Reason::Aborted) => RunEndedHow::Aborted,
                    Some(Reason::Alarm) => RunEndedHow::Alarm,
                    _ => RunEndedHow::Reset,
                };
                let place = program.zip(line);
                (
                    how,
                    place.map(|(program, line)| PlannedLocation { program, line }),
                )
            }
        };
        self.end_run(cs, ended_now(how, String::new(), place, now.time));
    }

    fn end_run(&mut self, cs: CoordinateSystemNumber, end: RunEnded) {
        if let Some(open) = self.open.remove(&cs) {
            self.close(open.run, open.order, end);
        }
    }

    fn close(&mut self, mut run: Run, order: Option<OrderKey>, end: RunEnded) {
        if end.how != RunEndedHow::Completed {
            self.produced(run.cs, run.program).cut_short += 1;
        }
        run.waits_for = None;
        run.end = Some(end);
        let n = self.ended.back().map_or(0, |last| last.n) + 1;
        self.ended.push_back(EndedRun { n, run, order });
        if self.ended.len() > RUNS_KEPT {
            self.ended.pop_front();
        }
    }

    fn produced(&mut self, cs: CoordinateSystemNumber, program: u16) -> &mut Production {
        self.production.entry((cs, program)).or_insert(Production {
            cs,
            program,
            parts: 0,
            cut_short: 0,
            parts_s: 0.0,
            last: None,
        })
    }

    /// Returns the present state of a run by its id.
    pub fn run(&self, id: &str, now_s: f64) -> Option<Run> {
        let mut open = self.open.values();
        if let Some(open) = open.find(|open| open.run.id == id) {
            let mut run = open.run.clone();
            if run.waits_for.is_none() {
                run.took_s = now_s - open.began_s;
            }
            return Some(run);
        }
        let ended = self.ended.iter().rev().find(|ended| ended.run.id == id);
        ended.map(|ended| ended.run.clone())
    }

    /// Returns the active run, or the last one that ended.
    pub fn state(&self, cs: CoordinateSystemNumber) -> RunState {
        let open = self.open.get(&cs).map(|open| &open.run);
        let mut ended = self.ended.iter().rev().map(|ended| &ended.run);
        RunState {
            run: open.or_else(|| ended.find(|run| run.cs == cs)).cloned(),
        }
    }

    /// Returns ended runs, the newest first.
    pub fn runs(&self, query: RunQuery) -> Runs {
        let is_asked = |cs: CoordinateSystemNumber| query.cs.is_none_or(|asked| asked == cs);
        let (from, count) = (
            query.from as usize,
            query.count.clamp(1, RUNS_AT_ONCE_MAX) as usize,
        );
        let ended = self.ended.iter().rev().map(|ended| &ended.run);
        let asked = ended.filter(|run| is_asked(run.cs)).skip(from).take(count);
        let production = self.production.values().filter(|of| is_asked(of.cs));
        Runs {
            runs: asked.cloned().collect(),
            production: production.cloned().collect(),
        }
    }

    /// Returns all ended runs, the newest first.
    pub fn ended(&self) -> impl Iterator<Item = &EndedRun> {
        self.ended.iter().rev()
    }

    /// Returns the active run of a coordinate system.
    pub fn open(&self, cs: CoordinateSystemNumber) -> Option<ActiveRunRecord> {
        self.open.get(&cs).map(|open| ActiveRunRecord {
            run: open.run.clone(),
            order: open.order.clone(),
            part_began: open.part_began.clone(),
        })
    }

    /// Returns the run started by an order of this user and id, and that order.
    pub fn ordered(&self, key: &OrderKey) -> Option<(&Run, &OrderKey)> {
        let open = self.open.values().map(|open| (&open.run, open.order.as_ref()));
        let ended = self
            .ended
            .iter()
            .rev()
            .map(|ended| (&ended.run, ended.order.as_ref()));
        let mut all = open.chain(ended);
        all.find_map(|(run, order)| {
            let order = order.filter(|order| (&order.user, &order.id) == (&key.user, &key.id))?;
            Some((run, order))
        })
    }

    /// Returns the counters of all programs.
    pub fn production(&self) -> Vec<Production> {
        self.production.values().cloned().collect()
    }
}

fn ended_now(how: RunEndedHow, text: String, place: Option<PlannedLocation>, time: SystemTime) -> RunEnded {
    RunEnded {
        at: Timestamp::from_system_time(time),
        how,
        text,
        place,
    }
}

fn unix_s(time: SystemTime) -> f64 {
    let since = time.duration_since(SystemTime::UNIX_EPOCH);
    since.unwrap_or_default().as_secs_f64()
}

impl OpenRun {
    /// Restores a run of an earlier start, with times of day as seconds.
    fn restore(kept: ActiveRunRecord) -> Self {
        let ActiveRunRecord {
            run,
            order,
            part_began,
        } = kept;
        let seconds = |at: &Timestamp| at.to_system_time().map_or(0.0, unix_s);
        Self {
            waits: run.waits.iter().map(|wait| (wait.m, wait.clone())).collect(),
            waiting: BTreeMap::new(),
            began_s: seconds(&run.began),
            part_began_s: seconds(&part_began),
            part_began,
            order,
            run,
        }
    }

    fn end_wait(&mut self, seq: u64, now_s: f64) {
        let Some((m, since_s)) = self.waiting.remove(&seq) else {
            return;
        };
        let took_s = now_s - since_s;
        let wait = self.waits.entry(m).or_insert(RunWait {
            m,
            count: 0,
            total_s: 0.0,
            longest_s: 0.0,
        });
        wait.count += 1;
        wait.total_s += took_s;
        wait.longest_s = wait.longest_s.max(took_s);
    }

    /// Ends the pending waits together with the part.
    fn end_part(&mut self, now_s: f64) {
        let waiting: Vec<u64> = self.waiting.keys().copied().collect();
        for seq in waiting {
            self.end_wait(seq, now_s);
        }
        self.run.took_s = now_s - self.began_s;
        let mut waits: Vec<RunWait> = self.waits.values().cloned().collect();
        waits.sort_by(|one, other| other.total_s.total_cmp(&one.total_s));
        waits.truncate(WAITS_MAX);
        self.run.waits = waits;
    }

    fn take_alarm(&mut self, alarm: &RaisedAlarm) {
        if self.run.alarms.len() >= ALARMS_MAX {
            return;
        }
        self.run.alarms.push(match alarm {
            RaisedAlarm::OfThis(record) => RunAlarm {
                number: record.number,
                text: record.text.clone(),
                line: record.line,
            },
            RaisedAlarm::OfAll { number, text } => RunAlarm {
                number: *number,
                text: text.clone(),
                line: None,
            },
        });
    }
}

#[cfg(test)]
mod tests;
