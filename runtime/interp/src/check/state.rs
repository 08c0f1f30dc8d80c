//! State of a run at one place, as far as the text shows it.

use tandem_syntax::AddressSet;

use crate::dialect::{Dialect, SpindleWord};
use crate::modal::Modal;
use crate::text_position::TextPosition;
use crate::text_values::{Locals, Values};

use super::CheckContext;

/// A program that waits for the end of one that it calls.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Caller {
    /// Place of the program among those checked.
    pub program: usize,
    /// The block at which it continues.
    pub block: usize,
    /// Remaining repetitions of the called program. `None` if unknown.
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
    /// True if F has been programmed, or may have been.
    pub has_feed: bool,
    /// True if S has been programmed, or may have been.
    pub has_speed: bool,
    /// Blocks in a row that do not move in the plane of cutter compensation.
    pub at_rest: u8,
    /// True if a modal value is unknown: the state represents many states.
    pub is_open: bool,
}

impl CheckState {
    /// Returns the state at the start of a main program.
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

    /// Discards the modal state and the tool position.
    pub fn forget(&mut self) {
        self.modal.forget();
        self.position = TextPosition::unknown();
        self.has_feed = true;
        self.has_speed = true;
        self.is_open = true;
    }

    /// Discards everything that an unknown subprogram may change.
    pub fn forget_all(&mut self) {
        self.forget();
        self.values.forget_shared();
    }

    /// Discards the positions of the axes of a block that may be skipped.
    pub fn lose(&mut self, named: AddressSet) {
        self.position.lose(named);
    }

    /// Merges another state of the same place. Returns `true` if that loses knowledge.
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
