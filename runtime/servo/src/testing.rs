//! Machines and profiles for the tests of this crate.

use tandem_model::profile::{Law, Profile, Stretch};
use tandem_model::settings::{MotorKind, MotorSettings};
use tandem_model::{AxisVector, Origin};

/// Returns a spindle: 4000 r/min at most, 1000 r/min per second, orientation at 60 r/min to 90 degrees.
pub(crate) fn spindle() -> MotorSettings {
    MotorSettings {
        kind: MotorKind::Spindle,
        max_velocity: 4000.0,
        max_acceleration: 1000.0,
        orientation_velocity: 60.0,
        orientation_position: 90.0,
        ..motor(5)
    }
}

/// Returns a motor: 500 mm/s, 5000 mm/s^2, in position within 0.01 mm in 2 s, no lag.
pub(crate) fn motor(number: u16) -> MotorSettings {
    MotorSettings::new(number, MotorKind::Linear, 500.0, 5000.0)
}

/// Returns a dwell of one second at position 0.
pub(crate) fn dwell(segment: u64) -> Profile {
    Profile {
        segment,
        epoch: 0,
        origin: Origin::default(),
        law: Law::Rest {
            at: AxisVector::ZERO,
            stretch: Stretch::whole(1.0),
        },
        duration_s: 1.0,
        exact_stop: true,
    }
}
