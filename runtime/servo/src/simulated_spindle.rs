//! The simulated spindle: ramps to a commanded speed, orientation, and the phase lock of tapping.

use tandem_model::settings::MotorSettings;

use crate::brake::or_unlimited;
use crate::control::SpindleDirection;
use crate::spindle::{Orientation, Spindle, SpindleState, ThreadStep};

/// Degrees per second of one revolution per minute.
const DEGREES_PER_SECOND: f64 = 6.0;

/// Angle tolerance for rounding: a spindle that returns from a thread within it is at its orientation
/// position.
const ORIENTED_WITHIN_DEG: f64 = 1e-6;

/// A spindle whose speed changes by at most `max_acceleration` (r/min per second), or at once if that is not
/// above 0.
#[derive(Debug, Clone)]
pub struct SimulatedSpindle {
    period_s: f64,
    max_rpm: f64,
    /// Maximum acceleration, r/min per second; infinite for an immediate change of speed.
    acceleration: f64,
    orientation_rpm: f64,
    orientation_deg: f64,
    direction: SpindleDirection,
    /// Commanded speed, r/min, clockwise positive.
    target_rpm: f64,
    rpm: f64,
    /// Angle, degrees, 0 to below 360.
    angle_deg: f64,
    approach: Option<Approach>,
    oriented: bool,
    /// True if an orientation was commanded and has not ended.
    orienting: bool,
    /// The lock to the motion while a thread is cut.
    lock: Option<Lock>,
}

/// State of a spindle that follows a motion.
#[derive(Debug, Clone, Copy)]
struct Lock {
    /// Angle at the start of the move in the thread.
    from_deg: f64,
    /// Revolutions since that angle, clockwise positive.
    revolutions: f64,
}

/// The last turn of an orientation: first at orientation speed, then decelerating to rest at the position.
#[derive(Debug, Clone, Copy)]
struct Approach {
    from_deg: f64,
    /// Orientation speed, r/min, clockwise positive.
    rpm: f64,
    cruise_s: f64,
    braking_s: f64,
    cycles: u64,
}

impl SimulatedSpindle {
    /// Creates a spindle with the speeds, acceleration and orientation of its motor, at rest at angle 0.
    pub fn new(motor: &MotorSettings, period_s: f64) -> Self {
        Self {
            period_s,
            max_rpm: motor.max_velocity.max(0.0),
            acceleration: or_unlimited(motor.max_acceleration),
            orientation_rpm: motor.orientation_velocity.max(0.0),
            orientation_deg: motor.orientation_position.rem_euclid(360.0),
            direction: SpindleDirection::Stop,
            target_rpm: 0.0,
            rpm: 0.0,
            angle_deg: 0.0,
            approach: None,
            oriented: false,
            orienting: false,
            lock: None,
        }
    }

    /// Ends the lock after a finished or abandoned thread. The spindle is at rest, or with `brakes` brakes
    /// from its speed. It is oriented again if it has returned to its orientation position.
    fn release(&mut self, brakes: bool) {
        if self.lock.take().is_none() {
            return;
        }
        if !brakes {
            self.rpm = 0.0;
        }
        let off_deg = (self.angle_deg - self.orientation_deg + 540.0).rem_euclid(360.0) - 180.0;
        self.oriented &= self.rpm == 0.0 && off_deg.abs() <= ORIENTED_WITHIN_DEG;
        self.target_rpm = 0.0;
        if self.direction != SpindleDirection::Orient || !self.oriented {
            self.direction = SpindleDirection::Stop;
        }
    }

    /// Changes to orientation speed in the present direction of rotation; from rest, clockwise.
    fn begin_orientation(&mut self) {
        let rpm = if self.rpm < 0.0 {
            -self.orientation_rpm
        } else {
            self.orientation_rpm
        };
        self.slew(rpm);
        if (self.rpm - rpm).abs() > 0.0 {
            return;
        }
        let speed_deg_s = rpm.abs() * DEGREES_PER_SECOND;
        let braking_s = rpm.abs() / self.acceleration;
        let braking_deg = speed_deg_s * braking_s / 2.0;
        let ahead_deg = (self.orientation_deg - self.angle_deg) * 1.0_f64.copysign(rpm);
        let cruise_deg = (ahead_deg - braking_deg).rem_euclid(360.0);
        self.approach = Some(Approach {
            from_deg: self.angle_deg,
            rpm,
            // Without an orientation speed, the spindle is at the position at once.
            cruise_s: if speed_deg_s > 0.0 {
                cruise_deg / speed_deg_s
            } else {
                0.0
            },
            braking_s,
            cycles: 0,
        });
    }

