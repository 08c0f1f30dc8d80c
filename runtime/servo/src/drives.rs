//! The drives of a channel. If one of them has a fault, or the bus is lost, the channel brakes and the drives
//! lose power.

use tandem_model::AxisVector;

use crate::brake::Brake;
use crate::bus::Command;
use crate::channel::Channel;
use crate::control::{Event, Fault};
use crate::power::{Power, concerns_drives_without_power};
use crate::setpoint_history::History;

impl Channel {
    /// Returns true if the drives of the axes follow. If false, the drives are being enabled, or a fault
    /// exists, and motion waits.
    pub(crate) fn has_power(&mut self) -> bool {
        if !self.power.is_commanded() {
            let trouble = self.motors.trouble(self.bus_lost);
            let lacks_power = matches!(trouble, Some(Fault::NotEnabled { .. }));
            let fault = trouble.filter(|_| !lacks_power);
            if let Some(fault) = fault.or_else(|| self.motors.elsewhere(self.setpoint)) {
                self.trip(fault);
                return false;
            }
            self.power.ask(!lacks_power);
        }
        self.power == Power::On
    }

    /// Requests a reset, which takes effect when the channel is at rest.
    pub(crate) fn ask_for_reset(&mut self) {
        self.power.ask_for_reset();
        if let Some(spindle) = &mut self.spindle {
            spindle.ask_for_reset();
        }
    }

    /// Executes a requested reset at rest. The setpoint becomes the actual position of the motors.
    pub(crate) fn reset_drives(&mut self) {
        if self.power.reset() {
            self.setpoint = self.motors.actual();
            self.history = History::at_rest(self.setpoint);
        }
        if let Some(spindle) = &mut self.spindle {
            spindle.reset();
        }
    }

    /// Returns the command fields common to all motors. The drives keep power until the motors have stopped.
    pub(crate) fn for_all_drives(&self) -> Command {
        Command {
            position: 0.0,
            enable: self.power.is_commanded() || self.braking.is_some(),
            clear_fault: self.power.clears_faults(),
        }
    }

    /// Returns true if the motors report the expected state.
    pub(crate) fn is_as_commanded(&self) -> bool {
        match self.power {
            Power::Off => {
                let trouble = self.motors.trouble(self.bus_lost);
                !trouble.is_some_and(concerns_drives_without_power)
            }
            Power::Tripped { .. } => true,
            Power::Enabling { .. } => false,
            Power::On => self.motors.are_operational() && self.bus_lost.is_none(),
        }
    }

    /// Handles unexpected reports of the motors.
    pub(crate) fn watch_drives(&mut self) {
        let trouble = self.motors.trouble(self.bus_lost);
        let is_off = self.power == Power::Off;
        match self.power.watch(trouble, self.period_s) {
            Ok(follow) => self.reported |= follow,
            // without power no motor moves; braking would enable the drives
            Err(fault) if is_off => self.fail(fault),
            Err(fault) => self.trip(fault),
        }
    }

    /// Executes the cycle of the spindle, after the cycle of the motors.
    pub(crate) fn cycle_spindle(&mut self) {
        let cycled = self.spindle.as_mut().map(|spindle| spindle.cycle(self.period_s));
        self.rests &= !matches!(cycled, Some(Err(_)));
        match cycled {
            Some(Ok(ends)) => {
                if ends.orientation {
                    self.report_event(Event::Oriented);
                }
                if let Some(id) = ends.reached {
                    self.report_event(Event::SpindleReached { id });
                }
            }
            // braking would enable the drives of the axes; without power no motor moves
            Some(Err(fault)) if !self.power.is_commanded() && self.braking.is_none() => self.fail(fault),
            Some(Err(fault)) => self.brake_for(fault),
            None => {}
        }
    }

    /// Switches the power off after a failure of the servo. All planned and commanded motion is discarded.
    pub(crate) fn power_off(&mut self, time_s: f64) {
        self.abandon_profile();
        (self.braking, self.stopping, self.thread) = (None, None, None);
        while self.profiles.pop().is_ok() {}
        while self.controls.pop().is_ok() {}
        self.velocity = AxisVector::ZERO;
        self.faulted = true;
        self.reported = false;
        self.power = Power::Tripped { resets: false };
        if let Some(spindle) = &mut self.spindle {
            spindle.power_off();
        }
        self.executing = None;
        self.publish(time_s);
    }

    /// Makes the motors brake. When they are at rest, the drives lose power.
    fn trip(&mut self, fault: Fault) {
        self.power = Power::Tripped { resets: false };
        self.brake_for(fault);
    }

    /// Makes the motors brake and leave the path, because of a fault.
    pub(crate) fn brake_for(&mut self, fault: Fault) {
        self.begin_braking();
        self.leave_thread(true);
        self.fail(fault);
    }

    /// Makes each motor brake independently, unless the motors brake already.
    pub(crate) fn begin_braking(&mut self) {
        if self.braking.is_none() {
            let deceleration = self.motors.deceleration();
            self.braking = Some(Brake::new(self.setpoint, self.velocity, deceleration));
        }
    }
}
