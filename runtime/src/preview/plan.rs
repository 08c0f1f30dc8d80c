//! A plan as it grows: one thread writes it, others read it.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use parking_lot::Mutex;
use plc_api::types::planned::{PlannedPlace, RehearsalOutcome, RehearsedMCode, RunTimeDependence};

use tandem_model::Origin;

use crate::coordinate_system::Conditions;

use super::chunk::{Chunk, distance_squared, share_along};
use super::tracer::{AxisTrace, Mark, Times};

/// A plan.
#[derive(Debug)]
pub(super) struct Plan {
    pub conditions: Conditions,
    /// Nobody wants it any more.
    pub is_cancelled: AtomicBool,
    content: Mutex<Arc<Content>>,
}

/// Where a run is.
#[derive(Debug)]
pub(super) struct Moment {
    /// By its number in the run.
    pub segment: u64,
    /// The block that is executed.
    pub executing: Origin,
    /// For how long, s.
    pub elapsed_s: f64,
    /// The program waits for an M code.
    pub is_waiting: bool,
    /// Machine position.
    pub at: [f32; 3],
}

/// What is known so far.
#[derive(Debug, Clone, Default)]
pub(super) struct Content {
    pub chunks: Vec<Arc<Chunk>>,
    /// Program numbers by their places in the words of vertices.
    pub palette: Vec<u16>,
    pub outcome: RehearsalOutcome,
    pub text: String,
    pub at: Option<PlannedPlace>,
    pub times: Times,
    pub depends: Option<RunTimeDependence>,
    pub m_codes: Vec<RehearsedMCode>,
    pub m_code_count: u64,
    pub axes: Vec<AxisTrace>,
    pub marks: Vec<Mark>,
    /// The path has more vertices than are kept.
    pub is_cut: bool,
}

impl Plan {
    pub fn new(conditions: Conditions) -> Self {
        Self {
            conditions,
            is_cancelled: AtomicBool::new(false),
            content: Mutex::default(),
        }
    }

    pub fn is_cancelled(&self) -> bool {
        self.is_cancelled.load(Ordering::Relaxed)
    }

    pub fn cancel(&self) {
        self.is_cancelled.store(true, Ordering::Relaxed);
    }

    pub fn content(&self) -> Arc<Content> {
        Arc::clone(&self.content.lock())
    }

    pub fn publish(&self, content: Content) {
        *self.content.lock() = Arc::new(content);
    }

    /// Tells it from plans made with anything else, and from what was known of it before.
    pub fn tag(&self, content: &Content) -> String {
        let Conditions { main, revision, .. } = &self.conditions;
        let extent = match content.outcome {
            RehearsalOutcome::Planning => content.chunks.len().to_string(),
            _ => "all".to_owned(),
        };
        format!("{}-{revision:016x}-{extent}", main.sum())
    }
}

impl Content {
    pub fn is_complete(&self) -> bool {
        self.outcome != RehearsalOutcome::Planning
    }

    /// The planned time of a run that is there.
    pub fn time_of(&self, now: &Moment) -> Times {
        let waits =
            |mark: &Mark| mark.waits && mark.segment == now.segment && mark.origin.line == now.executing.line;
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
        // at one place only the clock tells
        let gone_s = if moves_s > 0.0 {
            let time_s = self.nearest([start.total, end.total], now.at);
            time_s.map_or(0.0, |time_s| time_s - start.total)
        } else {
            now.elapsed_s
        };
        start.between(&end, (gone_s / length_s).clamp(0.0, 1.0))
    }

    /// When the path comes nearest to a position, between two times.
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
