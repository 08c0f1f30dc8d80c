//! The servo cycles of a runtime without a servo thread.

use std::sync::Arc;
use std::time::Duration;

use plc_protocol::types::CoordinateSystemNumber;
use tandem_model::AxisVector;
use tandem_servo::{Channel, Servo};

use crate::servo_thread::cycle_after;
use crate::shared::SharedState;

/// The servo of a runtime whose caller executes the servo cycles.
pub struct ServoCycles {
    servo: Servo,
    shared: Arc<SharedState>,
}

impl std::fmt::Debug for ServoCycles {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("ServoCycles")
    }
}

impl ServoCycles {
    pub(super) fn new(servo: Servo, shared: &Arc<SharedState>) -> Self {
        let shared = Arc::clone(shared);
        Self { servo, shared }
    }

    /// Returns the time from one cycle to the next.
    pub fn period(&self) -> Duration {
        self.shared.machine.servo_period()
    }

    /// Executes servo cycles, and then wakes the tasks that an event of these cycles concerns.
    pub fn execute(&mut self, count: u64) {
        let (mut left, mut has_event) = (count, false);
        while left > 0 {
            let passed = self.servo.cycles_to_pass(left - 1);
            self.servo.pass(passed);
            left -= passed + 1;
            has_event |= cycle_after(&mut self.servo, 0, 1, &self.shared.servo);
        }
        if has_event {
            self.shared.wake_all();
        }
    }

    /// Returns the commanded position of each coordinate system, in mm or degrees.
    pub fn setpoints(&self) -> impl Iterator<Item = (CoordinateSystemNumber, AxisVector)> {
        let systems = self.shared.machine.coordinate_systems.iter();
        let numbers = systems.map(|system| system.settings.number);
        numbers.zip(self.servo.channels().iter().map(Channel::setpoint))
    }
}
