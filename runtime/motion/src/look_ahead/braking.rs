//! The distance that the motion may continue on the known profiles. From any point on the path the motion
//! must be able to stop by the override factor alone, within the limits of the motors.

use std::collections::VecDeque;

use tandem_model::profile::SlewRoom;

/// Number of servo periods by which the servo may begin to slow down too late.
const LATE_PERIODS: f64 = 3.0;

/// Planned motion that the servo may not pass yet.
#[derive(Debug, Clone, Default)]
pub(super) struct Braking {
    parts: VecDeque<BrakingPart>,
    /// The last segment that the motion may pass.
    pub(super) free_to: u64,
    /// True for backward motion, in which segment numbers fall.
    is_backward: bool,
}

/// Splits a long piece into two ends of one servo period and the middle between them. No servo cycle then
/// touches both the middle and a neighbouring piece.
fn ends_apart(whole_s: f64, period_s: f64) -> [f64; 3] {
    if whole_s > 4.0 * period_s {
        [period_s, whole_s - 2.0 * period_s, period_s]
    } else {
        [whole_s, 0.0, 0.0]
    }
}

/// A part of the motion of at least one servo period.
#[derive(Debug, Clone, Copy)]
struct BrakingPart {
    segment: u64,
    duration_s: f64,
    room: SlewRoom,
}

impl Braking {
    /// Begins a chain with this segment. The motion before the segment ends at rest.
    pub(super) fn start_chain(&mut self, segment: u64, is_backward: bool) {
        self.parts.clear();
        self.is_backward = is_backward;
        self.free_to = self.before(segment);
    }

    /// Returns the number of the segment that is passed before this segment.
    fn before(&self, segment: u64) -> u64 {
        if self.is_backward {
            segment.saturating_add(1)
        } else {
            segment.saturating_sub(1)
        }
    }

    /// Ends the chain at rest; this segment is its last.
    pub(super) fn end_chain(&mut self, segment: u64) {
        self.parts.clear();
        self.free_to = segment;
    }

    /// Adds a segment, given as duration and room of each of its pieces.
    pub(super) fn add(&mut self, segment: u64, pieces: impl Iterator<Item = (f64, SlewRoom)>, period_s: f64) {
        let pieces =
            pieces.flat_map(|(whole_s, room)| ends_apart(whole_s, period_s).map(|part_s| (part_s, room)));
        for (duration_s, room) in pieces.filter(|(duration_s, _)| *duration_s > 0.0) {
            match self.parts.back_mut().filter(|last| last.duration_s < period_s) {
                Some(last) => {
                    last.duration_s += duration_s;
                    last.room = last.room.worst(room);
                }
                None => self.parts.push_back(BrakingPart {
                    segment,
                    duration_s,
                    room,
                }),
            }
        }
    }

    /// Frees each segment from whose end the factor can still fall from 1 to 0 within the parts, as steeply
    /// as the motors allow. A feed hold may take longer, because more parts become known meanwhile. Within a
    /// part of duration d the square of the factor falls by `2 s d`. Here s is the smallest fall that this
    /// part and its neighbours allow, since a servo cycle may touch two parts.
    /// may touch two.
    pub(super) fn free(&mut self, period_s: f64) {
        let mut square = 0.0_f64;
        let mut late_s = LATE_PERIODS * period_s;
        for i in (0..self.parts.len()).rev() {
            let beside = [i.checked_sub(1), Some(i), i.checked_add(1)];
            let room = beside
                .into_iter()
                .flatten()
                .filter_map(|k| self.parts.get(k))
                .fold(SlewRoom::default(), |room, part| room.worst(part.room));
            let Some(part) = self.parts.get(i) else { return };
            let late = late_s.min(part.duration_s);
            late_s -= late;
            let time_s = part.duration_s - late;
            if time_s > 0.0 {
                square = room.square_before(square, f64::INFINITY, time_s);
            }
            if square >= 1.0 {
                let before = self.before(part.segment);
                self.free_to = if self.is_backward {
                    self.free_to.min(before)
                } else {
                    self.free_to.max(before)
                };
                self.parts.drain(..i.saturating_sub(1));
                return;
            }
        }
    }
}
