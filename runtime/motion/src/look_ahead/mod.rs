//! Look-ahead, G64 with G500 (M1d): a chain keeps its path, and slows down before a motor would exceed its
//! maximum acceleration. The deceleration extends over as many blocks as necessary.
//!
//! The motion is `q(t) = q501(tau(t))` with a rate `tau' <= o`, whose square x is linear in tau on each
//! piece. Here o is the feed override. On a ramp from rest or to rest the rate may be up to 1 while the speed is
//! at most o times F.
//! A backward pass starts at the end of the known blocks. At the start of each piece it finds the largest x
//! from which the machine can still stop at that end; a second pass assumes no stop at that end. Where both
//! passes agree, no later block can change the preceding plan. The plan is final up to this point, and a
//! forward pass gives the largest rate. A backward pass starts only when the number of new blocks reaches the
//! number of blocks that are not final. So the cost of a block does not depend on the reach of look-ahead.
//!
//! A piece is halved, as long as this gains time, in two cases: the velocity would change at a constant rate,
//! or the rate could be higher at its end than at its start. On a ramp between blocks of different speeds the
//! rate is measured by distance ([`course`]) where this is faster than by plan time. The backward pass does
//! not know the speed at which the motion arrives. It may therefore divide a corner into thousands of pieces
//! for a rate that never occurs. The forward pass joins pieces where a single step is as fast.
//!
//! Maximum velocities hold because the rate is at most 1, or at most the value that the velocities of a block
//! allow.
//!
//! If a motor has a `max_jerk`, [`jerk`] plans the motion instead. [`crate::ramped`] has already lengthened the ramps of a line
//! from rest and to rest, so that they keep it.

mod blended_block;
mod braking;
mod course;
mod grid;
mod held_block;
mod jerk;
mod limits;
mod paced;
mod piece;
mod rate;
mod step;
mod straight;
mod way;

use std::collections::VecDeque;

use tandem_model::profile::{Law, Profile};
use tandem_model::settings::CoordinateSystemSettings;

pub(crate) use self::blended_block::Passage;
use self::braking::Braking;
use self::held_block::HeldBlock;
use self::jerk::{Begins, Ends, JerkPlan};
use self::limits::{HalfPlane, Motors, SQUARE_MIN};
use self::piece::Piece;
use self::step::RateStep;
use self::way::Way;
use crate::block::PlannedBlock;
use crate::record::{Entry, Record};

/// The largest feed override.
pub(crate) const FEED_OVERRIDE_MAX: f64 = 2.0;

/// The smallest feed override for which motion is planned. At a smaller override, the servo scales the time of the
/// plan.
pub(crate) const FEED_OVERRIDE_MIN: f64 = 0.01;

/// Value of the square of the rate that means no limit.
const SQUARE_MAX: f64 = FEED_OVERRIDE_MAX * FEED_OVERRIDE_MAX;

/// Maximum number of blocks held back. If these blocks are too short for a stop within them, the first half
/// is slowed down to the speed from which the second half can stop.
pub(crate) const BLOCKS_MAX: usize = 16_384;

/// Maximum number of pieces of blocks held back, about 24 MB. If the blocks need more pieces, the first half
/// is slowed down to the speed from which the second half can stop.
const HELD_PIECES_MAX: usize = 200_000;

/// Minimum number of new blocks that are planned at a time.
const BLOCKS_MIN: usize = 128;

/// Number of consecutive blocks that take at least [`IN_A_ROW_PERIODS`] servo periods, so that at most 128
/// blocks pass in one period. If the blocks would take less, the rate is lowered.
const IN_A_ROW: usize = 64;
const IN_A_ROW_PERIODS: f64 = 0.5;

/// Relative difference below which two limits of x are treated as equal: 0.05 percent of the rate.
const MET: f64 = 1e-3;

