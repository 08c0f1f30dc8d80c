//! Active runs, ended runs with their results, and production counters. Pure: all data come from journal events.

use std::collections::{BTreeMap, VecDeque};
use std::time::SystemTime;

use plc_protocol::handshake::Now;
use plc_protocol::types::output::Timing;
use plc_protocol::types::planned::PlannedLocation;
use plc_protocol::types::run::{
    Production, RUNS_AT_ONCE_MAX, RUNS_KEPT, Run, RunAlarm, RunEnded, RunEndedHow, RunQuery, RunState,
    RunWait, Runs,
};
use plc_protocol::types::state::Reason;
use plc_protocol::types::{CoordinateSystemNumber, Timestamp};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::disk::number;
use crate::journal::{Event, Line, RaisedAlarm, RunEnd};
use crate::order_key::OrderKey;

/// Maximum number of alarms that are reported for a run, and of M codes with their waits.
const ALARMS_MAX: usize = 10;
const WAITS_MAX: usize = 20;

/// Ended run with its number. The numbers continue after a restart of the runtime.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EndedRun {
    /// Number of the run.
    pub n: u64,
    /// The run itself.
    #[serde(flatten)]
    pub run: Run,
    /// The order that started the run, if it was ordered.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub order: Option<OrderKey>,
}

/// Active run in its stored form, with the order that started it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ActiveRunRecord {
    /// The run itself.
    #[serde(flatten)]
    pub run: Run,
    /// The order that started the run, if it was ordered.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub order: Option<OrderKey>,
    /// Start time of the part that runs now; between two parts, of the last part.
    pub part_began: Timestamp,
}

/// Data of runs that are stored over restarts of the runtime.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct KeptRuns {
    /// Ended runs, the oldest first.
    pub ended: Vec<EndedRun>,
    /// Runs that were active when these data were stored.
    pub open: Vec<ActiveRunRecord>,
    /// Production counters of the programs.
    pub production: Vec<Production>,
    /// By coordinate system, number of the newest journal line whose effect these data include.
    pub lines: LinesIncluded,
}

/// Number of a journal line, by coordinate system.
pub type LinesIncluded = BTreeMap<CoordinateSystemNumber, u64>;

/// All active and ended runs, and the production counters.
#[derive(Debug, Default)]
pub struct RunBook {
    open: BTreeMap<CoordinateSystemNumber, OpenRun>,
    /// Ended runs, the oldest first.
    ended: VecDeque<EndedRun>,
    production: BTreeMap<(CoordinateSystemNumber, u16), Production>,
    lines: LinesIncluded,
}

/// Active run with its times in seconds.
#[derive(Debug)]
struct OpenRun {
    run: Run,
    order: Option<OrderKey>,
    began_s: f64,
    part_began_s: f64,
    part_began: Timestamp,
    /// Pending outputs for which the program waits: M number and start of the wait in s, by sequence number.
    waiting: BTreeMap<u64, (u16, f64)>,
    waits: BTreeMap<u16, RunWait>,
}

impl RunBook {
    /// Restores the stored data, then adds the effects of newer journal lines. Reason: the store lags behind published
    /// data, the journal does not. Ends each active run, because the end of the runtime has ended it, in the block
    /// given by `place_of`. Returns these runs.
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

    /// Processes a journal line of an earlier start. The time of day in the line is used as the monotonic time.
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

    /// Notes that the effect of the line with this number is included.
    pub fn note_line(&mut self, cs: CoordinateSystemNumber, n: u64) {
        let included = self.lines.entry(cs).or_default();
        *included = n.max(*included);
    }

    /// Returns, by coordinate system, the number of the newest line whose effect is included.
    pub fn lines(&self) -> &LinesIncluded {
        &self.lines
    }

    /// Returns true if an event changes runs or counters.
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

    /// Processes an event. Returns true if the state of the run must be published.
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

    /// Returns the current state of the run with this id; `None` if the run is unknown.
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

    /// Returns the active run of a coordinate system, otherwise its last ended run.
    pub fn state(&self, cs: CoordinateSystemNumber) -> RunState {
        let open = self.open.get(&cs).map(|open| &open.run);
        let mut ended = self.ended.iter().rev().map(|ended| &ended.run);
        RunState {
            run: open.or_else(|| ended.find(|run| run.cs == cs)).cloned(),
        }
    }

    /// Returns the ended runs that the query asks for, the newest first, and the production counters.
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

    /// Returns the active run of a coordinate system in its stored form.
    pub fn open(&self, cs: CoordinateSystemNumber) -> Option<ActiveRunRecord> {
        self.open.get(&cs).map(|open| ActiveRunRecord {
            run: open.run.clone(),
            order: open.order.clone(),
            part_began: open.part_began.clone(),
        })
    }

    /// Returns the run that an order with the user and id of `key` started, and this order.
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

    /// Returns the production counters of all programs.
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
    /// Restores an active run of an earlier start. Its times are times of day in seconds.
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

    /// Ends the pending waits of a part that has ended, and updates the times of the run.
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
