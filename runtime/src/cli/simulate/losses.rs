//! Calculates from the planned profiles the time that blocks at feedrate lose because motion stops or slows
//! down between them, and the distance of the path from their corners.

use std::collections::VecDeque;

use serde::Serialize;
use tandem_model::profile::{CubicMotion, Law, PacedMotion, Profile, RampedMotion};
use tandem_model::{AxisVector, Origin, bisect};
use tandem_runtime::simulation::PlannedMotion;

/// Number of bisections of a block's plan time; after these, the result is exact to the last significant bits.
const HALVINGS: u32 = 60;

/// Time lost at the transitions between blocks.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub(super) struct TransitionLoss {
    /// Number of block transitions with a loss.
    places: u64,
    /// Sum of all losses, s.
    lost_s: f64,
    /// Largest single loss, with the program and line of the block that ends at this transition.
    worst: Option<Worst>,
}

/// A block transition that loses time.
#[derive(Debug, Clone, PartialEq, Serialize)]
struct Worst {
    program: u16,
    line: u32,
    lost_s: f64,
}

impl TransitionLoss {
    fn add(&mut self, at: Origin, lost_s: f64) {
        self.places += 1;
        self.lost_s += lost_s;
        if self.worst.as_ref().is_none_or(|worst| worst.lost_s < lost_s) {
            self.worst = Some(Worst {
                program: at.program,
                line: at.line,
                lost_s,
            });
        }
    }

    /// Returns the loss as a line of text.
    pub fn text(&self) -> String {
        let places = if self.places == 1 { "place" } else { "places" };
        let sum = format!("{:.3} s in {} {places}", self.lost_s, self.places);
        match self.worst.as_ref().filter(|worst| worst.lost_s > 0.0) {
            Some(worst) => format!("{sum}, most after line {}: {:.3} s", worst.line, worst.lost_s),
            None => sum,
        }
    }
}

/// Distance of the path from a programmed corner, and the block that ends at the corner.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(super) struct CornerDistance {
    pub distance_mm: f64,
    program: u16,
    pub line: u32,
}

/// Distance from a corner that is only rounding, mm.
const CORNER_MIN_MM: f64 = 1e-6;

/// The end of a block that the servo has passed.
#[derive(Debug, Clone, Copy)]
pub(super) struct PassedBlock {
    serial: u64,
    origin: Origin,
    /// End position; `None` if a signal ended the block.
    pub target: Option<AxisVector>,
    /// Distance of the path from the end position, where the next block begins without a stop, mm.
    pub corner_mm: Option<f64>,
}

/// A segment that is planned and that the servo has not passed.
#[derive(Debug)]
struct Piece {
    segment: u64,
    serial: u64,
    origin: Origin,
    /// Programmed feedrate within the limits of the axes, path units per second; `None` if the segment is not
    /// at feedrate.
    speed_limit: Option<f64>,
    /// True if the segment ends at rest.
    stops: bool,
    /// Duration of the segment's profiles, s.
    duration_s: f64,
    /// Losses in the first and in the second half of the segment's length, s.
    lost_s: [f64; 2],
    /// End position; `None` if a signal ends the segment, so that the position is not known in advance.
    target: Option<AxisVector>,
    /// Distance of the path from the corner at the end, mm.
    corner_mm: Option<f64>,
    /// Set when the servo reaches the segment: whether it follows the previous segment directly, and the rest
    /// time before it, s.
    begun: Option<(bool, f64)>,
}

/// The planned segments, and the times at which the servo passes them.
#[derive(Debug, Default)]
pub(super) struct Losses {
    /// Feed override, 1 at 100 percent.
    feed_override: f64,
    planned: VecDeque<Piece>,
    before: Option<Piece>,
    /// Chain of segments without rest: start time of the first segment, and total time of the passed
    /// segments, s.
    chain: (f64, f64),
    /// True if the program has waited since the last block.
    waited: bool,
    /// Blocks that the servo has passed and [`Losses::end_of`] has not returned; `None` if they are not needed.
    passed: Option<VecDeque<PassedBlock>>,
    /// The largest distance from a corner.
    pub corner: Option<CornerDistance>,
    pub stops: TransitionLoss,
    pub corners: TransitionLoss,
}