    /// Executes one cycle of the last turn. Returns true if the spindle is at rest at its position.
    fn turn_to_position(&mut self, approach: &mut Approach) -> bool {
        approach.cycles += 1;
        let t_s = approach.cycles as f64 * self.period_s;
        let braked_s = (t_s - approach.cruise_s).max(0.0);
        if braked_s >= approach.braking_s && t_s >= approach.cruise_s {
            self.rpm = 0.0;
            self.angle_deg = self.orientation_deg;
            return true;
        }
        let slowed = braked_s / approach.braking_s.max(f64::MIN_POSITIVE);
        let turned_deg = approach.rpm * DEGREES_PER_SECOND * (t_s - braked_s * slowed / 2.0);
        self.rpm = approach.rpm * (1.0 - slowed);
        self.angle_deg = (approach.from_deg + turned_deg).rem_euclid(360.0);
        false
    }

    fn slew(&mut self, target_rpm: f64) {
        let most = self.acceleration * self.period_s;
        let before = self.rpm;
        let change = target_rpm - before;
        self.rpm = if change.abs() <= most {
            target_rpm
        } else {
            before + most.copysign(change)
        };
        let mean_deg_s = f64::midpoint(before, self.rpm) * DEGREES_PER_SECOND;
        self.angle_deg = (self.angle_deg + mean_deg_s * self.period_s).rem_euclid(360.0);
    }
}

impl Spindle for SimulatedSpindle {
    /// Does nothing: the simulated spindle always has power.
    fn power(&mut self, _enable: bool, _clear_fault: bool) {}

    fn command(&mut self, direction: SpindleDirection, rpm: f64) {
        let speed = if rpm.is_finite() {
            rpm.abs().min(self.max_rpm)
        } else {
            0.0
        };
        self.direction = direction;
        self.orienting = direction == SpindleDirection::Orient;
        self.target_rpm = match direction {
            SpindleDirection::Cw => speed,
            SpindleDirection::Ccw => -speed,
            SpindleDirection::Stop | SpindleDirection::Orient => 0.0,
        };
        if !self.orienting {
            self.approach = None;
            self.oriented &= self.target_rpm == 0.0;
        }
    }

    fn follow(&mut self, step: ThreadStep) {
        match step {
            ThreadStep::Begin => {
                self.lock = Some(Lock {
                    from_deg: self.angle_deg,
                    revolutions: 0.0,
                });
            }
            ThreadStep::Turn(revolutions) => {
                let Some(lock) = &mut self.lock else { return };
                let revolutions = revolutions.unwrap_or(lock.revolutions);
                let turned = revolutions - lock.revolutions;
                lock.revolutions = revolutions;
                self.rpm = turned / self.period_s * 60.0;
                self.angle_deg = (lock.from_deg + 360.0 * revolutions).rem_euclid(360.0);
            }
            ThreadStep::End { brakes } => self.release(brakes),
        }
    }

    fn cycle(&mut self) -> SpindleState {
        if self.lock.is_some() {
            return self.state();
        }
        if self.direction != SpindleDirection::Orient {
            self.slew(self.target_rpm);
        } else if let Some(mut approach) = self.approach.take() {
            self.oriented = self.turn_to_position(&mut approach);
            self.approach = (!self.oriented).then_some(approach);
        } else if !self.oriented {
            self.begin_orientation();
        }
        self.orienting &= !self.oriented;
        self.state()
    }

