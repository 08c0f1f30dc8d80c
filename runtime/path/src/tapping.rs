//! Moves of a tapping cycle in the thread: along Z, with the revolutions of the spindle (M1h).

use tandem_model::alarm::{SPINDLE_SPEED_MISSING, TAP_OFF_AXIS, VALUE_OUT_OF_RANGE};
use tandem_model::flow::{
    AxisWords, Block, Distance, Segment, SegmentEnd, SegmentFeed, SegmentMotion, Tap, ThreadAhead,
};
use tandem_model::plane::Turn;
use tandem_model::{Alarm, Axis, AxisVector};

use crate::length::LENGTH_MIN;
use crate::stage::PathStage;

impl PathStage {
    /// Checks all holes of a cycle before its first motion. The first and the last hole suffice: all holes
    /// lie between them, since the transforms are linear.
    pub(crate) fn thread_ahead(&mut self, block: &Block, ahead: &ThreadAhead) -> Result<(), Alarm> {
        let before = (self.at, self.tool_shift);
        [1, ahead.repetitions].into_iter().try_for_each(|count| {
            let found = self.hole(block, ahead, count);
            (self.at, self.tool_shift) = before;
            found
        })
    }

    /// Checks the moves to hole number `count` of a cycle (from 1), into the hole, and back to the initial
    /// level.
    fn hole(&mut self, block: &Block, ahead: &ThreadAhead, count: u16) -> Result<(), Alarm> {
        let mut position = ahead.position;
        if position.distance == Distance::Incremental {
            position.values = position.values.scaled(f64::from(count));
        }
        self.check_move(block, &position)?;
        self.check_move(block, &ahead.r_point)?;
        self.thread(block, &ahead.tap)?;
        (ahead.initial.iter()).try_for_each(|level| self.check_move(block, level))
    }

    fn check_move(&mut self, block: &Block, words: &AxisWords) -> Result<(), Alarm> {
        let to = self.target(block, words)?;
        self.refuse_beyond(self.within_all_soft_limits(self.at, to), block.origin)?;
        self.at = to;
        self.arrived(block, words);
        Ok(())
    }

    /// Outputs a move in the thread.
    pub(crate) fn tap(&mut self, block: &Block, tap: &Tap, out: &mut Vec<Segment>) -> Result<(), Alarm> {
        let (to, feed, revolutions) = self.thread(block, tap)?;
        self.release(SegmentEnd::ExactStop, out);
        if (to[Axis::Z] - self.at[Axis::Z]).abs() >= LENGTH_MIN {
            let motion = SegmentMotion::Tap {
                from: self.at,
                to,
                feed,
                revolutions: match tap.turn {
                    Turn::Clockwise => revolutions,
                    Turn::CounterClockwise => -revolutions,
                },
                leg: tap.leg,
            };
            self.push_move_to_rest(block, motion, to, out);
        }
        self.arrived(block, &tap.target);
        Ok(())
    }

    /// Returns the end, the feedrate and the revolutions of a move in the thread from the present position.
    /// The revolutions have no sign: they are the machine's Z travel times S / F, whatever the transforms. If
    /// no spindle is locked to the move, they are 0.
    fn thread(&mut self, block: &Block, tap: &Tap) -> Result<(AxisVector, SegmentFeed, f64), Alarm> {
        let to = self.target(block, &tap.target)?;
        let aside = Axis::ALL
            .into_iter()
            .find(|&axis| axis != Axis::Z && (to[axis] - self.at[axis]).abs() >= LENGTH_MIN);
        if let Some(axis) = aside {
            let text = format!("The motion along Z would also move axis {}", axis.letter());
            return Err(Alarm::new(&TAP_OFF_AXIS, text));
        }
        self.refuse_beyond(self.within_all_soft_limits(self.at, to), block.origin)?;
        let feed = self.feed_in_force(block, false)?;
        let travel = (to[Axis::Z] - self.at[Axis::Z]).abs();
        let revolutions = match tap.spindle_speed_r_min {
            None => {
                self.as_fast_as_f(feed)?;
                0.0
            }
            Some(speed) if speed > 0.0 => travel * speed / feed.feedrate_mm_min,
            Some(speed) => {
                let text = format!("The spindle speed is {speed} r/min");
                return Err(Alarm::new(&SPINDLE_SPEED_MISSING, text).of_words("S"));
            }
        };
        Ok((to, feed, revolutions))
    }

    /// Rejects an F that Z cannot reach, if no spindle is locked to Z: the spindle would not slow down with
    /// Z, and the pitch would be wrong.
    fn as_fast_as_f(&self, feed: SegmentFeed) -> Result<(), Alarm> {
        let z = self.settings.motors[Axis::Z.index()].as_ref();
        let velocity = z.map_or(f64::INFINITY, |motor| motor.max_velocity);
        let most = (self.settings.max_feedrate_mm_min * feed.unit_mm).min(velocity * 60.0);
        let feedrate = feed.feedrate_mm_min;
        if feedrate <= most {
            return Ok(());
        }
        let text = format!(
            "F of {feedrate} mm/min is above the maximum of Z, {most} mm/min; without a spindle in the \
             coordinate system the thread would have another pitch"
        );
        Err(Alarm::new(&VALUE_OUT_OF_RANGE, text).of_words("F"))
    }
}
