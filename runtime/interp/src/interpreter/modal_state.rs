//! The modal state between two programs: stored, restored, and compared with the start-up state.

use std::sync::Arc;

use super::Interpreter;
use crate::codes::ModalGroup;
use crate::modal::{Modal, RetainedData};

/// The modal state between two programs, to be restored later.
#[derive(Debug, Clone)]
pub struct ModalState {
    modal: Modal,
    kept: Option<Arc<RetainedData>>,
    opens: bool,
}

impl Interpreter {
    /// Returns the modal state that a later [`Interpreter::restore`] brings back.
    pub fn modal_state(&self) -> ModalState {
        ModalState {
            modal: self.modal.clone(),
            kept: self.kept.clone(),
            opens: self.opens,
        }
    }

    /// Restores an earlier modal state, without a program. The caller must pass the transform to the path stage.
    pub fn restore(&mut self, state: ModalState) {
        self.forget_program();
        self.modal = state.modal;
        self.kept = state.kept;
        self.opens = state.opens;
    }

    /// Selects the start-up meaning of numbers for the program that begins: the unit of the settings, and
    /// positions. All other codes stay active.
    pub fn read_as_at_start_up(&mut self) {
        for group in [ModalGroup::Unit, ModalGroup::Distance] {
            if let Some(code) = self.start_up.code(group) {
                self.modal.remember(code);
            }
        }
        self.modal.unit_settled = self.start_up.unit_settled;
    }

    /// Returns the active codes that differ from those at start-up, except for motion and the return level of fixed
    /// cycles, which the next block names if it needs them.
    pub fn codes_unlike_start_up(&self) -> impl Iterator<Item = &'static str> {
        let named = [ModalGroup::Motion, ModalGroup::ReturnLevel].map(ModalGroup::number);
        let start_up: Vec<_> = self.start_up.groups().collect();
        let groups = self.modal.groups();
        let unlike = groups.filter(move |group| !named.contains(&group.0) && !start_up.contains(group));
        unlike.map(|(_, code)| code)
    }
}