    fn state(&self) -> SpindleState {
        let orients = self.direction == SpindleDirection::Orient && !self.oriented;
        SpindleState {
            rpm: self.rpm,
            angle_deg: self.angle_deg,
            orientation: if self.orienting {
                Orientation::Pending
            } else if self.oriented && self.lock.is_none() {
                Orientation::Reached
            } else {
                Orientation::Open
            },
            rests: self.rpm == 0.0 && self.target_rpm == 0.0 && !orients,
            is_steady: match self.direction {
                SpindleDirection::Orient => self.oriented && !self.orienting,
                _ => self.rpm.to_bits() == self.target_rpm.to_bits(),
            },
            is_enabled: true,
            fault: 0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing;

    fn spindle() -> SimulatedSpindle {
        // 1000 r/min per second, 4000 r/min at most, orientation at 60 r/min to 90 degrees
        SimulatedSpindle::new(&testing::spindle(), 0.001)
    }

    /// Executes one cycle. Returns true if a commanded orientation ends in it.
    fn ends(spindle: &mut SimulatedSpindle) -> bool {
        let was_orienting = spindle.state().orientation == Orientation::Pending;
        let is_orienting = spindle.cycle().orientation == Orientation::Pending;
        was_orienting && !is_orienting
    }

    #[test]
    fn the_spindle_ramps_with_its_acceleration_and_keeps_its_maximum() {
        let mut spindle = spindle();
        spindle.command(SpindleDirection::Ccw, 500.0);
        for _ in 0..250 {
            spindle.cycle();
        }
        assert!((spindle.rpm + 250.0).abs() < 1e-9);
        spindle.command(SpindleDirection::Cw, 9000.0);
        for _ in 0..4250 {
            spindle.cycle();
        }
        assert!((spindle.rpm - 4000.0).abs() < 1e-9);
        spindle.command(SpindleDirection::Stop, 0.0);
        for _ in 0..4000 {
            spindle.cycle();
        }
        assert!(spindle.rpm.abs() < 1e-9);
    }

    #[test]
    fn a_speed_that_is_not_a_number_turns_nothing() {
        let mut spindle = spindle();
        spindle.command(SpindleDirection::Cw, f64::NAN);
        spindle.cycle();
        assert!(spindle.rpm.abs() < 1e-12);
    }

    #[test]
    fn orientation_ends_at_rest_at_its_position_in_every_direction() {
        for (direction, turning) in [
            (SpindleDirection::Cw, 777),
            (SpindleDirection::Ccw, 1234),
            (SpindleDirection::Stop, 5),
        ] {
            let mut spindle = spindle();
            spindle.command(direction, 2000.0);
            for _ in 0..turning {
                assert!(!ends(&mut spindle));
            }
            spindle.command(SpindleDirection::Orient, 0.0);
            // At most: 2 s to the orientation speed, one turn of 1 s, 0.06 s to rest.
            let (mut cycles, mut last_deg, mut widest) = (0, spindle.angle_deg, 0.0_f64);
            while !ends(&mut spindle) {
                cycles += 1;
                assert!(cycles < 3100);
                let step = (spindle.angle_deg - last_deg + 540.0).rem_euclid(360.0) - 180.0;
                last_deg = spindle.angle_deg;
                widest = widest.max(step.abs());
            }
            assert!(spindle.state().orientation == Orientation::Reached);
            assert!(spindle.rpm.abs() < 1e-12);
            assert!((spindle.angle_deg - 90.0).abs() < 1e-9);
            let last = (90.0 - last_deg + 540.0).rem_euclid(360.0) - 180.0;
            assert!(last.abs() <= 60.0 * 6.0 * 0.001, "no jump at the end: {last}");
            assert!(
                widest <= 2000.0 * 6.0 * 0.001 + 1e-9,
                "never faster than it turned: {widest}"
            );
        }
    }

    #[test]
    fn once_oriented_it_rests_whatever_speed_was_commanded_before() {
        let mut spindle = spindle();
        spindle.command(SpindleDirection::Cw, 500.0);
        for _ in 0..1000 {
            spindle.cycle();
        }
        spindle.command(SpindleDirection::Orient, 0.0);
        assert!(!spindle.state().rests);
        while !ends(&mut spindle) {}
        assert!(spindle.state().orientation == Orientation::Reached && spindle.state().rests);
    }

    #[test]
    fn a_second_orientation_at_the_position_ends_at_once_and_turning_ends_it() {
        let mut spindle = spindle();
        spindle.command(SpindleDirection::Orient, 0.0);
        while !ends(&mut spindle) {}
        assert!(!ends(&mut spindle), "told once");
        spindle.command(SpindleDirection::Orient, 0.0);
        assert!(ends(&mut spindle));
        spindle.command(SpindleDirection::Cw, 100.0);
        spindle.cycle();
        assert!(spindle.state().orientation != Orientation::Reached);
    }
}
