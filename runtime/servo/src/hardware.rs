//! Hardware of a machine: the bus to its drives and its spindles, simulated or real.

use std::io;

use tandem_model::settings::CoordinateSystemSettings;

use crate::bus::{DriveBus, Feedback};
use crate::simulated_bus::SimulatedBus;
use crate::simulated_spindle::SimulatedSpindle;
use crate::spindle::Spindle;

/// Creates the hardware that moves the coordinate systems of these settings, in their order. It may take some time: it
/// is called once, before the first servo cycle, and returns running hardware, its drives not enabled. An error
/// prevents the machine from starting.
pub type HardwareFactory = Box<dyn FnOnce(&[&CoordinateSystemSettings]) -> io::Result<Hardware> + Send>;

/// Hardware of a machine.
#[derive(Debug)]
pub struct Hardware {
    /// The bus to the drives of all motors.
    pub bus: Box<dyn DriveBus>,
    /// Report of each motor before the first cycle, by its place on the bus. Missing places report the default.
    pub at_start: Vec<Feedback>,
    /// The spindle of each coordinate system, in their order; `None`, or a missing entry, for one without a
    /// spindle.
    pub spindles: Vec<Option<Box<dyn Spindle>>>,
}

impl Hardware {
    /// Creates simulated drives, at the positions of their settings, and simulated spindles.
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

    /// Returns the factory of [`Hardware::simulated`].
    pub fn simulated_factory() -> HardwareFactory {
        Box::new(|systems| Ok(Self::simulated(systems)))
    }
}
