//! The modal state between two programs: stored, restored, and compared with the start-up state.

use std::sync::Arc;

use super::Interpreter;
use crate::codes::ModalGroup;
use crate::modal::{Modal, RetainedData};

/// Modal state after a program, stored to be restored later.
#[derive(Debug, Clone)]
pub struct ModalState {
    modal: Modal,
    kept: Option<Arc<RetainedData>>,
    opens: bool,
}

impl Interpreter {
    /// Returns the modal state, for a later [`Interpreter::restore`].
    pub fn modal_state(&self) -> ModalState {
        ModalState {
            modal: self.modal.clone(),
            kept: self.kept.clone(),
            opens: self.opens,
        }
    }

    /// Restores an earlier modal state, and removes the program. The caller must pass the transform to the
    /// path stage.
    pub fn restore(&mut self, state: ModalState) {
        self.forget_program();
        self.modal = state.modal;
        self.kept = state.kept;
        self.opens = state.opens;
    }

    /// Sets the unit and the distance mode to the start-up state, so that the next program reads numbers as
    /// at start-up. All other codes stay active.
    pub fn read_as_at_start_up(&mut self) {
        for group in [ModalGroup::Unit, ModalGroup::Distance] {
            if let Some(code) = self.start_up.code(group) {
                self.modal.remember(code);
            }
        }
        self.modal.unit_settled = self.start_up.unit_settled;
    }

    /// Returns the active codes that differ from those at start-up. Motion and return level of fixed cycles
    /// are omitted, because the next block names them if it needs them.
    pub fn codes_unlike_start_up(&self) -> impl Iterator<Item = &'static str> {
        let named = [ModalGroup::Motion, ModalGroup::ReturnLevel].map(ModalGroup::number);
        let start_up: Vec<_> = self.start_up.groups().collect();
        let groups = self.modal.groups();
        let unlike = groups.filter(move |group| !named.contains(&group.0) && !start_up.contains(group));
        unlike.map(|(_, code)| code)
    }
}
