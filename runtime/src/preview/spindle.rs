//! Calculates the time for which a rehearsal waits for the spindle, if the stock sequence program turns it.
//! The override is 100 percent.

use plc_protocol::types::state::SpindleDirection;
use tandem_model::settings::MotorSettings;

/// A planned spindle, which changes its speed with the full acceleration of its motor.
#[derive(Debug)]
pub(super) struct PlannedSpindle {
    /// Acceleration, r/min per second.
    acceleration: f64,
    max_rpm: f64,
    /// Largest difference from the commanded speed, as a share of it, at which the speed is treated as reached.
    within: f64,
    /// Signed speed at the time `at_s`, and the target speed, r/min.
    rpm: f64,
    target_rpm: f64,
    at_s: f64,
}

impl PlannedSpindle {
    /// Creates a spindle at rest.
    pub fn new(motor: &MotorSettings) -> Self {
        Self {
            acceleration: motor.max_acceleration,
            max_rpm: motor.max_velocity.max(0.0),
            within: motor.at_speed_percent / 100.0,
            rpm: 0.0,
            target_rpm: 0.0,
            at_s: 0.0,
        }
    }

    /// Commands a speed at the time `at_s`, and returns the time in s until the spindle reaches it.
    pub fn command(&mut self, direction: SpindleDirection, rpm: f64, at_s: f64) -> f64 {
        let most = self.acceleration * (at_s - self.at_s).max(0.0);
        self.rpm += (self.target_rpm - self.rpm).clamp(-most, most);
        self.at_s = at_s;
        let speed = rpm.abs().min(self.max_rpm);
        self.target_rpm = match direction {
            SpindleDirection::Cw => speed,
            SpindleDirection::Ccw => -speed,
            SpindleDirection::Stop | SpindleDirection::Orient => 0.0,
        };
        let away = (self.target_rpm - self.rpm).abs() - self.within * self.target_rpm.abs();
        (away / self.acceleration).max(0.0)
    }

    /// Applies a changed S word, if the spindle turns.
    pub fn follow(&mut self, rpm: f64, at_s: f64) {
        let direction = if self.target_rpm > 0.0 {
            SpindleDirection::Cw
        } else {
            SpindleDirection::Ccw
        };
        if self.target_rpm.abs() > 0.0 {
            self.command(direction, rpm, at_s);
        }
    }
}

#[cfg(test)]
mod tests {
    use tandem_model::settings::MotorKind;

    use super::*;

    #[test]
    fn a_planned_spindle_takes_the_time_of_its_acceleration() {
        let motor = MotorSettings::new(4, MotorKind::Spindle, 3000.0, 1000.0);
        let mut spindle = PlannedSpindle::new(&motor);
        for (direction, rpm, at_s, wait_s) in [
            (SpindleDirection::Cw, 2000.0, 0.0, 1.8),
            (SpindleDirection::Cw, 2000.0, 5.0, 0.0),
            (SpindleDirection::Ccw, 1000.0, 5.0, 2.9),
            // Half a second after the previous command, the spindle has slowed from 2000 to 1500 r/min.
            (SpindleDirection::Stop, 0.0, 5.5, 1.5),
            (SpindleDirection::Stop, 0.0, 9.0, 0.0),
            (SpindleDirection::Cw, 0.0, 9.0, 0.0),
            (SpindleDirection::Cw, 9000.0, 9.0, 2.7),
        ] {
            let waits_s = spindle.command(direction, rpm, at_s);
            assert!(
                (waits_s - wait_s).abs() < 1e-9,
                "{direction:?} {rpm} at {at_s}: {waits_s}"
            );
        }
        spindle.follow(1000.0, 20.0);
        assert!((spindle.command(SpindleDirection::Stop, 0.0, 30.0) - 1.0).abs() < 1e-9);
        spindle.follow(1000.0, 40.0);
        assert!(
            spindle.command(SpindleDirection::Stop, 0.0, 50.0) < 1e-9,
            "S does not start a spindle at rest"
        );
    }
}