/// The blocks of a chain whose rate is not final.
#[derive(Debug, Clone)]
pub(crate) struct LookAhead {
    motors: Motors,
    /// Feed override for further blocks.
    feed_override: f64,
    blocks: VecDeque<HeldBlock>,
    pieces: VecDeque<Piece>,
    /// Plan times of the last [`IN_A_ROW`] blocks of the chain, s.
    in_a_row: VecDeque<f64>,
    /// Number of blocks that an earlier backward pass has included.
    seen: usize,
    /// Square of the rate at the start of the first block. If `None`, only the limit of that block applies,
    /// because the path is at rest there.
    square: Option<f64>,
    braking: Braking,
    /// The motion along a smoothed path, if a motor has a maximum jerk.
    jerk: JerkPlan,
    /// Ranges of the blocks in `blocks` that `jerk` knows, as distances along the chain.
    ranges: VecDeque<[f64; 2]>,
    planes: Vec<HalfPlane>,
    renewed: Vec<Piece>,
    cut: Vec<Piece>,
    steps: Vec<RateStep>,
}

impl LookAhead {
    pub(crate) fn new(settings: &CoordinateSystemSettings) -> Self {
        Self::empty(Motors::new(settings), 1.0)
    }

    /// Returns a look-ahead without blocks, with the same limits and override.
    pub(crate) fn emptied(&self) -> Self {
        Self::empty(self.motors, self.feed_override)
    }

    fn empty(motors: Motors, feed_override: f64) -> Self {
        Self {
            motors,
            feed_override,
            blocks: VecDeque::new(),
            pieces: VecDeque::new(),
            in_a_row: VecDeque::new(),
            seen: 0,
            square: None,
            braking: Braking::default(),
            jerk: JerkPlan::default(),
            ranges: VecDeque::new(),
            planes: Vec::new(),
            renewed: Vec::new(),
            cut: Vec::new(),
            steps: Vec::new(),
        }
    }

    pub(crate) fn clear(&mut self) {
        self.blocks.clear();
        self.pieces.clear();
        self.in_a_row.clear();
        self.seen = 0;
        self.square = None;
        self.jerk = JerkPlan::default();
        self.ranges.clear();
    }

    /// Sets the override for which further blocks are planned.
    pub(crate) fn set_feed_override(&mut self, factor: f64) {
        self.feed_override = factor.clamp(FEED_OVERRIDE_MIN, FEED_OVERRIDE_MAX);
    }

    /// Returns the blocks whose rate is not final.
    pub(crate) fn blocks(&self) -> impl Iterator<Item = &PlannedBlock> {
        self.blocks.iter().map(|held| &held.block)
    }

    /// Begins a chain at rest, although the planned path moves at this point. The next block has the number
    /// `segment`.
    pub(crate) fn begin_at_rest(&mut self, segment: u64, is_backward: bool) {
        self.square = Some(SQUARE_MIN);
        self.braking.start_chain(segment, is_backward);
    }

    /// Adds the next block of a chain, and outputs the blocks that are final. A block that ends at rest ends
    /// the chain.
    pub(crate) fn push(&mut self, block: PlannedBlock, record: &mut Record, out: &mut VecDeque<Profile>) {
        let is_last = block.ends_at_rest();
        self.pass(block, Passage::default(), is_last, record, out);
    }

