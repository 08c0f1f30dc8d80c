//! The last setpoints of a channel, by whose differences the next one is limited.

use tandem_model::AxisVector;

/// Number of cycles after a change of the factor in which the differences of the setpoints are checked.
const AFTER_CHANGE: u32 = 4;

/// Setpoints before the last one, the last first.
#[derive(Debug, Clone, Copy)]
pub(crate) struct History {
    before: [AxisVector; 2],
    /// Number of cycles in which the factor of the next cycle is limited.
    checked: u32,
}

impl History {
    /// Creates the history of a machine at rest.
    pub(crate) fn at_rest(setpoint: AxisVector) -> Self {
        Self {
            before: [setpoint; 2],
            checked: 0,
        }
    }

    /// Adds the setpoint of the last cycle.
    pub(crate) fn push(&mut self, setpoint: AxisVector) {
        self.before = [setpoint, self.before[0]];
    }

    /// Replaces all setpoints.
    pub(crate) fn replace(&mut self, before: [AxisVector; 2]) {
        self.before = before;
    }

    /// Returns the setpoints before the last one, the last first.
    pub(crate) fn before(&self) -> [AxisVector; 2] {
        self.before
    }

    /// Returns true if the factor of the next cycle is limited.
    pub(crate) fn is_checked(&self) -> bool {
        self.checked > 0
    }

    /// Ends the check of one cycle.
    pub(crate) fn pass_check(&mut self) {
        self.checked = self.checked.saturating_sub(1);
    }

    /// Checks the next cycles, because another plan begins.
    pub(crate) fn check(&mut self) {
        self.checked = AFTER_CHANGE;
    }
}
