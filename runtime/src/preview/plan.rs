//! A plan that grows while one thread writes it and other threads read it.

use std::fmt::Write as _;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};

use parking_lot::Mutex;
use plc_protocol::types::planned::{
    PathIdentity, PlanIdentity, PlannedLocation, RehearsalOutcome, RehearsedMCode, RunTimeDependence,
};

use tandem_model::variables::VariableArray;
use tandem_model::{Origin, Variables};
use tandem_store::disk::checksum_hex;

use crate::coordinate_system::Conditions;

use super::chunk::{Chunk, distance_squared, share_along};
use super::tracer::{AxisTrace, PlanMark, PlannedPeak, Times};

/// Selects one of the arrays of variables.
type ArrayOf = fn(&Variables) -> &VariableArray;

/// A plan of a program for certain conditions.
#[derive(Debug)]
pub(super) struct Plan {
    pub conditions: Arc<Conditions>,
    /// Variables that the plan changes as the program would. They also record which variables the plan has
    /// read.
    pub variables: Variables,
    /// True if the plan is no longer needed.
    pub is_cancelled: AtomicBool,
    content: Mutex<Arc<PlanContent>>,
    /// Identity of the conditions, set when it is first reported.
    identity: OnceLock<PlanIdentity>,
}

/// Current position of a run.
#[derive(Debug)]
pub(super) struct RunMoment {
    /// Number of the active segment in the run.
    pub segment: u64,
    /// Origin of the block that is executed.
    pub executing: Origin,
    /// Execution time of that block so far, s.
    pub elapsed_s: f64,
    /// True if the program waits for an M code.
    pub is_waiting: bool,
    /// True if the program waits and the end of the wait is unknown.
    pub waits_without_end: bool,
    /// Machine position of X, Y and Z, mm.
    pub at: [f32; 3],
}

/// Planned content up to the point that the planning has reached.
#[derive(Debug, Clone, Default)]
pub(super) struct PlanContent {
    pub chunks: Vec<Arc<Chunk>>,
    /// Program numbers by their indices in the words of vertices.
    pub palette: Vec<u16>,
    pub outcome: RehearsalOutcome,
    pub text: String,
    pub at: Option<PlannedLocation>,
    pub times: Times,
    pub depends: Option<RunTimeDependence>,
    pub m_codes: Vec<RehearsedMCode>,
    pub m_code_count: u64,
    pub axes: Vec<AxisTrace>,
    pub corners: Vec<PlannedPeak>,
    pub marks: Vec<PlanMark>,
    /// True if the path has more vertices than are stored.
    pub is_cut: bool,
}

impl Plan {
    pub fn new(conditions: Arc<Conditions>) -> Self {
        let Variables {
            global,
            coordinate_system,
        } = &conditions.variables;
        Self {
            variables: Variables {
                global: global.watched_copy(),
                coordinate_system: coordinate_system.watched_copy(),
            },
            conditions,
            is_cancelled: AtomicBool::new(false),
            content: Mutex::default(),
            identity: OnceLock::new(),
        }
    }

    /// Returns true if this plan is valid for a run with these conditions: all inputs and all variables that
    /// the plan has read are equal.
    pub fn matches(&self, now: &Conditions) -> bool {
        self.is_alive()
            && self.conditions.position_key == now.position_key
            && self.matches_but_position(now)
            && self
                .reads()
                .all(|(then, array, index)| bits(then, index) == bits(array(&now.variables), index))
    }

    /// Compares conditions as [`Plan::matches`] does, but ignores the machine position and the values of
    /// variables.
    pub fn matches_but_position(&self, now: &Conditions) -> bool {
        self.is_alive() && self.conditions.key == now.key
    }

    /// Returns false if planning was cancelled before it was complete.
    fn is_alive(&self) -> bool {
        !self.is_cancelled() || self.content().is_complete()
    }

    /// Returns each variable that the program reads before setting it: its array in the plan's conditions,
    /// its array in other conditions, and its index. For a run from a line, returns all variables, because
    /// the search for the line has read them.
    fn reads(&self) -> impl Iterator<Item = (&VariableArray, ArrayOf, usize)> {
        let Conditions {
            variables,
            reads_variables,
            from,
            ..
        } = &*self.conditions;
        let arrays: [(_, _, ArrayOf); 2] = [
            (&variables.global, &self.variables.global, |of| &of.global),
            (
                &variables.coordinate_system,
                &self.variables.coordinate_system,
                |of| &of.coordinate_system,
            ),
        ];
        let counts_all = from.is_some() && *reads_variables;
        arrays.into_iter().flat_map(move |(then, watched, array)| {
            let all = 0..if counts_all { then.len() } else { 0 };
            let read = watched.read_first().filter(move |_| !counts_all);
            all.chain(read).map(move |index| (then, array, index))
        })
    }

    /// Returns the identity of the plan's conditions; all calls return the result of the first one. If the
    /// first call comes during planning, the identity covers all variables, or none if the program reads
    /// none. After planning, it covers only the variables that were read.
    pub fn identity(&self, content: &PlanContent) -> PlanIdentity {
        self.identity
            .get_or_init(|| self.identify(content.is_complete()))
            .clone()
    }

