//! A part of a block on a smoothed path: each axis is a polynomial of third degree in plan time.

use crate::axis::AxisVector;

/// A part of a block whose path was smoothed within `path_tolerance`. Plan time runs at the speed of the block, so it is
/// the distance along the programmed path divided by that speed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CubicMotion {
    /// Programmed start and end of the block, machine coordinates.
    pub programmed: [AxisVector; 2],
    /// Speed of the block, path units per second of plan time.
    pub speed: f64,
    /// Plan time within the block at the start of this part, s.
    pub from_s: f64,
    /// Plan time within the block at the end of this part, s.
    pub to_s: f64,
    /// Position, and its first to third derivative with respect to plan time, at the start of this part.
    pub derivatives: [AxisVector; 4],
    /// Plan time at the end of the block, s.
    pub plan_s: f64,
    /// True if the motion ends at rest at the programmed end of the block.
    pub ends_at_rest: bool,
}

impl CubicMotion {
    /// Returns the machine position at a plan time within this part. The end of a chain is exact.
    pub fn position(&self, plan_s: f64) -> AxisVector {
        if self.ends_at_rest && plan_s >= self.plan_s {
            return self.programmed[1];
        }
        let t = plan_s - self.from_s;
        let [position, first, second, third] = &self.derivatives;
        let (half, sixth) = (t / 2.0, t / 3.0);
        AxisVector(std::array::from_fn(|i| {
            position.0[i] + t * (first.0[i] + half * (second.0[i] + sixth * third.0[i]))
        }))
    }

    /// Returns the distance, over X, Y and Z, of the path from the programmed end of the block, for the part at that
    /// end, mm.
    pub fn corner_distance(&self) -> f64 {
        self.position(self.plan_s)
            .minus(self.programmed[1])
            .orthogonal_length()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_position_is_the_taylor_polynomial_at_the_start_of_the_part() {
        let axis = |value| {
            let mut vector = AxisVector::ZERO;
            vector.0[1] = value;
            vector
        };
        let motion = CubicMotion {
            programmed: [AxisVector::ZERO, axis(100.0)],
            speed: 10.0,
            from_s: 2.0,
            to_s: 4.0,
            derivatives: [axis(1.0), axis(2.0), axis(3.0), axis(12.0)],
            plan_s: 4.0,
            ends_at_rest: true,
        };
        // 1 + 2 t + 3/2 t^2 + 2 t^3 at t = 1
        assert!((motion.position(3.0).0[1] - 6.5).abs() < 1e-12);
        assert!((motion.position(4.0).0[1] - 100.0).abs() < 1e-12);
    }
}