    /// Adds the next block of a chain with its passage. The last block ends at rest even if its path
    /// continues.
    pub(crate) fn pass(
        &mut self,
        block: PlannedBlock,
        passage: Passage,
        is_last: bool,
        record: &mut Record,
        out: &mut VecDeque<Profile>,
    ) {
        let way = Way::new(&block.motion, passage);
        if self.blocks.is_empty() && self.square.is_none() {
            let moves = !passage.is_backward && !block.begins_at_rest(passage.from_s);
            if !way.has_ramps() && !moves {
                self.square = Some(SQUARE_MIN);
            }
            self.jerk = JerkPlan::new(match (moves, way.has_ramps()) {
                (true, _) => Begins::Moving,
                (false, true) => Begins::OnRamp,
                (false, false) => Begins::AtRest,
            });
            self.braking.start_chain(block.segment, passage.is_backward);
        }
        let cap = self.cap(way.plan_s());
        let (limits_jerk, plan_s) = (self.motors.has_jerk, way.plan_s());
        let pieces = if limits_jerk {
            0
        } else {
            grid::cut(&way, way.bounds(&self.motors, cap), &mut self.pieces)
        };
        let comes_to_rest = if passage.is_backward {
            block.begins_at_rest(0.0)
        } else {
            block.ends_at_rest()
        };
        let rests = way.has_ramps() && comes_to_rest;
        self.blocks.push_back(HeldBlock {
            block,
            passage,
            is_last,
            feed_override: self.feed_override,
            pieces,
            cap,
        });
        let is_due = if limits_jerk {
            self.jerk
                .is_due(plan_s, self.blocks.len() - self.seen, self.seen, &self.motors)
        } else {
            self.blocks.len() - self.seen >= self.seen.max(BLOCKS_MIN)
        };
        if is_last {
            self.plan(Some(if rests { SQUARE_MAX } else { 0.0 }), record, out);
            self.clear();
        } else if is_due || self.is_full() {
            self.plan(None, record, out);
        }
    }

    /// Returns the largest square of the rate in the next block of the chain, which has this plan time.
    fn cap(&mut self, plan_s: f64) -> f64 {
        if self.in_a_row.len() == IN_A_ROW {
            self.in_a_row.pop_front();
        }
        self.in_a_row.push_back(plan_s);
        let least_s = IN_A_ROW_PERIODS * self.motors.period_s;
        let alone = plan_s * IN_A_ROW as f64 / least_s;
        let most = self.feed_override;
        if alone >= most || self.in_a_row.len() < IN_A_ROW {
            return most * most;
        }
        let whole_s: f64 = self.in_a_row.iter().sum();
        (whole_s / least_s).min(most).powi(2)
    }

    /// Returns true if look-ahead can hold no further blocks.
    fn is_full(&self) -> bool {
        self.blocks.len() >= BLOCKS_MAX || self.pieces.len() + self.jerk.cells() >= HELD_PIECES_MAX
    }

    /// Outputs the blocks that are final. `end` is the largest square of the rate at the end of the chain,
    /// `None` if more blocks follow.
    fn plan(&mut self, end: Option<f64>, record: &mut Record, out: &mut VecDeque<Profile>) {
        let limits_jerk = self.motors.has_jerk;
        let mut finals = if limits_jerk {
            self.plan_within_jerk(end)
        } else {
            self.pass_back(end)
        };
        let half = self.blocks.len() / 2;
        if !limits_jerk && (self.blocks.len() - finals >= BLOCKS_MAX || self.pieces.len() >= HELD_PIECES_MAX)
        {
            finals = finals.max(half);
        }
        let first = out.len();
        for block in 0..finals {
            if limits_jerk {
                self.release_within_jerk(block, out);
            } else {
                self.release_block(block, end.unwrap_or(SQUARE_MAX), out);
            }
            if block % BLOCKS_MIN == 0 {
                self.braking.free(self.motors.period_s);
            }
        }
        self.ranges.drain(..finals.min(self.ranges.len()));
        record.extend(self.blocks.drain(..finals).map(|held| Entry::Paced(held.block)));
        self.seen = self.blocks.len();
        // The last profile tells the servo how far the motion may continue when all these profiles are known.
        if let Some(last) = out.range_mut(first..).next_back()
            && let Law::Paced { pace, .. } = &mut last.law
        {
            if end.is_some() {
                self.braking.end_chain(last.segment);
            } else {
                self.braking.free(self.motors.period_s);
            }
            pace.free_to = self.braking.free_to;
        }
    }

    /// Plans the motion within the maximum jerks. Returns the number of leading blocks that are final.
    fn plan_within_jerk(&mut self, end: Option<f64>) -> usize {
        let known = self.ranges.len();
        let ends = match end {
            None => Ends::Open,
            Some(square) if square > 0.0 => Ends::OnRamp,
            Some(_) => Ends::AtRest,
        };
        let is_end = end.is_some();
        let new = self.jerk.extend(self.blocks.range(known..), ends, &self.motors);
        self.ranges.extend(new);
        let mut place = self.jerk.finish(is_end, &self.motors);
        if self.is_full() && !is_end {
            place = self.jerk.finish_half();
        }
        self.ranges.partition_point(|[_, to]| *to <= place)
    }

