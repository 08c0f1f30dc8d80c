//! What follows the setpoints: drives, and the simulated one.

use std::fmt;

/// The drive of one motor, as the servo cycle sees it. It must not allocate, lock or wait.
pub trait Drive: fmt::Debug + Send {
    /// Takes the commanded position of this cycle and gives the actual one, both mm or degrees.
    fn cycle(&mut self, command: f64) -> f64;

    /// True when the actual position is the command of the same cycle, whatever came before: simulated time may leave
    /// out cycles of such a drive.
    fn is_ideal(&self) -> bool {
        false
    }
}

/// A drive that follows its command as a first-order lag; with a lag of 0 it is ideal.
///
/// Between two cycles the command counts as a straight line, for which the step is exact: at constant velocity v
/// the following error settles at `v * lag`.
#[derive(Debug, Clone)]
pub struct SimulatedDrive {
    /// Lag over period.
    lag_periods: f64,
    /// Share of the error that is left after one period.
    decay: f64,
    command: f64,
    actual: f64,
}

impl SimulatedDrive {
    /// A drive at rest at a position. `lag_ms` is the time constant of its following error, at least 0.
    pub fn new(lag_ms: f64, period_s: f64, at: f64) -> Self {
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
        }
    }
}

impl Drive for SimulatedDrive {
    fn cycle(&mut self, command: f64) -> f64 {
        let step = command - self.command;
        // Error of a line command: it settles at step * lag_periods.
        let settled = step * self.lag_periods;
        let before = self.command - self.actual;
        let error = settled + (before - settled) * self.decay;
        self.command = command;
        self.actual = if self.decay > 0.0 {
            command - error
        } else {
            command
        };
        self.actual
    }

    fn is_ideal(&self) -> bool {
        self.lag_periods == 0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_ideal_drive_is_where_its_command_is() {
        let mut drive = SimulatedDrive::new(0.0, 0.001, 1.0);
        assert_eq!(drive.cycle(3.7).to_bits(), 3.7_f64.to_bits());
    }

    #[test]
    fn a_step_is_followed_with_the_time_constant() {
        // 10 ms lag, at rest on a new command: after 50 ms exp(-5) of the error is left.
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
