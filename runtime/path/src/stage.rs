//! Blocks in, segments out.

use tandem_model::flow::{Block, Segment, Transform};
use tandem_model::settings::CoordinateSystemSettings;
use tandem_model::{Alarm, MachinePosition, WorkPosition};

/// The path stage of one coordinate system.
#[derive(Debug, Clone)]
pub struct PathStage {
    transform: Transform,
    at: MachinePosition,
}

impl PathStage {
    /// A stage at a machine position, with the identity transform.
    pub fn new(settings: &CoordinateSystemSettings, at: MachinePosition) -> Self {
        let _ = settings;
        Self {
            transform: Transform::default(),
            at,
        }
    }

    /// Takes a block; what is certain of the way comes out.
    ///
    /// # Errors
    /// An alarm when the block cannot be run; the stage is as before the block then.
    pub fn push(&mut self, block: &Block, out: &mut Vec<Segment>) -> Result<(), Alarm> {
        let _ = (block, out);
        Ok(())
    }

    /// Puts out what is held back, ending in an exact stop: an output, a stop or the end follows.
    ///
    /// # Errors
    /// None so far.
    pub fn flush(&mut self, out: &mut Vec<Segment>) -> Result<(), Alarm> {
        let _ = out;
        Ok(())
    }

    /// After a stop or reset: this position, the identity transform, nothing held back.
    pub fn restart(&mut self, at: MachinePosition) {
        self.at = at;
        self.transform = Transform::default();
    }

    /// The transform in force for the next block.
    pub fn transform(&self) -> &Transform {
        &self.transform
    }

    /// Where the last block ends.
    pub fn position(&self) -> MachinePosition {
        self.at
    }
}

/// The work position of a machine position: the transform undone.
pub fn work_position(transform: &Transform, machine: MachinePosition) -> WorkPosition {
    WorkPosition(machine.0.minus(transform.work_offset))
}
