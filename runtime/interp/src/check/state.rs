//! State of a run at one place, as far as the text shows it.

use tandem_syntax::AddressSet;

use crate::dialect::{Dialect, SpindleWord};
use crate::modal::Modal;
use crate::text_position::TextPosition;
use crate::text_values::{Locals, Values};

use super::CheckContext;

/// A program that waits for the end of a program that it has called.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Caller {
    /// Index of the waiting program among the checked programs.
    pub program: usize,
    /// Index of the block at which the waiting program continues.
    pub block: usize,
    /// Remaining repetitions of the called program; `None` if their number is unknown.
    pub repetitions: Option<u16>,
    pub locals: Locals,
}

/// Known state of a run before a block.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct CheckState {
    pub modal: Modal,
    pub position: TextPosition,
    pub values: Values,
    pub callers: Vec<Caller>,
    /// True if the program has, or may have, programmed F.
    pub has_feed: bool,
    /// True if the program has, or may have, programmed S.
    pub has_speed: bool,
    /// Number of blocks in a row that do not move in the plane of cutter compensation.
    pub at_rest: u8,
    /// True if a modal value is unknown: this state then represents several states.
    pub is_open: bool,
}

impl CheckState {
    /// Creates the state at the start of a main program.
    pub fn start_up(dialect: &Dialect, context: &CheckContext<'_>) -> Self {
        Self {
            modal: Modal::start_up_from_text(dialect, context.unit),
            position: TextPosition::unknown(),
            values: Values::default(),
            callers: Vec::new(),
            has_feed: !context.calculates
                || context
                    .default_feedrate_mm_min
                    .is_some_and(|feedrate| feedrate > 0.0),
            has_speed: !(context.calculates
                && context.has_spindle == Some(true)
                && dialect.policy.spindle_word == SpindleWord::Speed),
            at_rest: 0,
            is_open: false,
        }
    }

    /// Sets the modal state and the tool position to unknown.
    pub fn forget(&mut self) {
        self.modal.forget();
        self.position = TextPosition::unknown();
        self.has_feed = true;
        self.has_speed = true;
        self.is_open = true;
    }

    /// Sets everything to unknown that an unknown subprogram may change.
    pub fn forget_all(&mut self) {
        self.forget();
        self.values.forget_shared();
    }

    /// Sets the positions of the named axes to unknown, because their block may be skipped.
    pub fn lose(&mut self, named: AddressSet) {
        self.position.lose(named);
    }

    /// Merges another state of the same place. Returns `true` if known values are lost.
    pub fn widen(&mut self, other: &Self) -> bool {
        let mut changed = self.values.widen(&other.values);
        changed |= self.position.join(&other.position);
        if self.modal != other.modal {
            changed |= self.modal.join(&other.modal);
            self.is_open = true;
        }
        changed |= !self.has_feed && other.has_feed;
        changed |= !self.has_speed && other.has_speed;
        self.has_feed |= other.has_feed;
        self.has_speed |= other.has_speed;
        self.at_rest = self.at_rest.min(other.at_rest);
        self.is_open |= other.is_open;
        changed
    }
}
