//! Joints: points of the path at which its second derivative steps.
//!
//! Between setpoints, a step of the acceleration has no finite jerk. The jerk of the setpoints is their third difference,
//! a weighted mean of the jerk over three servo periods T. A step D of the acceleration adds at most `3/4 D/T` to it. So at
//! a joint the acceleration of a motor may step by a share of `J T`, and in the cells next to the joint the motor uses only
//! the rest of its jerk J. Where joints follow each other in a time t below T, the step is at most that share of `J t`, so
//! that the mean of many steps is also within the share.
//!
//! At a joint, the acceleration along the path may step, too. Where the second derivative steps in the direction of the
//! path, as between two speeds on a line, both steps cancel.

use tandem_model::profile::JERK_RESERVE;
use tandem_model::{Axis, AxisVector};

use super::cell::{Cell, Room, Row};
use crate::limit::USED_WITHIN_JERK;
use crate::look_ahead::limits::Motors;

/// Largest share of the jerk that a step uses.
const SHARE: f64 = 0.5;

/// Smallest share of the jerk that is kept for a step, with which the speed along the path can follow.
const SHARE_MIN: f64 = 0.03;

/// Time before and after a joint in which the motion leaves room for its step, in servo periods: half of those in which a
/// step affects a third difference.
const ZONE: f64 = 1.5;

/// Square of the speed in this time, relative to that at the joint.
const FASTER: f64 = 2.0;

/// Share of the jerk below which a step at the largest speed is only rounding.
const SMOOTH: f64 = 0.01;

/// A step of the second derivative of the position with respect to distance.
#[derive(Debug, Clone, Copy)]
pub(super) struct Step {
    pub(super) change: AxisVector,
    /// Distance since the step before.
    pub(super) since: f64,
}

impl Step {
    pub(super) const NONE: Self = Self {
        change: AxisVector::ZERO,
        since: f64::INFINITY,
    };

    /// Returns true if the step is more than rounding at this square of the speed.
    pub(super) fn is_felt(&self, square: f64, motors: &Motors) -> bool {
        Joint::new(self, AxisVector::ZERO, square, motors).is_some()
    }
}

/// A joint between two cells.
#[derive(Debug, Clone)]
pub(super) struct Joint {
    rows: Vec<Row>,
    period_s: f64,
    /// Share of the jerk that the step may use.
    pub(super) share: f64,
    /// Largest square of the speed at which the step is within its share.
    pub(super) square_max: f64,
    /// The same where the acceleration along the path does not step.
    pub(super) square_even: f64,
}

impl Joint {
    /// Creates the joint of a step. `first` is the first derivative of the position, and `cap` the largest square of the
    /// speed. Returns `None` if the step is only rounding.
    pub(super) fn new(step: &Step, first: AxisVector, cap: f64, motors: &Motors) -> Option<Self> {
        if step.change == AxisVector::ZERO {
            return None;
        }
        let axes = Axis::ALL.map(|axis| {
            let inverse = motors.inverse_jerks[axis.index()]
                / (motors.period_s * USED_WITHIN_JERK * (1.0 - JERK_RESERVE));
            [step.change[axis] * inverse, first[axis] * inverse]
        });
        let largest =
            |of: &dyn Fn(f64, f64) -> f64| axes.iter().fold(0.0_f64, |most, [d, q]| most.max(of(*d, *q)));
        let even = largest(&|d, _| d.abs());
        if even * cap < SMOOTH {
            return None;
        }
        let [product, square] = axes.iter().fold([0.0; 2], |[product, square], [d, q]| {
            [product + d * q, square + q * q]
        });
        let factor = if square > 0.0 { product / square } else { 0.0 };
        let left = largest(&|d, q| (d - factor * q).abs());
        let share = (left * cap).clamp(SHARE_MIN, SHARE);
        let square_max =
            |most: f64| (share / most).min((share * step.since / (most * motors.period_s)).powf(2.0 / 3.0));
        let by_gap = motors.period_s / step.since;
        let rows = axes
            .iter()
            .filter(|[d, q]| *d != 0.0 || *q != 0.0)
            .map(|[d, q]| Row {
                at: 0.0,
                reach: 0.0,
                third: 0.0,
                second: d / share,
                first: 0.0,
                by_change: q / share,
                jerk: [d * by_gap / share, 0.0, q * by_gap / share],
            });
        Some(Self {
            rows: rows.collect(),
            share,
            period_s: motors.period_s,
            square_max: square_max(left).min(cap),
            square_even: square_max(even).min(cap),
        })
    }

    fn room(&self, cap: f64) -> Room {
        Room {
            left: 1.0 - self.share,
            zone: ZONE * self.period_s * (FASTER * self.square_max).min(cap).sqrt(),
        }
    }

    /// Leaves the jerk of the joint at an end of the path in the cells, which are in the order of their distance from it.
    pub(super) fn leave_room<'a>(&self, cells: impl Iterator<Item = &'a mut Cell>, at: f64) {
        self.room(f64::INFINITY).leave(cells, at);
    }

    /// Returns the joint as a cell of length 0 at a distance along the chain, with the largest square of the speed there.
    pub(super) fn cell(&self, at: f64, cap: f64) -> Cell {
        Cell {
            from: at,
            length: 0.0,
            rows: self.rows.clone(),
            caps: vec![[0.0, cap]],
            cap,
            limit: 1.0,
            jerk_left: 1.0,
            joint: Some(self.room(cap)),
        }
    }
}

/// Leaves the jerk of the joints in the cells near them.
pub(super) fn leave_room(cells: &mut [Cell]) {
    for k in 0..cells.len() {
        if let Some(room) = cells[k].joint {
            let at = cells[k].from;
            let (before, after) = cells.split_at_mut(k);
            room.leave(before.iter_mut().rev(), at);
            room.leave(after.iter_mut(), at);
        }
    }
}
