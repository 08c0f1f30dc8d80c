//! Simulated drives on one bus that never loses a frame.

use tandem_model::settings::CoordinateSystemSettings;

use crate::bus::{Command, CycleResult, DriveBus, Feedback};

/// Drives that follow their commands with the lag of their settings. At the start they are at rest at the
/// position of their settings. A drive that is not homed finds its reference when its faults are cleared.
#[derive(Debug)]
pub struct SimulatedBus {
    drives: Box<[SimulatedDrive]>,
}

impl SimulatedBus {
    /// Creates a bus with a drive for each motor of these coordinate systems.
    pub fn new<'a>(systems: impl IntoIterator<Item = &'a CoordinateSystemSettings>) -> Self {
        let drives = systems.into_iter().flat_map(|system| {
            let motors = system.motors.iter().flatten();
            motors.map(|motor| SimulatedDrive {
                is_homed: motor.is_homed_at_start,
                ..SimulatedDrive::new(motor.lag_ms, system.servo_period_s, motor.start_at)
            })
        });
        Self {
            drives: drives.collect(),
        }
    }

    /// Returns the reports of the motors at the start.
    pub fn feedback(&self) -> Vec<Feedback> {
        let drives = self.drives.iter();
        let feedback = drives.map(|drive| Feedback {
            is_homed: drive.is_homed,
            ..Feedback::following(drive.actual)
        });
        feedback.collect()
    }
}

impl DriveBus for SimulatedBus {
    fn exchange(&mut self, commands: &[Command], feedback: &mut [Feedback]) -> CycleResult {
        for ((drive, command), feedback) in self.drives.iter_mut().zip(commands).zip(feedback) {
            feedback.position = drive.cycle(command.position);
            drive.is_homed |= command.clear_fault;
            feedback.is_homed = drive.is_homed;
        }
        CycleResult::OnTime
    }

    fn keeps_speed(&self) -> bool {
        true
    }

    fn is_ideal(&self, place: usize) -> bool {
        self.drives
            .get(place)
            .is_some_and(|drive| drive.lag_periods == 0.0)
    }
}

/// A drive that follows its command as a first-order lag; with a lag of 0 it is ideal.
///
/// Between two cycles the command is treated as a straight line, for which the step is exact. At a constant
/// velocity v the following error settles at `v * lag`.
#[derive(Debug, Clone)]
struct SimulatedDrive {
    /// Lag divided by the servo period.
    lag_periods: f64,
    /// Share of the following error that remains after one period.
    decay: f64,
    command: f64,
    actual: f64,
    is_homed: bool,
}

impl SimulatedDrive {
    /// Creates a homed drive at rest at a position. `lag_ms` is the time constant of its following error, at
    /// least 0.
    fn new(lag_ms: f64, period_s: f64, at: f64) -> Self {
        let lag_periods = (lag_ms / 1000.0 / period_s).max(0.0);
        Self {
            lag_periods,
            decay: if lag_periods > 0.0 {
                (-1.0 / lag_periods).exp()
            } else {
                0.0
            },
            command: at,
            actual: at,
            is_homed: true,
        }
    }

    /// Sets the commanded position of this cycle, and returns the actual position.
    fn cycle(&mut self, command: f64) -> f64 {
        let step = command - self.command;
        // If the command changes by the same step in each cycle, the following error settles at step * lag_periods.
        let settled = step * self.lag_periods;
        let before = self.command - self.actual;
        let error = settled + (before - settled) * self.decay;
        self.command = command;
        self.actual = command - error;
        self.actual
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_ideal_drive_is_where_its_command_is() {
        let mut drive = SimulatedDrive::new(0.0, 0.001, 0.0);
        assert_eq!(drive.cycle(3.7).to_bits(), 3.7_f64.to_bits());
    }

    #[test]
    fn a_drive_starts_at_its_position_and_is_homed_by_a_reset() {
        let motor = tandem_model::settings::MotorSettings {
            start_at: 70.5,
            is_homed_at_start: false,
            ..crate::testing::motor(1)
        };
        let settings = CoordinateSystemSettings {
            motors: std::array::from_fn(|i| (i == 0).then(|| motor.clone())),
            servo_period_s: 0.001,
            ..CoordinateSystemSettings::default()
        };
        let mut bus = SimulatedBus::new([&settings]);
        let mut feedback = bus.feedback();
        assert_eq!((feedback[0].position, feedback[0].is_homed), (70.5, false));
        let mut command = Command {
            position: 70.5,
            enable: true,
            clear_fault: false,
        };
        bus.exchange(&[command], &mut feedback);
        assert!(!feedback[0].is_homed);
        command.clear_fault = true;
        bus.exchange(&[command], &mut feedback);
        assert_eq!((feedback[0].position, feedback[0].is_homed), (70.5, true));
    }

    #[test]
    fn a_step_is_followed_with_the_time_constant() {
        // 10 ms lag, constant command after a step: after 50 ms exp(-5) of the error remains.
        let mut drive = SimulatedDrive::new(10.0, 0.001, 0.0);
        drive.cycle(1.0);
        let first = 1.0 - drive.actual;
        for _ in 0..50 {
            drive.cycle(1.0);
        }
        assert!((1.0 - drive.actual - first * (-5.0_f64).exp()).abs() < 1e-12);
    }

    #[test]
    fn at_constant_velocity_the_following_error_is_velocity_times_lag() {
        let mut drive = SimulatedDrive::new(20.0, 0.001, 0.0);
        let mut command = 0.0;
        for k in 1..=2000 {
            command = 50.0 * f64::from(k) * 0.001;
            drive.cycle(command);
        }
        assert!((command - drive.actual - 50.0 * 0.020).abs() < 1e-9);
    }
}
