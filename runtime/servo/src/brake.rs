//! Abort: each motor brakes independently and leaves the path.

use tandem_model::{AXES_MAX, AxisVector};

/// Braking of each motor from its velocity to rest at its own deceleration, off the path.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Brake {
    from: AxisVector,
    velocity: AxisVector,
    /// Deceleration of each motor, above 0. A motor with an infinite value stops at once.
    deceleration: [f64; AXES_MAX],
    cycles: u64,
}

impl Brake {
    /// Creates the braking from velocities in units per second. A motor with a deceleration that is not above
    /// 0 stops at once.
    pub(crate) fn new(from: AxisVector, velocity: AxisVector, deceleration: [f64; AXES_MAX]) -> Self {
        Self {
            from,
            velocity,
            deceleration: deceleration.map(or_unlimited),
            cycles: 0,
        }
    }

    /// Returns the positions of the next cycle, and whether all motors are at rest there.
    pub(crate) fn cycle(&mut self, period_s: f64) -> (AxisVector, bool) {
        self.cycles += 1;
        let t_s = self.cycles as f64 * period_s;
        let mut at_rest = true;
        let mut position = self.from;
        for i in 0..AXES_MAX {
            let velocity = self.velocity.0[i];
            let braking_s = velocity.abs() / self.deceleration[i];
            if braking_s > 0.0 {
                at_rest &= t_s >= braking_s;
                let t_s = t_s.min(braking_s);
                position.0[i] += velocity * t_s * (1.0 - t_s / (2.0 * braking_s));
            }
        }
        (position, at_rest)
    }
}

/// Returns a limit above 0, or infinity for any other value.
pub(crate) fn or_unlimited(limit: f64) -> f64 {
    if limit > 0.0 { limit } else { f64::INFINITY }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_motor_stops_after_its_own_braking_distance() {
        // v^2/(2a): 100^2/2000 = 5 in 0.1 s; 50^2/10000 = 0.25 in 0.01 s
        let velocity = AxisVector([100.0, -50.0, 10.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        let deceleration = [1000.0, 5000.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0];
        let mut brake = Brake::new(AxisVector([1.0; AXES_MAX]), velocity, deceleration);
        let mut cycles = 0;
        let end = loop {
            let (position, at_rest) = brake.cycle(0.001);
            cycles += 1;
            if cycles == 50 {
                // v t - a t^2/2 at 0.05 s
                assert!((position.0[0] - (1.0 + 5.0 - 1.25)).abs() < 1e-12);
            }
            if at_rest {
                break position;
            }
        };
        assert!((100..=101).contains(&cycles));
        assert!((end.0[0] - 6.0).abs() < 1e-12);
        assert!((end.0[1] - 0.75).abs() < 1e-12);
        assert!((end.0[2] - 1.0).abs() < 1e-12, "no deceleration: at once");
    }

    #[test]
    fn motors_at_rest_need_no_braking() {
        let mut brake = Brake::new(AxisVector::ZERO, AxisVector::ZERO, [1.0; AXES_MAX]);
        assert_eq!(brake.cycle(0.001), (AxisVector::ZERO, true));
    }
}