impl Losses {
    /// Creates the calculation. With `each_block`, [`Losses::end_of`] returns the end of each block.
    pub fn new(feed_override: f64, each_block: bool) -> Self {
        Self {
            feed_override,
            passed: each_block.then(VecDeque::new),
            ..Self::default()
        }
    }

    pub fn plan(&mut self, planned: PlannedMotion<'_>) {
        match planned {
            PlannedMotion::Segment {
                number,
                segment,
                speed_limit,
            } => self.planned.push_back(Piece {
                segment: number,
                serial: segment.serial,
                origin: segment.origin,
                speed_limit,
                stops: true,
                duration_s: 0.0,
                lost_s: [0.0; 2],
                target: None,
                corner_mm: None,
                begun: None,
            }),
            PlannedMotion::Profile(profile) => self.add(profile),
        }
    }

    fn add(&mut self, profile: &Profile) {
        let of =
            |pieces: &VecDeque<Piece>, segment: u64| pieces.iter().position(|piece| piece.segment == segment);
        let Some(index) = of(&self.planned, profile.segment) else {
            return;
        };
        let next_limit = self.planned.get(index + 1).and_then(|next| next.speed_limit);
        let most = self
            .corner
            .filter(|_| self.passed.is_none())
            .map(|corner| corner.distance_mm);
        let corner_mm = profile.corner_distance(most.unwrap_or(CORNER_MIN_MM));
        let piece = &mut self.planned[index];
        piece.corner_mm = corner_mm.or(piece.corner_mm);
        if let Some(distance_mm) = corner_mm
            && self.corner.is_none_or(|corner| corner.distance_mm < distance_mm)
        {
            self.corner = Some(CornerDistance {
                distance_mm,
                program: piece.origin.program,
                line: piece.origin.line,
            });
        }
        // The duration of a profile with a pace is plan time, which runs faster by the factor `of_pace`.
        let (block, of_pace) = match &profile.law {
            Law::Ramped { block, .. } => (Some(FeedMotion::Ramped(block)), 1.0),
            Law::Paced { block, pace } => {
                let block = match block {
                    PacedMotion::Ramped(block) => FeedMotion::Ramped(block),
                    PacedMotion::Smoothed(part) => FeedMotion::Smoothed(part),
                };
                (Some(block), pace.feed_override)
            }
            _ => (None, self.feed_override),
        };
        let scale = of_pace / self.feed_override;
        piece.duration_s += profile.duration_s * scale;
        piece.stops = profile.exact_stop;
        piece.target = (!matches!(profile.law, Law::Skip { .. })).then(|| profile.target());
        if let (Some(block), Some(limit)) = (block, piece.speed_limit) {
            let limits = [limit, next_limit.unwrap_or(limit)].map(|limit| limit * of_pace);
            let lost_s = lost(profile, block, limits);
            for (sum, lost_s) in piece.lost_s.iter_mut().zip(lost_s) {
                *sum += lost_s * scale;
            }
        }
    }

    /// Records that the program waits for an output or is paused.
    pub fn wait(&mut self) {
        self.waited = true;
    }

    /// Records that the servo has reached this segment at the time `now_s`.
    pub fn reach(&mut self, segment: u64, now_s: f64) {
        while self.planned.front().is_some_and(|piece| piece.segment <= segment) {
            self.begin_piece(now_s);
            if self.planned.front().is_some_and(|piece| piece.segment == segment) {
                return;
            }
            self.pass();
        }
    }

    /// Records the end of the run.
    pub fn end_run(&mut self) {
        while self.planned.front().is_some_and(|piece| piece.begun.is_some()) {
            self.pass();
        }
        self.planned.clear();
        self.before = None;
    }

    /// Returns the end of the last passed block in machine coordinates; `None` if the end was not known in
    /// advance.
    pub fn target(&self) -> Option<AxisVector> {
        self.before.as_ref()?.target
    }

    /// Returns the end of the block that began at this place. The blocks before it are discarded.
    pub fn end_of(&mut self, program: u16, line: u32) -> Option<PassedBlock> {
        let passed = self.passed.as_mut()?;
        let is_here = |block: &PassedBlock| (block.origin.program, block.origin.line) == (program, line);
        let first = passed.iter().position(is_here)?;
        passed.drain(..first);
        let mut end = passed.pop_front()?;
        while let Some(next) = passed.pop_front_if(|next| next.serial == end.serial) {
            end = next;
        }
        Some(end)
    }

