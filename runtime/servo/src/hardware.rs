//! Hardware of a machine, simulated or real: the bus to its drives, and its spindles.

use std::io;

use tandem_model::settings::CoordinateSystemSettings;

use crate::bus::{DriveBus, Feedback};
use crate::simulated_bus::SimulatedBus;
use crate::simulated_spindle::SimulatedSpindle;
use crate::spindle::Spindle;

/// Function that creates the hardware for the coordinate systems of these settings, in their order. The
/// runtime calls it once, before the first servo cycle; it may take some time. It returns running hardware
/// with drives that are not enabled. An error prevents the machine from starting.
pub type HardwareFactory = Box<dyn FnOnce(&[&CoordinateSystemSettings]) -> io::Result<Hardware> + Send>;

/// Hardware of a machine.
#[derive(Debug)]
pub struct Hardware {
    /// The bus to the drives of all motors.
    pub bus: Box<dyn DriveBus>,
    /// Report of each motor before the first cycle, by the motor's place on the bus. A motor without an entry
    /// has the default report.
    pub at_start: Vec<Feedback>,
    /// The spindle of each coordinate system, in their order. `None`, or a missing entry, means no spindle.
    pub spindles: Vec<Option<Box<dyn Spindle>>>,
}

impl Hardware {
    /// Creates simulated drives at the positions of their settings, and simulated spindles.
    pub fn simulated(systems: &[&CoordinateSystemSettings]) -> Self {
        let spindles = systems.iter().map(|system| {
            let spindle = SimulatedSpindle::new(system.spindle.as_ref()?, system.servo_period_s);
            Some(Box::new(spindle) as Box<dyn Spindle>)
        });
        let bus = SimulatedBus::new(systems.iter().copied());
        Self {
            at_start: bus.feedback(),
            bus: Box::new(bus),
            spindles: spindles.collect(),
        }
    }

    /// Returns a factory that creates simulated hardware.
    pub fn simulated_factory() -> HardwareFactory {
        Box::new(|systems| Ok(Self::simulated(systems)))
    }
}