    fn identify(&self, is_complete: bool) -> PlanIdentity {
        let Conditions {
            main,
            texts,
            key,
            position_key,
            variables,
            reads_variables,
            ..
        } = &*self.conditions;
        let mut called = String::new();
        for (number, program) in texts.iter().filter(|(number, _)| **number != main.number) {
            let _ = writeln!(called, "{number} {}", program.checksum());
        }
        let mut hasher = DefaultHasher::new();
        (key, position_key).hash(&mut hasher);
        if is_complete {
            for (then, _, index) in self.reads() {
                (index, bits(then, index)).hash(&mut hasher);
            }
        } else if *reads_variables {
            for array in [&variables.global, &variables.coordinate_system] {
                for index in 0..array.len() {
                    bits(array, index).hash(&mut hasher);
                }
            }
        }
        PlanIdentity {
            hash: main.checksum().to_owned(),
            called: (!called.is_empty()).then(|| checksum_hex(called.as_bytes())),
            inputs: format!("{:016x}", hasher.finish()),
        }
    }

    pub fn is_cancelled(&self) -> bool {
        self.is_cancelled.load(Ordering::Relaxed)
    }

    pub fn cancel(&self) {
        self.is_cancelled.store(true, Ordering::Relaxed);
    }

    pub fn content(&self) -> Arc<PlanContent> {
        Arc::clone(&self.content.lock())
    }

    pub fn publish(&self, content: PlanContent) {
        *self.content.lock() = Arc::new(content);
    }

    /// Returns a tag of the planned content. The tag differs between plans, between runs, and between an
    /// incomplete plan and its extended version.
    pub fn tag(content: &PlanContent, PathIdentity { run_id, plan }: &PathIdentity) -> String {
        let extent = match content.outcome {
            RehearsalOutcome::Planning => content.chunks.len().to_string(),
            _ => "all".to_owned(),
        };
        let run = run_id.as_ref().map_or_else(String::new, |id| format!("-{id}"));
        format!("{}-{}-{extent}{run}", plan.hash, plan.inputs)
    }
}

fn bits(array: &VariableArray, index: usize) -> Option<u64> {
    array.get(index).map(f64::to_bits)
}

impl PlanContent {
    pub fn is_complete(&self) -> bool {
        self.outcome != RehearsalOutcome::Planning
    }

    /// Returns the planned times from the start of the plan to the current position of a run.
    pub fn time_of(&self, now: &RunMoment) -> Times {
        let waits = |mark: &PlanMark| {
            mark.waits && mark.segment == now.segment && mark.origin.line == now.executing.line
        };
        let begun = self
            .marks
            .partition_point(|mark| mark.segment < now.segment || mark.segment == now.segment && !mark.waits);
        let waiting = self.marks[begun..].iter().position(waits);
        let after = waiting
            .filter(|_| now.is_waiting)
            .map_or(begun, |place| begun + place + 1);
        let start = after
            .checked_sub(1)
            .map(|i| self.marks[i].times)
            .unwrap_or_default();
        let end = self.marks.get(after).map_or(self.times, |mark| mark.times);
        let length_s = end.total - start.total;
        if length_s <= 0.0 {
            return start;
        }
        let moves_s = end.feed - start.feed + end.rapid - start.rapid;
        // Without motion, only the elapsed time shows the progress.
        let gone_s = if moves_s > 0.0 {
            let time_s = self.nearest([start.total, end.total], now.at);
            time_s.map_or(0.0, |time_s| time_s - start.total)
        } else {
            now.elapsed_s
        };
        start.between(&end, (gone_s / length_s).clamp(0.0, 1.0))
    }

    /// Returns the time, between two times, at which the path comes nearest to a position.
    fn nearest(&self, [from_s, to_s]: [f64; 2], at: [f32; 3]) -> Option<f64> {
        let first = self
            .chunks
            .partition_point(|chunk| f64::from(chunk.end_s()) < from_s);
        let mut nearest: Option<(f32, f64)> = None;
        for chunk in self.chunks.get(first..)? {
            if f64::from(chunk.begin_s()) > to_s {
                break;
            }
            let begin = chunk
                .vertices
                .partition_point(|vertex| f64::from(vertex.time_s) < from_s);
            for ends in chunk.vertices.get(begin.saturating_sub(1)..)?.windows(2) {
                if f64::from(ends[0].time_s) >= to_s {
                    break;
                }
                let off = distance_squared(at, ends[0].at, ends[1].at);
                if nearest.is_none_or(|(least, _)| off < least) {
                    let share = f64::from(share_along(at, ends[0].at, ends[1].at));
                    let [a, b] = [f64::from(ends[0].time_s), f64::from(ends[1].time_s)];
                    nearest = Some((off, a + (b - a) * share));
                }
            }
        }
        nearest.map(|(_, time_s)| time_s.clamp(from_s, to_s))
    }
}
