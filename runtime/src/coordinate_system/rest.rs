//! Where the axes rest: written before anybody can hear that they have come to rest.

use plc_api::types::state::Execution;
use tandem_model::MachinePosition;

use super::CoordinateSystem;
use crate::persistence::positions::positions;

/// What was written last: where the axes rest, or `None`: they move, or a motor is not homed.
#[derive(Debug, Default)]
pub(super) struct WrittenRest(Option<MachinePosition>);

impl CoordinateSystem {
    /// Writes where the axes rest, if they have come to rest or have been placed elsewhere, and that they move when they begin
    /// to.
    pub(super) fn note_rest(&mut self) {
        let journal = &self.context.shared.journal;
        if !journal.is_on_disk() {
            return;
        }
        let at = self.rests().then(|| self.context.view.homed_position()).flatten();
        if at == self.rest.0 {
            return;
        }
        self.rest = WrittenRest(at);
        let settings = &self.context.configured.settings;
        let positions = at.map(|at| positions(settings, at));
        journal.note_rest(self.context.number, positions.as_ref());
    }

    /// True while no axis moves and none is about to.
    fn rests(&self) -> bool {
        let is_held = || {
            let (execution, _) = self.state.state_word();
            execution != Execution::Active && self.state.transition().is_none()
        };
        !self.is_moving() || is_held()
    }
}