    /// Outputs a final block.
    fn release_within_jerk(&mut self, block: usize, out: &mut VecDeque<Profile>) {
        let (Some(held), Some(range)) = (self.blocks.get(block), self.ranges.get(block)) else {
            return;
        };
        self.steps.clear();
        self.jerk.steps(held, *range, &mut self.steps);
        paced::profiles(held, &self.steps, self.braking.free_to, out);
        let steps = self.steps.iter().map(|step| (step.duration_s(), step.room));
        self.braking.add(held.block.segment, steps, self.motors.period_s);
    }

    /// Finds the limits of x backward from the end. Returns the number of leading blocks that are final.
    fn pass_back(&mut self, end: Option<f64>) -> usize {
        let [mut to_rest, mut open] = end.map_or([0.0, SQUARE_MAX], |end| [end; 2]);
        let mut finals = None;
        let mut i = self.pieces.len();
        self.renewed.clear();
        for block in (0..self.blocks.len()).rev() {
            let square_of_next = match [self.blocks.get(block), self.blocks.get(block + 1)] {
                [Some(held), Some(next)] => held.square_of_next(next),
                _ => 1.0,
            };
            [to_rest, open] = [to_rest, open].map(|square| square * square_of_next);
            let Some(held) = self.blocks.get_mut(block) else {
                break;
            };
            if finals.is_none() && open <= to_rest * (1.0 + MET) {
                finals = Some(block + 1);
            }
            let mut task = held.limits(&self.motors, &mut self.planes);
            let first_of_block = self.renewed.len();
            let mut unchanged = false;
            for _ in 0..held.pieces {
                i -= 1;
                let Some(piece) = self.pieces.get(i) else { break };
                let first = self.renewed.len();
                let before = task.renew(piece, to_rest, &mut self.renewed);
                unchanged = before.to_bits() == piece.limit.to_bits();
                if finals.is_some() || open <= to_rest {
                    open = before;
                } else {
                    for piece in self.renewed.get(first..).unwrap_or(&[]) {
                        open = task.start(piece, open);
                    }
                }
                to_rest = before;
            }
            held.pieces = self.renewed.len() - first_of_block;
            if unchanged && finals.is_some() {
                break;
            }
        }
        self.pieces.truncate(i);
        self.pieces.extend(self.renewed.drain(..).rev());
        finals.unwrap_or(0)
    }

    /// Plans a final block forward, as fast as its limits allow. The pieces of earlier blocks are already
    /// removed.
    fn release_block(&mut self, block: usize, end: f64, out: &mut VecDeque<Profile>) {
        let Some(held) = self.blocks.get(block) else {
            return;
        };
        self.steps.clear();
        let next = self.blocks.get(block + 1);
        let square_of_next = next.map_or(1.0, |next| held.square_of_next(next));
        let mut task = held.limits(&self.motors, &mut self.planes);
        let mut left = held.pieces;
        while let Some(first) = self.pieces.front().filter(|_| left > 0) {
            let cut = self.pieces.iter().take(left);
            let count = cut.take_while(|piece| piece.is_cut_with(first)).count().max(1);
            let before = self.square.unwrap_or(first.limit).min(first.limit);
            left -= count;
            self.cut.clear();
            self.cut.extend(self.pieces.drain(..count));
            let limit = match self.pieces.front() {
                Some(piece) if left > 0 => piece.limit,
                Some(of_next) => of_next.limit * square_of_next,
                None => end,
            };
            self.square = Some(task.pass_cut(&self.cut, before, limit, &mut self.steps));
        }
        self.square = self.square.map(|square| square / square_of_next);
        paced::profiles(held, &self.steps, self.braking.free_to, out);
        let steps = self.steps.iter().map(|step| (step.duration_s(), step.room));
        self.braking.add(held.block.segment, steps, self.motors.period_s);
    }
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use tandem_model::flow::{MultiBlock, Path, SegmentFeed};
    use tandem_model::plane::{Plane, Turn};
    use tandem_model::settings::{MotorKind, MotorSettings, ShortBlock};
    use tandem_model::{ArcPath, Axis, AxisVector, Origin};

