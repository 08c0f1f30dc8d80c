//! Power of a channel's drives. They are enabled before the first motion. A drive that fails, or a bus that is lost, brings
//! the channel to rest with a fault and takes the power off all of its drives, until a reset or the next motion enables them.
//!
//! ```text
//!                  motion                  all report that they follow
//!   Off, Tripped ----------> Enabling ------------------------------------> On
//!     Tripped      reset       |                                            |
//!        ^---------------------+--------------------------------------------+
//!                 not in time, a drive has a fault, the bus is lost
//! ```

use crate::brake::Brake;
use crate::bus::Command;
use crate::channel::Channel;
use crate::control::Fault;
use crate::motors::Power;

/// Time that drives have to be enabled in, their faults cleared included, s.
const ENABLING_S: f64 = 2.0;

impl Channel {
    /// True when the drives follow. Else they are enabled, or there is a fault, and motion waits.
    pub(crate) fn has_power(&mut self) -> bool {
        if self.power == Power::On {
            return true;
        }
        if self.power.is_enabling() {
            return false;
        }
        let elsewhere = self.motors.elsewhere(self.setpoint);
        if let Some(fault) = self.motors.trouble(self.bus_lost, false).or(elsewhere) {
            self.trip(fault);
            return false;
        }
        let is_on = self.motors.are_operational();
        self.power = if is_on {
            Power::On
        } else {
            Power::Enabling {
                cycles: 0,
                clears: false,
            }
        };
        is_on
    }

    /// A reset: takes effect when the channel rests.
    pub(crate) fn ask_for_reset(&mut self) {
        if let Power::Tripped { resets } = &mut self.power {
            *resets = true;
        }
    }

    /// At rest, behind a reset: clears the faults of the drives and enables them where they stand.
    pub(crate) fn reset_drives(&mut self) {
        if self.power == (Power::Tripped { resets: true }) {
            self.setpoint = self.motors.actual();
            self.power = Power::Enabling {
                cycles: 0,
                clears: true,
            };
        }
    }

    /// What all motors are to do alike. They have power until they have come to rest.
    pub(crate) fn of_all_drives(&self) -> Command {
        let is_off = matches!(self.power, Power::Off | Power::Tripped { .. });
        Command {
            position: 0.0,
            enable: !is_off || self.braking.is_some(),
            clear_fault: matches!(self.power, Power::Enabling { clears: true, .. }),
        }
    }

    /// True when the motors report what is expected of them.
    pub(crate) fn is_as_commanded(&self) -> bool {
        match self.power {
            Power::Off | Power::Tripped { .. } => true,
            Power::Enabling { .. } => false,
            Power::On => self.motors.are_operational() && self.bus_lost.is_none(),
        }
    }

    /// Looks at what the motors report otherwise.
    pub(crate) fn watch_drives(&mut self) {
        match &mut self.power {
            Power::Off | Power::Tripped { .. } => {}
            Power::Enabling { cycles, clears } => {
                *cycles += 1;
                let is_late = *cycles as f64 * self.period_s >= ENABLING_S;
                let clears = *clears && !is_late;
                if self.motors.are_operational() && self.bus_lost.is_none() {
                    self.power = Power::On;
                    self.told = true;
                } else if let Some(fault) = self.motors.trouble(self.bus_lost, is_late)
                    && !(clears && matches!(fault, Fault::DriveFault { .. }))
                {
                    self.trip(fault);
                }
            }
            Power::On => {
                if let Some(fault) = self.motors.trouble(self.bus_lost, true) {
                    self.trip(fault);
                }
            }
        }
    }

    /// The motors brake off the path; at rest they lose power.
    fn trip(&mut self, fault: Fault) {
        self.power = Power::Tripped { resets: false };
        if self.braking.is_none() {
            let deceleration = self.motors.deceleration();
            self.braking = Some(Brake::new(self.setpoint, self.velocity, deceleration));
        }
        self.leave_thread(true);
        self.fail(fault);
    }
}