    fn begin_piece(&mut self, now_s: f64) {
        let (began_s, passed_s) = self.chain;
        let Some(piece) = self.planned.front_mut().filter(|piece| piece.begun.is_none()) else {
            return;
        };
        let stands = self.before.as_ref().is_none_or(|before| before.stops);
        let waited = std::mem::take(&mut self.waited);
        let rested_s = if stands { now_s - began_s - passed_s } else { 0.0 };
        piece.begun = Some((!waited, rested_s));
        if stands {
            self.chain = (now_s, 0.0);
        }
    }

    fn pass(&mut self) {
        let Some(piece) = self.planned.pop_front() else {
            return;
        };
        self.chain.1 += piece.duration_s;
        if let Some(passed) = &mut self.passed {
            passed.push_back(PassedBlock {
                serial: piece.serial,
                origin: piece.origin,
                target: piece.target,
                corner_mm: piece.corner_mm,
            });
        }
        if let (Some(before), Some((true, rested_s))) = (&self.before, piece.begun)
            && before.speed_limit.is_some()
            && piece.speed_limit.is_some()
        {
            let lost_s = before.lost_s[1] + rested_s + piece.lost_s[0];
            let place = if before.stops {
                &mut self.stops
            } else {
                &mut self.corners
            };
            place.add(before.origin, lost_s);
        }
        self.before = Some(piece);
    }
}

/// Motion of a block at feedrate, in plan time.
#[derive(Debug, Clone, Copy)]
enum FeedMotion<'a> {
    Ramped(&'a RampedMotion),
    Smoothed(&'a CubicMotion),
}

impl FeedMotion<'_> {
    /// Returns the distances covered at a plan time along the block and along the next block.
    fn covered(self, plan_s: f64) -> [f64; 2] {
        match self {
            Self::Ramped(block) => {
                let (own, next_s) = block.covered_distances(plan_s);
                let next_speed = block.next.as_ref().map_or(0.0, |next| next.speed);
                [own, next_s * next_speed]
            }
            Self::Smoothed(part) => [plan_s * part.speed, 0.0],
        }
    }

    /// Returns the plan time at the middle of the block's length, s.
    fn middle_s(self) -> f64 {
        let block = match self {
            Self::Smoothed(part) => return part.plan_s / 2.0,
            Self::Ramped(block) => block,
        };
        // Between its ramps the block has covered its speed times the time, less half of the first ramp.
        let half = block.path.length() / 2.0;
        let even_s = half / block.speed + block.start.duration_s() / 2.0 - block.begun_s;
        let [begin_s, end_s] = [
            block.start.duration_s() - block.begun_s,
            block.plan_s - block.stop.duration_s(),
        ];
        if (begin_s..=end_s).contains(&even_s) {
            even_s
        } else {
            bisect([0.0, block.plan_s], HALVINGS, |plan_s| {
                self.covered(plan_s)[0] < half
            })[0]
        }
    }
}

/// Returns the loss in the first and in the second half of a block's length. The loss is the time of the
/// profile minus the time of the same path at the speed limits of this block and of the next one.
fn lost(profile: &Profile, block: FeedMotion<'_>, [own_limit, next_limit]: [f64; 2]) -> [f64; 2] {
    let best_s = |plan_s: f64| {
        let [own, next] = block.covered(plan_s);
        own / own_limit + next / next_limit
    };
    let end_s = profile.duration_s;
    let ends = [0.0, end_s].map(|t_s| profile.plan_time(t_s));
    let middle = block.middle_s();
    let middle_s = if ends[1] <= middle {
        end_s
    } else if ends[0] >= middle {
        0.0
    } else {
        match &profile.law {
            Law::Paced { pace, .. } => pace.when(middle).map_or(0.0, |(t_s, _)| t_s),
            _ => middle,
        }
    };
    let [from, half, to] = [ends[0], middle.clamp(ends[0], ends[1]), ends[1]].map(best_s);
    [middle_s - (half - from), end_s - middle_s - (to - half)]
}
