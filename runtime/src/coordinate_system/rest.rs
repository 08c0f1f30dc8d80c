//! Rest positions of the axes: written to disk before any client can learn that the axes rest.

use plc_api::types::state::Execution;
use tandem_model::MachinePosition;

use super::CoordinateSystem;
use crate::persistence::positions::positions;

/// The rest position written last; `None` if the axes move, or if a motor is not homed.
#[derive(Debug, Default)]
pub(super) struct WrittenRest(Option<MachinePosition>);

impl CoordinateSystem {
    /// Writes the rest position of the axes when they stop or are placed elsewhere, and the start of their motion.
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

    /// Returns true while no axis moves or is about to move.
    fn rests(&self) -> bool {
        let is_held = || {
            let (execution, _) = self.state.state_word();
            execution != Execution::Active && self.state.transition().is_none()
        };
        !self.is_moving() || is_held()
    }
}
