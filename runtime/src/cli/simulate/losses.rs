//! Calculates from the planned profiles the time that blocks at feedrate lose because motion stops or slows
//! down between them.

use std::collections::VecDeque;

use serde::Serialize;
use tandem_model::profile::{Law, Profile, RampedMotion};
use tandem_model::{AxisVector, Origin, bisect};
use tandem_runtime::simulation::PlannedMotion;

/// Number of bisections of a profile's time; after these, the result is exact to the last significant bits.
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

/// A segment that is planned and that the servo has not passed.
#[derive(Debug)]
struct Piece {
    segment: u64,
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
    pub stops: TransitionLoss,
    pub corners: TransitionLoss,
}

impl Losses {
    pub fn new(feed_override: f64) -> Self {
        Self {
            feed_override,
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
                origin: segment.origin,
                speed_limit,
                stops: true,
                duration_s: 0.0,
                lost_s: [0.0; 2],
                target: None,
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
        let piece = &mut self.planned[index];
        // The duration of a profile with a pace is plan time, which runs faster by the factor `of_pace`.
        let (block, of_pace) = match &profile.law {
            Law::Ramped { block, .. } => (Some(block), 1.0),
            Law::Paced { block, pace } => (Some(block), pace.feed_override),
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

/// Returns the loss in the first and in the second half of a block's length. The loss is the time of the
/// profile minus the time of the same path at the speed limits of this block and of the next one.
fn lost(profile: &Profile, block: &RampedMotion, [own_limit, next_limit]: [f64; 2]) -> [f64; 2] {
    let at = |t_s: f64| {
        let (gone, next_s) = block.covered_distances(profile.plan_time(t_s));
        let next_speed = block.next.as_ref().map_or(0.0, |next| next.speed);
        (gone, gone / own_limit + next_s * next_speed / next_limit)
    };
    let end_s = profile.duration_s;
    let middle = block.path.length() / 2.0;
    let middle_s = if at(end_s).0 <= middle {
        end_s
    } else {
        bisect([0.0, end_s], HALVINGS, |t_s| at(t_s).0 < middle)[0]
    };
    let [from, half, to] = [0.0, middle_s, end_s].map(|t_s| at(t_s).1);
    [middle_s - (half - from), end_s - middle_s - (to - half)]
}