    use super::*;
    use crate::block::ChainBlock;
    use crate::chain::Chain;
    use crate::ramped;

    /// Maximum acceleration of Z, mm/s^2.
    const OF_Z: f64 = 0.01;

    /// Period of the samples, s.
    const STEP_S: f64 = 0.005;

    /// Plans a thread along Z with a pitch of 0.1 mm. Each turn is a block of some thirty pieces; Z needs
    /// thousands of blocks to stop.
    fn thread(turns: u32, after_each: impl Fn(&LookAhead)) -> VecDeque<Profile> {
        let mut settings = CoordinateSystemSettings::default();
        for (axis, acceleration) in [(Axis::X, 1e5), (Axis::Y, 1e5), (Axis::Z, OF_Z)] {
            let motor = MotorSettings::new(1, MotorKind::Linear, 1e3, acceleration);
            settings.motors[axis.index()] = Some(motor);
        }
        let (mut chain, mut look_ahead) = (Chain::default(), LookAhead::new(&settings));
        let (mut record, mut out) = (Record::default(), VecDeque::new());
        let height = |turn: u32| {
            let mut at = AxisVector::ZERO;
            at[Axis::Z] = 0.1 * f64::from(turn);
            at
        };
        for turn in 0..turns {
            let arc = ArcPath::new(
                height(turn),
                height(turn + 1),
                Plane::Xy,
                [0.1, 0.0],
                Turn::Clockwise,
            );
            let path = Path::Arc(arc);
            let feed = SegmentFeed {
                feedrate_mm_min: if turn % 2 == 0 { 9000.0 } else { 4000.0 },
                ta_ms: 1.0,
                td_ms: 1.0,
                ts_ms: 0.3,
                ..SegmentFeed::default()
            };
            let block = ChainBlock {
                segment: u64::from(turn) + 1,
                epoch: 0,
                origin: Origin::default(),
                alone: ramped::plan(&settings, &path, feed, MultiBlock::On).unwrap(),
                path,
            };
            let push = |block| look_ahead.push(block, &mut record, &mut out);
            chain.push(ShortBlock::Shrink, block, push);
            after_each(&look_ahead);
        }
        let push = |block| look_ahead.push(block, &mut record, &mut out);
        chain.finish(ShortBlock::Shrink, push);
        out
    }

    #[test]
    fn m1d_more_pieces_than_look_ahead_holds_slow_down_and_keep_the_limits() {
        let most = Cell::new(0);
        let profiles = thread(15_000, |look_ahead| {
            most.set(most.get().max(look_ahead.pieces.len()));
        });
        let near = HELD_PIECES_MAX - 100..HELD_PIECES_MAX + 100;
        assert!(near.contains(&most.get()), "{} pieces", most.get());
        // A second difference is a mean of the acceleration.
        let (mut begin_s, mut samples) = (0.0, vec![0.0]);
        for profile in &profiles {
            while samples.len() as f64 * STEP_S < begin_s + profile.duration_s {
                let at = profile.position(samples.len() as f64 * STEP_S - begin_s);
                samples.push(at[Axis::Z]);
            }
            begin_s += profile.duration_s;
        }
        for (n, three) in samples.windows(3).enumerate() {
            let acceleration = (three[0] - 2.0 * three[1] + three[2]) / (STEP_S * STEP_S);
            let at_s = (n + 1) as f64 * STEP_S;
            assert!(
                acceleration.abs() < OF_Z * (1.0 + 1e-5),
                "{acceleration} at {at_s} s"
            );
        }
        // The fastest motion accelerates for half of the 1500 mm and decelerates for the other half.
        let best_s = 2.0 * (1500.0 / OF_Z).sqrt();
        assert!(begin_s < 1.5 * best_s, "{begin_s} s, best {best_s} s");
    }
}
