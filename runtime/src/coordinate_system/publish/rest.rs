//! Rest positions of the axes. They are written to disk before a client can learn that the axes rest.

use plc_protocol::types::state::Execution;
use tandem_model::MachinePosition;
use tandem_store::persistence::positions::positions;

use crate::coordinate_system::CoordinateSystem;

/// Rest position that was written last; `None` if the axes moved then, or if a motor was not homed.
#[derive(Debug, Default)]
pub(crate) struct WrittenRest(Option<MachinePosition>);

impl CoordinateSystem {
    /// Writes the rest position when the axes stop or get another position, and writes when they start to move.
    pub(crate) fn note_rest(&mut self) {
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

    /// Returns true if no axis moves and no planned motion is due.
    fn rests(&self) -> bool {
        let is_held = || {
            let (execution, _) = self.state.state_word();
            execution != Execution::Active && self.state.transition().is_none()
        };
        !self.is_moving() || is_held()
    }
}
